"""Traces as controls export them, written here as the page on trace exports describes them, and read by its recipes."""

import numpy as np
import pytest

from diffdrive.errors import LogError
from diffdrive.logs import ColumnMapping, read_log
from diffdrive.logs.read import read_table
from tests.support.written_log import COMMAND, POSITION, REFERENCE, TIME, N, assert_is_the_log, in_units, rows

# --- LinuxCNC halscope and halsampler ---------------------------------------------------------------------------------

HAL = {"joint.0.motor-pos-cmd": 1e3 * REFERENCE, "joint.0.motor-pos-fb": 1e3 * POSITION, "pid.x.output": COMMAND}
HAL_MAPPING = ColumnMapping(
    {"reference": "joint.0.motor-pos-cmd", "position": "joint.0.motor-pos-fb", "command": "pid.x.output"},
    {"reference": "mm", "position": "mm"},
)
PERIOD_NOTE = "time is counted from the sampling period, 1000000 ns"


def halscope_old(unit="nSec", decimal="."):
    """As older versions write it: names stand before values, and one sample too many ends the file."""
    values = np.column_stack(list(HAL.values()))
    lines = ["".join(f"{name} {value:+.14f} " for name, value in zip(HAL, row, strict=True)) for row in values]
    text = f"Sampling period is 1000000 {unit} \n" + "".join(f"\n{line}" for line in [*lines, lines[0]])
    return text.replace(".", decimal) if decimal != "." else text


@pytest.mark.parametrize("unit", ["nSec", "ns"])
def test_halscope_with_names_in_each_row(unit, tmp_path):
    path = tmp_path / "halscope.log.txt"
    path.write_text(halscope_old(unit))
    log = read_log(path, mapping=HAL_MAPPING, rate=1000.0)
    assert_is_the_log(log)
    assert log.notes[-1] == PERIOD_NOTE
    assert any("the last, has no line end" in note for note in log.notes)  # the sample too many


@pytest.mark.parametrize("end", ["", ";"])
def test_halscope_with_a_header(end, tmp_path):
    path = tmp_path / "halscope.csv"
    head = [
        "# Sampling period is 1000000 ns",
        ";".join(HAL),
        "# Position: 0.500000;0.500000;0.500000",
        "# Scale: 0;0;0",
    ]
    path.write_text("\n".join(head) + "\n" + rows(";", end=f"{end}\n", columns=tuple(HAL.values())))
    log = read_log(path, mapping=HAL_MAPPING, rate=1000.0)
    assert_is_the_log(log)
    assert log.notes == (PERIOD_NOTE,)


def test_halscope_of_another_period_than_the_drive_file_is_told(tmp_path):
    path = tmp_path / "halscope.txt"
    path.write_text(halscope_old())
    assert any("2000" in note for note in read_log(path, mapping=HAL_MAPPING, rate=2000.0).notes)


def test_halsampler_has_neither_header_nor_time(tmp_path):
    path = tmp_path / "sampler.txt"
    path.write_text(rows(" ", end=" \n", columns=(np.arange(N), *HAL.values())))
    mapping = ColumnMapping({"reference": "2", "position": "3", "command": "4"}, HAL_MAPPING.units)
    assert_is_the_log(read_log(path, mapping=mapping, rate=1000.0))
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:100], "overrun", *lines[100:]]) + "\n")
    with pytest.raises(LogError, match="line 101 has 1 columns, the other rows have 4"):
        read_log(path, mapping=mapping, rate=1000.0)


# --- SINUMERIK Operate ------------------------------------------------------------------------------------------------

SINUMERIK = {
    "f1": ("/Nck/!SEMA/cmdContrPos [u1, 1]", 1e3 * REFERENCE),
    "f2": ("/Nck/!SD/nckServoDataActPos1stEnc64 [u1, 1]", 1e3 * POSITION),
    "f3": ("/Nck/!SD/nckServoDataCmdTorque64 [u1, 1]", 1e-2 * COMMAND),
}
SINUMERIK_MAPPING = ColumnMapping(
    {
        "reference": "cmdContrPos [u1, 1]",
        "position": "nckServoDataActPos1stEnc64 [u1, 1]",
        "command": "nckServoDataCmdTorque64 [u1, 1]",
    },
    {"reference": "mm", "position": "mm", "command": "100 N"},
)


