"""Controllers against their formulas, recomputed in NumPy from what a run recorded."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffdrive import motion as motions
from diffdrive.controllers import (
    DOBVSC,
    PD,
    Cascade,
    Command,
    Controller,
    DisturbanceObserver,
    Feedforward,
    FrictionCompensation,
    PDFeedforwardDOB,
    PDGains,
    Reference,
    Tracking,
)
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.run import Run
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.friction import steady_friction
from diffdrive.model.parameters import Sampling, Sensor
from diffdrive.model.presets import PAPER_KD, PAPER_KP
from diffdrive.model.quantity import Directional
from diffdrive.numerics.arrays import as_arrays
from diffdrive.observers.friction_observer import KalmanObserver, LoadStateObserver
from diffdrive.observers.load_estimator import FixedLoad
from diffdrive.paper import example_controllers
from tests.support.paper_move import IDEAL, MOVE, RATE, SETTLED, TRACKING, run_of

ROUGH = dataclasses.replace(IDEAL, sensor=Sensor(resolution=1e-7, noise=2e-8))
FEEDFORWARD = Feedforward(mass=120.0, damping=Directional(400.0, 200.0))
N = len(MOVE.time)


def fed_forward(run: Run) -> np.ndarray:
    """FEEDFORWARD's force along MOVE."""
    damping = np.where(run.reference_velocity >= 0, 400.0, 200.0)
    return 120.0 * MOVE.acceleration + damping * run.reference_velocity


def assert_command(run: Run, expected: np.ndarray) -> None:
    np.testing.assert_allclose(run.command, expected, rtol=1e-9, atol=1e-9 * np.max(np.abs(expected)))


# --- what a controller declares ---------------------------------------------------------------------------------------

KINDS = example_controllers(IDEAL)


def commands_of(controller: Controller, factor: float) -> np.ndarray:
    """The command over a few samples of a stroke whose lengths are multiplied."""
    state, force, commands = controller.init(jnp.zeros(())), jnp.zeros(()), []
    for k in range(1, 5):
        length, speed = factor * 1e-5 * k**2, factor * 2e-5 * k * RATE
        given = Reference(jnp.asarray(length), jnp.asarray(speed), jnp.asarray(factor * 2e-5 * RATE**2))
        state, command = controller.step(state, given, jnp.asarray(0.8 * length), force, 1.0 / RATE)
        force = command.force
        commands.append(float(force))
    return np.array(commands)


@pytest.mark.parametrize("kind", KINDS)
def test_a_controller_that_is_said_to_be_linear_is_and_no_other(kind):
    """Three times the motion is three times the command."""
    controller, thrice = KINDS[kind], 3.0 * commands_of(KINDS[kind], 1.0)
    assert controller.is_linear == np.allclose(commands_of(controller, 3.0), thrice, rtol=1e-9)
    assert controller.has_friction_observer == isinstance(controller, FrictionCompensation)


def test_of_a_controller_that_says_nothing_nothing_is_presumed():
    class Own(Controller):
        def init(self, position):
            return ()

        def step(self, state, reference, position, applied, period):
            return (), Command(reference.position - position)

    assert (Own().is_linear, Own().is_memoryless, Own().has_friction_observer) == (False, False, True)


# --- feedback and feed-forward ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("feedforward", [None, FEEDFORWARD])
def test_pd_is_its_formula(feedforward):
    run = run_of(PD(Tracking(PDGains(PAPER_KP, PAPER_KD), feedforward)), ROUGH)
    error = run.reference - run.position
    before = np.r_[error[0], error[:-1]]
    expected = PAPER_KP * error + PAPER_KD * (error - before) * RATE
    assert_command(run, expected + (fed_forward(run) if feedforward is FEEDFORWARD else 0.0))


def test_the_plant_s_own_feedforward_leaves_only_friction_to_feedback():
    run = run_of(PD(Tracking(PDGains(PAPER_KP, PAPER_KD), Feedforward.of(IDEAL.plant))))
    friction = float(steady_friction(IDEAL.friction, 0.01, 0.0))
    assert PAPER_KP * run.error[SETTLED] == pytest.approx(friction, rel=1e-4)


