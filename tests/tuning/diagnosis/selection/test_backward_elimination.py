"""Effects that those found after them can do without, and what is looked for where nothing is missing any more."""

import pytest

from tests.support.fake_fits import fake_fit, names, no_filter_lost  # noqa: F401
from tuning.diagnosis.levels import DETAILS, WORTH
from tuning.diagnosis.selection import explain
from tuning.diagnosis.selection.explain import _Search
from tuning.diagnosis.selection.explanation import Explanation
from tuning.diagnosis.selection.search import Round

pytestmark = pytest.mark.usefixtures("no_filter_lost")


def quiet(*_):
    """No progress."""


def stepwise(monkeypatch, alone):
    """A process, found first, and a vibrating frame beside it; the frame `alone` explains so much."""
    base, process_noise = fake_fit(evidence=0.0), fake_fit("process_force", evidence=-6000.0)
    frame = fake_fit("frame_vibration", evidence=-3000.0)
    both = fake_fit("process_force", "frame_vibration", evidence=-24_000.0)
    rival = fake_fit("process_force", "compliance", evidence=-23_990.0)
    rounds = [Round(base, [], [process_noise, frame], 2, 0.0), Round(process_noise, [], [both, rival], 2, 50.0)]
    asked = []

    def drop_effect(fitter, one, index):
        asked.append((one, index))
        if alone is None or index:
            return None
        return fake_fit(names(Round(None, [], [one], 1, 0.0))[0], evidence=alone + (15.0 if one is rival else 0.0))

    monkeypatch.setattr(explain, "drop_effect", drop_effect)
    monkeypatch.setattr(explain, "is_complete", lambda *_: False)
    monkeypatch.setattr(explain, "share_left", lambda *_: 0.001)
    return Explanation(base, rounds, both), asked


@pytest.mark.parametrize(
    ("alone", "kept"),
    [(-23_900.0, False), (-24_000.0 + 0.9 * DETAILS * 24_000.0, False), (-22_000.0, True), (None, True)],
)
def test_what_was_found_first_is_dropped_where_what_came_after_explains_as_much_alone(monkeypatch, alone, kept):
    found, asked = stepwise(monkeypatch, alone)
    other = _Search(None, quiet, 2).backward_elimination(found)
    assert asked[0] == (found.best, 0)
    if kept:
        assert other is found
        return
    assert other.named == {"frame_vibration"}
    (first,) = other.rounds
    assert first.before is found.base
    assert first.fits[0] is other.best
    assert names(first) == ["frame_vibration", "compliance", "process_force"]  # tried and declared, as any rival is
    assert first.rivals == 3
    assert first.allowance == 50.0
    assert first.worth_it


@pytest.mark.parametrize(
    ("evidence", "first", "coarse", "kept"),
    [
        (-23_900.0, -6000.0, False, False),
        (-22_000.0, -6000.0, False, True),
        (-22_000.0, -6000.0, True, False),  # its details may be worth as much
        (-19_000.0, -6000.0, True, True),
    ],
)
def test_what_was_found_last_is_held_against_what_the_others_explain_alone(monkeypatch, evidence, first, coarse, kept):
    """It may have but set the fit before it going, which seems to be its own merit."""
    found, _ = stepwise(monkeypatch, None)
    found.rounds[0].fits[0].evidence = first
    fewer = fake_fit("process_force", evidence=evidence, coarse=coarse)
    monkeypatch.setattr(explain, "drop_effect", lambda fitter, one, index: fewer if index == 1 else None)
    other = _Search(None, quiet, 2).backward_elimination(found)
    assert other.best is (found.best if kept else fewer)
    assert names(other.rounds[0]) == ["process_force", "frame_vibration"]
    assert other.rounds[0].before is found.base
    assert other.rounds[0].fits[0] is fewer
    assert len(other.rounds) == 1 + kept
    if kept:
        last = other.rounds[1]
        assert last.gain == last.allowance + fewer.evidence - found.best.evidence
        assert last.worth_it


@pytest.mark.parametrize(("evidence", "kept"), [(-23_900.0, True), (-24_000.0 + 0.9 * WORTH, False)])
def test_what_was_found_last_need_bring_little_where_a_number_becomes_impossible_without(monkeypatch, evidence, kept):
    found, _ = stepwise(monkeypatch, None)
    found.rounds[1] = found.rounds[1]._replace(allowance=0.0)
    fewer = fake_fit("process_force", evidence=evidence, max_prior_deviation=9.0)
    monkeypatch.setattr(explain, "drop_effect", lambda fitter, one, index: fewer if index == 1 else None)
    other = _Search(None, quiet, 2).backward_elimination(found)
    assert other.best is (found.best if kept else fewer)
    assert all(one.worth_it for one in other.rounds)


@pytest.mark.parametrize(("evidence", "first"), [(-23_900.0, -13_000.0), (-5900.0, -6000.0)])
def test_what_brought_less_than_all_before_it_set_nothing_going(monkeypatch, evidence, first):
    """Nor did it where the others end no better without it."""
    found, _ = stepwise(monkeypatch, None)
    found.rounds[0].fits[0].evidence = first
    fewer = fake_fit("process_force", evidence=evidence)
    monkeypatch.setattr(explain, "drop_effect", lambda fitter, one, index: fewer if index == 1 else None)
    assert _Search(None, quiet, 2).backward_elimination(found) is found


