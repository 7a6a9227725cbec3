"""Which effect comes first, what it must bring, and what is looked at again."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.fake_fits import FakeFitter, fake_fit, names, no_filter_lost  # noqa: F401
from tuning.diagnosis.fits.fitting import MOST_STEPS
from tuning.diagnosis.fits.goodness_of_fit import max_prior_deviation, restores_nominal
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.catalogue import candidates
from tuning.diagnosis.hypotheses.setting import Setting
from tuning.diagnosis.levels import COARSE, DETAILS, IMPOSSIBLE, LACKING, LEFT, STRAINED, WORTH
from tuning.diagnosis.selection import explain, refit, search
from tuning.diagnosis.selection.explain import _refit_without_last, evidence_needed
from tuning.diagnosis.selection.refit import refit_rivals, to_its_end
from tuning.diagnosis.selection.search import CLOSE, SETTLED, Round, _again, _ranked

AXIS = Setting(
    mass=100.0, friction=70.0, load_coefficient=4e-4, viscous=2e3, delay=0.0, bristle=2e-6, period=5e-4, duration=3.0,
    low=0.0, high=0.05, speed=0.1, command=300.0, peak=300.0,
)  # fmt: skip


pytestmark = pytest.mark.usefixtures("no_filter_lost")


@pytest.mark.parametrize(
    ("before", "strain_then", "ended", "whole", "enough"),
    [
        (0.0, 0.0, False, False, WORTH),
        (1e4, 0.0, False, False, DETAILS * 1e4),
        (1e4, 0.0, False, True, LACKING),  # a small effect beside a large one, if nothing is left then
        (100.0, 0.0, False, True, WORTH),
        (1e4, 0.0, True, True, LACKING),
        (1e4, 5.0, True, True, WORTH),  # it says why a nominal parameter had to be moved
    ],
)
def test_what_one_more_effect_must_bring(monkeypatch, before, strain_then, ended, whole, enough):
    monkeypatch.setattr(explain, "is_complete", lambda *_: whole)
    best = fake_fit("cogging", evidence=-before, max_prior_deviation=strain_then)
    assert (
        evidence_needed(None, fake_fit(evidence=0.0), best, ended, [fake_fit("backlash", evidence=-2.0 * before)])
        == enough
    )


@pytest.mark.parametrize(
    ("sudden", "gained", "ended", "whole", "coarse", "enough"),
    [
        (5e3, 0.0, False, False, False, COARSE * 5e3),
        (5e3, 0.0, False, True, False, COARSE * 5e3),  # which explains it all
        (5e3, 0.0, True, True, False, COARSE * 5e3),
        (60.0, 0.0, True, True, False, LACKING),
        (5e3, 600.0, False, False, True, COARSE * 5e3),  # and beside a coarse effect no more than that
        (500.0, 2e3, False, False, True, COARSE * 2e3),
    ],
)
def test_a_detail_of_the_sudden_force_between_snapshots_is_no_effect(
    monkeypatch, sudden, gained, ended, whole, coarse, enough
):
    """That force explains as an effect does, and is no more exact than one."""
    monkeypatch.setattr(explain, "is_complete", lambda *_: whole)
    monkeypatch.setattr(explain, "sudden_force_evidence", lambda *_: sudden)
    best, cogging = fake_fit(evidence=-gained, coarse=coarse), fake_fit("cogging", evidence=-2e5)
    best.model.logged.of_snapshots = True
    assert evidence_needed(None, fake_fit(evidence=0.0), best, ended, [cogging]) == enough


def test_impossible_parameters_are_explained_by_what_brings_them_back():
    before = fake_fit(evidence=0.0, max_prior_deviation=10.0)
    believed = fake_fit(evidence=5000.0)
    gain = fake_fit("force_gain", evidence=100.0, max_prior_deviation=1.0)  # DETAILS of what the strain gained: allowed
    cogging = fake_fit("cogging", evidence=-150.0, max_prior_deviation=9.0)
    looked = _ranked(before, believed, [], [cogging, gain])
    assert names(looked) == ["force_gain", "cogging"]
    assert looked.rivals == 1
    assert looked.allowance == DETAILS * 5000.0
    for fits in (
        [cogging],
        [cogging, fake_fit("force_gain", evidence=300.0, max_prior_deviation=1.0)],
    ):
        looked = _ranked(before, believed, [], fits)
        assert names(looked)[0] == "cogging"
        assert (looked.rivals, looked.allowance) == (len(fits), 0.0)
    assert names(_ranked(before, None, [], [gain, cogging])) == ["cogging", "force_gain"]
    dwell = fake_fit(
        "friction_dwell", evidence=-9000.0, max_prior_deviation=9.0
    )  # far more than those parameters explained
    assert names(_ranked(before, believed, [], [dwell, gain]))[0] == "friction_dwell"


@pytest.mark.parametrize(
    ("max_prior_deviation", "more", "first"),
    [
        (IMPOSSIBLE - 1.0, SETTLED + 1.0, "backlash"),
        (IMPOSSIBLE - 1.0, SETTLED - 1.0, "force_gain"),
        (IMPOSSIBLE + 1.0, SETTLED + 1.0, "force_gain"),
    ],
)
def test_what_clearly_explains_more_with_parameters_that_can_be_stays_first(max_prior_deviation, more, first):
    before, believed = fake_fit(evidence=0.0, max_prior_deviation=10.0), fake_fit(evidence=5000.0)
    gain = fake_fit("force_gain", evidence=-100.0, max_prior_deviation=1.0)
    backlash = fake_fit("backlash", evidence=-100.0 - more, max_prior_deviation=max_prior_deviation)
    assert names(_ranked(before, believed, [], [gain, backlash]))[0] == first


@pytest.mark.parametrize(
    ("moved", "effect", "far"),
    [
        ("bristle_stiffness", "friction_dwell", 9.0),
        ("bristle_stiffness", "presliding_hysteresis", 0.0),  # its elements are the bristles
        ("coulomb_screw.negative", "presliding_hysteresis", 9.0),
    ],
)
def test_what_elements_before_sliding_take_over_was_not_moved(moved, effect, far):
    one = fake_fit(effect, evidence=0.0)
    one.theta[NAMES.index(moved)] = -9.0
    assert max_prior_deviation(one) == far
    assert max_prior_deviation(one, NAMES) == 9.0


def strained(*effects, evidence, by):
    """A fit that moves the bristle by that many tolerances."""
    one = fake_fit(*effects, evidence=evidence)
    one.theta[NAMES.index("bristle_stiffness")] = by
    return one


def test_what_elements_take_over_is_not_brought_back_by_them(monkeypatch):
    """The bristle stays where it was; that it means nothing any more is no merit."""
    monkeypatch.setattr(explain, "is_complete", lambda *_: False)
    base, dwell = fake_fit(evidence=0.0), strained("friction_dwell", evidence=-5000.0, by=4.5)
    elements = strained("friction_dwell", "presliding_hysteresis", evidence=-5020.0, by=4.5)
    assert evidence_needed(None, base, dwell, False, [elements]) == pytest.approx(DETAILS * 5000.0)
    back = strained("friction_dwell", "cogging", evidence=-5020.0, by=1.0)
    assert evidence_needed(None, base, dwell, False, [back]) == WORTH
    before, believed = strained(evidence=0.0, by=7.0), fake_fit(evidence=2000.0)
    cogging = strained("cogging", evidence=-150.0, by=6.5)
    worse = strained("presliding_hysteresis", evidence=60.0, by=7.0)
    looked = _ranked(before, believed, [], [cogging, worse])
    assert names(looked) == ["cogging", "presliding_hysteresis"]
    assert looked.allowance == 0.0
    assert not restores_nominal(worse, before, IMPOSSIBLE)
    assert restores_nominal(fake_fit("cogging", evidence=0.0, max_prior_deviation=1.0), before, IMPOSSIBLE)


@pytest.mark.parametrize("share", [0.5 * COARSE, 1.5 * COARSE])
def test_what_a_fit_gains_by_going_on_is_not_credited_to_an_effect(monkeypatch, share):
    """Where that is much of what the effect seemed to explain, everything is looked at again from there."""
    stopped, further = fake_fit(evidence=0.0), fake_fit(evidence=-1000.0 * share)
    looks = []

    def look(fitter, before, *_):
        looks.append(before)
        found = [fake_fit("cogging" if len(looks) == 1 else "backlash", evidence=-1000.0)]
        return Round(before, [], found, 1, 0.0)

    monkeypatch.setattr(explain, "select_next_effect", look)
    monkeypatch.setattr(explain, "is_complete", lambda *_: False)
    monkeypatch.setattr(explain, "share_left", lambda *_: 1.0)
    monkeypatch.setattr(
        explain, "_refit_without_last", lambda fitter, before, fits: further if before is stopped else None
    )
    found = explain.explain(None, stopped, [], lambda *_: None, most=1)
    again = share > COARSE
    assert looks == [stopped, further][: 1 + again]
    assert names(found.rounds[0]) == ["backlash" if again else "cogging"]
    assert found.base is found.rounds[0].before is further


@pytest.mark.parametrize("ended", [False, True])
def test_the_details_of_an_effect_within_the_filter_may_bring_more(monkeypatch, ended):
    monkeypatch.setattr(explain, "is_complete", lambda *_: True)
    best = fake_fit("backlash", evidence=-1e4, coarse=True, max_prior_deviation=4.5)
    fits = [fake_fit("cogging", evidence=-2e4, max_prior_deviation=4.2)]
    assert evidence_needed(None, fake_fit(evidence=0.0), best, ended, fits) == COARSE * 1e4
    assert evidence_needed(None, fake_fit(evidence=10.0 - 1e4), best, True, fits) == LACKING


def test_where_the_filter_was_lost_all_along_a_second_effect_must_bring_more(monkeypatch):
    monkeypatch.setattr(explain, "is_complete", lambda *_: False)
    monkeypatch.setattr(explain, "is_lost_throughout", lambda *_: True)
    base, best = fake_fit(evidence=0.0), fake_fit("cogging", evidence=-1e4)
    assert evidence_needed(None, base, best, False, [fake_fit("backlash", evidence=-2e4)]) == COARSE * 1e4


def test_a_fit_that_leads_to_no_machine_that_can_be_is_not_gone_on_with(monkeypatch):
    monkeypatch.setattr(refit, "is_complete", lambda *_: True)  # else it is begun again without process force

    def fitter(further):
        return FakeFitter(fit=lambda *_: further)

    one = fake_fit("frame_vibration", evidence=-100.0)
    one.steps, one.process_noise, one.filtered = MOST_STEPS, None, SimpleNamespace(trajectory=None)
    runaway, impossible = fake_fit("frame_vibration", evidence=np.inf), fake_fit("frame_vibration", evidence=-900.0)
    impossible.model.possible = lambda theta: False
    for further in (runaway, impossible):
        further.steps = 3
        assert to_its_end(fitter(further), one) is one
        assert refit_rivals(fitter(further), [one]) == [one]
    sound = fake_fit("frame_vibration", evidence=-200.0)
    sound.steps = 3
    assert to_its_end(fitter(sound), one) is sound
    assert refit_rivals(fitter(sound), [one]) == [sound]


def test_where_going_on_leaves_nothing_no_more_is_looked_for(monkeypatch):
    """The first effect's fit had stopped on its way: whatever else a round found, there is nothing left to explain."""
    further = fake_fit("cogging", evidence=-1400.0)
    offered = [SimpleNamespace(name=one, noisy=one == "lead_error") for one in ("cogging", "force_gain", "lead_error")]
    looks = []

    def look(fitter, before, few, *_):
        looks.append([one.name for one in few])
        there = [one.candidate.name for one in before.model.members]
        name = "force_gain" if there else "cogging"
        fits = [fake_fit(*there, name, evidence=before.evidence - 1000.0)] if name in looks[-1] else []
        return Round(before, [], fits, 1, 0.0)

    monkeypatch.setattr(explain, "select_next_effect", look)
    monkeypatch.setattr(explain, "is_complete", lambda fitter, one: one is further)
    monkeypatch.setattr(explain, "share_left", lambda *_: 1.0)
    monkeypatch.setattr(
        explain, "_refit_without_last", lambda fitter, before, fits: further if fits and len(looks) > 1 else None
    )
    found = explain.explain(None, fake_fit(evidence=0.0), offered, lambda *_: None)
    assert found.best is found.rounds[0].fits[0] is further
    everything = ["cogging", "force_gain", "lead_error"]
    assert looks == [everything, everything, ["lead_error"]]  # which may pass for noise


