"""Diagnosis, its engine: derivatives of the innovations, a sound machine, effects found among others."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.effects.actuator import ForceGain, ForceLimit, LoopDelay
from diffdrive.effects.forces import Cogging, ConstantForce
from diffdrive.effects.friction import AppliedLoad
from diffdrive.effects.machine import PayloadMass
from diffdrive.model.quantity import Directional
from tests.support.perturbed_machine import DEVIATIONS, catalogue, fitter_of, recalibrated_of
from tests.support.sound_log import DRIVE, RATE, axis_of, simulate_log, two_sines
from tuning.diagnosis.diagnose import logged_of
from tuning.diagnosis.fits.curvature import FARTHEST
from tuning.diagnosis.fits.fitting import LEAST, Fitter
from tuning.diagnosis.fits.goodness_of_fit import max_prior_deviation, missing_evidence
from tuning.diagnosis.hypotheses.calibration import LOGARITHMS, NAMES, TOLERANCE, calibrated, tolerated
from tuning.diagnosis.hypotheses.catalogue import candidates
from tuning.diagnosis.hypotheses.model import Model
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.judgement.events import least_foreseen
from tuning.diagnosis.levels import CHANCE, IMPOSSIBLE, LACKING, STRAINED, WORTH
from tuning.diagnosis.selection.explain import _refit_without_last, explain
from tuning.diagnosis.selection.first_fits import RACE, fit_from
from tuning.diagnosis.selection.screening import _pushed, begin, joined, screen, sensitivities, tried
from tuning.diagnosis.selection.search import initial_trajectory, recalibrated, select_next_effect
from tuning.diagnosis.selection.starting_points import starting_points

HIDDEN = np.append(np.random.default_rng(8).uniform(-0.02, 0.02, LOGARITHMS), [0.0, 0.0])


pytestmark = pytest.mark.long  # all but two begin with a recalibrated model: some seconds of tracing


@pytest.fixture(scope="module")
def sound():
    return recalibrated_of()


@pytest.fixture(scope="module")
def tilted():
    return recalibrated_of(ConstantForce(6.0))


def test_a_sound_machine_is_recalibrated_and_nothing_is_missing(sound):
    _, base = sound
    assert np.max(np.abs(base.theta)) < 3.0
    assert base.process_noise[0] < 0.01  # N
    assert missing_evidence(sound[0], base) < LACKING
    assert float(base.filtered.noise_scale_sq) == pytest.approx(1.0, abs=0.1)
    assert least_foreseen(base).decades > np.log10(CHANCE) / 2
    mass = NAMES.index("mass")
    assert TOLERANCE * base.theta[mass] == pytest.approx(DEVIATIONS[mass], abs=5e-4)


def test_no_effect_that_is_all_amplitude_is_worth_it_on_a_sound_machine(sound):
    fitter, base = sound
    for candidate in catalogue(fitter, base):
        if all(one.amplitude for one in candidate.parameters):
            assert screen(base, candidate).evidence < WORTH, candidate.name


def test_the_answers_are_the_derivatives_of_the_innovations(sound):
    """Against differences of the whole filter, whose gains depend a little on the parameters, too."""
    fitter, base = sound
    for name in ("mass", "viscous.positive", "coulomb_screw.negative", "bristle_stiffness"):
        k = NAMES.index(name)
        h = 1e-3 * np.eye(len(NAMES))[k]
        ahead, behind = (
            np.asarray(
                fitter.at(
                    base.model, base.theta + way * h, base.process_noise, base.filtered.trajectory
                ).filtered.innovation
            )
            for way in (1.0, -1.0)
        )
        unit = np.asarray(base.filtered.innovation_std) * np.sqrt(float(base.filtered.noise_scale_sq))
        difference = ((ahead - behind) / 2e-3 / unit * fitter.counts).ravel()
        column = base.jacobian[:, k]
        assert np.linalg.norm(difference - column) < 0.05 * np.linalg.norm(column), name


def test_a_tilt_is_found_and_measured(tilted):
    fitter, base = tilted
    found = {one.name: screen(base, one) for one in catalogue(fitter, base) if one.parameters[0].amplitude}
    best = max(found.values(), key=lambda one: one.evidence)
    assert best.candidate.name == "constant_force"
    fit = fit_from(fitter, base, best)
    assert fit.model.values(fit.theta)[0]["force"][0] == pytest.approx(6.0, abs=0.05)
    assert base.evidence - fit.evidence > 100.0
    assert missing_evidence(fitter, fit) < LACKING


@pytest.mark.parametrize(
    ("effect", "name", "key", "value"),
    [
        (Cogging(0.00125, 2.0, 1.0), "cogging", "period", 0.00125),
        (PayloadMass(15.0), "payload_mass", "mass", 15.0),
    ],
)
def test_an_effect_that_is_there_is_fitted(effect, name, key, value):
    fitter, base = recalibrated_of(effect)
    candidate = next(one for one in catalogue(fitter, base) if one.name == name)
    fit = fit_from(fitter, base, screen(base, candidate))
    assert fit.model.values(fit.theta)[0][key][0] == pytest.approx(value, rel=0.15 if name == "payload_mass" else 1e-3)
    assert base.evidence - fit.evidence > WORTH


def test_what_follows_the_table_is_screened_beside_what_pushes_it(tilted, monkeypatch):
    """A contact that slips under a tilt which nothing holds against never ages."""
    fitter, base = tilted
    tilt = next(one for one in catalogue(fitter, base) if one.name == "constant_force")
    fit = fit_from(fitter, base, screen(base, tilt))
    known = np.asarray(_pushed(fit).lanes.disturbance) - np.asarray(fitter.logged.lanes.disturbance)
    np.testing.assert_allclose(known, fit.model.values(fit.theta)[0]["force"][0], rtol=1e-9)
    assert not np.any(np.asarray(_pushed(base).lanes.disturbance) - np.asarray(fitter.logged.lanes.disturbance))
    dwell = next(one for one in catalogue(fitter, base) if one.name == "friction_dwell")
    point = starting_points(fit, dwell)[0]
    beside = sensitivities(fit, dwell, point)[0]
    monkeypatch.setattr("tuning.diagnosis.selection.screening._pushed", lambda fitted: fitted.model.logged)
    alone = sensitivities(fit, dwell, point)[0]
    assert np.linalg.norm(beside - alone) > 0.01 * np.linalg.norm(alone)


def test_screening_points_no_further_than_any_prior_could_mean(sound):
    """What is missing far beyond what the drive's own numbers can make up for has them run away."""
    fitter, base = sound
    cogging = next(one for one in catalogue(fitter, base) if one.name == "cogging")
    astray = base._replace(residual=base.residual + base.jacobian @ np.r_[1e4, np.zeros(base.theta.size - 1)])
    far = np.abs(screen(astray, cogging).rest - base.theta)
    assert far.max() == pytest.approx(FARTHEST)