def sinumerik(signals=SINUMERIK, root="traceSession", frames=1, spoilt=None):
    """A trace: signals, and records that state what has changed."""
    declared = "".join(
        f'<dataSignal id="{key}" key="{key}" name="{name}" description="signal" dataType="float" interval="0.001" '
        f'datapointCount="{N}" unitsType="position"/>\n'
        for key, (name, _) in signals.items()
    )
    records = []
    for k, t in enumerate(TIME):
        stated = [
            f'{key}="{values[k]!r}"' for key, (_, values) in signals.items() if k == 0 or values[k] != values[k - 1]
        ]
        records.append(f'<rec time="{float(t)!r}" {" ".join(stated)}/>'.replace("np.float64(", "").replace(")", ""))
    if spoilt:
        records[7] = spoilt
    frame = f'<dataFrame><frameHeader startTime="2024-05-01T12:00:00" dropOuts="0"/>\n{declared}'
    body = (frame + "\n".join(records) + "\n</dataFrame>\n") * frames
    return (
        f'<?xml version="1.0" encoding="utf-8"?>\n<{root} version="2.0">\n<traceCaptureSetup/>\n'
        f'<traceData dataFrames="{frames}">\n{body}</traceData>\n</{root}>\n'
    )


def test_sinumerik_trace(tmp_path):
    path = tmp_path / "trace.xml"
    path.write_text(sinumerik())
    log = read_log(path, mapping=SINUMERIK_MAPPING, rate=1000.0)
    assert_is_the_log(log)
    assert log.notes == ()