@pytest.mark.parametrize(("snapshots", "command_std"), [(False, 0.0), (True, 0.0), (True, 0.3)])
@pytest.mark.parametrize("twist", [None, 1.0])
def test_what_is_looked_for_though_nothing_is_missing(monkeypatch, twist, snapshots, command_std):
    """What hides: in recalibration, in the scale's noise, or from the first of two encoders."""
    looked, base = [], fake_fit(evidence=0.0)
    base.model.logged.command_std, base.model.logged.of_snapshots = command_std, snapshots

    def look(fitter, before, few, *_):
        looked.extend(few)
        return Round(before, [], [], 0, 0.0)

    monkeypatch.setattr(explain, "select_next_effect", look)
    monkeypatch.setattr(explain, "is_complete", lambda *_: True)
    monkeypatch.setattr(explain, "sudden_force_evidence", lambda *_: 0.0)
    explain.explain(SimpleNamespace(twist=twist), base, candidates(AXIS), lambda *_: None)
    names = {one.name for one in looked}
    moved_numbers = {"constant_force", "force_gain", "payload_mass", "friction_shape"}
    assert moved_numbers.isdisjoint(names) if command_std else (moved_numbers <= names)
    assert names.isdisjoint({"cogging", "loop_delay", "frame_vibration", "friction_dwell"})
    assert {"lead_error", "interpolation_error", "force_limit"} <= names
    screws = {"compliance", "backlash"}
    assert (screws <= names) if twist else screws.isdisjoint(names)