def test_a_feedforward_is_that_of_the_plant_or_none():
    heavier = dataclasses.replace(IDEAL, plant=dataclasses.replace(IDEAL.plant, mass=130.0))
    for controller in (PD(TRACKING), Cascade(kp=1.0, kv=1.0, feedforward=Feedforward(0.0))):
        assert controller.table()["feedforward"] is True
        assert controller.with_model(heavier) == heavier_of(controller, Feedforward.of(heavier.plant))
    for controller in (PD(Tracking(PDGains(1.0, 1.0))), Cascade(kp=1.0, kv=1.0)):
        assert controller.table()["feedforward"] is False
        assert controller.with_model(heavier) == controller


def heavier_of(controller, feedforward):
    if isinstance(controller, Cascade):
        return dataclasses.replace(controller, feedforward=feedforward)
    return PD(Tracking(controller.tracking.gains, feedforward))


def test_static_errors_of_the_paper_s_pd():
    motion = motions.staircase(speeds=[0.01], travel=5e-3, acceleration=1.0, rate=RATE, dwell=0.0)
    for load, positive, negative in ((0.0, 11.411e-6, -11.262e-6), (10e3, 11.870e-6, -11.721e-6)):
        run = simulate_loop(IDEAL, PD(Tracking(PDGains(PAPER_KP, PAPER_KD))), motion, load)
        middle = [np.argmin(np.abs(motion.time - share * motion.duration)) for share in (0.45, 0.95)]
        assert run.error[middle] == pytest.approx([positive, negative], abs=1e-9)


@pytest.mark.parametrize("samples", [1, 2, 5])
@pytest.mark.parametrize("ki", [0.0, 1e6])
def test_cascade_is_its_formula(samples, ki):
    controller = Cascade(200.0, 3e4, ki, velocity_feedforward=0.9, feedforward=FEEDFORWARD, velocity_samples=samples)
    run = run_of(controller, ROUGH)
    past = np.r_[np.full(samples, run.position[0]), run.position[:-samples]]
    velocity = (run.position - past) * RATE / samples
    wanted = 200.0 * (run.reference - run.position) + 0.9 * run.reference_velocity
    integral = np.cumsum(ki / RATE * (wanted - velocity))
    assert_command(run, 3e4 * (wanted - velocity) + integral + fed_forward(run))


def test_the_cascade_s_integral_holds_a_constant_force_without_error():
    leaning = dataclasses.replace(IDEAL, plant=dataclasses.replace(IDEAL.plant, constant_force=-50.0))
    still = motions.from_array(np.arange(10_000) / RATE, np.zeros(10_000))
    run = simulate_loop(leaning, Cascade(kp=100.0, kv=3e4, ki=3e6), still)
    assert abs(run.error[-1]) < 1e-9
    assert run.command[-1] - run.friction[-1] == pytest.approx(50.0, rel=1e-3)


# --- disturbance observer ---------------------------------------------------------------------------------------------


def resisting(cutoff: float, position: np.ndarray, force: np.ndarray, plant=IDEAL.plant, period=1 / RATE):
    """The disturbance observer's estimate for these signals."""
    observer = DisturbanceObserver.of(plant, cutoff)
    return jax.lax.scan(
        lambda s, at: observer.step(s, *at, period), observer.init(position[0]), as_arrays((position, force))
    )[1]


@pytest.mark.parametrize("cutoff", [3.0, 30.0, 240.0])
def test_a_step_of_force_on_a_held_table_appears_through_two_lags(cutoff):
    tau = 1 / (2 * np.pi * cutoff)
    time = np.arange(1, 4001) / RATE  # the force acts over the period before each sample
    estimate = np.asarray(resisting(cutoff, np.full(4000, 0.3), np.full(4000, 7.0)))
    exact = 7.0 * (1 - (1 + time / tau) * np.exp(-time / tau))
    slope = 7.0 / (np.e * tau)  # the steepest
    np.testing.assert_allclose(estimate, exact, atol=1.05 * slope / RATE / 2)  # half a sample of discretisation
    if cutoff > 10:
        assert estimate[-1] == pytest.approx(7.0, rel=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.1, 0.1), st.floats(-100.0, 100.0), st.floats(20.0, 300.0))
