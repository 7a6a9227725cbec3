"""The second way of a search: when it is gone, what comes of it, and what is searched for again at the end of each."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.fake_fits import FakeFitter, fake_fit, names, no_filter_lost  # noqa: F401
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.judgement import verdict
from tuning.diagnosis.levels import DETAILS, IMPOSSIBLE, WORTH
from tuning.diagnosis.selection import explain, refit
from tuning.diagnosis.selection.explain import _credibly, _searched_beside
from tuning.diagnosis.selection.explanation import Explanation, is_better, other_first
from tuning.diagnosis.selection.search import Round

pytestmark = pytest.mark.usefixtures("no_filter_lost")


def test_what_brings_the_parameters_back_is_tried_first_where_the_best_does_not():
    base = fake_fit(evidence=0.0, max_prior_deviation=6.0)
    backlash = fake_fit("backlash", evidence=-900.0, max_prior_deviation=5.5)
    tilt = fake_fit("constant_force", evidence=-100.0, max_prior_deviation=1.0)
    cogging = fake_fit("cogging", evidence=-300.0, max_prior_deviation=5.0)
    looked = Round(base, [], [backlash, cogging, tilt], 3, 0.0)
    first = other_first(Explanation(base, [looked], backlash))
    assert names(first) == ["constant_force", "backlash", "cogging"]
    assert first.rivals == 1  # it is tried, not preferred: the others are no rivals of it
    calm = fake_fit("backlash", evidence=-900.0, max_prior_deviation=3.0)
    assert other_first(Explanation(base, [looked], calm)) is None
    weak = looked._replace(fits=[backlash, fake_fit("constant_force", evidence=-WORTH, max_prior_deviation=1.0)])
    assert other_first(Explanation(base, [weak], backlash)) is None
    assert other_first(Explanation(base, [looked], base)) is None


def test_what_explains_nearly_as_much_is_tried_first_as_well():
    base = fake_fit(evidence=0.0)
    backlash, spring = (fake_fit(one, evidence=by) for one, by in (("backlash", -900.0), ("position_spring", -800.0)))
    looked = Round(base, [], [backlash, spring], 2, 0.0)
    first = other_first(Explanation(base, [looked], backlash))
    assert names(first) == ["position_spring", "backlash"]
    strained = looked._replace(fits=[backlash, fake_fit("position_spring", evidence=-1200.0, max_prior_deviation=9.0)])
    assert other_first(Explanation(base, [strained], backlash)) is None  # it stands behind since it cannot be
    far = looked._replace(fits=[backlash, fake_fit("position_spring", evidence=-700.0)])
    assert other_first(Explanation(base, [far], backlash)) is None
    assert other_first(Explanation(base, [looked._replace(fits=[backlash])], backlash)) is None


def test_no_end_with_numbers_that_cannot_be_is_better_than_one_that_can():
    base = fake_fit(evidence=5000.0)
    impossible, possible = (
        fake_fit(evidence=-900.0, max_prior_deviation=9.0),
        fake_fit(evidence=-100.0, max_prior_deviation=5.0),
    )
    assert not is_better(base, impossible, possible)
    assert is_better(base, possible, fake_fit(evidence=-50.0, max_prior_deviation=9.0))
    assert is_better(base, impossible, fake_fit(evidence=-100.0, max_prior_deviation=8.0))
    for lacks, better in ((0.9, True), (1.1, False)):
        far = fake_fit(evidence=-1000.0, max_prior_deviation=9.0)
        near = fake_fit(evidence=-1000.0 + lacks * DETAILS * 6000.0, max_prior_deviation=5.0)
        assert is_better(base, near, far) == better
    assert not is_better(base, fake_fit(evidence=-999.0), fake_fit(evidence=-1000.0))
    soft = fake_fit(
        evidence=-100.0, max_prior_deviation=5.0
    )  # what a table that slides tells counts before how the bristle bends
    soft.theta[NAMES.index("bristle_stiffness")] = 9.0
    assert not is_better(base, impossible, soft)


def test_a_second_effect_has_no_credit_for_what_searching_again_gave_the_first(monkeypatch):
    base = fake_fit(evidence=0.0)
    play, both = fake_fit("backlash", evidence=-500.0), fake_fit("backlash", "cogging", evidence=-700.0)
    nearer, searched = (fake_fit("backlash", evidence=-900.0), fake_fit("backlash", "cogging", evidence=-950.0))
    rounds = [Round(base, [], [play], 1, 0.0), Round(play, [], [both], 1, 0.0)]
    monkeypatch.setattr(explain, "searched_again", lambda *_: searched)
    monkeypatch.setattr(
        explain, "_refit_without_last", lambda fitter, before, fits: nearer if fits == [searched] else None
    )
    found = _searched_beside(None, Explanation(base, rounds, both))
    assert found.best is found.rounds[1].fits[0] is searched
    assert found.rounds[1].before is found.rounds[0].fits[0] is nearer
    assert _searched_beside(None, Explanation(base, rounds[:1], play)).best is play
    monkeypatch.setattr(explain, "searched_again", lambda fitter, before, one: one)
    assert _searched_beside(None, Explanation(base, rounds, both)).rounds == rounds


@pytest.mark.parametrize(("together", "found"), [(-960.0, {"backlash", "cogging"}), (-901.0, {"backlash"})])
def test_a_second_effect_that_is_worth_nothing_beside_the_first_searched_again_is_not_found(
    monkeypatch, together, found
):
    base, play = fake_fit(evidence=0.0), fake_fit("backlash", evidence=-500.0)
    both, searched = (fake_fit("backlash", "cogging", evidence=one) for one in (-700.0, together))
    nearer, asked = fake_fit("backlash", evidence=-900.0), []

    def look(fitter, before, *_):
        asked.append(before)
        if before is base:
            return Round(before, [], [play], 1, 0.0)
        more = [both] if before is play else [fake_fit("backlash", "cogging", evidence=before.evidence - 1.0)]
        return Round(before, [], more, 1, 0.0)

    monkeypatch.setattr(explain, "select_next_effect", look)
    monkeypatch.setattr(explain, "searched_again", lambda *_: searched)
    monkeypatch.setattr(
        explain, "_refit_without_last", lambda fitter, before, fits: nearer if fits == [searched] else None
    )
    monkeypatch.setattr(explain, "is_complete", lambda *_: False)
    monkeypatch.setattr(explain, "share_left", lambda *_: 1.0)
    ended = explain.explain(None, base, [], lambda *_: None)
    assert ended.named == found
    assert ended.best is (searched if len(found) == 2 else nearer)
    assert asked == ([base, play] if len(found) == 2 else [base, play, nearer])  # everything beside it as it is now
    refused = ended.rounds[1]
    gain = refused.before.evidence - refused.fits[0].evidence
    assert (gain >= refused.enough) == (len(found) == 2)


class Nearby(FakeFitter):
    """A fitter to which the drive file's own numbers are worth -4000, and what is fitted from there ends `near`, or
    where `later` says in turn.
    """

    def __init__(self, near):
        self.near, self.begun, self.later = near, [], []

    def minimise(self, model, theta, process_noise, trajectory, most, free=None):
        self.begun.append((theta, most, free))
        there = fake_fit("backlash", "cogging", evidence=-4000.0 if most else -1000.0)
        there.theta, there.process_noise, there.filtered = theta, "begun", SimpleNamespace(trajectory=None)
        return there, 0

    def fit(self, model, theta, process_noise, trajectory, *_):
        assert process_noise == "begun"
        self.begun.append((theta, None, None))
        return self.later.pop(0) if self.later else self.near


def far_and_near(monkeypatch, evidence, max_prior_deviation):
    """A search that ended 7.6 tolerances off at -9000, and the fitter that leads to another end from the file's own."""
    base, play = fake_fit(evidence=0.0), fake_fit("backlash", evidence=-8000.0)
    far, near = (
        fake_fit("backlash", "cogging", evidence=by, max_prior_deviation=moved)
        for by, moved in ((-9000.0, 7.6), (evidence, max_prior_deviation))
    )
    for one in (far, near):
        one.theta = np.r_[one.theta, 0.3, 0.4]
        one.filtered = SimpleNamespace(trajectory=None)
    monkeypatch.setattr(refit, "to_its_end", lambda fitter, one: one)
    monkeypatch.setattr(refit, "searched_again", lambda fitter, before, one: one)
    rounds = [Round(base, [], [play], 1, 0.0), Round(play, [], [far], 1, 0.0)]
    return Nearby(near), Explanation(base, rounds, far)