def test_where_screening_points_too_far_a_fit_begins_without_the_effect():
    fitter, base = recalibrated_of(Cogging(0.00125, 2.0, 1.0))
    found = screen(base, next(one for one in catalogue(fitter, base) if one.name == "cogging"))
    far = {name: value * (1.0 if name == "period" else 1e4) for name, value in found.values.items()}
    fit = fit_from(fitter, base, found._replace(values=far, rest=base.theta + 30.0), 4)
    assert base.evidence - fit.evidence > 100.0
    assert fit.model.values(fit.theta)[0]["cosine"][0] == pytest.approx(2.0, abs=0.2)


def test_a_fit_that_stopped_on_its_way_goes_on_before_an_effect_is_credited(sound, tilted):
    fitter, base = sound
    cogging = next(one for one in catalogue(fitter, base) if one.name == "cogging")
    model = joined(base.model, cogging)
    richer = fitter.fit(
        model,
        np.r_[base.theta, np.zeros(model.size - base.theta.size)],
        base.process_noise,
        base.filtered.trajectory,
        3,
    )
    stopped = fitter.fit(base.model, base.theta + 0.2, None, initial_trajectory(fitter.logged), 0)
    assert stopped.evidence - richer.evidence > WORTH
    further = _refit_without_last(fitter, stopped, [richer])
    assert further.evidence == pytest.approx(base.evidence, abs=2.0)
    assert _refit_without_last(fitter, base, [richer]) is None
    # nor does a fit go on where it is the effect that explains
    fitter, base = tilted
    tilt = next(one for one in catalogue(fitter, base) if one.name == "constant_force")
    assert _refit_without_last(fitter, base, [fit_from(fitter, base, screen(base, tilt))]) is None
    assert _refit_without_last(fitter, base, []) is None