@pytest.mark.parametrize("snapshots", [False, True])
def test_an_effect_is_held_against_the_sudden_force_that_does_without_it_between_snapshots(monkeypatch, snapshots):
    """The fit that led there is not thrown away with what was missing."""
    looks, base, further = [], fake_fit(evidence=0.0), fake_fit(evidence=-1e3)
    found = fake_fit("frame_vibration", evidence=-5e3)
    for one in (base, further, found):
        one.model.logged.of_snapshots = snapshots

    def look(fitter, before, few, *_):
        looks.append({one.name for one in few})
        return Round(before, [], [found] if "frame_vibration" in looks[-1] else [], 1, 0.0)

    monkeypatch.setattr(explain, "select_next_effect", look)
    monkeypatch.setattr(explain, "is_complete", lambda fitter, one: one is not base)
    monkeypatch.setattr(explain, "share_left", lambda *_: 1.0)
    monkeypatch.setattr(explain, "sudden_force_evidence", lambda *_: 1e3)
    monkeypatch.setattr(
        explain, "_refit_without_last", lambda fitter, before, fits: further if before is base else None
    )
    explained = explain.explain(SimpleNamespace(twist=None), base, candidates(AXIS), lambda *_: None)
    assert explained.base is further
    assert (explained.best is found) == snapshots
    if snapshots:
        assert explained.rounds[0].enough == COARSE * 1e3