@pytest.mark.parametrize(
    ("evidence", "max_prior_deviation", "taken"), [(-8900.0, 5.0, True), (-8700.0, 5.0, False), (-8900.0, 6.5, False)]
)
def test_numbers_that_cannot_be_are_given_up_where_the_files_own_lead_nearly_as_far(
    monkeypatch, evidence, max_prior_deviation, taken
):
    """What they told is 5000 here, of which DETAILS is 250."""
    fitter, far = far_and_near(monkeypatch, evidence, max_prior_deviation)
    found = _credibly(fitter, far)
    if not taken:
        assert found is far
    else:
        assert found.best is found.rounds[1].fits[0] is fitter.near
        assert found.rounds[1].gain == far.rounds[1].gain  # what was lost is no less of a merit of the effect's
    for theta, _, _ in fitter.begun:  # from the drive file's own, the effects as they were found
        np.testing.assert_array_equal(theta[: len(NAMES)], 0.0)
        np.testing.assert_array_equal(theta[len(NAMES) :], [0.3, 0.4])
    free = next(one for _, most, one in fitter.begun if most)  # beside which what the file's own tell is measured
    np.testing.assert_array_equal(free, np.r_[np.zeros(len(NAMES)), 1.0, 1.0])
    fewer = Explanation(far.base, far.rounds[:1], far.rounds[0].fits[0])
    assert _credibly(fitter, fewer) is fewer


