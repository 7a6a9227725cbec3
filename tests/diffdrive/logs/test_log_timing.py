"""The clock of a log: its order, rounding, jitter, gaps and rate, and samples without a value."""

import re

import numpy as np
import pytest

from diffdrive.errors import LogError
from diffdrive.logs import ColumnMapping, Log, read_log
from diffdrive.logs.clocks.interpolate import resample
from diffdrive.logs.write import write_csv

N, RATE = 5000, 1000.0
TIME = np.arange(N) / RATE
RNG = np.random.default_rng(7)


def position(time) -> np.ndarray:
    return 0.02 * np.sin(2 * np.pi * 3.0 * time)


def command(time) -> np.ndarray:
    return 100 * np.sin(2 * np.pi * 2.0 * time)


@pytest.fixture
def read(tmp_path):
    """Reads signals through a file; position and command follow the true times."""

    def through(time, *, true=None, rate=None, mapping=None, **changes) -> Log:
        true = time if true is None else true
        columns = {"time": time, "position": position(true), "command": command(true)} | changes
        write_csv(tmp_path / "log.csv", columns)
        return read_log(tmp_path / "log.csv", mapping=mapping, rate=rate)

    return through


def said(log: Log, text: str) -> bool:
    return any(text in note for note in log.notes)


# --- stamps -----------------------------------------------------------------------------------------------------------


def test_exact_stamps_are_kept_without_a_word(read):
    log = read(TIME, rate=RATE)
    np.testing.assert_array_equal(log.time, TIME)
    assert log.notes == ()


@pytest.mark.parametrize("start", [-3.0, 17.25, 86_399.0, 1.7e9])
def test_time_starts_anywhere_and_is_kept(start, read):
    log = read(start + TIME, true=TIME, rate=RATE)
    np.testing.assert_array_equal(log.time, start + TIME)
    assert len(log.notes) == 1
    assert said(log, f"time starts at {start:.9g} s")


def test_rounded_stamps_become_uniform(read):
    log = read(np.round(TIME + 3.2e-8 * np.sin(np.arange(N)), 12), rate=RATE)
    np.testing.assert_allclose(log.time, TIME, atol=1e-15)
    assert said(log, "rounded by up to 0.032 us")


def test_the_period_comes_from_the_whole_log_not_from_two_stamps(read):
    """Stamps rounded to 16 ns, of which the first steps are all short: t(10) - t(9) is off by 1.6e-5."""
    step = 1.6e-8
    log = read(np.floor(TIME / step) * step)
    assert abs(np.diff(log.time[8:10])[0] - 1e-3) < 1e-15
    assert log.duration == pytest.approx(TIME[-1], abs=1e-12)


@pytest.mark.parametrize("off", [1e-5, -1e-5, 4e-4])
def test_another_clock_is_kept_and_its_drift_told(off, read):
    time = TIME * (1 + off)
    log = read(time, rate=RATE)
    np.testing.assert_array_equal(log.time, time)
    assert said(log, f"{1e3 * abs(off) * TIME[-1]:.3g} ms over the log")
    assert said(log, "below" if off > 0 else "above")


@pytest.mark.parametrize("resolution", [1e-3, 5e-4, 1e-2])
def test_a_clock_coarser_than_the_period(resolution, read):
    time = np.arange(N) / 4000.0
    log = read(np.floor(time / resolution + 1e-9) * resolution, true=time, rate=4000.0)
    np.testing.assert_allclose(np.diff(log.time), 1 / 4000.0, rtol=1e-3)
    assert said(log, "coarser than the period")
    assert said(log, "single samples that are missing would not show")
    assert log.gaps == ()


