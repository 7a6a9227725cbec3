"""The motor behind a screw, in the filter: how motor and table answer one another, and that the filter finds it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.effects.base import Seen
from diffdrive.effects.transmission import Backlash, Compliance
from diffdrive.effects.two_mass import MotorState
from diffdrive.model.friction import coulomb
from diffdrive.numerics.oscillator import Oscillator
from tests.support.perturbed_machine import DEVIATIONS, catalogue, fitter_of
from tests.support.sound_log import DRIVE
from tuning.diagnosis.filter import motor_state
from tuning.diagnosis.fits.reference_noise import lost_share
from tuning.diagnosis.hypotheses.calibration import NAMES, TOLERANCE
from tuning.diagnosis.hypotheses.model import Model
from tuning.diagnosis.selection.screening import begin, joined
from tuning.diagnosis.selection.search import initial_trajectory

PLAY = {"gap": 9e-6, "frequency": 450.0, "damping": 0.08, "motor_share": 0.3, "table_friction": 0.6}
SCREWS = {
    "elastic": Compliance(frequency=300.0, damping=0.05, motor_share=0.4, table_friction=0.5),
    "loose": Backlash(**PLAY),
}


def seen(velocity, bristle):
    zero = jnp.zeros(())
    return Seen(zero, zero, velocity, bristle, jnp.asarray(90.0), zero, jnp.asarray(500.0), jnp.asarray(4.0))


@pytest.mark.long
@pytest.mark.parametrize(
    ("screw", "at"),
    [
        ("elastic", (0.02, 1.5e-6, 3e-7, -1e-4)),
        ("elastic", (1e-6, 2e-7, 1e-7, 1e-6)),  # it sticks
        ("loose", (0.02, 1.5e-6, 1e-6, 1e-4)),  # free between its sides
        ("loose", (-0.01, -1e-6, -4.8e-6, -1e-4)),  # and against one
        ("loose", (0.02, 1.5e-6, 4.2e-6, 2e-3)),  # about to strike
    ],
)
def test_answers_of_motor_and_table_are_those_of_differences(screw, at):
    effect, drive, period = SCREWS[screw], DRIVE.drive, 5e-4

    def after(values):
        velocity, bristle, deflection, rate = values
        motor = MotorState.at_rest()._replace(relative=Oscillator(deflection, rate))
        motor, acts = effect.step(motor, seen(velocity, bristle), drive, period)
        return jnp.stack([*motor.relative, acts.force, acts.shift])

    here = np.array(at)
    velocity, bristle, deflection, rate = (jnp.asarray(value) for value in at)
    motor = MotorState.at_rest()._replace(relative=Oscillator(deflection, rate))
    ahead, acts, answers = effect.step_with_sensitivities(motor, seen(velocity, bristle), drive, period)
    np.testing.assert_allclose(after(here), jnp.stack([*ahead.relative, acts.force, acts.shift]), rtol=1e-12)
    for k, h in enumerate((1e-9, 1e-12, 1e-12, 1e-9)):
        step = h * np.eye(4)[k]
        slope = (after(here + step) - after(here - step)) / (2.0 * h)
        rounding = 4.0 * np.spacing(np.abs(after(here))) / h  # of each in its own unit
        rounding[3] += rounding[2] * period**2 / 100.0  # the shift is a difference of what that force does
        off = np.abs(jnp.stack([*answers[k]]) - slope)
        assert np.all(off < 2e-3 * np.abs(slope) + rounding), (k, off, slope)


@pytest.mark.parametrize(
    ("screw", "at"),
    [
        ("elastic", (0.02, 1.5e-6, 3e-7, -1e-4)),
        ("elastic", (-1e-6, 2e-7, 1e-7, 1e-6)),  # it sticks
        ("loose", (0.02, 1.5e-6, 1e-6, 1e-4)),  # free
        ("loose", (-0.01, -1e-6, -4.8e-6, -1e-4)),  # against one side
        ("loose", (0.02, 1.5e-6, 4.2e-6, 2e-3)),  # it strikes
    ],
)
def test_one_loop_answers_as_the_derivative_of_the_step_does(screw, at):
    effect, drive = SCREWS[screw], DRIVE.drive

    def after(values):
        velocity, bristle, deflection, rate = values
        motor = MotorState.at_rest()._replace(relative=Oscillator(deflection, rate))
        motor, acts = effect.step(motor, seen(velocity, bristle), drive, 5e-4)
        return jnp.stack([*motor.relative, acts.force, acts.shift])

    here = jnp.array(at)
    motor = MotorState.at_rest()._replace(relative=Oscillator(here[2], here[3]))
    ahead, acts, answers = effect.step_with_sensitivities(motor, seen(here[0], here[1]), drive, 5e-4)
    np.testing.assert_allclose(jnp.stack([*ahead.relative, acts.force, acts.shift]), after(here), rtol=1e-12)
    found = jnp.stack([jnp.stack([*one]) for one in answers], axis=1)
    derivative = jax.jacfwd(after)(here)
    largest = np.abs(derivative).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found / largest, derivative / largest, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0, 0.0), (0.02, 1.5e-6, 3e-7, -1e-4)])
def test_without_a_gap_a_loose_screw_answers_as_an_elastic_one(at):
    """At rest in its middle, too, where both sides touch."""
    numbers = {name: value for name, value in PLAY.items() if name != "gap"}
    velocity, bristle, deflection, rate = (jnp.asarray(value) for value in at)
    motor = MotorState.at_rest()._replace(relative=Oscillator(deflection, rate))
    loose, elastic = (
        jnp.stack([jnp.stack([*one]) for one in answers])
        for effect in (Backlash(gap=0.0, **numbers), Compliance(**numbers))
        for answers in [effect.step_with_sensitivities(motor, seen(velocity, bristle), DRIVE.drive, 5e-4)[2]]
    )
    np.testing.assert_allclose(loose, elastic, rtol=1e-12)


def test_where_no_screw_is_there_is_nothing_hidden():
    assert motor_state.screw_of(()) is None
    assert (
        motor_state.read((), ())
        == motor_state.unknown((), DRIVE.drive, 1.0)
        == motor_state.velocity_noise_vars((), 1.0)
        == ()
    )


@pytest.mark.parametrize(("force", "deflection"), [(40.0, 4e-6), (400.0, 4e-6), (400.0, 2e-5)])
def test_a_lost_motor_rests_where_its_force_may_hold_it(force, deflection):
    """A screw that carries more than friction is bent by that: only what no force explains is taken back."""
    screw = SCREWS["elastic"]
    stiffness = 0.4 * 0.6 * DRIVE.drive.plant.mass * (2.0 * np.pi * 300.0) ** 2
    found, rate = motor_state.regained((screw,), (deflection, 1e-3), jnp.asarray(True), DRIVE.drive, force)
    friction = float(coulomb(DRIVE.drive.friction, 1.0, 0.0))
    assert float(found) == pytest.approx(min(deflection, max(force, friction) / stiffness))
    assert float(rate) == 0.0
    assert motor_state.regained((screw,), (deflection, 1e-3), jnp.asarray(False), DRIVE.drive, force)[1] == 1e-3
    assert motor_state.unknown((screw,), DRIVE.drive, force)[0] == pytest.approx(
        (max(force, friction) / stiffness) ** 2
    )


@pytest.mark.long
def test_the_filter_finds_a_motor_that_is_not_where_it_begins():
    """Begun in the middle of the gap, with the drive file off by its tolerance: blows tell where the motor is."""
    fitter, process_noise = fitter_of(Backlash(**PLAY)), np.array([1.0, 1.0])
    bare = fitter.fit(Model(fitter.logged), np.zeros(len(NAMES)), process_noise, initial_trajectory(fitter.logged), 0)
    candidate = next(one for one in catalogue(fitter, bare) if one.name == "backlash")
    model = joined(bare.model, candidate)
    values = {name: np.array([value]) for name, value in PLAY.items()}
    own = begin(model, values)
    true = fitter.fit(model, np.r_[DEVIATIONS / TOLERANCE, own], process_noise, initial_trajectory(fitter.logged), 0)
    file = fitter.fit(model, np.r_[np.zeros(len(NAMES)), own], process_noise, initial_trajectory(fitter.logged), 0)
    wide = begin(model, {**values, "gap": np.array([1.3 * PLAY["gap"]])})
    wrong = fitter.fit(model, np.r_[DEVIATIONS / TOLERANCE, wide], process_noise, initial_trajectory(fitter.logged), 0)
    assert lost_share(fitter, true, process_noise) < 2e-3
    assert true.cost < min(file.cost, wrong.cost) - 100.0
