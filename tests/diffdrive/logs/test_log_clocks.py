"""TwinCAT Scope: each channel has a clock of its own, and a sample belongs where its own stamp is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffdrive.errors import LogError
from diffdrive.logs import ColumnMapping, read_log

N = 300
MS = np.arange(N)
POSITION = np.round(1e3 * np.sin(MS / 40.0), 6)
COMMAND = np.round(np.cos(MS / 30.0), 6)
SCOPE = ColumnMapping({"position": "Act", "command": "Trq"})


def scope(path, command_clock, command=COMMAND, clock=MS, position=POSITION, stamp="{}") -> None:
    """A scope's export; None leaves a cell empty."""

    def written(values, form="{}"):
        return ["" if value is None else form.format(value) for value in values]

    columns = [written(clock, stamp), written(position), written(command_clock, stamp), written(command)]
    head = "Name\tAct\tName\tTrq\nSampleTime[ms]\t1\tSampleTime[ms]\t1\nUnit\tmm\tUnit\tN\n\n"
    path.write_text(head + "\n".join(map("\t".join, zip(*columns, strict=True))) + "\nEOF\n")


def test_equal_clocks_are_no_matter(tmp_path):
    scope(tmp_path / "scope.csv", MS)
    log = read_log(tmp_path / "scope.csv", mapping=SCOPE, rate=1000.0)
    np.testing.assert_array_equal(log.command, COMMAND)
    assert log.notes == ()


@given(
    shift=st.integers(-250, 250).filter(bool),
    period=st.sampled_from([1, 2, 0.25]),
    lost=st.sets(st.integers(5, N - 5), max_size=3),
)
@settings(max_examples=60)
def test_whole_samples_between_the_clocks_are_taken_off(shift, period, lost, tmp_path_factory):
    """Whatever the offset, the period and the gaps, the command comes out at its own stamps."""
    path = tmp_path_factory.getbasetemp() / "scope.csv"
    kept = np.delete(MS, sorted(lost))
    scope(path, (kept + shift) * period, COMMAND[kept], kept * period, POSITION[kept])
    log = read_log(path, mapping=SCOPE)
    rows = np.rint(1e3 * log.time / period).astype(int)
    np.testing.assert_array_equal(log.command, COMMAND[rows - shift])
    np.testing.assert_allclose(log.position, 1e-3 * POSITION[rows], rtol=1e-14)
    assert set(rows) == set(kept) & set(kept + shift)
    way = "ahead of" if shift > 0 else "behind"
    assert any(
        note.startswith(f"command: its own clock, 'Trq.clock', is {abs(shift) * period:g} ms {way} 'time'")
        for note in log.notes
    )


@pytest.mark.parametrize(
    ("stamp", "mapping"),
    [
        ("26.03.2024 09:00:00,{:03}", SCOPE),
        ("9:00:00.{:03}", SCOPE),
        ("13295950584{:03}0000", ColumnMapping(SCOPE.columns, {"time": "100 ns"})),
    ],
)
def test_stamps_of_every_form_are_compared(stamp, mapping, tmp_path):
    path = tmp_path / "scope.csv"
    scope(path, MS, stamp=stamp)
    np.testing.assert_array_equal(read_log(path, mapping=mapping).command, COMMAND)
    scope(path, MS + 3, stamp=stamp)
    log = read_log(path, mapping=mapping)
    np.testing.assert_array_equal(log.command, COMMAND[:-3])
    np.testing.assert_allclose(log.position, 1e-3 * POSITION[3:], rtol=1e-14)
    scope(path, 2 * MS, stamp=stamp)
    with pytest.raises(
        LogError, match=r"line 6: the command's own clock, 'Trq\.clock', is 1 ms ahead of 'time', with 2"
    ):
        read_log(path, mapping=mapping)


def test_another_clock_may_be_the_time(tmp_path):
    path = tmp_path / "scope.csv"
    scope(path, MS + 1)
    log = read_log(path, mapping=ColumnMapping(SCOPE.columns | {"time": "Trq.clock"}))
    np.testing.assert_array_equal(log.command, COMMAND[:-1])
    np.testing.assert_allclose(log.position, 1e-3 * POSITION[1:], rtol=1e-14)


def test_channels_that_share_a_clock_share_its_offset(tmp_path):
    path = tmp_path / "scope.csv"
    rows = "\n".join(f"{k}\t{POSITION[k]}\t{k + 2}\t{COMMAND[k]}\t{k}" for k in MS)
    path.write_text("Name\tAct\tName\tTrq\tLoad\nUnit\tmm\tUnit\tN\tN\n\n" + rows + "\n")
    log = read_log(path, mapping=ColumnMapping(SCOPE.columns | {"load": "Load"}))
    np.testing.assert_array_equal(log.command, COMMAND[:-2])
    np.testing.assert_array_equal(log.load, MS[:-2])


def test_a_clock_of_a_channel_that_is_not_used_is_no_matter(tmp_path):
    path = tmp_path / "scope.csv"
    rows = "\n".join(f"{k}\t{POSITION[k]}\t{k}\t{COMMAND[k]}\t{10 * k}\t20" for k in MS)
    path.write_text("Name\tAct\tName\tTrq\tName\tTemp\nUnit\tmm\tUnit\tN\tUnit\tC\n\n" + rows + "\n")
    np.testing.assert_array_equal(read_log(path, mapping=SCOPE).command, COMMAND)


def test_a_slower_channel_that_is_empty_between_is_read_at_its_own_rate(tmp_path):
    path = tmp_path / "scope.csv"
    even = [k if k % 2 == 0 else None for k in MS]
    scope(path, even, [COMMAND[k] if k % 2 == 0 else None for k in MS])
    log = read_log(path, mapping=SCOPE)
    assert log.rate == pytest.approx(500.0)
    np.testing.assert_array_equal(log.command, COMMAND[::2])