def test_what_made_up_for_an_effect_makes_way_for_it():
    """A workpiece of 25 kg, taken for a mass far off: the step that screening points to moves both."""
    fitter = fitter_of(PayloadMass(25.0))
    base, mass = recalibrated(fitter, TOLERANCE), NAMES.index("mass")
    payload = next(one for one in catalogue(fitter, base) if one.name == "payload_mass")
    found = screen(base, payload)
    assert base.theta[mass] > 10.0
    assert abs(found.rest[mass]) < 2.0
    assert found.values["mass"][0] == pytest.approx(25.0, abs=5.0)
    others = np.arange(len(NAMES)) != mass
    np.testing.assert_allclose(found.rest[others], base.theta[others], atol=0.3)
    fit = fit_from(fitter, base, found)
    assert max_prior_deviation(fit) < 2.0
    assert float(fit.model.values(fit.theta)[0]["mass"][0]) == pytest.approx(25.0, abs=3.0)  # as the mass is known
    assert base.evidence - fit.evidence > 100.0  # of the prior alone: one explains the log as well as the other


def test_no_step_leads_further_than_a_prior_could_mean(sound, monkeypatch):
    fitter, base = sound
    point = fitter.at(base.model, base.theta, base.process_noise, base.filtered.trajectory)
    residual = 10.0 * FARTHEST * base.residual / np.linalg.norm(base.residual)
    jacobian = np.zeros((residual.size, base.model.size))
    jacobian[:, 3] = residual / np.linalg.norm(residual)  # what it asks for is five times too far
    seen, at = [], fitter.at

    def watched(model, theta, process_noise, trajectory):
        seen.append(theta)
        return at(model, theta, process_noise, trajectory)

    monkeypatch.setattr(fitter, "at", watched)
    monkeypatch.setattr(fitter, "residuals", lambda point: (residual, np.ones_like(residual)))
    fitter.step(base.model, point, 0.1, np.ones(base.model.size), jacobian)
    assert np.max(np.abs(seen[0] - point.theta)) == pytest.approx(FARTHEST)


def test_a_secant_holds_along_the_step_that_was_taken(sound):
    fitter, base = sound
    before = fitter.at(base.model, base.theta, base.process_noise, base.filtered.trajectory)
    step = np.random.default_rng(2).standard_normal(base.model.size)
    ahead = fitter.at(base.model, base.theta + step, base.process_noise, base.filtered.trajectory)
    updated = fitter._updated(base.jacobian, before, ahead)
    moved = fitter.residuals(ahead)[0] - fitter.residuals(before)[0]
    np.testing.assert_allclose(updated @ step, moved, atol=1e-12 * np.abs(moved).max())
    across = np.linalg.svd(step[None])[2][1:].T  # directions that the step says nothing of
    np.testing.assert_allclose(updated @ across, base.jacobian @ across, atol=1e-9 * np.abs(base.jacobian).max())


def test_parameters_of_the_session_are_one_for_each_log(sound):
    fitter, _ = sound
    twice = fitter.logged._replace(
        lanes=jax.tree.map(lambda one: jnp.concatenate([one, one]), fitter.logged.lanes),
        owner=(0, 1),
        starts=jnp.zeros(2),
    )
    candidate = next(one for one in candidates(setting(DRIVE.drive, twice.lanes, 1.0 / RATE)) if one.name == "cogging")
    model = joined(Model(twice), candidate)
    names = [(name, log) for _, name, log in model.slots]
    assert names.count(("period", None)) == 1
    assert {("cosine", 0), ("cosine", 1)} <= set(names)
    theta = np.zeros(model.size)
    theta[len(NAMES) + names.index(("cosine", 1))] = 2.0
    effect = model.effects(theta)[0]
    assert float(effect.cosine[0]) == 0.0
    assert float(effect.cosine[1]) == pytest.approx(2.0 * candidate.parameters[0].spread)


