"""The Stribeck curve with another exponent than the paper's, as many programs have it: exp(-(|v| / v_s)^d)."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive import motion
from diffdrive.axis_file.drive_file import parse_axis
from diffdrive.controllers import PD, PDGains, Tracking
from diffdrive.effects.machine import FrictionShape
from diffdrive.errors import DriveFileError
from diffdrive.loop import metrics
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.simulate import simulate_loop
from diffdrive.loop.smooth import smooth
from diffdrive.model.friction import steady_friction, steepest_stribeck_slope
from diffdrive.model.parameters import Sampling
from diffdrive.model.plant import PlantState, advance
from diffdrive.model.presets import PAPER_KD, PAPER_KP
from diffdrive.numerics.arrays import as_arrays
from experiments.studies.recovery.truth import run
from experiments.studies.withheld import generate
from experiments.studies.withheld.draw import draw
from tests.support.asymmetric_drive import ASYMMETRIC
from tests.support.perturbed_machine import catalogue
from tests.support.sound_log import DRIVE, RATE, simulate_log, two_sines
from tuning.diagnosis.diagnose import diagnose, logged_of
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.gap.gap import drive_of
from tuning.diagnosis.hypotheses.calibration import NAMES, TOLERANCE
from tuning.diagnosis.selection.explain import explain
from tuning.diagnosis.selection.search import recalibrated
from tuning.identification.unknowns import unknowns_of

LOAD = 5_000.0
CONTROLLER = PD(Tracking(PDGains(PAPER_KP, PAPER_KD)))
EXPONENTS = [0.5, 1.0, 1.7, 2.0, 4.0]


def curved(exponent, drive=ASYMMETRIC):
    return replace(drive, friction=replace(drive.friction, stribeck_exponent=exponent))


def textbook(friction, speed, exponent):
    """Steady friction (N) by plain branches."""
    side = "positive" if speed >= 0 else "negative"
    coulomb = getattr(friction.coulomb_screw, side) + getattr(friction.load_coefficient, side) * (
        friction.initial_load + LOAD
    )
    fall = np.exp(-((abs(speed) / getattr(friction.stribeck_velocity, side)) ** exponent))
    level = coulomb + getattr(friction.breakaway_gap, side) * fall
    return np.sign(speed) * level + getattr(friction.viscous, side) * speed


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("speed", [-0.3, -1e-3, -1e-5, 1e-6, 4e-4, 1e-3, 2e-3, 0.01, 0.3])
def test_steady_sliding_is_on_the_curve(exponent, speed):
    drive = curved(exponent)
    expected = textbook(drive.friction, speed, exponent)
    assert float(steady_friction(drive.friction, speed, LOAD)) == pytest.approx(expected, rel=1e-13)


def test_sliding_on_the_curve_stays_there():
    drive, speed = curved(2.0), 8e-4
    friction = drive.friction
    resistance = textbook(friction, speed, 2.0)
    viscous = friction.viscous.positive * speed
    start = PlantState(0.0, speed, (resistance - viscous) / friction.bristle_stiffness.positive)
    force = resistance + drive.plant.damping.positive * speed - drive.plant.constant_force
    state = advance(drive, start, force, LOAD, 1e-3, 200)
    np.testing.assert_allclose(state, [1e-3 * speed, *start[1:]], rtol=1e-9)


def there_and_back():
    return motion.triangular(speed=0.01, stroke=0.0007, rounding=0.04, duration=0.18, rate=1e4)


def test_an_exponent_of_one_is_the_papers_curve():
    one, none = (simulate_loop(drive, CONTROLLER, there_and_back()) for drive in (curved(1.0), ASYMMETRIC))
    np.testing.assert_allclose(one.position, none.position, rtol=0, atol=1e-15)


@pytest.mark.parametrize("exponent", [0.5, 2.0])
def test_it_moves_as_the_truth_machine_does(exponent):
    """Against another integrator, in which the curve is written out again."""
    level = replace(
        ASYMMETRIC, plant=replace(ASYMMETRIC.plant, constant_force=0.0)
    )  # the simulator begins with no force
    drive, reference = curved(exponent, level), there_and_back()
    loads = jnp.zeros(len(reference.position))
    arguments = (jnp.asarray(reference.position), loads, jnp.zeros(()), jax.random.key(0))
    table = jax.jit(lambda d, g: run(d, g, *arguments, rate=1e4))(*as_arrays((drive, CONTROLLER.tracking.gains)))
    ours = simulate_loop(drive, CONTROLLER, reference)
    other = simulate_loop(level, CONTROLLER, reference)
    off = np.abs(ours.position - np.asarray(table.table)).max()
    assert off < 2e-9
    assert off < 0.02 * np.abs(ours.position - other.position).max()


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_slopes_of_the_curve_are_those_of_differences(exponent):
    def at(exponent, speed):
        return steady_friction(curved(exponent).friction, speed, LOAD)

    for speed in (-2e-3, -3e-5, 2e-4, 1e-3, 0.05):
        by_exponent, by_speed = jax.grad(at, (0, 1))(exponent, speed)
        h, step = 1e-5, 1e-4 * abs(speed)
        differences = float(at(exponent + h, speed) - at(exponent - h, speed)) / (2 * h)
        assert by_exponent == pytest.approx(differences, rel=1e-5, abs=1e-8)
        differences = float(at(exponent, speed + step) - at(exponent, speed - step)) / (2 * step)
        assert by_speed == pytest.approx(differences, rel=1e-5, abs=1e-3)
    for slope in jax.grad(at, (0, 1))(exponent, 0.0):  # where an exponent below one has none
        assert np.isfinite(slope)


@pytest.mark.long
@pytest.mark.parametrize("exponent", [0.7, 2.0])
def test_the_error_of_a_whole_motion_by_the_exponent(exponent):
    """Through rest, a reversal and stick, forwards and backwards, against differences."""
    inputs = loop_inputs(there_and_back(), jnp.zeros(1801))

    @jax.jit
    def error(exponent):
        frames = rollout_loop(smooth(curved(exponent)), CONTROLLER, inputs, Sampling(), jax.random.key(0))
        return metrics.rms(inputs.reference.position - frames.table_position)

    h = 1e-4
    once, twice = (float(error(exponent + far) - error(exponent - far)) for far in (h, 2 * h))
    forward, reverse = float(jax.jacfwd(error)(exponent)), float(jax.grad(error)(exponent))
    assert forward == pytest.approx((8 * once - twice) / (12 * h), rel=1e-5)
    assert reverse == pytest.approx(forward, rel=1e-9)


def test_a_friction_shape_changes_the_exponent_that_there_is():
    inputs = there_and_back()
    for before in (None, 2.0):
        shaped = replace(curved(before), effects=(FrictionShape(stribeck_exponent=np.log(1.5)),))
        expected = simulate_loop(curved(1.5 * (before or 1.0)), CONTROLLER, inputs)
        np.testing.assert_allclose(
            simulate_loop(shaped, CONTROLLER, inputs).position, expected.position, rtol=0, atol=1e-13
        )


def test_a_friction_shape_without_one_asks_for_no_power():
    shaped = FrictionShape(stribeck_velocity=0.1)
    assert shaped.alter(curved(None)).friction.stribeck_exponent is None
    assert shaped.alter(curved(2.0)).friction.stribeck_exponent == 2.0


@pytest.mark.long
def test_a_curve_of_another_exponent_is_found_by_its_name():
    """A machine with the textbook's curve, a drive file with the paper's."""
    truth = replace(DRIVE, drive=curved(2.0, DRIVE.drive))
    fitter = Fitter(logged_of(DRIVE.drive, [simulate_log(truth, two_sines())]))
    base = recalibrated(fitter, TOLERANCE)
    wanted = [one for one in catalogue(fitter, base) if one.name in ("friction_shape", "constant_force", "cogging")]
    found = explain(fitter, base, wanted, lambda *_: None)
    assert found.named == {"friction_shape"}
    best = found.best
    number = len(NAMES) + [name for _, name, _ in best.model.slots].index("stribeck_exponent")
    known = {one.name: one for one in best.model.members[0].candidate.parameters}["stribeck_exponent"]
    spread = known.spread * float(np.sqrt(np.linalg.inv(best.hessian)[number, number]))
    value = known.value(float(best.theta[number]))
    assert spread < 0.1
    assert abs(value - np.log(2.0)) < 4 * spread


@pytest.mark.slow
def test_a_fault_is_sure_beside_a_curve_of_another_exponent():
    """A tilt on a machine of other numerics, whose drive file has the paper's curve: whole catalogue, some minutes."""
    case = draw(np.random.default_rng([3, 1, 0]), ("constant_force",))
    case = case._replace(true=curved(2.0, case.true))
    logs, _ = generate._simulate_logs(case)
    believed = generate._nominal_axis(case)
    told = diagnose(believed.drive, believed.controller, logs).verdict
    sure = {one.effect for one in told.beliefs if one.found and one.confidence > 0.9}
    assert (told.verdict, sure) == ("effect", {"constant_force", "friction_shape"})


