"""Files of logs: each format and dialect gives the same log, and each broken file one line that says what to mend."""

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from diffdrive.errors import LogError
from diffdrive.logs import Log, Mapping, read_log, read_logs

N = 400
TIME = np.arange(N) * 1e-3
REFERENCE = 0.02 * np.sin(2 * np.pi * TIME)
POSITION = np.round(REFERENCE - 1e-6, 9)
COMMAND = np.round(100 * np.cos(2 * np.pi * TIME), 6)
COLUMNS = {"time": TIME, "reference": REFERENCE, "position": POSITION, "command": COMMAND}


def assert_is_the_log(log: Log, *, exact: bool = False) -> None:
    for name, values in COLUMNS.items():
        scale = 0.0 if exact else 1e-12 * np.max(np.abs(values))
        np.testing.assert_allclose(log.channels[name], values, rtol=0, atol=scale, err_msg=name)
    assert log.gaps == ()


def rows(delimiter=",", decimal=".", end="\n", columns=tuple(COLUMNS.values())) -> str:
    lines = (delimiter.join(repr(float(v)) for v in row).replace(".", decimal) for row in zip(*columns, strict=True))
    return end.join(lines) + end


def in_units() -> tuple[np.ndarray, ...]:
    """The log in ms, mm, um and kN."""
    return 1e3 * TIME, 1e3 * REFERENCE, 1e6 * POSITION, 1e-3 * COMMAND


NAMES = "time,reference,position,command"
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
SCOPE = Mapping({"reference": "Set", "position": "Act", "command": "Trq"})

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
    log = read_log(path, Mapping({"temperature": "Öltemperatur"}))
    assert_is_the_log(log)
    assert set(log.temperature) == {21.5}


@pytest.mark.parametrize("end", ["", "EOF\n"])
def test_twincat_scope(end, tmp_path):
    path = tmp_path / "scope.csv"
    path.write_text(TWINCAT + TWINCAT_ROWS + end)
    assert_is_the_log(read_log(path, SCOPE, rate=1000.0))
    shared = TWINCAT.replace("\tName\t", "\t").replace("\tUnit\t", "\t").replace("Data-Type\tREAL64\t", "")
    path.write_text(shared + rows("\t", ",", columns=(_T, _R, _P, _C)) + end)
    assert_is_the_log(read_log(path, SCOPE))


def test_twincat_scope_full_time_stamps_keep_their_100_ns(tmp_path):
    path = tmp_path / "scope.csv"
    ticks = 132959505843760000 + np.rint(TIME * 1e7).astype(np.int64)
    body = "\n".join(f"{t}\t{r!r}\t{t}\t{p!r}\t{t}\t{c!r}" for t, r, p, c in zip(ticks, *COLUMN_LISTS, strict=True))
    path.write_text(TWINCAT.replace("mm", "m").replace("um", "m").replace("kN", "N") + body)
    log = read_log(path, Mapping(SCOPE.columns, {"time": "100 ns"}))
    np.testing.assert_allclose(log.time, TIME, atol=1e-12)
    assert any("counted from 132959505843760000" in note for note in log.notes)


COLUMN_LISTS = [values.tolist() for values in (REFERENCE, POSITION, COMMAND)]