def test_sinumerik_signals_keep_their_values_until_a_record_states_another(tmp_path):
    path = tmp_path / "trace.xml"
    steps = np.repeat(np.arange(N // 8), 8) * 1.0
    path.write_text(sinumerik(SINUMERIK | {"f1": ("steps", steps)}))
    np.testing.assert_array_equal(read_table(path).columns["steps"], steps)


def test_sinumerik_bits_of_no_number_are_missing(tmp_path):
    path = tmp_path / "trace.xml"
    values = POSITION.copy()
    values[5] = 9218868437227405313.0
    path.write_text(sinumerik(SINUMERIK | {"f2": ("held", values), "f4": ("never", np.full(N, 9.3e18))}))
    table = read_table(path)
    assert np.flatnonzero(np.isnan(table.columns["held"])).tolist() == [5]
    assert table.skipped == {"never": "has no values"}


BAD_TRACES = {
    "of another kind": (sinumerik(root="project"), r"is XML of another kind, 'project'"),
    "of two recordings": (sinumerik(frames=2), "holds 2 recordings; save each trace in a file of its own"),
    "without signals": (sinumerik({}), "holds no recorded signals"),
    "cut off": (sinumerik()[:9000], "cut off"),
    "no XML": ("time,position\n1,2\n", "it is another format or cut off"),
    "with a word": (
        sinumerik(spoilt='<rec time="0.007" f2="oops"/>'),
        r"record 8, '/Nck/!SD/nck.*': 'oops' is not a n",
    ),
    "of entities": (
        '<!DOCTYPE a [<!ENTITY b "x"><!ENTITY c "&b;&b;&b;">]>\n<traceSession><rec time="&c;"/></traceSession>',
        "is not a number|cut off",
    ),
}


@pytest.mark.parametrize(("text", "says"), BAD_TRACES.values(), ids=BAD_TRACES.keys())
def test_a_trace_that_is_none_is_refused(text, says, tmp_path):
    path = tmp_path / "trace.xml"
    path.write_text(text)
    with pytest.raises(LogError, match=says) as error:
        read_log(path, mapping=SINUMERIK_MAPPING)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


# --- HEIDENHAIN TNCscope ----------------------------------------------------------------------------------------------

CURVES = {
    "s nominal": ("X", "mm", 1e3 * REFERENCE),
    "s actual": ("X", "mm", 1e3 * POSITION),
    "I nominal": ("X", "A", 1e-2 * COMMAND),
}
TNC_MAPPING = ColumnMapping(
    {"reference": "s nominal X", "position": "s actual X", "command": "I nominal X"}, {"command": "100 N"}
)


def tncscope(curves=CURVES, cycles=(1000, 1000, 1000), count=N):
    """A recording: what is known of each channel as comments, then rows that end in a semicolon."""
    head = ["%[GLOBAL]", "%VERSION=1", "%"]
    for k, (name, (axis, unit, _)) in enumerate(curves.items()):
        head += [f"%[CURVE{k + 1}]", f"%CHANNELTYPE={name}", f"%AXISTYPE={axis}", f"%DIMENSION={unit}"]
        head += [f"%COUNT={count}", f"%CYCLETIME={cycles[k]}", "%"]
    columns = (1e6 * TIME, *(values for _, _, values in curves.values()))
    return "\n".join([*head, "%[DATA]", ""]) + rows(";", end=";\n", columns=columns)


def test_tncscope(tmp_path):
    path = tmp_path / "lap.sco"
    path.write_text(tncscope())
    log = read_log(path, mapping=TNC_MAPPING, rate=1000.0)
    assert_is_the_log(log)
    assert any("the file says A, [units] says 100 N, which was taken" in note for note in log.notes)


def test_tncscope_channels_of_another_cycle_are_refused_where_they_are_meant(tmp_path):
    path = tmp_path / "lap.sco"
    path.write_text(tncscope(cycles=(1000, 1000, 3000)))
    with pytest.raises(LogError, match=r"the command's own clock, 'I nominal X.clock', is .* export channels of one"):
        read_log(path, mapping=TNC_MAPPING)


BAD_RECORDINGS = {
    "a table": ("time;position\n0;1\n1;2\n", r"is no recording of TNCscope: it needs '\[CURVE1\]'"),
    "no cycle time": (tncscope().replace("%CYCLETIME=1000", "%CYCLETIME=x"), "CYCLETIME must be a positive number"),
    "too many columns": (tncscope().replace(";\n", ";1.0;2.0;\n"), "has 3 channels in its comments and 6 columns"),
    "no rows": (tncscope().split("%[DATA]")[0] + "%[DATA]\n", "has no rows of numbers|is empty"),
    "binary": ("\x00\x01" * 500, "is no recording of TNCscope"),
}


@pytest.mark.parametrize(("text", "says"), BAD_RECORDINGS.values(), ids=BAD_RECORDINGS.keys())
def test_a_recording_that_is_none_is_refused(text, says, tmp_path):
    path = tmp_path / "lap.sco"
    path.write_text(text)
    with pytest.raises(LogError, match=says) as error:
        read_log(path, mapping=TNC_MAPPING)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_a_csv_file_of_pylsv2_has_no_time(tmp_path):
    path = tmp_path / "scope.csv"
    columns = (1e3 * REFERENCE, 1e3 * POSITION, 1e-2 * COMMAND)
    path.write_text("s_nominal_x,s_actual_x,i_nominal_x\n" + rows(columns=columns))
    columns = {"reference": "s_nominal_x", "position": "s_actual_x", "command": "i_nominal_x"}
    units = {"reference": "mm", "position": "mm", "command": "100 N"}
    assert_is_the_log(read_log(path, mapping=ColumnMapping(columns, units), rate=1000.0))


# --- TwinCAT Scope, and tables of drives ------------------------------------------------------------------------------


@pytest.mark.parametrize(("delimiter", "decimal"), [("\t", ","), (";", ","), (";", "."), (",", ".")])
def test_twincat_scope_with_a_time_for_all_channels_of_one_sample_time(delimiter, decimal, tmp_path):
    path = tmp_path / "scope.csv"
    lines = [
        ["Name", "Scope Project"], ["File", "C:\\axis.svdx"], ["Starttime of export", "132959505843760000"], [],
        ["Name", "Set", "Act", "Trq"], ["SymbolComment", "", "", ""], ["Data-Type", "REAL64", "REAL64", "REAL64"],
        ["SampleTime[ms]", "1", "1", "1"], ["Unit", "mm", "um", "kN"], [],
    ]  # fmt: skip
    path.write_text(
        "\n".join(map(delimiter.join, lines)) + "\n" + rows(delimiter, decimal, columns=in_units()) + "EOF\n"
    )
    assert_is_the_log(read_log(path, columns={"reference": "Set", "position": "Act", "command": "Trq"}))


def test_a_drive_trace_with_units_in_brackets_and_axis_addresses(tmp_path):
    path = tmp_path / "trace.csv"
    names = ["Time [ms]", "/Nck/!SEMA/cmdContrPos [u1; 1]", "/Nck/!SD/nckServoDataActPos1stEnc64 [u1; 1]", "r0080 [Nm]"]
    t, reference, _, _ = in_units()
    columns = (t, reference, 1e3 * POSITION, 1e-2 * COMMAND)
    path.write_text('"' + '";"'.join(names) + '"\n' + rows(";", ",", columns=columns))
    mapping = ColumnMapping(
        {"reference": "cmdContrPos [u1; 1]", "position": "nckServoDataActPos1stEnc64 [u1; 1]", "command": "r0080"},
        {"reference": "mm", "position": "mm", "command": "100 N"},
    )
    log = read_log(path, mapping=mapping)
    assert_is_the_log(log)
    assert log.notes == ("command: the file says Nm, [units] says 100 N, which was taken",)
