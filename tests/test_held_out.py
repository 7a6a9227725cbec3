"""What held-out logs say of a verdict: withdrawn, not believed, and how much of the gap is closed."""

from types import SimpleNamespace

import numpy as np
import pytest

from tuning.diagnosis.calibration import NAMES
from tuning.diagnosis.explain import Explanation
from tuning.diagnosis.gap import ForceGap
from tuning.diagnosis.held_out import Closed, closed, confirmed, denied, upheld
from tuning.diagnosis.search import Round
from tuning.diagnosis.verdict import Belief, Verdict

RATE = 1000.0


def rung(deviance, scatter=0.0, moved=1.0):
    """What the held-out logs say of a model, piece by piece, and how far it moves a nominal parameter."""
    pieces = deviance / 50 + scatter * np.random.default_rng(0).choice([-1.0, 1.0], 50) * (deviance != 0.0)
    return SimpleNamespace(unlikely=pieces, fitted=SimpleNamespace(u=np.full(len(NAMES), moved)))


def test_a_model_is_denied_by_more_than_chance_and_more_than_a_little():
    assert denied(rung(50.0), rung(0.0), 500.0)
    assert not denied(rung(10.0), rung(0.0), 100.0)
    assert not denied(rung(50.0), rung(0.0), 5000.0)  # beside what it explains it is little
    assert not denied(rung(50.0, scatter=8.0), rung(0.0), 500.0)  # some pieces say so, others the contrary
    assert not denied(rung(50.0), rung(0.0, moved=20.0), 500.0)  # by numbers that cannot be
    assert denied(rung(50.0, moved=20.0), rung(0.0, moved=20.0), 500.0)


@pytest.mark.parametrize(("held_out", "confidence"), [(-500.0, 0.9), (50.0, 0.5)])
def test_a_cause_that_foresees_held_out_logs_worse_is_not_believed(held_out, confidence):
    verdict = Verdict("effect", [Belief("cogging", 0.9, True, 0, 500.0, None, [])], 0.0, "cogging explains the gap")
    rungs = [rung(one) for one in (100.0, 0.0, held_out)]
    judged = confirmed(verdict, rungs, None)
    assert judged.verdict == ("effect" if held_out < 0.0 else "unknown")
    assert judged.beliefs[0].confidence == confidence


@pytest.mark.parametrize(("held_out", "stays"), [((0.0, -500.0, -900.0), 2), ((0.0, -500.0, -400.0), 1)])
def test_a_second_effect_that_foresees_held_out_logs_worse_is_withdrawn(held_out, stays):
    fits = [SimpleNamespace(evidence=-900.0 * k, model=SimpleNamespace(added=k)) for k in range(len(held_out))]
    rounds = [Round(fits[k], [], [fits[k + 1]], 1, 0.0) for k in range(2)]
    rungs = [rung(one) for one in (100.0, *held_out)]
    elsewhere = Explanation(fits[0], rounds[:1], fits[2])
    found, left = upheld(Explanation(fits[0], rounds, fits[2], elsewhere), rungs)
    assert found.best is fits[stays]
    assert (found.other is elsewhere) == (stays == 2)  # two effects are no rival of the one that is left
    assert len(left) == stays + 2
    assert [one.enough == np.inf for one in found.rounds] == [False, stays < 2]  # and is not believed any more


def lacking(force, floor=1.0):
    """A rung whose force gap is white, of this RMS (N), over 20 s; the same noise in each."""
    white = np.random.default_rng(1).standard_normal((1, 20_000))
    signal = force * white / np.sqrt(np.mean(white**2))
    return SimpleNamespace(force=ForceGap(signal, None, signal**2, np.ones_like(signal)), floor=floor)


def test_what_is_closed_is_counted_from_the_floor():
    share, low, high = closed(lacking(3.0), lacking(np.sqrt(3.0)), RATE)
    assert share == pytest.approx(1.0 - 2.0 / 8.0)  # (3 - 1) of (9 - 1) N^2 are left
    assert low <= share <= high
    assert high - low < 0.05
    assert closed(lacking(3.0), lacking(0.9), RATE).share == 1.0  # below the floor is at it
    assert closed(lacking(3.0), lacking(4.0), RATE).share < 0.0
    assert closed(lacking(1.02), lacking(1.0), RATE) is None  # of nothing there is no share


@pytest.mark.parametrize(
    ("share", "verdict"),
    [(None, "effect"), ((0.9, 0.7, 1.0), "effect"), ((0.4, 0.3, 0.5), "unknown"), ((0.7, -0.1, 1.0), "unknown")],
)
def test_a_cause_that_leaves_most_of_the_held_out_gap_is_not_believed(share, verdict):
    believed = Verdict("effect", [Belief("cogging", 0.9, True, 0, 500.0, None, [])], 0.0, "cogging explains the gap")
    judged = confirmed(believed, [rung(one) for one in (100.0, 0.0, -500.0)], share and Closed(*share))
    assert judged.verdict == verdict
    assert judged.beliefs[0].confidence == (0.9 if verdict == "effect" else 0.5)
    assert ("closed" in judged.says) == (verdict == "unknown")