@pytest.mark.slow
def test_impossible_numbers_are_explained_before_anything_else():
    """A force constant that is a fifth off, and cogging: recalibration hides the first, by moving all else as far.

    The cogging explains more, which would come first if the numbers were possible.
    """
    fitter = fitter_of(ForceGain(-0.2), Cogging(0.00125, 1.0, 0.3))
    base = recalibrated(fitter, TOLERANCE)
    assert max_prior_deviation(base) > IMPOSSIBLE
    few = [one for one in catalogue(fitter, base) if one.name in ("force_gain", "payload_mass", "cogging")]
    found = select_next_effect(
        fitter, base, few, lambda what, done, most: None, lambda one: float(missing_evidence(fitter, one) >= LACKING)
    )
    first = found.fits[0]
    assert [member.candidate.name for member in first.model.members] == ["force_gain"]
    assert first.evidence > found.fits[1].evidence + WORTH
    assert first.model.values(first.theta)[0]["gain"][0] == pytest.approx(-0.2, abs=0.03)
    assert max_prior_deviation(first) < STRAINED
    assert base.evidence - first.evidence + found.allowance > WORTH


def test_a_machine_has_one_screw(sound):
    known = {one.name: one for one in catalogue(*sound)}
    assert known["backlash"].excludes(known["compliance"])
    assert known["compliance"].excludes(known["compliance"])
    assert not known["compliance"].excludes(known["cogging"])


@pytest.mark.parametrize("delay", [0.15, 0.25])
def test_a_delay_that_recalibration_made_up_for_is_screened_beside_what_makes_way_for_it(delay):
    fitter = fitter_of(LoopDelay(delay))
    base = recalibrated(fitter, TOLERANCE)
    late = next(one for one in catalogue(fitter, base) if one.effect is LoopDelay)
    found = tried(fitter, base, late)
    model = joined(base.model, late)
    least = min(float(point["delay"][0]) for point in starting_points(base, late))
    beside = fitter.at(
        model,
        np.r_[base.theta, begin(model, {"delay": np.array([least])})],
        base.process_noise,
        base.filtered.trajectory,
    )
    assert base.cost - beside.cost < 0.0  # where nothing makes way, the least of the grid explains nothing
    assert found.evidence > 100.0
    assert found.values["delay"][0] == pytest.approx(delay, rel=0.6)


@pytest.mark.parametrize("reached", [6, 20])
def test_a_limit_is_found_that_few_samples_reach(sound, reached):
    """So few that no force is missed; how many, decides which step of a grid comes near it."""
    command = np.abs(np.asarray(sound[0].logged.lanes.command)).ravel()
    limit = float(np.sort(command)[-reached])
    fitter = fitter_of(ForceLimit(limit))
    base = recalibrated(fitter, TOLERANCE)
    assert missing_evidence(fitter, base) < LACKING
    if reached > 10:  # fewer may or may not be seen, by when they come
        assert least_foreseen(base).decades < np.log10(CHANCE)  # though a moment goes wrong
    few = [one for one in catalogue(fitter, base) if one.name in ("force_limit", "force_gain", "payload_mass")]
    found = explain(fitter, base, few, lambda *_: None)
    assert found.named == {"force_limit"}
    assert found.best.model.values(found.best.theta)[-1]["limit"][0] == pytest.approx(limit, rel=1e-3)


@pytest.mark.parametrize("astray", [1e-6, 1e-4])
def test_a_count_that_went_astray_is_no_event_nor_is_a_long_rest(sound, astray):
    """The filter begins again after it, and is off once more."""
    simulate_log = sound[0].logged
    resting = 16_000  # samples, before the motion
    ahead = {"position": "edge", "command": "constant", "disturbance": "edge", "load": "edge", "counts": "edge"}
    lanes = simulate_log.lanes._replace(
        **{
            name: jnp.pad(getattr(simulate_log.lanes, name), ((0, 0), (resting, 0)), mode=mode)
            for name, mode in ahead.items()
        }
    )
    lanes = lanes._replace(position=lanes.position.at[0, resting + 3000].add(astray), velocity=jnp.zeros(1))
    base = recalibrated(Fitter(simulate_log._replace(lanes=lanes)), TOLERANCE)
    assert float(base.filtered.noise_scale_sq) < 0.5
    assert least_foreseen(base).decades > np.log10(CHANCE) / 2


