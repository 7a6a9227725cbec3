"""The truth machine against Radau, the simulator, its own order of convergence, and what its log must show."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from diffdrive import motion
from diffdrive.controllers import PD, PDGains, Tracking
from diffdrive.errors import DivergenceError, ParameterError
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.parameters import Actuator, Sensor
from diffdrive.model.presets import PAPER_KD, PAPER_KP
from diffdrive.numerics.arrays import as_arrays
from experiments.benchmarks.loops import one_kernel
from experiments.studies.recovery.truth import SCALE, TruthTable, advance, run, truth_log, truth_logs
from tests.support.asymmetric_drive import ASYMMETRIC, PAPER

RATE, LOAD = 10_000.0, 5_000.0
GAINS = PDGains(PAPER_KP, PAPER_KD)
LEVEL = replace(ASYMMETRIC, plant=replace(ASYMMETRIC.plant, constant_force=0.0))
DELAYED = replace(ASYMMETRIC, actuator=Actuator(force_limit=105.0, delay_samples=1, delay_fraction=0.3))


def there_and_back(distance=1e-4, speed=0.005, rate=RATE):
    return motion.jerk_limited(distance=distance, speed=speed, acceleration=1.0, jerk=200.0, rate=rate, dwell=2e-3)


def tables(drive, reference, deflection=0.0, load=LOAD, seed=0, **options):
    """`run` with one load throughout."""
    loads = jnp.full(len(reference), load)
    key = jax.random.key(seed)
    return jax.jit(partial(run, rate=RATE, **options))(
        *as_arrays((drive, GAINS)), jnp.asarray(reference), loads, jnp.asarray(deflection), key
    )


def equations(time, state, drive, force):
    """Eqs. (4) to (7), written for one state and with plain branches."""
    _, v, z = state
    f, p = drive.friction, drive.plant
    side, bent = ("positive" if x >= 0 else "negative" for x in (v, z))

    def now(pair):
        return getattr(pair, side)

    stiffness = getattr(f.bristle_stiffness, bent)
    coulomb = now(f.coulomb_screw) + now(f.load_coefficient) * (f.initial_load + LOAD)
    level = coulomb + now(f.breakaway_gap) * np.exp(-abs(v) / now(f.stribeck_velocity))
    slip = v - stiffness * abs(v) * z / level
    friction = stiffness * z + now(f.bristle_damping) * slip + now(f.viscous) * v
    return [v, (force + p.constant_force - now(p.damping) * v - friction) / p.mass, slip]


def radau(drive, state, force, duration):
    solution = solve_ivp(
        equations, (0.0, duration), state, "Radau", args=(drive, force), rtol=1e-10, atol=[1e-15, 1e-12, 1e-15]
    )
    return solution.y[:, -1]


def radau_loop(drive, reference, deflection):
    """Positions of the closed loop with a clean scale, each constant force in a piece of its own."""
    actuator, holding = drive.actuator, drive.friction.bristle_stiffness.positive * deflection
    holding -= drive.plant.constant_force
    state = np.array([reference[0] - holding / GAINS.kp, 0.0, deflection])
    limit = actuator.force_limit or np.inf
    past = [holding] * (actuator.delay_samples + 1)
    last, positions = None, []
    for wanted in reference:
        positions.append(state[0])
        error = wanted - state[0]
        command = GAINS.kp * error + GAINS.kd * (error - (error if last is None else last)) * RATE
        last = error
        past = [np.clip(command, -limit, limit), *past]
        share = actuator.delay_fraction or 0.0
        if share:
            state = radau(drive, state, past[-1], share / RATE)
        state = radau(drive, state, past[-2], (1 - share) / RATE)
        past.pop()
    return np.array(positions)


@pytest.mark.long
@pytest.mark.parametrize("drive", [ASYMMETRIC, DELAYED], ids=["no delay", "delay of 1.3 periods, force limit"])
def test_it_agrees_with_radau_through_a_reversal(drive):
    reference = there_and_back().position
    exact = radau_loop(drive, reference, 5e-7)
    ours = tables(drive, reference, 5e-7)
    assert np.ptp(exact) > 0.8 * np.ptp(reference)
    assert np.max(np.abs(ours.command)) > 105.0  # the limit is reached where there is one
    assert np.max(np.abs(ours.table - exact)) < 1e-10


@pytest.mark.parametrize("share", [None, 0.37], ids=["one force", "the force switches within the period"])
def test_it_converges_with_fourth_order_where_the_motion_is_smooth(share):
    drive = replace(ASYMMETRIC, actuator=Actuator(delay_fraction=share))
    start = TruthTable(*as_arrays((0.0, 0.002, 1e-6)))

    def end(steps):
        return np.array(advance(as_arrays(drive), start, 150.0, 180.0, LOAD, 2e-3, steps))

    best = end(2048)
    errors = np.array([np.abs(end(steps) - best) for steps in (16, 32, 64)])
    assert best[1] > 0.002
    orders = np.log2(errors[:-1] / errors[1:])
    assert np.all(orders > 3.7), orders
    assert np.all(orders < 4.6), orders


def test_it_agrees_with_the_simulator():
    reference = motion.jerk_limited(
        distance=2e-3, speed=0.010, acceleration=1.0, jerk=100.0, rate=RATE, dwell=0.02, repeats=1
    )
    assert 0.4 < reference.duration < 0.55
    # level, since the simulator begins with no force and a relaxed bristle
    theirs = simulate_loop(LEVEL, PD(Tracking(GAINS)), reference, LOAD).position
    ours = tables(LEVEL, reference.position).table
    assert np.max(np.abs(ours - theirs)) < 1e-9


def test_a_switch_within_the_period_is_two_pieces():
    drive = as_arrays(replace(ASYMMETRIC, actuator=Actuator(delay_fraction=0.3141)))
    whole = as_arrays(ASYMMETRIC)
    start = TruthTable(*as_arrays((0.0, 1e-4, -1e-6)))
    ours = advance(drive, start, 200.0, -300.0, LOAD, 1e-4, 50)
    between = advance(whole, start, 0.0, 200.0, LOAD, 0.3141e-4, 50)
    pieces = advance(whole, between, 0.0, -300.0, LOAD, 0.6859e-4, 50)
    assert np.allclose(ours, pieces, rtol=1e-9, atol=0)


def test_a_fraction_of_a_whole_period_is_a_whole_period():
    reference = there_and_back().position
    fraction = tables(replace(ASYMMETRIC, actuator=Actuator(delay_fraction=1.0)), reference)
    whole = tables(replace(ASYMMETRIC, actuator=Actuator(delay_samples=1)), reference)
    none = tables(ASYMMETRIC, reference)
    assert np.max(np.abs(fraction.table - whole.table)) < 1e-14
    assert np.max(np.abs(fraction.table - none.table)) > 1e-8


def test_it_begins_at_rest_and_stays_there():
    ours = tables(DELAYED, np.full(500, 0.01), 1e-6)
    assert np.ptp(ours.table) < 1e-13
    # 3e7 N/m * 1 um - 12 N
    assert np.allclose(ours.command, 18.0, atol=1e-6)


@pytest.fixture(scope="module")
def moving():
    drive = replace(PAPER, sensor=SCALE)
    reference = there_and_back(2e-3, 0.01)
    return reference, tables(drive, reference.position)


def test_the_scale_is_quantised_and_noisy(moving):
    reference, signals = moving
    counts = np.asarray(signals.position) / 1e-7
    assert np.max(np.abs(counts - np.round(counts))) < 1e-6
    # while it moves, the rounding is as good as independent noise of resolution / sqrt 12
    moves = np.abs(reference.velocity) > 0.005
    error = np.asarray(signals.position - signals.table)[moves]
    n = len(error)
    expected = np.hypot(3e-8, 1e-7 / np.sqrt(12))
    assert n > 2000
    assert abs(np.mean(error)) < 4 * expected / np.sqrt(n)
    assert abs(np.std(error) / expected - 1) < 4 / np.sqrt(2 * n)
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 4 / np.sqrt(n)


def test_noise_alone_has_its_deviation():
    drive = replace(PAPER, sensor=Sensor(noise=3e-8))
    signals = tables(drive, there_and_back(2e-3, 0.01).position)
    noise = np.asarray(signals.position - signals.table)
    assert abs(np.std(noise) / 3e-8 - 1) < 4 / np.sqrt(2 * len(noise))


def test_the_command_is_that_of_the_logged_position():
    reference = there_and_back()
    log = truth_log(replace(DELAYED, sensor=SCALE), GAINS, reference, LOAD)
    error = log.reference - log.position
    command = PAPER_KP * error + PAPER_KD * np.diff(error, prepend=error[0]) * RATE
    assert np.allclose(log.command, command, rtol=0, atol=1e-9)
    assert np.array_equal(log.load, np.full(len(log.time), LOAD))


def test_lanes_are_independent_machines():
    drives = [replace(drive, sensor=SCALE) for drive in (PAPER, ASYMMETRIC)]
    gains, loads = [GAINS, PDGains(0.7 * PAPER_KP, 0.7 * PAPER_KD)], [0.0, np.linspace(0.0, LOAD, 2000)]
    reference = motion.sine(amplitude=1e-5, frequency=10.0, duration=1999 / RATE, rate=RATE)
    logs = truth_logs(drives, gains, reference, loads, [3, 4])
    for k, log in enumerate(logs):
        # the compiler may contract other products and sums: equal to rounding, which may tip the quantiser
        alone = truth_log(drives[k], gains[k], reference, loads[k], [3, 4][k])
        assert np.mean(log.position == alone.position) > 0.9
        assert np.max(np.abs(log.position - alone.position)) < 3e-7
    assert truth_log(drives[0], GAINS, reference, seed=5).position[0] != logs[0].position[0]


def test_what_cannot_be_run_is_refused():
    reference = there_and_back()
    with pytest.raises(ParameterError, match="delay_samples"):
        truth_logs([ASYMMETRIC, DELAYED], GAINS, reference)
    with pytest.raises(ParameterError, match="as many"):
        truth_logs([ASYMMETRIC, ASYMMETRIC], [GAINS], reference)
    with pytest.raises(DivergenceError, match=r"drives \[1\]"):
        truth_logs([PAPER, PAPER], [GAINS, PDGains(1e12, 1e7)], reference)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="only XLA's CPU compiler hoists loops into one kernel")
@pytest.mark.parametrize("lanes", [1, 32])
@pytest.mark.parametrize("drive", [PAPER, DELAYED], ids=["ideal actuator", "delay and limit"])
def test_the_loop_is_one_kernel(drive, lanes):
    machines = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf, (lanes,)), as_arrays((replace(drive, sensor=SCALE), GAINS))
    )
    keys, samples = jax.random.split(jax.random.key(0), lanes), 500
    arguments = (*machines, jnp.zeros(samples), jnp.zeros((lanes, samples)), jnp.zeros(lanes), keys)
    many = jax.vmap(partial(run, rate=4_000.0), in_axes=(0, 0, None, 0, 0, 0))
    assert one_kernel(jax.jit(many).lower(*arguments).compile().as_text())
