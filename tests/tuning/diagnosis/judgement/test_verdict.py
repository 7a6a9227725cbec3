"""What an explanation may leave, and how sure its causes are."""

import numpy as np
import pytest

from tests.support.fake_fits import fake_fit
from tuning.diagnosis.judgement import verdict
from tuning.diagnosis.levels import COLDEST
from tuning.diagnosis.selection.explanation import Explanation
from tuning.diagnosis.selection.search import Round


@pytest.fixture
def leaving(monkeypatch):
    """Let every explanation leave such a share of what was missing."""

    def leave(share):
        monkeypatch.setattr(verdict, "is_complete", lambda *_: False)
        monkeypatch.setattr(verdict, "share_left", lambda *_: share)

    return leave


def explained(*effects, coarse=False):
    """These effects found one after the other, each by far."""
    fits = [fake_fit(evidence=0.0)]
    rounds = []
    for count in range(1, len(effects) + 1):
        fits.append(fake_fit(*effects[:count], evidence=-1e5 * count, coarse=coarse))
        rounds.append(Round(fits[-2], [], [fits[-1]], 1, 0.0))
    return Explanation(fits[0], rounds, fits[-1])


@pytest.mark.parametrize(
    ("effects", "coarse", "share", "says"),
    [
        (("backlash",), True, 0.15, "effect"),
        (("backlash",), True, 0.3, "unknown"),
        (("backlash", "cogging"), True, 0.04, "effect"),
        (("backlash", "cogging"), True, 0.06, "unknown"),
        (("cogging",), False, 0.019, "effect"),
        (("cogging",), False, 0.03, "unknown"),
    ],
)
def test_only_alone_may_an_effect_whose_details_differ_leave_much(leaving, effects, coarse, share, says):
    leaving(share)
    told = verdict.judge(None, explained(*effects, coarse=coarse))
    assert told.verdict == says
    assert all(one.confidence > 0.5 for one in told.beliefs) == (says == "effect")


@pytest.mark.parametrize(
    ("share", "closes", "most"),
    [(0.6, None, 0.2), (0.6, 0.89, 0.2), (0.6, 0.91, 0.5), (0.03, 0.99, 0.5), (0.001, 0.2, 0.97)],
)
def test_an_effect_that_takes_away_the_force_may_act_though_likelihood_leaves_much(leaving, share, closes, most):
    """Whatever likelihood says of small errors that last; how sure, the studies told."""
    leaving(share)
    told = verdict.judge(None, explained("constant_force"), closes=[closes])
    assert told.verdict == ("unknown" if share > 0.02 else "effect")
    assert told.beliefs[0].confidence == pytest.approx(most, abs=0.01)
    assert ("constant_force takes away 90 % and more" in told.says) == (share > 0.02 and most == 0.5)


def test_a_rival_of_another_way_shares_the_belief_in_an_effect_that_takes_away_the_force(leaving):
    leaving(0.6)
    found = explained("constant_force")
    alone = verdict.judge(None, found, closes=[0.95]).beliefs[0].confidence
    told = {
        one.effect: one
        for one in verdict.judge(None, found._replace(other=explained("cogging")), closes=[0.95]).beliefs
    }
    assert alone == pytest.approx(0.5, abs=0.01)
    assert told["constant_force"].confidence == pytest.approx(0.5 * alone)
    assert told["constant_force"].alternatives == ["cogging"]


def test_each_effect_is_believed_for_the_force_that_it_takes_away_itself(leaving):
    leaving(0.6)
    told = verdict.judge(None, explained("constant_force", "cogging"), closes=[0.95, 0.1]).beliefs
    assert [round(one.confidence, 1) for one in told] == [0.5, 0.2]


def test_where_a_filter_is_not_trusted_its_force_is_not_either(leaving):
    """A wrong effect whose details differ may be followed, its simulation going astray."""
    leaving(0.01)
    found = explained("backlash", coarse=True)
    told = verdict.judge(None, found, 0.6, [0.99])
    assert told.beliefs[0].confidence == verdict.judge(None, found, 0.6).beliefs[0].confidence < 0.3
    assert "likelihood" not in told.says


