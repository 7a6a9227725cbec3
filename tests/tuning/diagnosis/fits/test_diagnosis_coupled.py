"""Diagnosis: effects that are stepped within the filter."""

import numpy as np
import pytest

from diffdrive.effects.forces import Cogging, ConstantForce, FrameVibration
from diffdrive.effects.friction import PreslidingHysteresis
from diffdrive.effects.transmission import Backlash, Compliance
from tests.support.fake_fits import FakeFitter
from tests.support.perturbed_machine import DEVIATIONS, catalogue, fitter_of, recalibrated_of
from tests.support.sound_log import DRIVE, RATE
from tuning.diagnosis.fits.goodness_of_fit import is_complete, max_prior_deviation, power_left
from tuning.diagnosis.hypotheses.calibration import NAMES, TOLERANCE
from tuning.diagnosis.hypotheses.catalogue import candidates
from tuning.diagnosis.hypotheses.model import Model
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.levels import LACKING, STRAINED
from tuning.diagnosis.selection import evolving, refit
from tuning.diagnosis.selection.first_fits import fit_from
from tuning.diagnosis.selection.screening import begin, joined, screen, sensitivities
from tuning.diagnosis.selection.search import _bringing_back, initial_trajectory, recalibrated, select_next_effect
from tuning.optimisation.adaptation import Minimum

PLAY = {"gap": 5e-6, "frequency": 450.0, "damping": 0.08, "motor_share": 0.4, "table_friction": 0.4}


pytestmark = pytest.mark.long  # all begin with a recalibrated model: some seconds of tracing


@pytest.fixture(scope="module")
def sound():
    return recalibrated_of()


@pytest.fixture(scope="module")
def vibrating():
    """A machine on a base that swings, and the fit that has it."""
    fitter = fitter_of(FrameVibration(ratio=0.08, frequency=21.0, damping=0.05))
    base = recalibrated(fitter, TOLERANCE)
    candidate = next(one for one in catalogue(fitter, base) if one.name == "frame_vibration")
    return fitter, base, fit_from(fitter, base, screen(base, candidate))


def test_an_effect_within_the_filter_is_fitted_and_its_jacobian_is_that_of_the_innovations(vibrating):
    fitter, base, fit = vibrating
    values = fit.model.values(fit.theta)[0]
    assert values["frequency"][0] == pytest.approx(21.0, rel=0.02)
    assert values["ratio"][0] == pytest.approx(0.08, rel=0.1)
    assert max_prior_deviation(fit) < STRAINED
    assert power_left(base, fit) < 0.02

    point = fitter.at(fit.model, fit.theta, fit.process_noise, fit.filtered.trajectory)
    jacobian, unit = fitter.jacobian(fit.model, point), fitter.residuals(point)[1]
    for k in (NAMES.index("mass"), len(NAMES), len(NAMES) + 1):
        h = 1e-4
        ahead, behind = (
            np.asarray(
                fitter.at(
                    fit.model, fit.theta + way * h * np.eye(fit.model.size)[k], fit.process_noise, point.trajectory
                ).filtered.innovation
            )
            for way in (1.0, -1.0)
        )
        slope = (
            (ahead - behind) / (2.0 * h) / np.asarray(point.filtered.innovation_std) * fitter.counts
        ).ravel() * unit
        assert np.linalg.norm(slope - jacobian[:, k]) < 0.1 * np.linalg.norm(slope), k
    again = fitter.jacobian(fit.model, point, near=1.4 * jacobian)  # steps of a like size at once
    np.testing.assert_array_less(
        np.linalg.norm(again - jacobian, axis=0), 0.05 * np.linalg.norm(jacobian, axis=0) + 1e-9
    )


def test_a_base_that_swings_with_little_damping_is_screened_between_the_points_of_the_grid(sound):
    """A resonance is as narrow as its damping, the grid's steps are a tenth: half way between two, neither shows it."""
    grid = next(one for one in catalogue(*sound) if one.name == "frame_vibration").grid
    below, above = grid[22]["frequency"], grid[23]["frequency"]
    swings = float(np.sqrt(below * above))
    fitter = fitter_of(FrameVibration(ratio=0.06, frequency=swings, damping=0.015))
    base = recalibrated(fitter, TOLERANCE)
    candidate = next(one for one in catalogue(fitter, base) if one.name == "frame_vibration")
    found, coarse = screen(base, candidate), screen(base, candidate._replace(narrow=""))
    assert found.values["frequency"][0] == pytest.approx(swings, rel=0.01)
    assert found.gain > 1.5 * coarse.gain


