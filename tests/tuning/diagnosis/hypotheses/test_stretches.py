"""Which stretches of long logs are diagnosed: the beginning of each, and those that show what no other does."""

import dataclasses

import numpy as np
import pytest

from diffdrive.logs import Log
from diffdrive.model.presets import paper_drive
from tuning.diagnosis.hypotheses.stretches import _hats, _turned, most_telling

RATE = 500.0
DRIVE = paper_drive()


def log_of(velocity, seconds=100.0, name="lap"):
    time = np.arange(int(seconds * RATE)) / RATE
    position = np.cumsum(velocity(time)) / RATE + 1e-9 * np.random.default_rng(0).standard_normal(len(time))
    return Log(name, time=time, position=position, command=np.zeros(len(time)))


def begins(log):
    return {round(float(log.time[piece][0])) for piece in log.pieces()}


def short_strokes(time):
    return 0.05 * np.sin(2 * np.pi * time)


def test_short_logs_are_diagnosed_as_they_are():
    logs = [log_of(short_strokes, 15.0), log_of(short_strokes, 15.0, "other")]
    assert list(most_telling(logs, DRIVE).fitted) == logs


def test_a_log_keeps_its_beginning_from_which_times_count():
    logs = [log_of(short_strokes, 60.0), log_of(short_strokes, 60.0, "other")]
    found = most_telling(logs, DRIVE, seconds=20.0)
    assert [log.name for log in found.fitted] == ["lap", "other"]
    for whole, part in zip(logs, found.fitted, strict=True):
        assert part.time[0] == whole.time[0]
        assert 5.0 <= len(part.time) / RATE <= 15.0
    assert sum(len(log.time) for log in found.fitted) == 20.0 * RATE


def test_a_log_of_scraps_is_left_to_be_refused():
    whole = log_of(short_strokes)
    scraps = dataclasses.replace(whole, name="scraps", gaps=tuple(range(100, len(whole.time), 100)))
    assert list(most_telling([whole, scraps], DRIVE).fitted) == [whole, scraps]


def test_a_place_that_only_one_stretch_goes_to_is_diagnosed():
    def far_once(time):
        there = ((time >= 70.0) & (time < 71.0)).astype(float) - ((time >= 72.0) & (time < 73.0))
        return short_strokes(time) * (np.abs(time - 71.5) > 1.5) + 0.5 * there

    (part,) = most_telling([log_of(far_once)], DRIVE, seconds=10.0).fitted
    assert begins(part) == {0, 70}


def test_a_turn_that_only_one_stretch_makes_is_diagnosed():
    """One way all the time, but for a short return."""

    def onward(time):
        return 0.01 - 0.02 * ((time >= 52.0) & (time < 53.0))

    (part,) = most_telling([log_of(onward)], DRIVE, seconds=10.0).fitted
    assert begins(part) == {0, 50}


def test_hats_add_up_to_one_everywhere_between_their_ends():
    knots = np.linspace(-1.0, 2.0, 7)
    values = np.random.default_rng(1).uniform(-1.0, 2.0, 100)
    np.testing.assert_allclose(_hats(values, knots).sum(axis=1), 1.0)
    np.testing.assert_allclose(_hats(values, knots) @ knots, values, atol=1e-12)  # and reproduce what is linear


@pytest.mark.parametrize(
    ("way", "up", "down"),
    [
        ([0, 1, 1, 0, 0, -1, -1, -1, 0], [], [5, 6]),
        ([-1, 0, -1, 1, 1, 1, -1, -1], [3, 4], [6, 7]),
        ([0, 0, 1, 0, 1, 1], [], []),
    ],
)
def test_a_turn_is_where_the_table_moves_the_other_way_than_it_last_did(way, up, down):
    found = _turned(np.array(way, float), 2)
    assert list(np.flatnonzero(found[:, 0])) == up
    assert list(np.flatnonzero(found[:, 1])) == down