@pytest.mark.parametrize("rate", [2000.0, 10_000.0])
def test_a_limit_beyond_all_commands_limits_nothing(rate):
    """Where a sample is several control periods, beyond the largest of these, not of their means."""
    fast = axis_of(rate=rate)
    log = simulate_log(fast, two_sines(1.0, rate))
    there = logged_of(fast.drive, [log])
    known = {one.name: one for one in candidates(setting(there.drive, there.lanes, there.sampling.period))}
    most, lasts = float(np.abs(log.command).max()), there.lasts
    assert known["force_limit"].plausible({"limit": np.array([0.99 * most])}, lasts)
    assert not known["force_limit"].plausible({"limit": np.array([1.01 * most])}, lasts)


def test_a_filter_under_a_rough_cost_tries_every_small_sudden_force(sound, monkeypatch):
    fitter, base = sound
    model, tried_for = base.model, []
    plain = Fitter.with_process

    def watched(self, point, model, processes):
        tried_for.append(np.asarray(processes))
        return plain(self, point, model, processes)

    monkeypatch.setattr(Fitter, "with_process", watched)
    fitter.minimise(model, base.theta, base.process_noise, base.filtered.trajectory, 3)
    sudden = fitter.quiet(base.process_noise)
    assert sudden[0, 1] == LEAST
    assert np.all(sudden[:, 0] == base.process_noise[0])
    assert any(one.shape == sudden.shape and np.allclose(one, sudden) for one in tried_for)


def test_the_least_process_force_hides_in_the_noise_of_a_fine_scale(sound):
    """A force gain and a machine that is as much lighter are one and the same, as far as that least is nothing: the one
    of a heavy table tells them apart on a light one behind a scale of 10 nm.
    """
    scaled = np.array([k < LOGARITHMS and not name.startswith("stribeck") for k, name in enumerate(NAMES)])
    fine = axis_of(kp=3.99e5, kd=1_217.0, noise=2e-9, resolution=1e-8)
    undamped = dataclasses.replace(fine.drive.plant, damping=Directional(0.0, 0.0))  # no part of what is calibrated
    heavy = dataclasses.replace(fine.drive, plant=undamped)
    light = jax.tree.map(float, calibrated(heavy, jnp.asarray(np.log(0.1) * scaled)))
    fine = dataclasses.replace(fine, drive=light)
    fitter = Fitter(logged_of(light, [simulate_log(fine, two_sines(1.5))]))
    base = recalibrated(fitter, TOLERANCE)
    gain = next(one for one in catalogue(fitter, base) if one.name == "force_gain")
    one_by_one = dataclasses.replace(base.model, prior=tolerated(TOLERANCE))  # the load's friction by itself, too
    there = base.model.prior @ base.theta / TOLERANCE
    model = joined(one_by_one, gain)
    lighter = np.r_[there + scaled * np.log(0.92) / TOLERANCE, gain.parameters[0].standard(-0.08)]

    def apart(least):
        told = [
            float(fitter.at(one, theta, np.full(2, least), base.filtered.trajectory).filtered.deviance)
            for one, theta in ((one_by_one, there), (model, lighter))
        ]
        return abs(told[1] - told[0])

    assert apart(fitter.least) < 5.0
    assert apart(LEAST) > 10.0
    assert sound[0].least == LEAST


@pytest.mark.parametrize("step", [0.0, 0.2])
def test_what_recalibration_hid_is_found_however_coarsely_the_command_was_logged(step):
    """It begins far off, in a long valley: after a few steps it is still on its way, and looks worse than nothing."""
    machine = jax.tree.map(float, calibrated(DRIVE.drive, jnp.asarray(HIDDEN)))
    loaded = dataclasses.replace(machine, effects=(AppliedLoad(load=30e3),))
    log = simulate_log(dataclasses.replace(DRIVE, drive=loaded), two_sines())
    if step:
        log = dataclasses.replace(log, command=step * np.round(log.command / step))
    fitter = Fitter(logged_of(DRIVE.drive, [log]))
    base = recalibrated(fitter, TOLERANCE)
    load = next(one for one in catalogue(fitter, base) if one.name == "applied_load")
    found = screen(base, load)
    fit = fit_from(fitter, base, found, RACE)
    assert base.evidence - fit.evidence > 0.9 * found.gain > 100.0
    assert fit.model.values(fit.theta)[0]["load"][0] == pytest.approx(30e3, rel=0.1)