@pytest.mark.parametrize(("gain", "reached"), [(WORTH + 1.0, True), (WORTH - 1.0, False)])
def test_the_files_own_numbers_are_returned_to_as_long_as_that_leads_further(monkeypatch, gain, reached):
    """Each time beside the effects as they were found the time before: a gap is found a little closer."""
    fitter, far = far_and_near(monkeypatch, -8900.0, 5.0)
    fitter.later = [
        fake_fit("backlash", "cogging", evidence=by, max_prior_deviation=6.5) for by in (-8000.0, -8000.0 - gain)
    ]
    for effects, one in zip(([0.5, 0.5], [0.6, 0.6]), fitter.later, strict=True):
        one.theta, one.filtered = np.r_[one.theta, effects], SimpleNamespace(trajectory=None)
    found = _credibly(fitter, far)
    assert found.best is (fitter.near if reached else far.best)
    begun = [list(theta[len(NAMES) :]) for theta, most, _ in fitter.begun if most is None]
    assert begun == [[0.3, 0.4], [0.5, 0.5], [0.6, 0.6]][: 2 + reached]
    assert all((theta[: len(NAMES)] == 0.0).all() for theta, _, _ in fitter.begun)


def test_a_search_that_leads_off_once_more_is_not_followed(monkeypatch):
    fitter, far = far_and_near(monkeypatch, -8900.0, 5.0)
    off = fake_fit("backlash", "cogging", evidence=-9500.0, max_prior_deviation=9.0)
    monkeypatch.setattr(refit, "searched_again", lambda fitter, before, one: off)
    assert _credibly(fitter, far).best is fitter.near
    off.theta[0] = 2.0
    assert _credibly(fitter, far).best is off


def test_what_a_sliding_table_does_not_tell_may_stay_far_off(monkeypatch):
    fitter, far = far_and_near(monkeypatch, -8900.0, 5.0)
    fitter.near.theta[NAMES.index("bristle_stiffness")] = 9.0
    assert _credibly(fitter, far).best is fitter.near


def test_a_rival_that_needs_numbers_that_cannot_be_is_none_of_what_does_without(monkeypatch):
    """And one that does without them and explains more stands in front."""
    fitter, far = far_and_near(monkeypatch, -8900.0, 5.0)
    impossible, likelier, other = (
        fake_fit("backlash", name, evidence=by, max_prior_deviation=moved)
        for name, by, moved in (("lead_error", -8990.0, 8.0), ("constant_force", -8950.0, 2.0), ("stiction", -9.0, 0.0))
    )
    looked = far.rounds[1]._replace(fits=[far.best, impossible, likelier, other], rivals=3)
    found = _credibly(fitter, far._replace(rounds=[far.rounds[0], looked]))
    assert found.best is likelier
    assert found.rounds[1].fits == [likelier, fitter.near, impossible, other]
    assert found.rounds[1].rivals == 2
    assert found.rounds[1].gain == looked.gain
    for module in (explain, verdict):
        monkeypatch.setattr(module, "is_complete", lambda *_: False)
        monkeypatch.setattr(module, "share_left", lambda *_: 0.001)
    told = {one.effect: one for one in verdict.judge(None, found).beliefs}
    assert told["constant_force"].confidence > 0.5 > told["lead_error"].confidence