def test_a_constant_disturbance_at_constant_speed_is_estimated_exactly(speed, disturbance, cutoff):
    time = np.arange(4000) / RATE
    damping = 380.0 if speed >= 0 else 260.0
    force = np.full(4000, damping * speed + disturbance)
    estimate = resisting(cutoff, 0.2 + speed * time, force)
    assert float(estimate[-1]) == pytest.approx(disturbance, abs=1e-4)


@pytest.mark.parametrize(("mass", "damping"), [(100.0, 0.0), (1e-9, 300.0)])
def test_a_table_dragged_without_force_appears_through_two_lags(mass, damping):
    tau, speed = 1 / (2 * np.pi * 30.0), 0.02
    time = np.arange(2000) / RATE
    plant = dataclasses.replace(IDEAL.plant, mass=mass, damping=Directional(damping, damping))
    estimate = np.asarray(resisting(30.0, speed * time, np.zeros(2000), plant))
    fade = np.exp(-time / tau)
    exact = -speed * (mass * time / tau**2 * fade + damping * (1 - (1 + time / tau) * fade))
    np.testing.assert_allclose(estimate, exact, atol=0.02 * np.max(np.abs(exact)))


def test_inertia_is_no_disturbance():
    """A table that accelerates as its force says: nothing resists it, but for the lag's start."""
    time = np.arange(8000) / RATE
    frictionless = dataclasses.replace(IDEAL.plant, damping=Directional(0.0, 0.0))
    estimate = resisting(30.0, 0.5 * 2.0 * time**2, np.full(8000, 200.0), frictionless)
    assert abs(float(estimate[-1])) < 1e-3 * 200.0


@pytest.mark.parametrize("controller", [DOBVSC, PDFeedforwardDOB])
def test_controllers_with_a_disturbance_observer_find_the_steady_friction(controller):
    observer = DisturbanceObserver.of(IDEAL.plant, 100.0)
    extra = {"friction": IDEAL.friction} if controller is PDFeedforwardDOB else {"reach": 0.0}
    loaded = 5000.0  # which the feed-forward knows nothing of
    run = run_of(controller(tracking=TRACKING, observer=observer, **extra), load=loaded)
    friction = float(steady_friction(IDEAL.friction, 0.01, loaded))
    assert run.friction_estimate[SETTLED] == pytest.approx(friction, rel=1e-3)
    assert abs(run.error[SETTLED]) < 1e-8


def test_switching_force_saturates_at_its_reach():
    observer = DisturbanceObserver.of(IDEAL.plant, 100.0)
    run = run_of(DOBVSC(TRACKING, observer, reach=3.0, layer=1e-4, slope=200.0), ROUGH)
    plain = run_of(DOBVSC(TRACKING, observer, reach=0.0), ROUGH)
    error = run.reference - run.position
    surface = np.diff(error, prepend=error[0]) * RATE + 200.0 * error
    damping = np.where(MOVE.velocity >= 0, 380.0, 260.0)
    rest = PAPER_KP * error + PAPER_KD * np.diff(error, prepend=error[0]) * RATE
    rest = rest + 100.0 * MOVE.acceleration + damping * MOVE.velocity + run.friction_estimate
    switching = 3.0 * np.clip(surface / 1e-4, -1, 1)
    np.testing.assert_allclose(run.command - rest, switching, atol=1e-6)
    assert np.any(np.abs(switching) == 3.0)
    assert plain.status.ok


# --- friction compensation --------------------------------------------------------------------------------------------


