"""Logs: what is written is read back, the real logs at hand, and formats of one's own."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from pymatreader import read_mat

from diffdrive import motion
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.controllers import PD
from diffdrive.controllers.base import PDGains, Tracking
from diffdrive.errors import LogError, ParameterError
from diffdrive.logs import ColumnMapping, Log, Table, read_log, read_logs, register_format, write_log
from diffdrive.logs.formats import registry
from diffdrive.logs.log import CHANNELS
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from experiments.reports.simulation import write_run

DATA = (Path(__file__).parents[3] / "../shared/data").resolve()
EMPS, BENCH = DATA / "emps/DATA_EMPS.mat", DATA / "bench"
needs_emps = pytest.mark.skipif(not EMPS.exists(), reason="the EMPS files are not here")
needs_bench = pytest.mark.skipif(not BENCH.exists(), reason="the bench logs are not here")
OPTIONAL = [name for name, channel in CHANNELS.items() if not channel.required and name != "command"]
SHORT = np.arange(10) * 1e-3


def assert_same(one: Log, other: Log) -> None:
    assert one.name == other.name
    assert one.gaps == other.gaps
    assert list(one.channels) == list(other.channels)
    for name, values in one.channels.items():
        np.testing.assert_array_equal(values, other.channels[name], err_msg=name)


@st.composite
def logs(draw) -> Log:
    count, rate = draw(st.integers(3, 40)), draw(st.sampled_from([250.0, 1000.0, 10_000.0, 3333.0]))
    places = draw(st.sets(st.integers(2, count - 1), max_size=3)) if count > 12 else set()
    steps = np.ones(count - 1, dtype=int)
    for place in places:
        steps[place - 1] += draw(st.integers(1, 1000))
    time = draw(st.sampled_from([0.0, -2.5, 1e5])) + np.concatenate(([0], np.cumsum(steps))) / rate
    signal = arrays.arrays(np.float64, count, elements=st.floats(-1e300, 1e300))
    held = draw(st.sets(st.sampled_from(OPTIONAL)))
    signals = {name: draw(signal) for name in ("position", "command", *sorted(held))}
    return Log("round trip", time, **signals, gaps=tuple(sorted(places)))


@pytest.mark.parametrize("extension", [".csv", ".parquet", ".mat", ".73.mat"])
@given(log=logs())
@settings(max_examples=40)
def test_what_is_written_is_read_back(log, extension, tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / f"{log.name}{extension}"
    write_log(path, log)
    assert_same(dataclasses.replace(read_log(path), name=log.name), log)


def test_units_are_written(tmp_path):
    log = Log("log", SHORT, SHORT, SHORT, temperature=SHORT)
    for extension in (".csv", ".parquet", ".mat", ".73.mat"):
        write_log(tmp_path / f"log{extension}", log)
    header = (tmp_path / "log.csv").read_text().splitlines()[0]
    assert header == "time [s],position [m],command [N],temperature [degC]"
    assert pq.read_schema(tmp_path / "log.parquet").field("position").metadata == {b"unit": b"m"}
    assert scipy.io.loadmat(tmp_path / "log.mat", simplify_cells=True)["units"]["command"] == "N"
    assert read_mat(tmp_path / "log.73.mat")["units"]["command"] == "N"


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"position": np.arange(7.0)}, r"log: position: has 7 samples, time 10"),
        ({"load": np.arange(3.0)}, r"log: load: has 3 samples, time 10"),
        ({"command": np.ones((10, 2))}, r"log: command: has 2 dimensions; a signal is one number in each row"),
        ({"command": np.float64(1.0)}, r"log: command: has 0 dimensions"),
        ({"command": None}, r"log: command: is missing; a log has time, position, command"),
        ({"velocity": np.array(["1"] * 10)}, r"log: velocity: holds <U1; a signal is one real number in each row"),
        ({"position": 1j * SHORT}, r"log: position: holds complex128"),
        ({"time": np.array([])}, r"log: time: has 0 samples, and a log at least 2"),
        ({"gaps": (0,)}, r"log: gaps: 0 is no place between two of 10 samples"),
        ({"gaps": (3, 10)}, r"log: gaps: 10 is no place between two of 10 samples"),
        ({"gaps": (4, 2)}, r"log: gaps: must rise, got \(4, 2\)"),
        ({"gaps": (2.5,)}, r"log: gaps: 2\.5 is no place"),
        ({"shifts": {"speed": 1}}, r"log: shifts: no such channel 'speed'"),
    ],
)
def test_signals_that_make_no_log_are_refused_by_name(fields, says):
    whole = {"time": SHORT, "position": SHORT, "command": SHORT}
    with pytest.raises(LogError, match=says):
        Log("log", **(whole | fields))
    with pytest.raises(LogError, match=says):
        Log("log", **whole).replace(**fields)


def test_a_field_that_no_log_has_is_refused_by_name():
    with pytest.raises(LogError, match=r"log: no such field 'postion'; did you mean 'position'"):
        Log("log", SHORT, SHORT, SHORT).replace(postion=SHORT)
    with pytest.raises(LogError, match=r"log: no such field 'foo'; known: name, time, position, command, reference, "):
        Log("log", SHORT, SHORT, SHORT).replace(foo=SHORT)


def test_whole_and_single_precision_numbers_become_those_of_double_precision():
    log = Log("log", SHORT, list(range(10)), np.arange(10, dtype=np.float32), load=jnp.zeros(10, jnp.float32), gaps=[3])
    assert all(type(signal) is np.ndarray and signal.dtype == np.float64 for signal in log.channels.values())
    np.testing.assert_array_equal(log.position, np.arange(10.0))
    assert log.time is SHORT
    assert log.gaps == (3,)


def test_what_cannot_be_written_is_refused(tmp_path):
    log = Log("log", SHORT, SHORT, SHORT)
    with pytest.raises(LogError, match=r"cannot write '\.xlsx'; known: \.csv, \.parquet, \.73\.mat, \.mat"):
        write_log(tmp_path / "log.xlsx", log)
    with pytest.raises(LogError, match="cannot be written"):
        write_log(tmp_path / "absent" / "log.csv", log)


@pytest.fixture(scope="module")
def run():
    move = motion.triangular(speed=0.01, stroke=0.0015, rounding=0.1, duration=0.05, rate=10_000.0)
    return simulate_loop(
        paper_drive(), PD(Tracking(PDGains(PAPER_KP, PAPER_KD))), move, load=500.0 * jnp.ones(len(move.time))
    )


def test_a_simulated_run_is_a_log(run, tmp_path):
    log = run.log("simulated")
    assert list(log.channels) == ["time", "reference", "position", "command", "load"]
    np.testing.assert_array_equal(log.position, run.position)
    assert log.rate == pytest.approx(10_000.0)
    write_run(tmp_path / "simulated.csv", run)
    for mapping in (ColumnMapping(), ColumnMapping(force_per_volt=35.0), ColumnMapping(force_per_ampere=10.0)):
        assert_same(read_log(tmp_path / "simulated.csv", mapping=mapping, rate=10_000.0), log)


# --- real logs --------------------------------------------------------------------------------------------------------

EMPS_MAPPING = ColumnMapping(
    {"time": "t", "reference": "qg", "position": "qm", "command": "vir"}, {"command": "V"}, 35.15065
)


@needs_emps
def test_emps_is_read_right():
    log = read_log(EMPS, mapping=EMPS_MAPPING, rate=1000.0)
    data = scipy.io.loadmat(EMPS)
    np.testing.assert_array_equal(log.position, data["qm"].ravel())
    np.testing.assert_allclose(log.command, 35.15065 * data["vir"].ravel(), rtol=1e-14)
    np.testing.assert_allclose(log.time, np.arange(24841) * 1e-3, atol=1e-14)
    assert log.gaps == ()
    assert log.notes == ("time stamps are rounded by up to 0.0321 us: replaced by uniform ones",)
    with pytest.raises(LogError, match="the file has 'qg', 'qm', 't', 'vir'"):
        read_log(EMPS)


@needs_emps
def test_emps_pulses_are_volts_whatever_their_name_says():
    mapping = EMPS_MAPPING.overridden({"disturbance": "pulses_N"}, {"disturbance": "1.0139 V"}, {})
    log = read_log(EMPS.with_name("DATA_EMPS_PULSES.mat"), mapping=mapping, rate=1000.0)
    assert np.max(log.disturbance) == pytest.approx(5 * 1.0139 * 35.15065)
    assert "disturbance: the file says N, [units] says 1.0139 V, which was taken" in log.notes


@needs_bench
@pytest.mark.parametrize("case", ["01", "17", "34"])
def test_bench_logs_are_read_as_they_are(case, tmp_path):
    description = read_axis(BENCH / case / "drive.toml")
    paths = [BENCH / case / f"log-{letter}.parquet" for letter in "ab"]
    for path, log in zip(
        paths, read_logs(paths, mapping=description.mapping, rate=description.sampling.rate), strict=True
    ):
        table = pq.read_table(path)
        for name, values in log.channels.items():
            np.testing.assert_array_equal(values, table[name].to_numpy(), err_msg=name)
        assert log.notes == ()
        write_log(tmp_path / path.name, dataclasses.replace(log, notes=()))
        assert_same(read_log(tmp_path / path.name), log)


@pytest.fixture
def read_trace():
    """A registered reader, gone again afterwards."""

    @register_format(".trc")
    def read_trace(path):
        values = np.loadtxt(path)
        return Table(str(path), {"time": values[:, 0], "position": values[:, 1], "command": values[:, 2]})

    yield read_trace
    registry.READERS.remove(".trc")


def test_a_format_of_ones_own_is_read_like_any_other(read_trace, tmp_path):
    time = np.arange(400) / 1000.0
    rows = np.stack([time, 1e3 * np.sin(time), np.cos(time)], axis=1)
    np.savetxt(tmp_path / "lap.trc", rows)
    log = read_log(tmp_path / "lap.trc", units={"position": "mm"})
    np.testing.assert_allclose(log.position, np.sin(time), atol=1e-12)
    assert log.name == "lap"


@pytest.mark.parametrize(
    ("extension", "says"),
    [
        ("trc", r"log format 'trc': its name must be the last extension of a file with its dot, such as '\.trc'"),
        (".tar.gz", r"log format '\.tar\.gz': its name must be the last extension"),
        (".CSV", r"log format '\.csv': there is one of this name"),
        (None, r"log format None: its name must be"),
    ],
)
def test_an_extension_that_no_file_would_be_read_by_is_refused(extension, says):
    with pytest.raises(ParameterError, match=says):
        register_format(extension)(lambda path: Table(str(path), {}))
