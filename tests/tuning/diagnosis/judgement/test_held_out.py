"""What held-out logs say of a verdict: withdrawn, not believed, and how much of the gap is closed."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from diffdrive.effects.catalogue import EFFECTS
from diffdrive.effects.friction import AppliedLoad
from tests.support.fake_fits import fake_fit
from tests.support.sound_log import DRIVE, simulate_log, two_sines
from tuning.diagnosis.diagnose import diagnose
from tuning.diagnosis.gap.gap import ForceGap, LoopGap
from tuning.diagnosis.hypotheses.calibration import NAMES, tolerated
from tuning.diagnosis.judgement.held_out import (
    PLAIN,
    SEEN,
    GapReduction,
    confirmed,
    fails_validation,
    gap_reduction,
    is_hidden,
    left_in_loop,
    prune_on_validation,
)
from tuning.diagnosis.judgement.verdict import Belief, Verdict
from tuning.diagnosis.selection.explanation import Explanation
from tuning.diagnosis.selection.search import Round

RATE = 1000.0


def comparison(deviance, scatter=0.0, moved=1.0):
    """What the held-out logs say of a model, piece by piece, and how far it moves a nominal parameter."""
    pieces = deviance / 50 + scatter * np.random.default_rng(0).choice([-1.0, 1.0], 50) * (deviance != 0.0)
    bare = SimpleNamespace(
        theta=np.full(len(NAMES), moved),
        model=SimpleNamespace(members=(), coarse=False, coupled=False, prior=tolerated(0.02)),
    )
    return SimpleNamespace(unlikely=pieces, fitted=bare)


def test_a_model_is_denied_by_more_than_chance_and_more_than_a_little():
    assert fails_validation(comparison(50.0), comparison(0.0), 500.0)
    assert not fails_validation(comparison(10.0), comparison(0.0), 100.0)
    assert not fails_validation(comparison(50.0), comparison(0.0), 5000.0)  # beside what it explains it is little
    assert not fails_validation(
        comparison(50.0, scatter=8.0), comparison(0.0), 500.0
    )  # some pieces say so, others the contrary
    assert not fails_validation(comparison(50.0), comparison(0.0, moved=20.0), 500.0)  # by numbers that cannot be
    assert fails_validation(comparison(50.0, moved=20.0), comparison(0.0, moved=20.0), 500.0)


@pytest.mark.parametrize(
    ("moved", "gained", "hidden"),
    [(8.5, 0.1, True), (8.5, 500.0, False), (1.0, 0.1, False)],
)
def test_recalibration_hides_what_it_tells_as_well_by_a_number_moved_far(moved, gained, hidden):
    base = fake_fit(evidence=0.0, max_prior_deviation=moved)
    best = fake_fit("payload_mass", evidence=-60.0 - gained)
    base.filtered, best.filtered = (SimpleNamespace(deviance=one) for one in (0.0, -gained))
    assert is_hidden(Explanation(base, [], best)) == hidden


def in_loop(position, floor, command=0.0, says="", coarse=True):
    """What the simulation in closed loop is off, by its position and by a command whose floor is one."""
    members = [SimpleNamespace(candidate=SimpleNamespace(coarse=coarse))]
    loop = LoopGap(position, command, floor, 1.0, says)
    return SimpleNamespace(loop=loop, fitted=SimpleNamespace(model=SimpleNamespace(members=members)))


def left(*comparisons):
    """Of the recalibrated drive and what follows; the nominal one tells nothing."""
    return left_in_loop([in_loop(1e3, 1.0), *comparisons])


def test_what_is_left_in_closed_loop_is_what_lies_beyond_the_floor():
    before = in_loop(5.0, 1.0)
    assert left(before, in_loop(3.0, 1.0)) == pytest.approx((9.0 - PLAIN) / (25.0 - PLAIN))
    assert left(before, in_loop(1.4, 1.0)) == 0.0
    assert left(before, in_loop(9.0, 1.0)) == 1.0  # worse than before is all of it
    assert left(in_loop(0.99 * SEEN, 1.0), in_loop(1.0, 1.0)) is None
    away = in_loop(np.inf, np.inf, says="runs away")
    assert left(before, away) == 1.0
    assert left(away, in_loop(0.5, 0.6)) is None
    unknown = SimpleNamespace(loop=None)
    assert left(unknown, unknown) is None
    assert left(before) is None


def test_a_simulation_that_hunts_explains_nothing_by_differing_from_itself():
    before = in_loop(5.0, 1.0)
    assert left(before, in_loop(5.5, 0.99 * SEEN)) == 1.0
    assert left(before, in_loop(5.5, 1.01 * SEEN)) is None


def test_of_position_and_command_the_one_of_which_more_is_left_counts():
    assert left(in_loop(5.0, 1.0, 8.0), in_loop(1.0, 1.0, 5.0)) == pytest.approx((25.0 - PLAIN) / (64.0 - PLAIN))
    assert left(in_loop(5.0, 1.0, 0.9 * SEEN), in_loop(1.0, 1.0, 0.8 * SEEN)) == 0.0  # hardly seen before


@pytest.mark.parametrize(("after_first", "told"), [(9.0, 0.0), (1.5, None), (1.0, None)])
def test_beside_another_an_effect_whose_details_differ_must_have_closed_most_of_what_it_found(after_first, told):
    """A force limit closes the gap: a frame beside it is not proved by that."""
    before, first, second = in_loop(10.0, 1.0), in_loop(after_first, 1.0, coarse=False), in_loop(1.3, 1.0)
    assert left(before, first, second) == told
    plain = in_loop(1.3, 1.0, coarse=False)
    assert left(before, in_loop(2.5, 1.0), plain) == 0.0


@pytest.mark.parametrize(("held_out", "confidence"), [(-500.0, 0.9), (50.0, 0.5)])
def test_a_cause_that_foresees_held_out_logs_worse_is_not_believed(held_out, confidence):
    verdict = Verdict("effect", [Belief("cogging", 0.9, True, 0, 500.0, None, [])], 0.0, "cogging explains the gap")
    comparisons = [comparison(one) for one in (100.0, 0.0, held_out)]
    judged = confirmed(verdict, comparisons, None)
    assert judged.verdict == ("effect" if held_out < 0.0 else "unknown")
    assert judged.beliefs[0].confidence == confidence


@pytest.mark.parametrize(("held_out", "stays"), [((0.0, -500.0, -900.0), 2), ((0.0, -500.0, -400.0), 1)])
def test_a_second_effect_that_foresees_held_out_logs_worse_is_withdrawn(held_out, stays):
    fits = [SimpleNamespace(evidence=-900.0 * k, model=SimpleNamespace(added=k)) for k in range(len(held_out))]
    rounds = [Round(fits[k], [], [fits[k + 1]], 1, 0.0) for k in range(2)]
    comparisons = [comparison(one) for one in (100.0, *held_out)]
    elsewhere = Explanation(fits[0], rounds[:1], fits[2])
    found, left = prune_on_validation(Explanation(fits[0], rounds, fits[2], elsewhere), comparisons)
    assert found.best is fits[stays]
    assert (found.other is elsewhere) == (stays == 2)  # two effects are no rival of the one that is left
    assert len(left) == stays + 2
    assert [one.enough == np.inf for one in found.rounds] == [False, stays < 2]  # and is not believed any more


def lacking(force, floor=1.0, trusting=2.0):
    """A rung whose force gap is white, of this RMS (N), over 20 s, told by such a filter; the same noise in each."""
    white = np.random.default_rng(1).standard_normal((1, 20_000))
    signal = force * white / np.sqrt(np.mean(white**2))
    gap = ForceGap(signal, None, signal**2, np.ones_like(signal))
    return SimpleNamespace(force=gap, floor=floor, trusting=np.array([trusting, 1e-3]))


def test_what_is_closed_is_counted_from_the_floor():
    share, low, high = gap_reduction(lacking(3.0), lacking(np.sqrt(3.0)), RATE)
    assert share == pytest.approx(1.0 - 2.0 / 8.0)  # (3 - 1) of (9 - 1) N^2 are left
    assert low <= share <= high
    assert high - low < 0.05
    assert gap_reduction(lacking(3.0), lacking(0.9), RATE).share == 1.0  # below the floor is at it
    assert gap_reduction(lacking(3.0), lacking(4.0), RATE).share < 0.0
    assert gap_reduction(lacking(1.02), lacking(1.0), RATE) is None  # of nothing there is no share


def test_of_a_gap_that_may_as_well_be_none_there_is_no_share():
    """A little beyond the floor, in stretches: drawn anew, it lies within as often as not."""
    gap = lacking(1.07)
    loud = np.where(np.arange(20_000) % 5000 < 2000, 1.5, 0.5)
    gap.force = gap.force._replace(force=gap.force.force * loud / np.sqrt(np.mean(loud**2)))
    assert gap_reduction(gap, gap, RATE) is None
    clear = lacking(3.0)
    clear.force = clear.force._replace(force=3.0 * gap.force.force)
    assert gap_reduction(clear, clear, RATE) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("before", [1.0, 1.3, 2.0])
def test_a_gap_that_is_opened_in_a_single_place_is_opened(before):
    """A quarter of a second where the force is twenty times what it was: many a draw misses it."""
    after = lacking(0.97)
    loud = np.where(np.abs(np.arange(20_000) - 10_000) < 125, 20.0, 1.0)
    after.force = after.force._replace(force=after.force.force * loud)
    share = gap_reduction(lacking(before), after, RATE)
    assert share.share < 0.0


def test_what_closes_next_to_nothing_of_a_plain_gap_closes_nothing():
    assert gap_reduction(lacking(2.0), lacking(1.95), RATE).share < 0.1


def test_a_model_told_by_a_filter_of_its_own_is_held_against_the_floor_of_that():
    before = lacking(3.0, floor=np.sqrt(5.0), trusting=200.0)
    assert gap_reduction(before, lacking(1.0, floor=0.5), RATE).share == pytest.approx(1.0 - 0.75 / 4.0)
    assert gap_reduction(before, lacking(1.0, floor=0.5, trusting=200.0), RATE).share == pytest.approx(
        1.0 - 0.75 / 8.75
    )
    hidden = lacking(1.02, floor=1.0, trusting=200.0)
    assert (
        gap_reduction(hidden, lacking(0.5, floor=0.5), RATE) is None
    )  # not more than its own filter makes of the noise


def test_an_effect_that_opens_a_gap_closes_none():
    assert gap_reduction(lacking(1.0), lacking(2.0), RATE).high < 0.0
    assert gap_reduction(lacking(1.0), lacking(1.04), RATE) is None  # within the floor


@pytest.mark.parametrize(
    ("before", "after"), [((3.0, 1.0), (np.nan, 1.0)), ((np.nan, 1.0), (1.0, 1.0)), ((3.0, 1.0), (1.0, np.nan))]
)
def test_a_filter_that_ran_away_closes_nothing(before, after):
    assert gap_reduction(lacking(*before), lacking(*after), RATE) == (0.0, 0.0, 0.0)


def test_a_filter_that_is_lost_closes_nothing_and_what_it_saw_is_nothing_to_close():
    near, lost = lacking(3.0), lacking(1e-7)
    lost.force = lost.force._replace(lost=0.3)
    assert gap_reduction(near, lost, RATE) == (0.0, 0.0, 0.0)
    assert gap_reduction(lost, near, RATE) is None


def test_a_filter_that_ran_away_denies():
    sound, gone = comparison(0.0), SimpleNamespace(unlikely=np.full(50, np.nan), fitted=comparison(0.0).fitted)
    assert fails_validation(gone, sound, 500.0)
    assert fails_validation(gone, gone, 500.0)
    assert not fails_validation(sound, gone, 500.0)


@pytest.mark.parametrize(
    ("share", "verdict"),
    [(None, "effect"), ((0.9, 0.7, 1.0), "effect"), ((0.4, 0.3, 0.5), "unknown"), ((0.7, -0.1, 1.0), "unknown")],
)
def test_a_cause_that_leaves_most_of_the_held_out_gap_is_not_believed(share, verdict):
    believed = Verdict("effect", [Belief("cogging", 0.9, True, 0, 500.0, None, [])], 0.0, "cogging explains the gap")
    judged = confirmed(believed, [comparison(one) for one in (100.0, 0.0, -500.0)], share and GapReduction(*share))
    assert judged.verdict == verdict
    assert judged.beliefs[0].confidence == (0.9 if verdict == "effect" else 0.5)
    assert ("of the missing force is gone" in judged.says) == (verdict == "unknown")


@pytest.mark.parametrize(("left", "coarse", "verdict"), [(2.4, True, 0), (2.6, True, 1), (2.6, False, 0)])
def test_details_that_an_effect_may_leave_are_no_larger_than_what_noise_makes(left, coarse, verdict):
    """Though that is a thousandth of the gap: a play in the place of an elastic screw leaves no more."""
    believed = Verdict("effect", [Belief("backlash", 0.9, True, 0, 5e4, None, [])], 0.0, "backlash explains the gap")
    comparisons = [comparison(one) for one in (100.0, 0.0, -500.0)]
    comparisons[-1].force, comparisons[-1].floor = lacking(left).force, 1.0
    comparisons[-1].fitted.model.coarse = coarse
    judged = confirmed(believed, comparisons, GapReduction(0.999, 0.99, 1.0))
    assert judged.verdict == ("effect", "unknown")[verdict]
    assert judged.beliefs[0].confidence == (0.9, 0.5)[verdict]
    assert ("2.6 times its floor" in judged.says) == bool(verdict)
    comparisons[-1].fitted.model.coupled = True  # then the floor may be the recalibrated drive's, whose filter is lost
    comparisons[1].force = lacking(1.0).force._replace(lost=0.5)
    assert confirmed(believed, comparisons, GapReduction(0.999, 0.99, 1.0)).verdict == "effect"
    comparisons[-1].fitted.model.coupled, comparisons[-1].floor = False, np.inf
    assert confirmed(believed, comparisons, GapReduction(0.999, 0.99, 1.0)).verdict == "effect"


@pytest.mark.long
def test_what_begins_in_the_last_part_of_a_single_log_is_proved_in_other_parts():
    """At 70 % of it: the first 60 % cannot tell how large it is."""
    loaded = dataclasses.replace(DRIVE.drive, effects=(AppliedLoad(more=40e3, start=3.5, end=1e9),))
    log = simulate_log(dataclasses.replace(DRIVE, drive=loaded), two_sines(5.0))
    others = [name for name in EFFECTS if name not in ("applied_load", "constant_force", "friction_shape")]
    found = diagnose(DRIVE.drive, DRIVE.controller, [log], without=others, most_effects=1)
    assert found.split.says.startswith("every other tenth of the log held out")
    assert found.verdict.verdict == "effect"
    assert [one.effect for one in found.verdict.beliefs if one.found] == ["applied_load"]
    assert found.closed.share > 0.9
    values = found.found.model.values(found.found.theta)[-1]
    assert values["more"][0] == pytest.approx(40e3, rel=0.05)
    assert values["start"][0] == pytest.approx(3.5, abs=0.05)