@pytest.mark.parametrize("exponent", [None, *EXPONENTS])
def test_the_steepest_fall_is_that_of_the_curve(exponent):
    friction = curved(exponent).friction
    d = exponent or 1.0
    speeds = np.geomspace(1e-5, 20.0, 200_001)
    slopes = d * speeds ** (d - 1.0) * np.exp(-(speeds**d))
    steepest = slopes.max() if d >= 1.0 else (1.0 - np.exp(-1.0))  # below, the chord to where a factor e is gone
    scale = friction.breakaway_gap.negative / friction.stribeck_velocity.negative
    assert steepest_stribeck_slope(friction, "negative") == pytest.approx(scale * steepest, rel=1e-4)


@pytest.mark.long
def test_a_drive_file_that_states_none_is_written_without_one():
    """Though every hypothesis of the diagnosis holds the exponent as a number; one that is stated stays."""
    for stated, held in ((None, None), (2.0, 2.0)):
        fitter = Fitter(logged_of(curved(stated, DRIVE.drive), [simulate_log(DRIVE, two_sines(0.5))]))
        assert drive_of(recalibrated(fitter, TOLERANCE), 0).friction.stribeck_exponent == held


def test_identification_keeps_the_exponent_of_the_file():
    drive = curved(2.0)
    assert unknowns_of(drive, 0.0).drive(drive).friction.stribeck_exponent == 2.0


def written(exponent):
    friction = {"coulomb_screw": 95.0, "load_coefficient": 0.0, "initial_load": 0.0, "breakaway_gap": 32.0} | {
        "stribeck_velocity": 1.2e-3, "stribeck_exponent": exponent, "viscous": 1900.0, "bristle_stiffness": 4e7,
        "bristle_damping": 5e3}  # fmt: skip
    return {
        "plant": {"mass": 140.0, "damping": 420.0},
        "friction": friction,
        "controller": {"kind": "pd", "kp": 1.6e6, "kd": 9e3},
        "sampling": {"rate": RATE},
    }


def test_a_drive_file_states_it():
    assert parse_axis(written(2)).drive.friction.stribeck_exponent == 2.0


@pytest.mark.parametrize("exponent", [0.0, -1.0, 5.0, "two"])
def test_what_is_no_exponent_is_refused_by_its_name(exponent):
    with pytest.raises(DriveFileError, match="stribeck_exponent"):
        parse_axis(written(exponent))