def test_samples_that_a_coarse_clock_lacks_here_and_there_are_noted(read):
    """Eight of 5000: the clock's buckets hold 9 or 10 samples, as those of a uniform clock of another rate may."""
    time = np.delete(np.arange(5000) / 1e3, [110, 377, 801, 1203, 1502, 1909, 2201, 2404])
    log = read(np.floor(time * 100 + 1e-9) / 100, true=time)
    [missing] = [
        re.search(r"at least (\d) samples are missing or late", note) for note in log.notes if "missing" in note
    ]
    assert 1 <= int(missing.group(1)) <= 8


def test_a_coarse_clock_with_samples_missing_is_refused(read):
    time = np.delete(np.arange(N) / 4000.0, slice(1000, 1200))
    with pytest.raises(LogError, match=r"line \d+: .* repeat the one before, and samples are missing"):
        read(np.floor(time * 1000) / 1000)


def test_jittered_stamps_are_interpolated_without_ringing(read):
    stamps = TIME + RNG.uniform(-0.2, 0.2, N) / RATE
    log = read(stamps, rate=RATE)
    np.testing.assert_allclose(np.diff(log.time), 1 / RATE, rtol=1e-9)
    np.testing.assert_allclose(log.position, position(log.time), atol=1e-9)
    assert np.ptp(log.command) <= np.ptp(command(stamps))
    assert said(log, "time stamps jitter by 11")
    assert log.gaps == ()
    assert N - 2 <= len(log.time) <= N


def test_a_late_stamp_is_no_gap(read):
    stamps = TIME.copy()
    stamps[2000] += 0.7e-3
    log = read(stamps, rate=RATE)
    assert log.gaps == ()
    np.testing.assert_allclose(log.time, TIME, atol=1e-9)


def test_irregular_stamps_are_refused(read):
    with pytest.raises(LogError, match=r"irregular: .* log at a fixed rate"):
        read(np.cumsum(RNG.exponential(1e-3, N)))


def test_a_held_command_keeps_its_impulse():
    stamps = TIME + RNG.uniform(-0.3, 0.3, N) / RATE
    held = RNG.normal(size=N)
    at = TIME[10:-10]
    begin, end = np.maximum(stamps, at[0]), np.minimum(np.append(stamps[1:], np.inf), at[-1] + 1 / RATE)
    means = resample("command", stamps, held, at)
    assert np.sum(means) / RATE == pytest.approx(np.sum(held * np.maximum(end - begin, 0.0)), abs=1e-9)
    np.testing.assert_allclose(resample("command", TIME, held, TIME), held, atol=1e-12)


# --- gaps -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lost", [1, 2, 7, 500])
@pytest.mark.parametrize("jitter", [0.0, 3e-8, 1e-4])
def test_missing_samples_stay_visible(lost, jitter, read):
    kept = np.delete(np.arange(N), [*range(1000, 1000 + lost), *range(4000, 4003)])
    time = TIME[kept]
    log = read(time + jitter * RNG.uniform(-1, 1, len(time)), true=time, rate=RATE)
    assert len(log.gaps) == 2
    np.testing.assert_allclose(
        log.time[list(log.gaps)], [TIME[1000 + lost], TIME[4003]], atol=2e-3 if jitter > 1e-6 else 1e-9
    )
    assert len(log.time) <= len(time)
    assert said(log, "samples are missing at 2 places, the first after t =")


def test_a_recording_that_was_stopped_and_started_again(read):
    time = np.concatenate([TIME[:2000], TIME[2000:] + 0.12345])
    log = read(time, true=time, rate=RATE)
    assert log.gaps == (2000,)
    np.testing.assert_array_equal(log.time, time)


def test_repeated_stamps_are_left_out(read):
    time = np.insert(TIME, 700, TIME[699])
    log = read(time, rate=RATE)
    np.testing.assert_array_equal(log.time, TIME)
    assert said(log, "1 samples with a repeated time stamp were left out, the first at line 702")


# --- order ------------------------------------------------------------------------------------------------------------

