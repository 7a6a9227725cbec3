"""Which column is which channel in which unit, as a mapping, a header or a drive file says."""

import tomllib

import numpy as np
import pytest
import scipy.io

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import axis_tables, parse_axis, read_axis, write_axis
from diffdrive.controllers import PD
from diffdrive.controllers.base import PDGains, Tracking
from diffdrive.errors import DriveFileError, LogError
from diffdrive.logs import ColumnMapping, read_log
from diffdrive.model.parameters import Sampling
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.motion.motion import Limits

SHORT = np.arange(10) * 1e-3
RAW = {"t": np.arange(10.0), "qg": np.arange(10.0), "qm": np.arange(10.0) + 0.5, "u": np.arange(10.0) - 4.0}
NAMED = {"time": "t", "reference": "qg", "position": "qm", "command": "u"}


@pytest.fixture
def raw(tmp_path):
    path = tmp_path / "raw.mat"
    scipy.io.savemat(path, RAW)
    return path


UNITS = {
    "SI": ({}, {}, (1.0, 1.0)),
    "millimetres": ({"position": "mm"}, {}, (1e-3, 1.0)),
    "counts": ({"position": "50 nm"}, {}, (5e-8, 1.0)),
    "sign": ({"command": "-0.1 N", "position": "-um"}, {}, (-1e-6, -0.1)),
    "volts": ({"command": "V"}, {"force_per_volt": 35.0}, (1.0, 35.0)),
    "millivolts, reversed": ({"command": "-mV"}, {"force_per_volt": 35.0}, (1.0, -0.035)),
    "amperes": ({"command": "2 A"}, {"force_per_ampere": 10.0}, (1.0, 20.0)),
    "newtons although the gain is known": ({"command": "kN"}, {"force_per_volt": 35.0}, (1.0, 1e3)),
}


@pytest.mark.parametrize(("units", "gains", "factors"), UNITS.values(), ids=UNITS.keys())
def test_units(units, gains, factors, raw):
    log = read_log(raw, mapping=ColumnMapping(NAMED, units, **gains))
    np.testing.assert_allclose(log.position, factors[0] * RAW["qm"], rtol=1e-14)
    np.testing.assert_allclose(log.command, factors[1] * RAW["u"], rtol=1e-14)
    log = read_log(raw, mapping=ColumnMapping(NAMED, {"time": "ms"}))
    np.testing.assert_allclose(log.time, 1e-3 * RAW["t"], atol=1e-18)


@pytest.mark.parametrize(("unit", "celsius"), [("degC", 10.0), ("K", -263.15), ("degF", -12.2222222)])
def test_temperatures(unit, celsius, tmp_path):
    scipy.io.savemat(tmp_path / "t.mat", RAW | {"temp": np.full(10, 10.0)})
    log = read_log(tmp_path / "t.mat", mapping=ColumnMapping(NAMED | {"temperature": "temp"}, {"temperature": unit}))
    assert log.temperature[0] == pytest.approx(celsius)


BAD_MAPPINGS = {
    "channel": (
        lambda: ColumnMapping({"positon": "qm"}),
        r"\[columns\] positon: no such channel; did you mean 'position'",
    ),
    "unit of none": (lambda: ColumnMapping(units={"force": "N"}), r"\[units\] force: no such channel"),
    "number": (lambda: ColumnMapping({"position": 3}), r"\[columns\] position: must be a text, such as \"qm\", got 3"),
    "empty": (lambda: ColumnMapping({"position": " "}), r"\[columns\] position: must be a text"),
    "twice": (lambda: ColumnMapping({"position": "x", "reference": "x"}), r"reference: 'x' is the position already"),
    "length in N": (
        lambda: ColumnMapping(units={"command": "mm"}),
        r"\[units\] command: 'mm' is no unit of the command",
    ),
    "torque": (
        lambda: ColumnMapping(units={"command": "N*m"}),
        r"no unit of the command without \[axis\] lead: .* such as \"0\.05 N\" "
        r"\(a torque of 1 N m makes 2 pi / lead newtons",
    ),
    "force in m": (
        lambda: ColumnMapping(units={"position": "N"}),
        r"\[units\] position: 'N' is no unit of the position",
    ),
    "counts": (
        lambda: ColumnMapping(units={"position": "counts"}),
        'what one unit of the column is, such as "0.05 m"$',
    ),
    "angle": (lambda: ColumnMapping(units={"position": "deg"}), "'deg' is no unit of the position"),
    "zero": (lambda: ColumnMapping(units={"position": "0 mm"}), "'0 mm' is zero"),
    "temperature": (lambda: ColumnMapping(units={"temperature": "mm"}), "write degC, K or degF"),
    "no gain": (
        lambda: ColumnMapping(units={"command": "V"}),
        "needs force_per_volt in .units., such as force_per_volt = ",
    ),
    "other gain": (lambda: ColumnMapping(units={"command": "A"}, force_per_volt=3.0), "needs force_per_ampere"),
    "gain of nothing": (
        lambda: ColumnMapping(force_per_volt=0.0),
        "force_per_volt: must be a finite number of N/V other",
    ),
    "gain of another unit": (
        lambda: ColumnMapping().overridden({}, {"force_per_volt": "3 m"}, {}),
        r"\[units\] force_per_volt: '3 m' has the",
    ),
}