def test_a_rival_that_needs_impossible_numbers_without_what_was_dropped_is_none(monkeypatch):
    found, _ = stepwise(monkeypatch, -23_900.0)
    ends = {"frame_vibration": 0.0, "compliance": 9.0}

    def drop_effect(fitter, one, index):
        name = names(Round(None, [], [one], 1, 0.0))[0]
        return fake_fit(name, evidence=-23_950.0, max_prior_deviation=ends[name])

    monkeypatch.setattr(explain, "drop_effect", drop_effect)
    (first,) = _Search(None, quiet, 2).backward_elimination(found).rounds
    assert names(first) == ["frame_vibration", "process_force"]


def test_an_effect_is_not_dropped_where_a_number_becomes_impossible_without(monkeypatch):
    found, _ = stepwise(monkeypatch, None)
    found.best.theta[0] = 5.0
    fewer = fake_fit("frame_vibration", evidence=-23_900.0, max_prior_deviation=9.0)
    monkeypatch.setattr(explain, "drop_effect", lambda fitter, one, index: None if index else fewer)
    assert _Search(None, quiet, 2).backward_elimination(found) is found


def test_where_nothing_is_left_an_effect_need_not_bring_more_than_a_small_one_brings(monkeypatch):
    found, _ = stepwise(monkeypatch, -23_900.0)
    monkeypatch.setattr(explain, "is_complete", lambda fitter, one: one is found.best)
    assert _Search(None, quiet, 2).backward_elimination(found) is found


def test_an_effect_that_keeps_a_number_where_it_can_be_is_not_dropped(monkeypatch):
    found, _ = stepwise(monkeypatch, None)
    fewer = fake_fit("frame_vibration", evidence=-23_900.0, max_prior_deviation=9.0)
    monkeypatch.setattr(explain, "drop_effect", lambda fitter, one, index: None if index else fewer)
    assert _Search(None, quiet, 2).backward_elimination(found) is found
    fewer.evidence = found.best.evidence + 0.9 * WORTH
    assert _Search(None, quiet, 2).backward_elimination(found).best is fewer


def test_of_three_effects_the_first_is_dropped_and_the_others_stay_in_their_order(monkeypatch):
    base = fake_fit(evidence=0.0)
    chain = [fake_fit(*("cogging", "backlash", "lead_error")[: k + 1], evidence=-1e4 * (k + 1)) for k in range(3)]
    rounds = [Round(before, [], [one], 1, 0.0) for before, one in zip([base, *chain], chain, strict=False)]
    fewer = {id(chain[1]): fake_fit("backlash", evidence=-1.9e4)}
    fewer[id(chain[2])] = fake_fit("backlash", "lead_error", evidence=-2.99e4)

    def drop_effect(fitter, one, index):
        return fewer[id(one)] if index == 0 else None

    monkeypatch.setattr(explain, "drop_effect", drop_effect)
    monkeypatch.setattr(explain, "is_complete", lambda *_: False)
    monkeypatch.setattr(explain, "share_left", lambda *_: 0.001)
    other = _Search(None, quiet, 3).backward_elimination(Explanation(base, rounds, chain[2]))
    assert [names(one)[0] for one in other.rounds] == ["backlash", "lead_error"]
    assert other.rounds[0].before is base
    assert other.rounds[1].before is other.rounds[0].fits[0]
    assert other.rounds[1].fits[0] is other.best


def offered(monkeypatch, coupled):
    """Which effects are looked for beside a first one that leaves nothing."""
    base, first = fake_fit(evidence=0.0), fake_fit("friction_dwell", evidence=-1e4)
    first.model.coupled = coupled
    asked = []

    def look(fitter, before, catalogue, *_):
        asked.append([one.name for one in catalogue])
        return Round(before, [], [first] if before is base else [], 1, 0.0)

    monkeypatch.setattr(explain, "select_next_effect", look)
    monkeypatch.setattr(explain, "_refit_without_last", lambda *_: None)
    monkeypatch.setattr(explain, "is_complete", lambda fitter, one: one is first)
    monkeypatch.setattr(explain, "share_left", lambda *_: 1.0)
    search = _Search(None, quiet, 2)
    found = search.forward_selection(base, [], base, catalogue())
    return found, asked


def catalogue():
    """Three effects: one that pushes, one that parameters stand in for, one that passes for noise."""
    made = []
    for name, absorbable, noisy in (
        ("cogging", False, False),
        ("force_gain", True, False),
        ("lead_error", False, True),
    ):
        one = type(
            "Stub",
            (),
            {"name": name, "absorbable": absorbable, "noisy": noisy, "unseen": absorbable or noisy},
        )
        made.append(one)
    return made


def test_an_error_of_the_scale_is_looked_for_where_nothing_is_missing_any_more(monkeypatch):
    """The filter takes it for noise, so that another effect can leave nothing to see of it."""
    found, asked = offered(monkeypatch, coupled=False)
    assert asked == [["cogging", "force_gain", "lead_error"], ["lead_error"]]
    assert found.named == {"friction_dwell"}
    assert not found.rounds[1].worth_it


def test_beside_a_screw_that_leaves_nothing_nothing_is_looked_for(monkeypatch):
    _, asked = offered(monkeypatch, coupled=True)
    assert asked == [["cogging", "force_gain", "lead_error"]]
