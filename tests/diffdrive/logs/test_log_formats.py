"""Files of logs: each format and dialect gives the same log."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from diffdrive.errors import LogError
from diffdrive.logs import ColumnMapping, read_log
from tests.support.written_log import (
    COMMAND,
    NAMES,
    PLAIN,
    POSITION,
    REFERENCE,
    TIME,
    N,
    assert_is_the_log,
    in_units,
    rows,
    write_v73,
)

TWINCAT = "\n".join(
    [
        "Name\tScope Project",
        "File\tC:\\scope\\axis.svdx",
        "Starttime of export\t132959505843760000\t02. Mai 2022\t13:56:24",
        "Endtime of export\t132959505853760000\t02. Mai 2022\t13:56:25",
        "",
        "\t".join(f"Name\t{name}" for name in ("Set", "Act", "Trq")),
        "\t".join(["SymbolComment\t"] * 3),
        "\t".join(["Data-Type\tREAL64"] * 3),
        "\t".join(["SampleTime[ms]\t1"] * 3),
        "\t".join(["VariableSize\t8"] * 3),
        "\t".join(["SymbolBased\tTRUE"] * 3),
        "\t".join(["Offset\t0"] * 3),
        "\t".join(["ScaleFactor\t1"] * 3),
        "Unit\tmm\tUnit\tum\tUnit\tkN",
        "",
        "",
    ]
)
_T, _R, _P, _C = in_units()
TWINCAT_ROWS = rows("\t", ",", columns=(_T, _R, _T, _P, _T, _C))
SCOPE = ColumnMapping({"reference": "Set", "position": "Act", "command": "Trq"})

DIALECTS = {
    "plain": NAMES + "\n" + rows(),
    "windows line ends": NAMES + "\r\n" + rows(end="\r\n"),
    "old Mac line ends": NAMES + "\r" + rows(end="\r"),
    "byte order mark": "\ufeff" + NAMES + "\n" + rows(),
    "other case": NAMES.upper() + "\n" + rows(),
    "space after the comma": NAMES.replace(",", ", ") + "\n" + rows(", "),
    "tabs": NAMES.replace(",", "\t") + "\n" + rows("\t"),
    "semicolons": NAMES.replace(",", ";") + "\n" + rows(";"),
    "decimal comma": NAMES.replace(",", ";") + "\n" + rows(";", ","),
    "decimal comma, tabs": NAMES.replace(",", "\t") + "\n" + rows("\t", ","),
    "decimal comma, quoted": NAMES + "\n" + '"' + rows('","', ",", end='"\n"').removesuffix('"'),
    "white space": NAMES.replace(",", "   ") + "\n" + rows("   "),
    "white space, units": "time [s]  reference [m] position [m] command [N]\n" + rows(" "),
    "white space, preamble": "A log of axis X\n\n" + NAMES.replace(",", " ") + "\n" + rows(" "),
    "white space, unit row": NAMES.replace(",", " ") + "\nunits ms mm um kN\n" + rows(" ", columns=in_units()),
    "indented": "  " + NAMES.replace(",", " ") + "\n" + "  " + rows("  ", end="\n  "),
    "quoted header": '"time","reference","position","command"\n' + rows(),
    "comments": "# a log\n# of 4 columns\n" + NAMES + "\n" + rows().replace("\n", "\n# noise\n", 3),
    "commented header": "# " + NAMES + "\n" + rows(),
    "blank lines": "\n\n" + NAMES + "\n\n" + rows() + "\n\n",
    "trailing delimiter": NAMES + ",\n" + rows(end=",\n"),
    "trailing delimiter only in rows": NAMES + "\n" + rows(end=",\n"),
    "preamble": "Axis X\nRecorded;2024-01-01\nPeriod [ms];1\n\n" * 700 + NAMES + "\n" + rows(),
    "units in brackets": "time [ms],reference [mm],position [um],command [kN]\n" + rows(columns=in_units()),
    "units in parentheses": "time (ms),reference (mm),position(um),command (kN)\n" + rows(columns=in_units()),
    "units as suffix": "time_ms,reference_mm,position_um,command_kN\n" + rows(columns=in_units()),
    "unit row": NAMES + "\nms,mm,um,kN\n" + rows(columns=in_units()),
    "unit row in brackets": NAMES + "\n[ms],[mm],[um],[kN]\n" + rows(columns=in_units()),
    "unit row with a unit of no channel": NAMES + ",speed\nms,mm,um,kN,rpm\n" + rows(columns=(*in_units(), TIME)),
    "unit row, mostly of no channel": NAMES
    + ",a,b,c,d,e\nms,mm,um,kN,rpm,%,bar,Nm,inc\n"
    + rows(columns=(*in_units(), *5 * [TIME])),
    "unit row with a label": "," + NAMES + '\nunit,"ms","mm","um","kN"\n,' + rows(end="\n,", columns=in_units())[:-1],
    "label above the row numbers": "signal," + NAMES + "\n[unit],ms,mm,um,kN\n" + rows(columns=(TIME, *in_units())),
    "unit row longer by its label": NAMES + "\nUnits:,ms,mm,um,kN\n" + rows(columns=in_units()),
    "preamble as wide as the table": "Machine,Axis X,s,kN\n" + NAMES + "\n" + rows(),
    "a text column": NAMES + ",state\n" + rows(end=",RUN\n"),
    "EOF mark": NAMES + "\n" + rows() + "EOF\n",
}


@pytest.mark.parametrize("text", DIALECTS.values(), ids=DIALECTS.keys())
def test_csv_dialects(text, tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(text.encode("utf-8"))
    assert_is_the_log(read_log(path))


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8", "utf-16"])
def test_csv_encodings(encoding, tmp_path):
    path = tmp_path / "log.TXT"
    header = "time [s],reference [m],position [µm],command [N],Öltemperatur [°C]\n"
    columns = (TIME, REFERENCE, 1e6 * POSITION, COMMAND, np.full(N, 21.5))
    path.write_bytes((header + rows(columns=columns)).encode(encoding))
    log = read_log(path, mapping=ColumnMapping({"temperature": "Öltemperatur"}))
    assert_is_the_log(log)
    assert set(log.temperature) == {21.5}


@pytest.mark.parametrize("end", ["", "EOF\n"])
def test_twincat_scope(end, tmp_path):
    path = tmp_path / "scope.csv"
    path.write_text(TWINCAT + TWINCAT_ROWS + end)
    assert_is_the_log(read_log(path, mapping=SCOPE, rate=1000.0))
    shared = TWINCAT.replace("\tName\t", "\t").replace("\tUnit\t", "\t").replace("Data-Type\tREAL64\t", "")
    path.write_text(shared + rows("\t", ",", columns=(_T, _R, _P, _C)) + end)
    assert_is_the_log(read_log(path, mapping=SCOPE))


def test_twincat_scope_full_time_stamps_keep_their_100_ns(tmp_path):
    path = tmp_path / "scope.csv"
    ticks = 132959505843760000 + np.rint(TIME * 1e7).astype(np.int64)
    body = "\n".join(f"{t}\t{r!r}\t{t}\t{p!r}\t{t}\t{c!r}" for t, r, p, c in zip(ticks, *COLUMN_LISTS, strict=True))
    path.write_text(TWINCAT.replace("mm", "m").replace("um", "m").replace("kN", "N") + body + "\n")
    log = read_log(path, mapping=ColumnMapping(SCOPE.columns, {"time": "100 ns"}))
    np.testing.assert_allclose(log.time, TIME, atol=1e-12)
    assert any("counted from 132959505843760000" in note for note in log.notes)


COLUMN_LISTS = [values.tolist() for values in (REFERENCE, POSITION, COMMAND)]


def test_columns_without_a_header_are_numbered(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(rows())
    mapping = ColumnMapping({"time": "1", "reference": "2", "position": "3", "command": "4"})
    assert_is_the_log(read_log(path, mapping=mapping))
    with pytest.raises(LogError, match="the file has '1', '2', '3', '4'"):
        read_log(path)


@pytest.mark.parametrize(
    ("stamp", "first"),
    [
        ("2024-05-01T12:00:0{:.3f}", "2024-05-01"),
        ("12:00:0{:.3f}", "12:00:00.000"),
        ("9:00:0{:.3f}", "9:00:00.000"),
        ("26.03.2024 12:00:0{:.3f}", "26.03.2024 12:00:00.000"),
        ("1.3.2024 9:59:5{:.3f}", "1.3.2024 9:59:50.000"),
    ],
)
def test_dates_and_times_of_day_count_from_the_first(stamp, first, tmp_path):
    path = tmp_path / "log.csv"
    texts = [stamp.format(t) for t in TIME]
    body = "\n".join(f"{t},{r!r},{p!r},{c!r}" for t, r, p, c in zip(texts, *COLUMN_LISTS, strict=True))
    path.write_text(NAMES + "\n" + body + "\n")
    log = read_log(path)
    assert_is_the_log(log)
    assert any(first in note for note in log.notes)


def test_a_last_line_that_is_cut_off_is_left_out(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(NAMES + "\n" + rows() + "0.4,0.1")
    log = read_log(path)
    assert_is_the_log(log)
    assert log.notes == (
        f"line {N + 2}, the last, has 2 columns, the other rows have 4: the file is cut off there, and this line is "
        "left out; if the log was longer, copy or export it again",
    )


@pytest.mark.parametrize("cut", ["0.4,0.1,0.2,-12", "0.4,0.1,0.2,"])
def test_a_last_line_without_its_end_is_left_out_since_its_last_number_may_be_cut(cut, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(NAMES + "\n" + rows() + cut)
    log = read_log(path)
    assert_is_the_log(log)
    assert log.notes == (f"line {N + 2}, the last, has no line end: its last number may be cut off; left out",)
    path.write_text(NAMES + "\n" + cut)
    with pytest.raises(LogError, match=r"has one row, and that is cut off|has no rows of numbers"):
        read_log(path)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\n# end of the log", "\n\n", "\n\x00\x00", "\nEOF"])
def test_a_last_line_with_its_end_is_a_row_whatever_follows(end, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(NAMES + "\n" + rows().rstrip("\n") + end)
    log = read_log(path)
    assert_is_the_log(log)
    assert log.notes == ()


def test_stamps_may_begin_late_and_end_in_commas(tmp_path):
    path = tmp_path / "log.csv"
    texts = ["", *(f"26.03.2024 9:00:0{t:.3f}".replace(".", ",").replace(",", ".", 2) for t in TIME[1:])]
    body = "\n".join(f"{t};{r!r};{p!r};{c!r}" for t, r, p, c in zip(texts, *COLUMN_LISTS, strict=True))
    path.write_text(NAMES.replace(",", ";") + "\n" + body + "\n")
    log = read_log(path)
    np.testing.assert_allclose(log.time, TIME[1:] - TIME[1], atol=1e-12)
    assert "time is counted from its first stamp, 26.03.2024 9:00:00,001" in log.notes


# --- MAT --------------------------------------------------------------------------------------------------------------


def recorded(name, data, unit) -> tuple:
    return (name, data.reshape(1, -1), unit)


def dspace() -> dict:
    signals = [("pos", POSITION, "m"), ("cmd", COMMAND, "N"), ("ref", REFERENCE, "m")]
    fields = [("Name", "O"), ("Data", "O"), ("Unit", "O")]
    return {
        "X": np.array([recorded("t", TIME, "s")], dtype=fields),
        "Y": np.array([recorded(*signal) for signal in signals], dtype=fields),
        "Description": "recorded",
    }


def simulink() -> dict:
    signals = [
        (np.column_stack([REFERENCE, POSITION]), "axis", 2.0),
        (COMMAND.reshape(-1, 1), "command", 1.0),
    ]
    fields = [("values", "O"), ("label", "O"), ("dimensions", "O")]
    return {"time": TIME.reshape(-1, 1), "signals": np.array(signals, dtype=fields)}


STRUCTURES = {
    "variables": (PLAIN | {"kp": 160.18, "title": "axis", "none": np.zeros((0, 0))}, ColumnMapping()),
    "row vectors": ({name: values.reshape(1, -1) for name, values in PLAIN.items()}, ColumnMapping()),
    "single structure": ({"log": {"axis": PLAIN}}, ColumnMapping()),
    "paths": (
        {"rig": {"clock": TIME, "x": {"ref": REFERENCE, "act": POSITION}, "u": COMMAND}},
        ColumnMapping({"time": "rig.clock", "reference": "rig.x.ref", "position": "rig.x.act", "command": "u"}),
    ),
    "matrix": (
        {"tout": TIME, "yout": np.column_stack([REFERENCE, POSITION, COMMAND])},
        ColumnMapping({"time": "tout", "reference": "yout(1)", "position": "yout(2)", "command": "yout(3)"}),
    ),
    "dSPACE": (
        {"rec": dspace()},
        ColumnMapping({"reference": "rec.Y.ref", "position": "rec.Y.pos", "command": "rec.Y.cmd"}),
    ),
    "Simulink": ({"out": simulink()}, ColumnMapping({"reference": "out.axis(1)", "position": "axis(2)"})),
    "ends of paths": (
        {"rec": dspace()},
        ColumnMapping({"time": "X.time", "reference": "Y.ref", "position": "Y.pos", "command": "Y.cmd"}),
    ),
    "units": ({name: 1e3 * values for name, values in PLAIN.items()} | {"units": dict.fromkeys(PLAIN, "")}, None),
}
STRUCTURES["units"] = (
    {"time": 1e3 * TIME, "reference": 1e3 * REFERENCE, "position": 1e6 * POSITION, "command": 1e-3 * COMMAND}
    | {"units": {"time": "ms", "reference": "mm", "position": "um", "command": "kN"}},
    ColumnMapping(),
)


@pytest.mark.parametrize("version", ["5", "7.3"])
@pytest.mark.parametrize("shape", [(1, 2), (2, 1), (2, 2), (500, 2)])
def test_simulink_matrices_have_time_last(shape, version, tmp_path):
    path = tmp_path / "log.mat"
    axis = np.zeros((*shape, N))
    first, last = (0, 0), tuple(size - 1 for size in shape)
    axis[first], axis[last] = REFERENCE, POSITION
    signals = [(axis, "axis", 2.0), (COMMAND.reshape(1, 1, N), "command", 1.0)]
    held = {"time": TIME.reshape(-1, 1), "signals": np.array(signals, dtype=simulink()["signals"].dtype)}
    if version == "7.3":
        write_v73(path, {"out": held})
    else:
        scipy.io.savemat(path, {"out": held})
    names = [f"axis({i + 1},{j + 1})" if min(shape) > 1 else f"axis({max(i, j) + 1})" for i, j in (first, last)]
    assert_is_the_log(read_log(path, mapping=ColumnMapping(dict(zip(("reference", "position"), names, strict=True)))))


@pytest.mark.parametrize("version", ["4", "5", "7.3"])
@pytest.mark.parametrize("structure", STRUCTURES)
def test_mat_structures(structure, version, tmp_path):
    path = tmp_path / "log.mat"
    variables, mapping = STRUCTURES[structure]
    if version == "7.3":
        write_v73(path, variables)
    elif version == "4" and structure not in ("row vectors", "matrix"):
        pytest.skip("v4 has no structures")
    else:
        scipy.io.savemat(path, variables, format=version, oned_as="row")
    assert_is_the_log(read_log(path, mapping=mapping))


# --- Parquet ----------------------------------------------------------------------------------------------------------


def test_parquet_types(tmp_path):
    path = tmp_path / "log.parquet"
    fields = [
        pa.field("time", pa.timestamp("us")),
        pa.field("reference", pa.float64()),
        pa.field("position", pa.int64(), metadata={"unit": "nm"}),
        pa.field("command", pa.float64(), nullable=True),
        pa.field("state", pa.string()),
    ]
    stamps = (1_700_000_000_000_000 + np.rint(1e6 * TIME)).astype("datetime64[us]")
    counts = np.rint(1e9 * POSITION).astype(np.int64)
    data = [stamps, REFERENCE, counts, [None, *COMMAND[1:]], ["RUN"] * N]
    pq.write_table(pa.table([pa.array(one) for one in data], schema=pa.schema(fields)), path)
    log = read_log(path)
    assert len(log.time) == N - 1
    np.testing.assert_allclose(log.position, POSITION[1:], atol=1e-15)
    np.testing.assert_allclose(np.diff(log.time), 1e-3, atol=1e-6)
