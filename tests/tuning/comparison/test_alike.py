"""Both sides of a comparison are identified by the same encoders, read alike, from as many starting points."""

from types import SimpleNamespace

import numpy as np
import pytest

from diffdrive.logs import Log
from tuning.checked_logs import CheckedLogs
from tuning.comparison import alike
from tuning.identification.row_force import BetweenRows
from tuning.optimisation.least_squares import Outcome

TIME = np.arange(100) * 1e-3


def side(name, motor=True):
    signal = np.zeros(100)
    return CheckedLogs((Log(name, TIME, signal, signal, motor_position=signal if motor else None),), ())


@pytest.fixture
def fits(monkeypatch):
    """Every fit: that of `loose` leaves the motor's encoder out by itself, that of `slow` takes rows for snapshots."""
    made = []

    def identify_checked(axis, used, held_out, *, start=None, starts, between=None, **more):
        (log,) = used.logs
        by_motor = log.motor_position is not None and log.name != "loose"
        made.append((log.name, by_motor, start, starts))
        full = SimpleNamespace(problem=SimpleNamespace(lanes=SimpleNamespace(motor="read" if by_motor else None)))
        search = SimpleNamespace(outcome=Outcome.INTERRUPTED if log.name == "stopped" else Outcome.CONVERGED)
        between = between or (BetweenRows.SMOOTH if log.name == "slow" else BetweenRows.HELD)
        return SimpleNamespace(fit=SimpleNamespace(full_fit=full, search=search, name=log.name, between=between))

    monkeypatch.setattr(alike, "identify_checked", identify_checked)
    monkeypatch.setattr(alike, "answer", lambda fit: f"answer of {fit.name}")
    return made


def identified(before, after):
    quiet = {"store": None, "progress": lambda *_: None}
    return alike.identified_alike(None, before, after, fixed=(), starts=6, seed=0, **quiet)


def test_two_fits_by_both_encoders_stand(fits):
    found = identified(side("first"), side("second"))
    assert found.notes == ()
    assert fits == [("first", True, None, 6), ("second", True, "answer of first", 6)]


@pytest.mark.parametrize("names", [("first", "loose"), ("loose", "second")])
def test_where_one_side_goes_without_the_motor_s_encoder_both_do(fits, names):
    found = identified(*map(side, names))
    assert [by_motor for _, by_motor, *_ in fits[2:]] == [False, False]
    without = "before" if names[0] == "loose" else "after"
    assert found.notes == (
        f"both sides are fitted by the scale alone: {without}, the motor's encoder is left out of the fit",
    )


def test_a_log_without_a_motor_s_encoder_takes_it_from_the_other_side(fits):
    assert identified(side("first", motor=False), side("second")).notes
    assert [by_motor for _, by_motor, *_ in fits] == [False, True, False, False]


@pytest.mark.parametrize(("names", "which"), [(("first", "slow"), "after"), (("slow", "second"), "before")])
def test_where_the_rows_of_one_side_are_snapshots_those_of_both_are(fits, names, which):
    found = identified(*map(side, names))
    assert [found.before.fit.between, found.after.fit.between] == 2 * [BetweenRows.SMOOTH]
    assert found.notes == (f"the rows of both sides are read as snapshots of a faster loop, as those {which} show it",)
    assert len(fits) == 4
    assert fits[-1][2] == f"answer of {names[0]}"


def test_half_a_comparison_is_none(fits):
    with pytest.raises(KeyboardInterrupt):
        identified(side("first"), side("stopped"))