@pytest.mark.parametrize(("build", "says"), BAD_MAPPINGS.values(), ids=BAD_MAPPINGS.keys())
def test_a_bad_mapping_is_refused(build, says):
    with pytest.raises(LogError, match=says):
        build()


def test_a_mapping_that_does_not_fit_the_file_is_refused(raw, tmp_path):
    with pytest.raises(LogError, match=r"'qmm': no such column; did you mean 'qm'\? the file has 't', 'qg', 'qm', 'u'"):
        read_log(raw, mapping=ColumnMapping(NAMED | {"position": "qmm"}))
    with pytest.raises(LogError, match=r"'soll': no such column.*a log needs no reference: leave that line out"):
        read_log(raw, mapping=ColumnMapping(NAMED | {"reference": "soll"}))
    with pytest.raises(LogError, match=r"nothing says whether the command .* \[units\] .* or give --unit command=N"):
        read_log(raw, mapping=ColumnMapping(NAMED, force_per_volt=3.0))
    scipy.io.savemat(tmp_path / "two.mat", RAW | {"a": {"pos": RAW["t"]}, "b": {"pos": RAW["t"]}})
    with pytest.raises(LogError, match=r"position = 'pos' fits 'a\.pos', 'b\.pos'; write one of them in full"):
        read_log(tmp_path / "two.mat", mapping=ColumnMapping(NAMED | {"position": "pos"}))


def test_what_is_stated_for_a_log_goes_over_the_file():
    base = ColumnMapping({"time": "t", "position": "x"}, {"position": "mm"})
    over = base.overridden({"position": "qm"}, {"command": "V", "force_per_volt": 35.2}, {})
    assert over == ColumnMapping({"time": "t", "position": "qm"}, {"position": "mm", "command": "V"}, 35.2)
    assert base.overridden({}, {"force_per_ampere": "0.5 kN/A"}, {}).force_per_ampere == pytest.approx(500.0)


def test_volts_may_be_stated_for_a_log_whose_axis_has_the_force_per_volt():
    axis = described(ColumnMapping(force_per_volt=35.2))
    columns = {"time": SHORT, "position": SHORT, "command": np.ones(10)}
    np.testing.assert_allclose(read_log(columns, axis, units={"command": "V"}, rate=1e3).command, 35.2)


def test_the_mapping_wins_over_the_header_and_says_so(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time,position [mm],command\n" + "".join(f"{k},{k},{k}\n" for k in range(10)))
    assert read_log(path).position[-1] == pytest.approx(9e-3)
    log = read_log(path, mapping=ColumnMapping(units={"position": "um"}))
    assert log.position[-1] == pytest.approx(9e-6)
    assert log.notes == ("position: the file says mm, [units] says um, which was taken",)
    assert read_log(path, mapping=ColumnMapping(units={"position": "0.001 m"})).notes == ()
    exact = read_log(path, mapping=ColumnMapping({"position": "Position"}, {"position": "mm"}))
    assert exact.position[-1] == pytest.approx(9e-3)


# --- drive files ------------------------------------------------------------------------------------------------------

MAPPINGS = [
    ColumnMapping(),
    ColumnMapping({"position": "qm"}),
    ColumnMapping(units={"time": "ms", "position": "50 nm"}),
    ColumnMapping(NAMED | {"load": "rig.Y.load"}, {"command": "-V", "temperature": "K"}, force_per_volt=35.15065),
    ColumnMapping(units={"command": "A"}, force_per_ampere=-3.25),
]


def described(mapping) -> Axis:
    controller = PD(Tracking(PDGains(PAPER_KP, PAPER_KD)))
    return Axis(paper_drive(), controller, Sampling(1000.0), Limits(), mapping)


@pytest.mark.parametrize("mapping", MAPPINGS)
def test_drive_files_carry_the_mapping(mapping, tmp_path):
    write_axis(tmp_path / "drive.toml", described(mapping))
    assert read_axis(tmp_path / "drive.toml").mapping == mapping
    held = set(tomllib.loads((tmp_path / "drive.toml").read_text())) & {"columns", "units"}
    assert held == {
        name for name in ("columns", "units") if getattr(mapping, name) or (name == "units" and mapping.force_per)
    }


BAD_TABLES = {
    "unknown channel": ({"columns": {"pos": "x"}}, r"drive: \[columns\] pos: no such channel"),
    "no table": ({"units": "mm"}, r"drive: \[units\] must be a table"),
    "bad unit": ({"units": {"position": "N"}}, r"drive: \[units\] position: 'N' is no unit"),
    "bad gain": ({"units": {"force_per_volt": True}}, r"drive: \[units\] force_per_volt: must be a number in N/V"),
    "gain in another unit": (
        {"units": {"force_per_volt": "3 N/A"}},
        r"\[units\] force_per_volt: '3 N/A' has the wrong",
    ),
}


@pytest.mark.parametrize(("tables", "says"), BAD_TABLES.values(), ids=BAD_TABLES.keys())
def test_a_drive_file_with_a_bad_mapping_is_refused(tables, says):
    with pytest.raises(DriveFileError, match=says):
        parse_axis(axis_tables(described(ColumnMapping())) | tables)


def test_a_gain_may_have_a_unit():
    tables = axis_tables(described(ColumnMapping())) | {"units": {"command": "V", "force_per_volt": "0.035 kN/V"}}
    assert parse_axis(tables).mapping.force_per_volt == pytest.approx(35.0)
