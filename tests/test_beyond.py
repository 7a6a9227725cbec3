"""One effect more, where the loop says that much is left of which the filter sees little."""

from types import SimpleNamespace

import pytest
from imagined import hypothesis, names

from tuning.diagnosis import beyond as module
from tuning.diagnosis.beyond import beyond, proved
from tuning.diagnosis.explain import RELIEF, Explanation
from tuning.diagnosis.search import Round


def quiet(*_):
    """No progress."""


BASE = hypothesis(evidence=0.0)
ELEMENTS = hypothesis("presliding_hysteresis", evidence=-20_000.0, coarse=True)


def beside(name, gain):
    return hypothesis("presliding_hysteresis", name, evidence=ELEMENTS.evidence - gain, coarse=True)


def found(*seen, first=ELEMENTS):
    """The elements, and what was seen beside them and not worth it."""
    rounds = [Round(BASE, [], [first], 1, 0.0)]
    rounds += [Round(first, [], list(seen), len(seen), 0.0, 4000.0)] if seen else []
    return Explanation(BASE, rounds, first)


@pytest.fixture
def looking(monkeypatch):
    """What a new search beside the elements finds, and how often it is asked."""
    asked = []

    def look(fitter, before, catalogue, *_):
        asked.append(catalogue)
        return Round(before, [], [beside("frame_vibration", 500.0)], 1, 0.0)

    def leaving(in_loop, in_filter):
        monkeypatch.setattr(module, "left_in_loop", lambda _: in_loop)
        monkeypatch.setattr(module, "left_by", lambda *_: in_filter)

    monkeypatch.setattr(module, "look", look)
    return leaving, asked


def test_what_was_looked_for_among_all_effects_is_tried_as_it_is(looking):
    leaving, asked = looking
    leaving(0.6, 0.3)
    more = beyond(None, found(beside("force_limit", 900.0), beside("compliance", 600.0)), [], ["all"], quiet)
    assert more.named == {"presliding_hysteresis", "force_limit"}
    assert [names(one)[0] for one in more.rounds] == ["presliding_hysteresis", "force_limit"]
    assert more.rounds[1].enough == RELIEF
    assert more.best is more.rounds[1].fits[0]
    assert not asked


@pytest.mark.parametrize("seen", [(), (beside("lead_error", 1.0),)])
def test_where_the_filter_saw_next_to_nothing_all_effects_are_looked_for(looking, seen):
    """Few had been, since nothing was missing but details."""
    leaving, asked = looking
    leaving(0.6, 0.01)
    assert beyond(None, found(*seen), [], ["all"], quiet).named == {"presliding_hysteresis", "frame_vibration"}
    assert asked == [["all"]]


def test_no_more_is_asked_for_by_a_loop_that_leaves_little_or_cannot_tell(looking):
    leaving, asked = looking
    one = beside("force_limit", 900.0)
    for in_loop in (0.19, None):
        leaving(in_loop, 0.3)
        assert beyond(None, found(one), [], ["all"], quiet) is None
    leaving(0.6, 0.3)
    assert beyond(None, found(beside("force_limit", 0.9 * RELIEF)), [], ["all"], quiet) is None
    plain = hypothesis("cogging", evidence=-20_000.0)
    assert beyond(None, found(one, first=plain), [], ["all"], quiet) is None  # the filter tells that
    assert not asked


@pytest.mark.parametrize(
    ("then", "worse", "holds"),
    [(0.29, False, True), (0.31, False, False), (0.29, True, False), (None, False, False)],
)
def test_it_is_proved_by_closing_half_of_what_was_left_and_foreseeing_no_worse(monkeypatch, then, worse, holds):
    """Though the first, alone, had not closed half of it."""
    before = [SimpleNamespace(left=one) for one in (2.0, 1.0, 0.6)]
    after = [*before, SimpleNamespace(left=then)]
    monkeypatch.setattr(module, "left_beyond_floor", lambda from_there, to: to.left if from_there is before[1] else 9.0)
    monkeypatch.setattr(module, "denied", lambda more, fewer, gained: worse and gained == 900.0)
    assert proved(after, before, 900.0) == holds