def test_columns_without_a_header_are_numbered(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(rows())
    mapping = Mapping({"time": "1", "reference": "2", "position": "3", "command": "4"})
    assert_is_the_log(read_log(path, mapping))
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
    path.write_text(NAMES + "\n" + body)
    log = read_log(path)
    assert_is_the_log(log)
    assert any(first in note for note in log.notes)


def test_a_last_line_that_is_cut_off_is_left_out(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(NAMES + "\n" + rows() + "0.4,0.1")
    log = read_log(path)
    assert_is_the_log(log)
    assert log.notes == (f"line {N + 2}, the last, is cut off and was left out",)


def test_stamps_may_begin_late_and_end_in_commas(tmp_path):
    path = tmp_path / "log.csv"
    texts = ["", *(f"26.03.2024 9:00:0{t:.3f}".replace(".", ",").replace(",", ".", 2) for t in TIME[1:])]
    body = "\n".join(f"{t};{r!r};{p!r};{c!r}" for t, r, p, c in zip(texts, *COLUMN_LISTS, strict=True))
    path.write_text(NAMES.replace(",", ";") + "\n" + body)
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


PLAIN = {name: values.reshape(-1, 1) for name, values in COLUMNS.items()}
STRUCTURES = {
    "variables": (PLAIN | {"kp": 160.18, "title": "axis", "none": np.zeros((0, 0))}, Mapping()),
    "row vectors": ({name: values.reshape(1, -1) for name, values in PLAIN.items()}, Mapping()),
    "single structure": ({"log": {"axis": PLAIN}}, Mapping()),
    "paths": (
        {"rig": {"clock": TIME, "x": {"ref": REFERENCE, "act": POSITION}, "u": COMMAND}},
        Mapping({"time": "rig.clock", "reference": "rig.x.ref", "position": "rig.x.act", "command": "u"}),
    ),
    "matrix": (
        {"tout": TIME, "yout": np.column_stack([REFERENCE, POSITION, COMMAND])},
        Mapping({"time": "tout", "reference": "yout(1)", "position": "yout(2)", "command": "yout(3)"}),
    ),
    "dSPACE": (
        {"rec": dspace()},
        Mapping({"reference": "rec.Y.ref", "position": "rec.Y.pos", "command": "rec.Y.cmd"}),
    ),
    "Simulink": ({"out": simulink()}, Mapping({"reference": "out.axis(1)", "position": "axis(2)"})),
    "units": ({name: 1e3 * values for name, values in PLAIN.items()} | {"units": dict.fromkeys(PLAIN, "")}, None),
}
STRUCTURES["units"] = (
    {"time": 1e3 * TIME, "reference": 1e3 * REFERENCE, "position": 1e6 * POSITION, "command": 1e-3 * COMMAND}
    | {"units": {"time": "ms", "reference": "mm", "position": "um", "command": "kN"}},
    Mapping(),
)


def write_v73(path, variables: dict) -> None:
    """A v7.3 file as MATLAB lays it out: arrays transposed, texts as UTF-16 codes, structure arrays as references."""

    def put(parent, name, value):
        if isinstance(value, dict):
            group = parent.create_group(name)
            group.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, one in value.items():
                put(group, key, one)
        elif isinstance(value, np.ndarray) and value.dtype.names:
            if len(value) == 1:
                return put(parent, name, {field: value[field][0] for field in value.dtype.names})
            group = parent.create_group(name)
            group.attrs["MATLAB_class"] = np.bytes_("struct")
            for field in value.dtype.names:
                made = [put(refs, f"{name}_{field}_{k}", one) for k, one in enumerate(value[field])]
                group.create_dataset(field, data=np.array([[one.ref] for one in made], dtype=h5py.ref_dtype))
        elif isinstance(value, str):
            data = parent.create_dataset(name, data=np.array([[ord(c)] for c in value], dtype=np.uint16))
            data.attrs["MATLAB_class"] = np.bytes_("char")
            return data
        else:
            array = np.atleast_2d(np.asarray(value, dtype=float))
            if not array.size:
                data = parent.create_dataset(name, data=np.array(array.shape, dtype=np.uint64))
                data.attrs["MATLAB_empty"] = np.uint8(1)
            else:
                data = parent.create_dataset(name, data=array.T)
            data.attrs["MATLAB_class"] = np.bytes_("double")
            return data

    with h5py.File(path, "w", userblock_size=512) as file:
        refs = file.create_group("#refs#")
        for name, value in variables.items():
            put(file, name, value)
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan  1 00:00:00 2024 HDF5 schema 1.00 ."
    with open(path, "r+b") as file:
        file.write(header.ljust(124, b" ") + b"\x00\x02IM")


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
    assert_is_the_log(read_log(path, Mapping(dict(zip(("reference", "position"), names, strict=True)))))


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
    assert_is_the_log(read_log(path, mapping))


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


# --- what cannot be read ----------------------------------------------------------------------------------------------


def spoilt(line: int, text: str) -> str:
    lines = (NAMES + "\n" + rows()).splitlines()
    lines[line - 1] = text
    return "\n".join(lines)


FIRST, LAST = np.where(TIME < 0.2, 1.0, np.nan), np.where(TIME < 0.2, np.nan, 1.0)
BAD_CSV = {
    "empty": ("", "is empty"),
    "blank": ("\n \n", "is empty"),
    "only a header": (NAMES + "\n", "no rows of numbers, only text such as 'time,reference"),
    "prose": ("Dear customer,\nthe log, as asked,\nis attached\n", "no rows of numbers"),
    "one row": (NAMES + "\n0,0,0,0\n", "1 samples with a time stamp; a log needs at least 3"),
    "two rows": (NAMES + "\n0,0,0,0\n1,1,1,1\n", "2 samples"),
    "a word in a cell": (spoilt(57, "0.055,0.1,oops,3"), "line 57, column 'position': 'oops' is not a number"),
    "a word in the first row": (spoilt(2, "0,0.1,oops,3"), "line 2, column 'position': 'oops'"),
    "thousands": (
        NAMES.replace(",", ";") + "\n" + rows(";", ",").replace("\n", "\n0,0005;1.234,5;0,0;0,0\n", 1),
        "line 3, column 'reference': '1.234,5' is not a number",
    ),
    **{
        f"thousands, {name}": (
            delimiter.join(["time", "position", "command"]) + "\n"
            + rows(delimiter, decimal, columns=(TIME, TIME, COMMAND))
            + last,
            f"line {N + 2}, column 'position': '{cell}' is not a number where the decimal sign is '{decimal}'; "
            "remove the thousands separators",
        )
        for name, delimiter, decimal, cell, last in (
            ("points beside decimal commas", ";", ",", "1.004", "0,4;1.004;7\n"),
            ("points beside decimal commas, tabs", "\t", ",", "-1.004", "0,4\t-1.004\t7\n"),
            ("commas beside decimal points", ";", ".", "1,004", "0.4;1,004;7\n"),
            ("commas in quotes", ",", ".", "12,004", '0.4,"12,004",7\n'),
            ("commas and a decimal point", ";", ".", "1,004.5", "0.4;1,004.5;7\n"),
            ("millions", ";", ",", "1.004.000", "0,4;1.004.000;7\n"),
        )
    },
    "thousands in all rows of one column": (
        "time;position;command\n" + "".join(f"{k}.5;1,{k:03};{k}\n" for k in range(100, 200)),
        "line 2, column 'position': '1,100' is not a number where the decimal sign is '.'; remove the thousands",
    ),
    "thousands in all rows of two columns": (
        "time;position;command\n" + "".join(f"{k},5;1.{k:03};2.{k:03}\n" for k in range(100, 200)),
        "line 2, column 'position': '1.100' is not a number where the decimal sign is ','; remove the thousands",
    ),
    "thousands, all but some with decimals": (
        "time;position;command\n" + "".join(f"{k};1.{k},5;1.{k}\n" for k in range(100, 200)),
        "line 2, column 'position': '1.100,5' is not a number where the decimal sign is ','; remove the thousands",
    ),
    "two decimal signs": (
        "time;position;command\n" + rows(";", columns=(TIME, POSITION, COMMAND)) + "0.4;0,5;7\n",
        f"line {N + 2}, column 'position': '0,5' is not .* write decimals with one sign",
    ),
    "decimal comma without quotes": (NAMES + "\n" + rows(",", ","), "decimal comma without quotes; export with semico"),
    "decimal comma without quotes, whole times": (
        "time,position,command\n" + rows(columns=(TIME, POSITION, COMMAND)).replace("0.0,", "0,").replace(".", ","),
        "cells below the 3 names in line 1: decimal comma without quotes",
    ),
    "decimal comma without quotes, one column": (
        "time,position,command\n" + "".join(f"{k},{k % 7},0,{k:03}\n" for k in range(50)),
        "line 2 has 4 cells below the 3 names in line 1: decimal comma without quotes; export with semicolons or",
    ),
    "a header that is too short": ("time,position,command\n" + rows(), "no column is called"),
    "a unit of no channel": (
        NAMES + "\ns,mm,um,%\n" + rows(),
        r"column 'command': '%' is no unit of the command; correct .* \[units\] command = \"0\.05 N\"",
    ),
    "a label for a unit": (NAMES + "\nunit,mm,um,N\n" + rows(), r"column 'time': 'unit' is no .* time = \"ms\""),
    "stamps of another form": (
        NAMES + "\n" + "".join(f"3/26/24 9:00:00.{k:03},0.1,0.2,{k}\n" for k in range(100)),
        r"line 2, column 'time': '3/26/24 9:00:00\.000' is no time that can be read; export it as .* 26\.03\.2024",
    ),
    "minutes and seconds": (
        NAMES + "\n" + "".join(f"00:00.{k:03},0.1,0.2,{k}\n" for k in range(100)),
        r"'00:00\.000' is no time that can be read; export it as seconds or counts, 9:00:00\.000, ",
    ),
    "a stamp that is none": (
        NAMES + "\n9:00:00.000,0,0,0\n9:00:00.001,0,0,0\n9:00:0o.002,0,0,0\n9:00:00.003,0,0,0\n",
        r"line 4, column 'time': '9:00:0o\.002' is no time like '9:00:00\.000'; correct or empty this cell",
    ),
    "a day that is none": (
        NAMES + "\n28.02.2023 9:00:00,0,0,0\n29.02.2023 9:00:00,0,0,0\n1.3.2023 9:00:00,0,0,0\n",
        r"line 3, column 'time': '29\.02\.2023 9:00:00' is no time like '28\.02\.2023",
    ),
    "short row": (spoilt(57, "0.055,0.1"), "line 57 has 2 columns, the other rows have 4"),
    "long row": (spoilt(57, "0.055,0.1,0,0,0"), "line 57 has 5 columns, the other rows have 4"),
    "no position": (NAMES.replace("position", "positoin") + "\n" + rows(), r"\[columns\] position = \"positoin\""),
    "no command": (NAMES.replace("command", "x") + "\n" + rows(), "no column is called \"command\".*'x'"),
    "no time": (NAMES.replace("time", "x") + "\n" + rows(), 'no column is called "time"'),
    "two positions": (
        NAMES + ",Position [mm]\n" + rows(columns=(*COLUMNS.values(), POSITION)),
        r"'position', 'Position \[mm\]' may each be the position.*--column position=",
    ),
    "the same name twice": (NAMES.replace("reference", "position") + "\n" + rows(), "'position#1', 'position#2'"),
    "a unit that is none": (NAMES.replace("position", "position [foo]") + "\n" + rows(), r"'position \[foo\]': 'foo'"),
    "the wrong unit": (NAMES.replace("position", "position [V]") + "\n" + rows(), "'V' is no unit of the position"),
    "volts": (NAMES.replace("command", "command [V]") + "\n" + rows(), r"needs force_per_volt in \[units\]"),
    "no value": (NAMES + "\n" + rows(columns=(TIME, REFERENCE, POSITION * np.nan, COMMAND)), "position has no value"),
    "never complete": (
        NAMES + "\n" + rows(columns=(TIME, REFERENCE, FIRST * POSITION, LAST * COMMAND)),
        "no sample has a value in all of",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "says"), BAD_CSV.values(), ids=BAD_CSV.keys())
def test_a_bad_csv_file_is_refused(text, says, tmp_path):
    path = tmp_path / "bad log.csv"
    path.write_text(text)
    with pytest.raises(LogError, match=says) as error:
        read_log(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def whole(extension, tmp_path):
    path = tmp_path / f"whole{extension}"
    if extension == ".mat":
        scipy.io.savemat(path, PLAIN)
    elif extension == ".73.mat":
        write_v73(path, PLAIN)
    else:
        pq.write_table(pa.table({name: pa.array(values) for name, values in COLUMNS.items()}), path)
    return path.read_bytes()


@pytest.mark.parametrize("extension", [".mat", ".73.mat", ".parquet"])
@pytest.mark.parametrize("kept", [0.0, 0.02, 0.5, 0.97])
def test_a_truncated_file_is_refused(extension, kept, tmp_path):
    path = tmp_path / f"log{extension}"
    data = whole(extension, tmp_path)
    path.write_bytes(data[: int(kept * len(data))])
    with pytest.raises(LogError, match=r"cut off|is empty|no column is called") as error:
        read_log(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


WRONG = {
    "junk.csv": (np.random.default_rng(0).bytes(5000), "is no text file but binary"),
    "junk.mat": (np.random.default_rng(0).bytes(5000), "cannot be read as a MAT file"),
    "junk.parquet": (np.random.default_rng(0).bytes(5000), "cannot be read as Parquet"),
    "text.mat": ((NAMES + "\n" + rows()).encode(), "cannot be read as a MAT file"),
    "text.parquet": ((NAMES + "\n" + rows()).encode(), "cannot be read as Parquet"),
    "sheet.csv": (b"PK\x03\x04" + bytes(100), "Excel workbook"),
    "parquet.csv": (b"PAR1" + bytes(100), "name it .parquet"),
    "mat.csv": (b"MATLAB 5.0 MAT-file", "name it .mat"),
    "log.svdx": (b"x", r"unknown extension '\.svdx'; known: \.csv, .*\.mat.*\.parquet"),
    "log": (b"x", "unknown extension ''"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_log_is_refused(name, tmp_path):
    content, says = WRONG[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=says):
        read_log(tmp_path / name)


def test_a_folder_and_a_missing_file_are_refused(tmp_path):
    with pytest.raises(LogError, match="is a folder"):
        read_log(tmp_path)
    with pytest.raises(LogError, match=r"absent\.csv: no such file"):
        read_log(tmp_path / "absent.csv")
    with pytest.raises(LogError, match="no log is named"):
        read_logs([])


def test_arrays_of_another_length_are_refused_only_where_they_are_meant(tmp_path):
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, PLAIN | {"spare": np.arange(7.0)})
    assert_is_the_log(read_log(path), exact=True)
    with pytest.raises(LogError, match="'spare' has 7 values, 'time' has 400"):
        read_log(path, Mapping({"load": "spare"}))
    scipy.io.savemat(path, {"kp": 1.0, "name": "axis"})
    with pytest.raises(LogError, match=r"holds no arrays of numbers \(variables: kp, name\)"):
        read_log(path)