@pytest.mark.parametrize(
    ("coarse", "share", "in_loop", "says"),
    [
        (True, 0.4, 0.01, "effect"),  # details that a filter resolves
        (True, 0.01, 0.6, "unknown"),  # a filter follows what the simulation does not
        (True, 0.4, None, "unknown"),
        (True, 0.01, None, "effect"),
        (False, 0.4, 0.01, "unknown"),
        (False, 0.01, 0.6, "effect"),
    ],
)
def test_where_details_differ_the_simulation_tells_how_much_is_explained(leaving, coarse, share, in_loop, says):
    leaving(share)
    told = verdict.judge(None, explained("backlash", coarse=coarse), in_loop)
    assert told.verdict == says
    assert told.unexplained == share  # what the filter misses is said all the same
    judged, gap = (in_loop, "gap in closed loop") if coarse and in_loop is not None else (share, "gap")
    left = f", but for {100 * judged:.0f} % of it" if says == "effect" else f"{100 * judged:.0f} % of the {gap} unex"
    assert left in told.says
    assert gap in told.says


@pytest.mark.parametrize(
    ("moved", "says"),
    [
        (0.0, "the recalibrated drive explains the logs to the noise, and with friction_shape they are likelier still"),
        (5.0, "recalibration hides the gap: mass had to be moved by +10.5 %, 5.0 times its tolerance, which friction_"),
    ],
)
def test_where_recalibration_leaves_no_gap_none_is_explained(monkeypatch, moved, says):
    monkeypatch.setattr(verdict, "is_complete", lambda *_: True)
    base, best = fake_fit(evidence=0.0, max_prior_deviation=moved), fake_fit("friction_shape", evidence=-100.0)
    told = verdict.judge(None, Explanation(base, [Round(base, [], [best], 1, 0.0)], best))
    assert told.verdict == "effect"
    assert told.says.startswith(says)
    assert "explains the gap" not in told.says


def test_of_each_effect_there_is_one_belief(leaving):
    """What was found of it, however sure it seemed in another round; else what is surest."""
    leaving(0.001)
    found = explained("cogging", "lead_error")
    rival, worse = fake_fit("lead_error", evidence=-1e5 + 1e3), fake_fit("backlash", evidence=-1e4)
    nearer = fake_fit("cogging", "backlash", evidence=-2e5 + 1e3)
    first, second = found.rounds
    first = first._replace(fits=[*first.fits, rival, worse], rivals=3)
    second = second._replace(fits=[*second.fits, nearer], rivals=2)
    told = verdict.judge(None, found._replace(rounds=[first, second])).beliefs
    assert [(one.effect, one.found, one.round) for one in told] == [
        ("cogging", True, 0),
        ("lead_error", True, 1),
        ("backlash", False, 1),
    ]
    assert told[2].fitted is nearer
    assert told[2].alternatives == ["lead_error"]


def second(gain, enough):
    """How sure a second effect is that brings so much evidence, where so much is enough."""
    first, both = fake_fit("cogging", evidence=-1e5), fake_fit("cogging", "lead_error", evidence=-1e5 - gain)
    base = fake_fit(evidence=0.0)
    rounds = [Round(base, [], [first], 1, 0.0), Round(first, [], [both], 1, 0.0, enough)]
    best = both if gain >= enough else first
    told = verdict.judge(None, Explanation(base, rounds, best)).beliefs
    return next(one.confidence for one in told if one.effect == "lead_error")


def test_what_is_enough_is_no_step_where_it_is_much(leaving):
    leaving(0.0)
    assert second(4040.0, 4000.0) == pytest.approx(second(3960.0, 4000.0), abs=0.05)
    assert second(9000.0, 4000.0) > 0.95
    assert second(1000.0, 4000.0) < 0.1
    assert second(52.0, 12.0) > 0.95  # few are told as sharply as the fits are
    assert second(32.0 + COLDEST, 32.0) - second(32.0 - COLDEST, 32.0) == pytest.approx(0.46, abs=0.01)


def test_what_was_withdrawn_is_not_believed(leaving):
    leaving(0.0)
    assert second(500.0, np.inf) == 0.0