@pytest.mark.parametrize(("here", "gains"), [(-500.0, True), (-5.0, False)])
def test_a_filter_that_was_trusted_too_little_is_no_evidence_for_an_effect(monkeypatch, here, gains):
    """Where the richer fit ended differs from the simpler one's in nothing but how far its filter trusts the model."""
    before, best = (
        fake_fit(evidence=0.0, max_prior_deviation=1.0),
        fake_fit("force_gain", evidence=-500.0, max_prior_deviation=3.0),
    )
    for one, force in ((before, 1.0), (best, 0.1)):
        one.process_noise, one.filtered = np.array([force, force]), SimpleNamespace(trajectory=None)
    monkeypatch.setattr(explain, "_without", lambda *_: [best.theta])  # far off: what makes up for an effect bends

    def at(model, theta, process_noise, trajectory):
        cost = here if theta is before.theta else 9000.0
        return SimpleNamespace(theta=theta, process_noise=process_noise, cost=cost, filtered=before.filtered)

    fitter = FakeFitter(
        at=at,
        with_process=lambda one, *_: one,
        fit=lambda model, theta, *_: fake_fit(evidence=at(model, theta, None, 0).cost),
    )
    found = _refit_without_last(fitter, before, [best])
    assert (found is not None and found.evidence == here) if gains else found is None


@pytest.mark.parametrize(
    ("left", "max_prior_deviation", "asked"),
    [
        (1.5 * LEFT, 1.0, ["backlash", "compliance"]),
        (0.5 * LEFT, 1.0, []),  # no rival will do better
        (0.5 * LEFT, STRAINED + 1.0, ["backlash", "compliance"]),
    ],
)
def test_screws_that_bring_nearly_as_much_as_the_best_are_searched_for_again(
    monkeypatch, left, max_prior_deviation, asked
):
    """Not one that brings half, nor what a slope leads to."""
    known = []

    def searched_again(fitter, before, one):
        known.append(one.model.members[-1].candidate.name)
        return fake_fit(known[-1], evidence=one.evidence - 1.0)

    monkeypatch.setattr(search, "searched_again", searched_again)
    base, far = fake_fit(evidence=0.0), fake_fit("friction_dwell", "compliance", evidence=-CLOSE * 1000.0 + 1.0)
    fits = [
        fake_fit("cogging", evidence=-1000.0, max_prior_deviation=max_prior_deviation),
        fake_fit("backlash", evidence=-800.0), fake_fit("compliance", evidence=-900.0), far,
    ]  # fmt: skip
    found = _again(None, base, fits, lambda one: left)
    assert sorted(known) == asked
    assert sorted(one.evidence for one in found) == [
        -1000.0,
        *([-901.0, -801.0] if asked else [-900.0, -800.0]),
        -699.0,
    ]