@pytest.mark.parametrize("name", ["constant_force", "cogging", "friction_shape", "lead_error"])
def test_differences_of_the_filter_are_its_answers_where_it_has_some(sound, monkeypatch, name):
    fitter, base = sound
    candidate = next(one for one in catalogue(fitter, base) if one.name == name)
    point = {key: np.array([value]) for key, value in candidate.grid[0].items()}
    along, labels = sensitivities(base, candidate, point)
    monkeypatch.setattr(type(base.model), "coupled", True)
    differences, _ = sensitivities(base, candidate, point)
    for k, (parameter, _) in enumerate(labels):
        off = np.linalg.norm(differences[..., k] - along[..., k]) / np.linalg.norm(differences[..., k])
        assert off < 0.05, parameter.name


def test_what_acts_beside_an_effect_within_the_filter_is_screened_as_it_is():
    """Presliding by Maxwell elements alone: no linear recursion along the filter's course holds there."""
    truth = PreslidingHysteresis(share=0.95, longest=1e-5, shortest=0.2)
    fitter = fitter_of(truth, Cogging(0.00125, 1.0, 0.5))
    base = recalibrated(fitter, TOLERANCE)
    known = {one.name: one for one in catalogue(fitter, base)}
    model = joined(base.model, known["presliding_hysteresis"])
    values = {key: np.array([getattr(truth, key)]) for key in ("share", "longest", "shortest")}
    first = fitter.fit(model, np.r_[np.zeros(len(NAMES)), begin(model, values)], None, base.filtered.trajectory, 6)
    found = screen(first, known["cogging"])
    assert found.gain < np.sum(first.residual**2) + np.sum(first.theta**2)  # no projection explains more than there is
    assert found.values["period"][0] == pytest.approx(0.00125, rel=0.05)
    assert found.values["cosine"][0] == pytest.approx(1.0, abs=0.3)
    assert found.values["sine"][0] == pytest.approx(0.5, abs=0.3)
    fit = fit_from(fitter, first, found, 4)
    assert first.evidence - fit.evidence > 100.0


@pytest.mark.parametrize("name", ["backlash", "compliance"])
def test_where_nobody_can_say_what_is_missing_a_search_begins_as_expected(sound, monkeypatch, name):
    fitter, base = sound
    candidate = next(one for one in catalogue(fitter, base) if one.name == name)
    nothing = np.full(np.shape(base.filtered.innovation), np.nan)
    monkeypatch.setattr(evolving, "missing_force", lambda fitted: nothing)
    model = joined(base.model, candidate)
    values, forces = evolving.evolved(base, model, 0, np.r_[base.theta, begin(model, {})])
    assert {key: value[0] for key, value in values.items()} == pytest.approx(
        {one.name: one.middle for one in candidate.parameters}
    )
    assert np.all(np.isfinite(forces))


def test_a_population_keeps_to_the_screws_that_can_be(sound, monkeypatch):
    """A resonance beyond what a log shows would win the search, and be thrown away."""
    fitter, base = sound
    candidate = next(one for one in catalogue(fitter, base) if one.name == "compliance")
    model = joined(base.model, candidate._replace(bounds=(("frequency", 300.0, 310.0), ("damping", 0.0, 0.01))))
    for share in (0.0, 1.0):
        monkeypatch.setattr(
            evolving,
            "minimum",
            lambda costs, start, spread, share=share, **more: Minimum(0.0 * start + share, -np.inf, 1),
        )
        values, _ = evolving.evolved(base, model, 0, np.r_[base.theta, begin(model, {})])
        assert values["frequency"][0] == pytest.approx(300.0 + 10.0 * share)
        assert values["damping"][0] <= 0.01


def test_a_search_for_a_screw_ends_with_nothing_where_none_is_likelier_than_a_stiff_one(sound):
    fitter, base = sound
    candidate = next(one for one in catalogue(fitter, base) if one.name == "backlash")
    wide = candidate._replace(bounds=(("gap", 1e-3, 1e-2),))  # a table that a millimetre of play would let go
    model = joined(base.model, wide)
    assert evolving.evolved(base, model, 0, np.r_[base.theta, begin(model, {})]) is None