BACK = {
    "midnight": ((86_397.0 + TIME) % 86_400, 1.0, "line 3002: .*midnight; add 24 h"),
    "16 bits of ms": ((64_000 + 1e3 * TIME) % 2**16, 1e-3, "a counter of 16 bits wrapped"),
    "32 bits of us": ((2**32 - 2e6 + 1e6 * TIME) % 2**32, 1e-6, "line 2002: .* a counter of 32 bits wrapped"),
    "two recordings": (np.concatenate([TIME[:3000], TIME[:2000]]), 1.0, "line 3002: .* a second recording begins"),
    "swapped rows": (np.concatenate([TIME[:3000], TIME[2500:4500]]), 1.0, "line 3002: .* not in order; sort them"),
    "standing still": (np.full(N, 3.0), 1.0, "the clock stands still at 3 s"),
}


@pytest.mark.parametrize(("stamps", "unit", "says"), BACK.values(), ids=BACK.keys())
def test_time_must_increase(stamps, unit, says, read):
    with pytest.raises(LogError, match=says):
        read(stamps, mapping=ColumnMapping(units={"time": f"{unit!r} s"}))


# --- several clocks ---------------------------------------------------------------------------------------------------

MS = np.arange(400)
CLOCKS = {
    "half the rate": (
        2 * MS,
        r"line 5: the command's .* is 1 ms ahead of 'time', with 2 ms per row beside 1 ms; export",
    ),
    "twice the rate": (0.5 * MS, r"line 5: .* is 0\.5 ms behind 'time', with 0\.5 ms per row beside 1 ms"),
    "half the rows": ([*map(str, 2 * MS[:200]), *200 * [""]], r"line 5: .* is 1 ms ahead of 'time', with 2 ms per row"),
    "part of a sample": (MS + 0.3, r"line 4: .* is 0\.3 ms ahead of 'time'; export channels of one task"),
    "samples and a half": (MS - 2.5, r"line 4: .* is 2\.5 ms behind 'time'; export"),
    "drift": (MS * 1.001, r"line 55: .* is 0\.051 ms ahead of 'time'; export"),
    "a restart": (MS + 5 * (MS > 300), r"line 305: .* is 5 ms ahead of 'time'; export"),
    "another recording": (MS + 5000, r"line 4: .* is 5000 ms ahead of 'time'; export"),
}


@pytest.mark.parametrize(("clock", "says"), CLOCKS.values(), ids=CLOCKS.keys())
def test_channels_on_another_clock_are_refused(clock, says, tmp_path):
    """TwinCAT Scope writes a clock for each channel: read by rows, the command would be late or compressed in time."""
    path = tmp_path / "scope.csv"
    rows = "".join(f"{k}\t{k}\t{own}\t{k if str(own) else ''}\n" for k, own in zip(MS, clock, strict=True))
    path.write_text("Name\tposition\tName\tcommand\nUnit\tmm\tUnit\tN\n\n" + rows)
    with pytest.raises(LogError, match=says) as error:
        read_log(path, rate=RATE)
    assert str(error.value).startswith(f"{path}: line")
    assert "'command.clock'" in str(error.value)


# --- rate -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate", "says"),
    [
        (1e6, r"Write \[units\] time = \"ms\""),
        (1e9, r"time = \"us\""),
        (1.0, r"has 1000 Hz, the drive file says 1 Hz; correct \[sampling\] rate"),
        (1003.0, r"has 1000 Hz, the drive file says 1003 Hz; correct \[sampling\] rate"),
        (1500.0, "has 1000 Hz, the drive file says 1500 Hz"),
        (70_000.0, "has 1000 Hz, the drive file says 70000 Hz"),
        (np.nan, "must be positive and finite"),
        (-1.0, "must be positive and finite"),
    ],
)
def test_another_rate_is_refused(rate, says, read):
    with pytest.raises(LogError, match=says):
        read(TIME, rate=rate)


@pytest.mark.parametrize(
    ("rate", "says"), [(4000.0, "every 4th sample of"), (10_000.0, "every 10th"), (500.0, "2 samples in each period")]
)
def test_a_decimated_log_is_told(rate, says, read):
    assert said(read(TIME, rate=rate), says)


