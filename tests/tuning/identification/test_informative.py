"""Which stretches of long logs are fitted: by what moves in them, and none is lost."""

import dataclasses

import numpy as np
import pytest

from diffdrive.logs import Log
from diffdrive.model.presets import paper_drive
from tuning.identification.informative import STRETCH, most_informative

RATE = 500.0
DRIVE = paper_drive()


def log_of(seconds, velocity, name="lap", **more):
    time = np.arange(int(seconds * RATE)) / RATE
    position = np.cumsum(velocity(time)) / RATE + 1e-9 * np.random.default_rng(0).standard_normal(len(time))
    return Log(name, time=time, position=position, command=np.arange(len(time), dtype=float), **more)


def mostly_resting(time):
    """It moves from 20 to 25 s fast, from 60 to 65 s slowly."""
    fast = 0.1 * np.sin(2 * np.pi * time) * ((time >= 20) & (time < 25))
    slow = 0.002 * np.sin(np.pi * time) * ((time >= 60) & (time < 65))
    return fast + slow


def test_short_logs_are_fitted_as_they_are():
    logs = [log_of(12.0, mostly_resting), log_of(12.0, mostly_resting, "other")]
    found = most_informative(logs, DRIVE)
    assert list(found.fitted) == logs
    assert (found.rest, found.note) == ((), "")


def test_of_a_long_log_what_moves_is_fitted_and_the_rest_held_out():
    log = log_of(100.0, mostly_resting)
    found = most_informative([log], DRIVE, seconds=10.0)
    (fitted,), (rest,) = found
    times = {round(float(fitted.time[piece][0])) for piece in fitted.pieces()}
    assert times == {20, 60}
    assert [piece.stop - piece.start for piece in fitted.pieces()] == [STRETCH * RATE] * 2
    assert "last 100 s: fitted are the 10 s" in found.note
    # no sample is lost, none is in both, and each has its own signals
    assert sorted([*fitted.command, *rest.command]) == list(log.command)
    np.testing.assert_array_equal(fitted.position, log.position[fitted.command.astype(int)])
    assert fitted.rate == pytest.approx(RATE)


def test_a_stretch_that_shows_something_new_goes_before_one_more_of_the_same():
    """A load that is there for a tenth of the time, and speeds that are alike."""

    def strokes(time):
        return 0.05 * np.sin(2 * np.pi * time)

    log = log_of(100.0, strokes)
    loaded = dataclasses.replace(log, load=np.where((log.time >= 40) & (log.time < 45), 8e3, 0.0))
    (fitted,), _ = most_informative([loaded], DRIVE, seconds=10.0)
    assert np.max(fitted.load) == 8e3
    assert np.min(fitted.load) == 0.0


def test_several_logs_and_their_gaps_are_cut_at_the_gaps():
    torn = dataclasses.replace(log_of(30.0, lambda time: 0.05 * np.sin(2 * np.pi * time)), gaps=(7_000, 7_050))
    resting = log_of(30.0, np.zeros_like, "rest")
    found = most_informative([torn, resting], DRIVE, seconds=20.0)
    assert [log.name for log in found.fitted] == ["lap"]
    assert [log.name for log in found.rest] == ["lap", "rest"]
    for log in (*found.fitted, *found.rest):
        for piece in log.pieces():  # no stretch reaches over a place where samples are missing, or were cut out
            np.testing.assert_allclose(np.diff(log.time[piece]), 1.0 / RATE, rtol=1e-6)