def test_the_search_goes_on_from_numbers_that_can_be(monkeypatch):
    """What stood in for a second effect is gone then: it is looked for."""
    base = fake_fit(evidence=0.0, max_prior_deviation=9.0)
    far, near = (
        fake_fit("backlash", evidence=by, max_prior_deviation=moved) for by, moved in ((-9000.0, 7.6), (-8900.0, 3.0))
    )
    tilted = fake_fit("backlash", "constant_force", evidence=-9500.0)

    def look(fitter, before, *_):
        nothing = fake_fit("backlash", "cogging", evidence=-9001.0, max_prior_deviation=7.6)
        return Round(before, [], [far if before is base else nothing if before is far else tilted], 1, 0.0)

    monkeypatch.setattr(explain, "select_next_effect", look)
    monkeypatch.setattr(explain, "refit_from_nominal", lambda fitter, before, one: near if one is far else one)
    monkeypatch.setattr(explain, "_refit_without_last", lambda *_: None)
    monkeypatch.setattr(explain, "is_complete", lambda fitter, one: one is tilted)
    monkeypatch.setattr(explain, "share_left", lambda *_: 1.0)
    found = explain.explain(None, base, [], lambda *_: None)
    assert found.best is tilted
    assert [one.fits[0] for one in found.rounds] == [near, tilted]


FIRST = {"backlash": (-900.0, 5.5), "constant_force": (-850.0, 1.0)}


def both_ways(monkeypatch, joint):
    """The search for a loose screw on a tilted axis; `joint` is the evidence of both together."""
    asked = []

    def look(fitter, before, catalogue, *_):
        there = [one.candidate.name for one in before.model.members]
        asked.append((there, [one.name for one in catalogue]))
        ends = {
            (): [((name,), *how) for name, how in FIRST.items()],
            ("backlash",): [(("backlash", "cogging"), -1000.0, 5.0)],
            ("constant_force",): [
                (("constant_force", "backlash"), joint, 1.0),
                (("constant_force", "cogging"), joint + 10.0, 1.0),
            ],
        }[tuple(there)]
        fits = [fake_fit(*one, evidence=by, max_prior_deviation=far) for one, by, far in ends]
        known = {one.name for one in catalogue}
        fits = [one for one in fits if one.model.members[-1].candidate.name in known]
        return Round(before, [], fits, len(fits), 0.0)

    monkeypatch.setattr(explain, "select_next_effect", look)
    monkeypatch.setattr(explain, "to_its_end", lambda fitter, one: one)
    monkeypatch.setattr(explain, "searched_again", lambda fitter, before, one: one)
    monkeypatch.setattr(explain, "_refit_without_last", lambda *_: None)
    for module in (explain, verdict):
        monkeypatch.setattr(module, "is_complete", lambda *_: False)
        monkeypatch.setattr(module, "share_left", lambda *_: 0.001)
    monkeypatch.setattr(explain, "share_left", lambda *_: 1.0)
    catalogue = [SimpleNamespace(name=one, absorbable=False) for one in ("backlash", "constant_force", "cogging")]
    return explain.explain(None, fake_fit(evidence=0.0, max_prior_deviation=8.0), catalogue, lambda *_: None), asked


def test_a_second_way_that_ends_better_has_everything_looked_for_beside_it(monkeypatch):
    found, asked = both_ways(monkeypatch, -2000.0)
    assert found.named == {"constant_force", "backlash"}
    assert found.other.named == {"backlash", "cogging"}
    everything = ["backlash", "constant_force", "cogging"]
    few = ["backlash", "cogging"]
    assert asked == [
        ([], everything),
        (["backlash"], everything),
        (["constant_force"], few),
        (["constant_force"], everything),
    ]
    assert names(found.rounds[1]) == ["backlash", "cogging"]
    told = verdict.judge(None, found)
    believed = {one.effect: one for one in told.beliefs if one.found}
    assert believed["constant_force"].confidence > 0.9
    assert believed["backlash"].alternatives == ["cogging"]  # ten in evidence do not exclude it