@pytest.mark.slow
def test_an_elastic_screw_is_fitted_from_where_a_loose_one_ended_and_not_the_other_way():
    truth = {"frequency": 313.0, "damping": 0.03, "motor_share": 0.36, "table_friction": 0.61}
    fitter = fitter_of(
        Compliance(**truth), seed=3
    )  # some other noise ends in another minimum (docs/history/diagnosis.md)
    base = recalibrated(fitter, TOLERANCE)
    known = {one.name: one for one in catalogue(fitter, base)}
    astray = {"gap": 8e-7, "frequency": 330.0, "damping": 0.05, "motor_share": 0.3, "table_friction": 0.7}
    values = {name: np.array([value]) for name, value in astray.items()}
    model = joined(base.model, known["backlash"], values)
    loose = fitter.fit(model, np.r_[base.theta, begin(model, values)], base.process_noise, base.filtered.trajectory, 3)
    (elastic,) = refit.simpler(fitter, base, [loose], [known["compliance"], known["backlash"]])
    found = elastic.model.values(elastic.theta)[-1]
    assert found["frequency"][0] == pytest.approx(truth["frequency"], rel=0.01)
    assert found["motor_share"][0] == pytest.approx(truth["motor_share"], rel=0.2)
    assert elastic.evidence < loose.evidence - 100.0
    assert refit.simpler(fitter, base, [elastic], [known["compliance"], known["backlash"]]) == []
    assert refit.simpler(fitter, base, [], known.values()) == []


def test_at_the_truth_a_slowly_swinging_base_leaves_nothing_to_invent():
    """Its state outlasts a segment: begun at rest in each, half a second of it would be missing again and again."""
    truth = {"ratio": 0.05, "frequency": 6.0, "damping": 0.02}
    fitter = fitter_of(FrameVibration(**truth))
    candidate = next(
        one
        for one in candidates(setting(DRIVE.drive, fitter.logged.lanes, 1.0 / RATE))
        if one.name == "frame_vibration"
    )
    model = joined(Model(fitter.logged), candidate)
    theta = np.r_[DEVIATIONS / TOLERANCE, begin(model, {name: np.array([value]) for name, value in truth.items()})]
    little, more = np.full(2, 0.02), np.array([[1.0, 0.1], [0.1, 0.1], [0.1, 1.0], [0.01, 0.3], [0.3, 0.01]])  # N
    there = fitter.at(model, theta, more[1], initial_trajectory(fitter.logged))
    for _ in range(12):
        there = fitter.at(model, theta, little, there.next_trajectory)
    assert there.cost - fitter.with_process(there, model, more).cost < LACKING


def both(fitter, base):
    """A play and a tilt, in that order, of values that differ from all middles."""
    known = {one.name: one for one in catalogue(fitter, base)}
    model = joined(joined(base.model, known["backlash"]), known["constant_force"])
    values = {name: np.array([value]) for name, value in PLAY.items()}
    return model, np.r_[base.theta, begin(model, values, 0), begin(model, {"force": np.array([3.0])})]


def test_numbers_of_a_member_are_those_that_its_values_are_made_of(sound):
    model, theta = both(*sound)
    found = model.values(theta)
    assert {name: value[0] for name, value in found[0].items()} == pytest.approx(PLAY)
    assert found[1]["force"][0] == pytest.approx(3.0)
    np.testing.assert_array_equal(begin(model, found[0], 0), theta[model.of_member(0)])
    np.testing.assert_array_equal(begin(model, found[1], 1), theta[model.of_member(1)])
    assert not np.any(model.of_member(0) & model.of_member(1))
    assert not np.any(model.of_member(0)[: len(NAMES)])


@pytest.mark.parametrize(("without", "stays"), [(0, "constant_force"), (1, "backlash")])
def test_a_fit_without_one_of_its_effects_begins_where_it_ended(sound, monkeypatch, without, stays):
    model, theta = both(*sound)
    one = sound[1]._replace(model=model, theta=theta)

    def fit(model, theta, process_noise, trajectory):
        assert (process_noise is one.process_noise, trajectory is one.filtered.trajectory) == (True, True)
        return one._replace(model=model, theta=theta)

    monkeypatch.setattr(refit, "to_its_end", lambda fitter, fitted: fitted)
    found = refit.drop_effect(FakeFitter(fit=fit), one, without)
    (member,) = found.model.members
    assert member.candidate.name == stays
    assert found.theta.size == found.model.size
    np.testing.assert_array_equal(found.theta[: len(NAMES)], theta[: len(NAMES)])
    for name, value in model.values(theta)[1 - without].items():
        np.testing.assert_allclose(found.model.values(found.theta)[0][name], value)