def test_without_time_the_rate_counts(tmp_path):
    write_csv(tmp_path / "log.csv", {"position": position(TIME), "command": command(TIME)})
    log = read_log(tmp_path / "log.csv", rate=RATE)
    np.testing.assert_array_equal(log.time, TIME)
    assert log.notes == ("no column holds the time: counted at the drive file's 1000 Hz",)
    with pytest.raises(LogError, match='no column is called "time"'):
        read_log(tmp_path / "log.csv")


@pytest.mark.parametrize("header", ["Zeit [ms]", "clock_ms"])
def test_a_clock_that_nobody_named_is_not_counted_over(header, tmp_path):
    """At another rate than the log's every speed would be another."""
    columns = {header: 1e3 * TIME, "position": position(TIME), "command": command(TIME)}
    write_csv(tmp_path / "log.csv", columns)
    told = rf'\'{re.escape(header)}\' is in a unit of time .*--column "?time={re.escape(header)}'
    with pytest.raises(LogError, match=told):
        read_log(tmp_path / "log.csv", rate=5 * RATE)
    np.testing.assert_allclose(
        read_log(tmp_path / "log.csv", mapping=ColumnMapping({"time": header})).time, TIME, atol=1e-12
    )
    # what does not rise is no clock: the cycle's own duration, say
    write_csv(tmp_path / "log.csv", columns | {header: np.full(len(TIME), 0.2)})
    np.testing.assert_array_equal(read_log(tmp_path / "log.csv", rate=RATE).time, TIME)


# --- samples without a value ------------------------------------------------------------------------------------------


def holed(values, *holes) -> np.ndarray:
    values = values.copy()
    for hole in holes:
        values[hole] = np.nan
    return values


def test_a_few_missing_values_are_interpolated(read):
    changed = {"position": holed(position(TIME), slice(100, 105)), "command": holed(command(TIME), 900)}
    log = read(TIME, **changed)
    np.testing.assert_allclose(log.position, position(TIME), atol=2e-8)
    assert log.command[900] == log.command[899]
    assert log.gaps == ()
    assert said(log, "position: 5 samples without a value were interpolated")
    assert said(log, "command: 1 samples")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_longer_stretches_become_gaps(bad, read):
    values = position(TIME)
    values[2000:2006] = bad
    log = read(TIME, position=values)
    assert log.gaps == (2000,)
    np.testing.assert_array_equal(log.time, np.delete(TIME, slice(2000, 2006)))
    assert said(log, "6 samples without a value were left out, which leaves 1 gaps")


def test_many_short_stretches_become_gaps(read):
    log = read(TIME, position=holed(position(TIME), slice(100, 4900, 800)))
    assert len(log.gaps) == 6


def test_ends_without_a_value_are_cut(read):
    log = read(TIME, position=holed(position(TIME), slice(0, 3)), command=holed(command(TIME), slice(-40, None)))
    np.testing.assert_array_equal(log.time, TIME[3:-40])
    assert said(log, "3 samples at the start and 40 at the end have no value and were cut off")


def test_rows_without_a_stamp_are_left_out(read):
    log = read(holed(TIME, slice(50, 60)), true=TIME)
    assert log.gaps == (50,)
    assert said(log, "10 rows without a time stamp")


def test_optional_channels_are_left_out_rather_than_the_log(read):
    slow = np.full(N, np.nan)
    slow[::500] = 20.0 + 0.001 * np.arange(0, N, 500)
    log = read(TIME, load=np.full(N, np.nan), current=holed(command(TIME), slice(0, 2500)), temperature=slow)
    assert len(log.time) == N
    assert log.load is None
    assert log.current is None
    assert np.ptp(log.temperature) == pytest.approx(4.5)
    assert said(log, "load: 100% of its samples have no value; the channel was left out")
    assert said(log, "temperature: 4990 samples")