@pytest.mark.parametrize("joint", [-1001.0, -999.0])
def test_two_ways_that_end_alike_are_rivals(monkeypatch, joint):
    found, _ = both_ways(monkeypatch, joint)
    first, second = ("constant_force", "backlash") if joint < -1000.0 else ("backlash", "cogging")
    told = {one.effect: one for one in verdict.judge(None, found).beliefs if one.found}
    theirs = sorted(found.other.named - found.named)
    assert list(told) == [first, second]
    for name in found.named - found.other.named:
        assert told[name].confidence < 0.6
        assert set(theirs) <= set(told[name].alternatives)
    rival = next(one for one in verdict.judge(None, found).beliefs if one.effect in theirs and one.confidence > 0.3)
    assert set(rival.alternatives) == found.named - found.other.named


def test_a_way_refused_for_numbers_that_cannot_be_is_no_rival(monkeypatch):
    found, _ = both_ways(monkeypatch, -999.0)
    found.other.best.theta[0] = IMPOSSIBLE + 1.0
    assert verdict.judge(None, found).beliefs == verdict.judge(None, found._replace(other=None)).beliefs


def test_a_rival_of_a_round_that_ends_the_other_way_is_not_counted_twice(monkeypatch):
    monkeypatch.setattr(verdict, "is_complete", lambda *_: False)
    monkeypatch.setattr(verdict, "share_left", lambda *_: 0.001)
    base = fake_fit(evidence=0.0)
    fits = [fake_fit(name, evidence=by) for name, by in (("cogging", -1000.0), ("lead_error", -995.0))]
    first = Round(base, [], fits, 2, 0.0)
    other = Explanation(base, [first._replace(fits=fits[::-1])], fits[1])
    told = {one.effect: one for one in verdict.judge(None, Explanation(base, [first], fits[0], other)).beliefs}
    assert told["cogging"].confidence > told["lead_error"].confidence
    assert told["cogging"].confidence + told["lead_error"].confidence <= 1.0


def test_what_was_found_is_not_said_to_be_open(monkeypatch):
    """Of two effects found together, either may have been a near rival of the other in the first round."""
    monkeypatch.setattr(verdict, "is_complete", lambda *_: False)
    monkeypatch.setattr(verdict, "share_left", lambda *_: 0.001)
    base, one = fake_fit(evidence=0.0), fake_fit("cogging", evidence=-1000.0)
    both = fake_fit("cogging", "lead_error", evidence=-3000.0)
    rounds = [Round(base, [], [one, fake_fit("lead_error", evidence=-999.0)], 2, 0.0), Round(one, [], [both], 1, 0.0)]
    assert verdict.judge(None, Explanation(base, rounds, both)).says == "cogging and lead_error explain the gap"


@pytest.mark.parametrize(("left", "says"), [(3.0, "effect"), (IMPOSSIBLE + 1.0, "unknown")])
def test_an_effect_that_leaves_a_number_where_it_cannot_be_does_not_explain_how_it_came_there(monkeypatch, left, says):
    """Nothing is missing: how far the drive file's numbers were moved is all that speaks for an effect."""
    monkeypatch.setattr(verdict, "is_complete", lambda *_: True)
    base = fake_fit(evidence=0.0, max_prior_deviation=17.0)
    gain = fake_fit("force_gain", evidence=-100.0, max_prior_deviation=left)
    told = verdict.judge(None, Explanation(base, [Round(base, [], [gain], 1, 0.0)], gain))
    assert told.verdict == says
    assert told.beliefs[0].confidence == (verdict.UNSURE if says == "unknown" else verdict.SUREST)
    assert (f"still {NAMES[0]} had to be moved" in told.says) == (says == "unknown")


def test_no_cause_is_sure_where_the_logs_say_unknown(monkeypatch):
    """Also where what is left is but a little more than what the details of a model may leave."""
    monkeypatch.setattr(verdict, "is_complete", lambda *_: False)
    monkeypatch.setattr(verdict, "share_left", lambda *_: 0.021)
    base, one = fake_fit(evidence=0.0), fake_fit("cogging", evidence=-1e5)
    told = verdict.judge(None, Explanation(base, [Round(base, [], [one], 1, 0.0)], one))
    assert told.verdict == "unknown"
    assert told.beliefs[0].confidence == verdict.UNSURE


def test_a_way_that_ends_worse_is_no_rival(monkeypatch):
    found, asked = both_ways(monkeypatch, -860.0)
    assert found.named == {"backlash", "cogging"}
    assert len(asked) == 3
    cogging = next(one for one in verdict.judge(None, found).beliefs if one.effect == "cogging" and one.found)
    assert cogging.confidence > 0.9
    assert cogging.alternatives == []