@pytest.mark.parametrize(("gains", "searches"), [((0.0,), 1), ((50.0, 0.0), 2), ((50.0, 50.0, 50.0), 3)])
def test_a_screw_is_searched_for_again_beside_a_tilt_as_long_as_it_helps(sound, monkeypatch, gains, searches):
    fitter, base = sound
    model, theta = both(fitter, base)
    one = base._replace(model=model, theta=theta, hessian=np.eye(theta.size))
    asked, costs = [], one.cost - np.cumsum(gains)
    ahead = iter(costs)

    def evolved(store, before, model, index, theta, seed):
        asked.append((index, seed))
        further = {name: 1.1 * value for name, value in model.values(theta)[index].items()}
        return evolving.Evolved(further, np.ones((1, 2)))

    class Fits(type(fitter)):
        def fit(self, model, theta, process_noise, trajectory, *_):
            return one._replace(theta=theta, cost=next(ahead))

    monkeypatch.setattr(refit, "evolved_once", evolved)
    again = refit.searched_again(Fits(fitter.logged), base, one)
    assert asked == [(0, seed) for seed in range(1, 1 + searches)]
    assert again.cost == min(costs)
    others = ~model.of_member(0)
    np.testing.assert_array_equal(again.theta[others], theta[others])
    helped = sum(gain > 0.0 for gain in gains)
    assert model.values(again.theta)[0]["gap"][0] == pytest.approx(1.1**helped * PLAY["gap"])


def test_a_second_effect_is_begun_from_what_it_was_found_to_be_alone(sound):
    fitter, base = sound
    known = {one.name: one for one in catalogue(fitter, base)}
    pushed = fitter_of(ConstantForce(force=3.0))
    base = recalibrated(pushed, TOLERANCE)
    tilt = screen(base, known["constant_force"])
    alone = fit_from(pushed, base, tilt)
    astray = tilt._replace(values={"force": np.array([-40.0])}, rest=base.theta + 20.0, aside=base.theta + 20.0)
    fit = fit_from(pushed, base, astray, 0, alone)
    assert fit.model.values(fit.theta)[0]["force"][0] == pytest.approx(3.0, abs=0.3)
    assert fit.evidence == pytest.approx(alone.evidence, abs=5.0)


def test_what_moves_no_number_far_alone_is_fitted_beside_what_moves_one(sound):
    """What explained most then first, whatever screening sees of it now."""
    fitter, base = sound
    known = {one.name: one for one in catalogue(fitter, base)}
    names = ("friction_shape", "constant_force", "viscous_drift", "loop_delay", "force_gain")
    screened = [screen(base, known["force_gain"])._replace(candidate=known[name]) for name in names]
    far = base._replace(theta=base.theta + (STRAINED + 1.0) * np.sign(base.theta[0]) * (np.arange(len(NAMES)) == 0))
    assert max_prior_deviation(base) < STRAINED < max_prior_deviation(far)
    fits = {"friction_shape": (far, 500.0), "force_gain": (base, 20.0), "loop_delay": (base, 90.0)}
    fits["constant_force"] = (base, 60.0)
    alone = [
        one._replace(model=joined(base.model, known[name]), cost=one.cost - gain) for name, (one, gain) in fits.items()
    ]
    found = _bringing_back(far, alone, screened)
    assert [one.candidate.name for one in found] == ["loop_delay", "constant_force"]
    assert _bringing_back(base, alone, screened) == _bringing_back(far, (), screened) == []


@pytest.mark.slow
def test_a_backlash_is_found_where_no_gradient_leads():
    fitter = fitter_of(Backlash(**PLAY))
    base = recalibrated(fitter, TOLERANCE)
    few = [one for one in catalogue(fitter, base) if one.name in ("backlash", "compliance", "frame_vibration")]
    found = select_next_effect(
        fitter, base, few, lambda what, done, most: None, lambda one: 0.0 if is_complete(fitter, one) else 1.0
    )
    first = found.fits[0]
    assert [member.candidate.name for member in first.model.members] == ["backlash"]
    values = first.model.values(first.theta)[0]
    # to a tenth, as docs/history/diagnosis.md says: the truth is likelier by hundreds yet, in a funnel that the search
    # missed
    assert values["gap"][0] == pytest.approx(PLAY["gap"], rel=0.1)
    assert values["motor_share"][0] == pytest.approx(PLAY["motor_share"], rel=0.1)