def test_an_exact_friction_observer_cancels_friction():
    observer = KalmanObserver(IDEAL.plant, IDEAL.friction, load_estimator=FixedLoad(0.0))
    with_it, without = run_of(FrictionCompensation(TRACKING, observer)), run_of(PD(TRACKING))
    assert with_it.peak_error() < 0.03 * without.peak_error()
    assert abs(with_it.error[SETTLED]) < 1e-6 * abs(without.error[SETTLED])
    assert with_it.friction_estimate[SETTLED] == pytest.approx(with_it.friction[SETTLED], rel=1e-6)
    assert with_it.load_estimate is None  # an assumed load is not an estimate


def test_friction_compensation_adds_its_estimate_to_pd():
    observer = LoadStateObserver(IDEAL.plant, IDEAL.friction)
    run = run_of(FrictionCompensation(Tracking(PDGains(PAPER_KP, PAPER_KD), FEEDFORWARD), observer), ROUGH)
    error = run.reference - run.position
    derivative = np.diff(error, prepend=error[0]) * RATE
    assert_command(run, PAPER_KP * error + PAPER_KD * derivative + fed_forward(run) + run.friction_estimate)


def test_the_load_state_finds_the_load():
    observer = LoadStateObserver(IDEAL.plant, IDEAL.friction)
    run = run_of(FrictionCompensation(TRACKING, observer), load=10e3)
    assert run.load_estimate[SETTLED] == pytest.approx(10e3, rel=0.05)


# --- recording, lanes -------------------------------------------------------------------------------------------------

SIGNALS = [
    "time", "reference", "reference_velocity", "load", "position", "table_position", "velocity", "command", "force",
    "friction",
]  # fmt: skip


@pytest.mark.parametrize("every", [7, 10, N - 1])
def test_every_nth_sample_is_that_of_the_full_run(every):
    noisy = dataclasses.replace(IDEAL, sensor=Sensor(noise=1e-9))
    load = np.linspace(0.0, 1000.0, N)
    full = run_of(PD(TRACKING), noisy, load=load)
    thin = run_of(PD(TRACKING), noisy, load=load, every=every)
    for name in SIGNALS:
        expected = getattr(full, name)[::every][: N // every]
        np.testing.assert_allclose(getattr(thin, name), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max() + 1e-30)


def test_estimates_are_decimated_with_the_rest():
    controller = FrictionCompensation(TRACKING, LoadStateObserver(IDEAL.plant, IDEAL.friction))
    full, thin = run_of(controller, load=500.0), run_of(controller, load=500.0, every=10)
    np.testing.assert_allclose(thin.friction_estimate, full.friction_estimate[::10][: N // 10], atol=1e-6)
    np.testing.assert_allclose(thin.load_estimate, full.load_estimate[::10][: N // 10], rtol=1e-6, atol=1e-3)


def test_lanes_over_load_mass_and_seed_equal_single_runs():
    noisy = dataclasses.replace(IDEAL, sensor=Sensor(noise=1e-8))
    loads, masses, seeds = np.array([0.0, 3e3, 10e3]), np.array([80.0, 100.0, 130.0]), np.array([1, 2, 3])
    controller = as_arrays(PD(TRACKING))

    def lane(load, mass, seed):
        drive = eqx.tree_at(lambda d: d.plant.mass, as_arrays(noisy), mass)
        inputs = loop_inputs(MOVE, np.zeros(N))
        inputs = inputs._replace(load=jnp.full(N, load))
        frame = rollout_loop(drive, controller, inputs, Sampling(), jax.random.key(seed))
        return frame.table_position, frame.command

    positions, commands = jax.jit(jax.vmap(lane))(loads, masses, seeds)
    for i in range(3):
        drive = eqx.tree_at(lambda d: d.plant.mass, noisy, float(masses[i]))
        single = run_of(PD(TRACKING), drive, load=loads[i], seed=int(seeds[i]))
        np.testing.assert_allclose(positions[i], single.table_position, atol=1e-13)
        np.testing.assert_allclose(commands[i], single.command, atol=1e-5)
