"""The cascade with what real loops have: against a loop in NumPy, sample by sample, and against python-control."""

import dataclasses
import re
import tomllib
from pathlib import Path

import control
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

import diffdrive as dd
from diffdrive import motion as motions
from diffdrive.axis_file.drive_file import axis_tables, parse_axis
from diffdrive.controllers import PT1, PT2, Cascade, Feedforward, Notch, Reference, SecondOrder
from diffdrive.errors import DriveFileError, ParameterError
from diffdrive.loop.linearise import OperatingPoint, open_loop
from diffdrive.loop.linearise import response as loop_response
from diffdrive.loop.margins import margins
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.simulate import simulate_loop
from diffdrive.loop.smooth import smooth
from diffdrive.model.friction import stribeck_level
from diffdrive.model.parameters import Actuator, Sampling, Sensor
from diffdrive.model.presets import paper_drive
from diffdrive.model.quantity import Directional
from diffdrive.numerics.arrays import as_arrays
from tests.diffdrive.controllers.test_filters import by_python_control

RATE = 8_000.0  # that of the filters in test_filters.py
PERIOD = 1.0 / RATE
IDEAL = paper_drive(quantised=False)
ROUGH = dataclasses.replace(IDEAL, sensor=Sensor(resolution=1e-7, noise=2e-8))
FEEDFORWARD = Feedforward(mass=120.0, damping=Directional(400.0, 200.0))
MOVE = motions.jerk_limited(
    distance=2e-3, speed=0.01, acceleration=1.0, jerk=100.0, rate=RATE, dwell=0.02, start=12.34564e-6
)
FILTERS = (Notch(700.0, 200.0, 25.0), PT2(1_500.0), PT1(1e-4), SecondOrder(1_100.0, 0.1, 900.0, 0.5))
WHOLE = Cascade(
    kp=120.0, kv=2e4, velocity_feedforward=0.9, feedforward=FEEDFORWARD, velocity_samples=2, reset_time=0.02,
    force_feedforward=0.8, force_limit=900.0, velocity_filter_time=3e-4, reference_filter_time=2e-3,
    reference_delay_samples=3, position_every=4, filters=FILTERS,
)  # fmt: skip
ONE_EACH = {
    "reset time": Cascade(120.0, 2e4, reset_time=0.02),
    "share of the feed-forward": Cascade(120.0, 2e4, feedforward=FEEDFORWARD, force_feedforward=0.6),
    "limit": Cascade(120.0, 2e4, 1e6, force_limit=150.0),
    "filter of the velocity": Cascade(120.0, 2e4, 1e6, velocity_filter_time=5e-4),
    "filter of the set-point": Cascade(120.0, 2e4, 1e6, reference_filter_time=2e-3),
    "delay of the set-point": Cascade(120.0, 2e4, 1e6, reference_delay_samples=5),
    "slower position loop": Cascade(120.0, 2e4, 1e6, position_every=5),
    "one notch": Cascade(120.0, 2e4, 1e6, filters=FILTERS[:1]),
}


def commands_in_numpy(c: Cascade, reference, velocity, acceleration, position):
    """The command of each sample; filters by difference equations with the coefficients of python-control."""
    a = PERIOD / (2.0 * (c.velocity_filter_time or 1.0))
    b = PERIOD / (2.0 * (c.reference_filter_time or 1.0))
    lagged = last_velocity = 0.0
    aimed = last_aim = reference[0]
    integral, held, forces = 0.0, 0.0, []
    for k in range(len(reference)):
        speed = (position[k] - position[max(k - c.velocity_samples, 0)]) * RATE / c.velocity_samples
        if c.velocity_filter_time:  # (1 + 1/2a') y = ...: the bilinear transform of T y' + y = u
            lagged = ((1.0 - a) * lagged + a * (speed + last_velocity)) / (1.0 + a)
            last_velocity, speed = speed, lagged
        aim = reference[max(k - c.reference_delay_samples, 0)]
        if c.reference_filter_time:
            aimed = ((1.0 - b) * aimed + b * (aim + last_aim)) / (1.0 + b)
            last_aim, aim = aim, aimed
        if k % c.position_every == 0:
            held = c.kp * (aim - position[k]) + c.velocity_feedforward * velocity[k]
        error = held - speed
        ki = c.kv / c.reset_time if c.reset_time else c.ki
        further = integral + ki * PERIOD * error
        force = c.kv * error + further
        if c.feedforward is not None:
            damping = 400.0 if velocity[k] >= 0 else 200.0
            share = 1.0 if c.force_feedforward is None else c.force_feedforward
            force += share * (120.0 * acceleration[k] + damping * velocity[k])
        if c.force_limit is None:
            integral = further
        else:
            beyond = abs(force) > c.force_limit and error * force > 0.0
            integral = integral if beyond else further
            force = np.clip(force, -c.force_limit, c.force_limit)
        forces.append(force)
    forces = np.array(forces)
    for one in c.filters:
        found = by_python_control(one)
        forces = lfilter(found.num[0][0], found.den[0][0], forces)
    return forces


@pytest.mark.parametrize("name", [*ONE_EACH, "whole"])
def test_a_run_s_command_is_that_of_a_loop_in_numpy(name):
    controller = ONE_EACH.get(name, WHOLE)
    run = simulate_loop(ROUGH, controller, MOVE, sampling=Sampling(RATE)).require_ok()
    expected = commands_in_numpy(controller, run.reference, run.reference_velocity, MOVE.acceleration, run.position)
    np.testing.assert_allclose(run.command, expected, rtol=0, atol=1e-8 * np.max(np.abs(expected)))
    if name == "limit":
        assert np.max(np.abs(run.command)) == 150.0


def test_a_reset_time_is_an_integral_gain():
    one, other = (
        simulate_loop(ROUGH, c, MOVE, sampling=Sampling(RATE)).command
        for c in (Cascade(120.0, 2e4, reset_time=0.02), Cascade(120.0, 2e4, 1e6))
    )
    np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_the_smooth_variant_may_be_made_inside_a_traced_function():
    """There no number is known, and so none is refused."""
    made = jax.jit(lambda controller: smooth(controller))(as_arrays(WHOLE))
    assert float(made.limit_rounding) == pytest.approx(9.0)
    lanes = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (3,)), as_arrays(WHOLE))
    assert jax.vmap(smooth)(lanes).limit_rounding.shape == (3,)
    assert smooth(Cascade(1.0, 1.0)) == Cascade(1.0, 1.0)


def test_what_a_cascade_leaves_out_costs_nothing():
    """Not one operation or number more: what is absent is not there."""
    plain = Cascade(120.0, 2e4, 1e6)
    state = plain.init(jnp.zeros(()))
    assert len(jax.tree.leaves(state)) == 3
    assert len(jax.tree.leaves(as_arrays(plain))) == 4

    def operations(controller):
        def step(state, position):
            reference = Reference(position, position, position)
            return controller.step(state, reference, position, position, PERIOD)

        return len(jax.make_jaxpr(step)(controller.init(jnp.zeros(())), jnp.zeros(())).eqns)

    # the history's start (4), difference (3), set-point (4), PI (6), and the flag
    assert operations(as_arrays(plain)) <= 18
    assert operations(as_arrays(ONE_EACH["one notch"])) > operations(as_arrays(plain))


def test_an_integral_that_is_held_at_the_limit_comes_back_at_once():
    """Pushed beyond its limit for half a second: with windup the table would overshoot as long again."""
    still = motions.from_array(np.arange(8_000) / RATE, np.r_[np.zeros(400), np.full(7_600, 2e-3)])
    limit = 300.0
    held = simulate_loop(IDEAL, Cascade(100.0, 2e4, 2e6, force_limit=limit), still, sampling=Sampling(RATE))
    weak = dataclasses.replace(IDEAL, actuator=Actuator(force_limit=limit))
    wound = simulate_loop(weak, Cascade(100.0, 2e4, 2e6), still, sampling=Sampling(RATE))
    assert np.max(np.abs(held.command)) == limit
    beyond = [np.max(run.table_position) - 2e-3 for run in (held, wound)]
    assert beyond[0] < 0.5 * beyond[1]


def test_of_the_smooth_limit_little_is_felt_inside_it():
    c = dataclasses.replace(ONE_EACH["limit"], force_limit=2_000.0)
    exact, rounded = (simulate_loop(IDEAL, one, MOVE, sampling=Sampling(RATE)).command for one in (c, smooth(c)))
    np.testing.assert_allclose(rounded, exact, rtol=1e-9, atol=1e-9)
    near = dataclasses.replace(c, force_limit=140.0)
    exact, rounded = (simulate_loop(IDEAL, one, MOVE, sampling=Sampling(RATE)).command for one in (near, smooth(near)))
    assert np.max(np.abs(exact)) == 140.0
    assert np.max(np.abs(rounded - exact)) < 0.05 * 140.0


def test_a_set_point_that_waits_for_the_speed_feedforward_takes_its_lag_away():
    """A velocity loop that lags by T follows a ramp without error where the set-point lags by T as well."""
    ramp = motions.jerk_limited(distance=8e-3, speed=0.02, acceleration=1.0, jerk=50.0, rate=RATE, dwell=0.0)
    plain = Cascade(80.0, 2e4, velocity_feedforward=1.0, feedforward=Feedforward.of(IDEAL.plant), reset_time=0.01,
                    velocity_filter_time=1e-3)  # fmt: skip
    errors = [
        simulate_loop(IDEAL, c, ramp, sampling=Sampling(RATE)).rms_error()
        for c in (plain, dataclasses.replace(plain, reference_filter_time=1e-3))
    ]
    assert errors[0] != errors[1]


@pytest.mark.parametrize("every", [2, 5, 40])
def test_a_slow_sinusoid_through_a_held_loop_is_that_of_its_smooth_variant(every):
    """The spectral line of the command at the frequency of the position, which the hold shifts and lowers."""
    exact = Cascade(300.0, 2e4, 1e6, position_every=every)
    n, cycles = 4_000, 30  # the hold's own lines fall elsewhere
    position = 1e-5 * np.cos(2 * np.pi * cycles * np.arange(2 * n) / n)

    def line(controller):
        def body(state, y):
            zero = jnp.zeros(())
            state, command = controller.step(state, Reference(zero, zero, zero), y, zero, PERIOD)
            return state, command.force

        commands = jax.lax.scan(body, controller.init(jnp.asarray(position[0])), jnp.asarray(position))[1]
        return np.fft.fft(np.asarray(commands)[n:])[cycles]

    assert line(smooth(exact)) == pytest.approx(line(exact), rel=1e-9)


# --- the linearised loop ----------------------------------------------------------------------------------------------

LINEAR = Cascade(
    kp=90.0, kv=3e4, velocity_samples=2, reset_time=0.02, force_limit=5_000.0, velocity_filter_time=3e-4,
    reference_filter_time=2e-3, reference_delay_samples=3, position_every=4,
    filters=(Notch(700.0, 200.0, 25.0), PT2(1_500.0), SecondOrder(1_100.0, 0.1, 900.0, 0.5)),
)  # fmt: skip
LATE = Actuator(force_limit=3_000.0, delay_samples=1, delay_fraction=0.4)


def table_by_hand(velocity):
    """The paper's table about a steady motion, [x, v, z]: of its friction see `drive_by_hand` in test_linearise.py."""
    friction = IDEAL.friction
    level = float(stribeck_level(friction, velocity, 0.0))
    gap, slowest = friction.breakaway_gap.positive, friction.stribeck_velocity.positive
    slope = -gap / slowest * np.exp(-velocity / slowest)
    bristle = np.array([0.0, velocity * slope / level, -3.35e7 * velocity / level])
    drag = friction.viscous.positive + IDEAL.plant.damping.positive
    pull = -(np.array([0.0, drag, 3.35e7]) + 4.54e3 * bristle) / 100.0
    return np.array([[0.0, 1.0, 0.0], pull, bristle]), np.array([0.0, 0.01, 0.0])


def current_loop_by_hand(actuator):
    """From request to force, (a, b, c) in continuous time."""
    w, damping = 2 * np.pi * actuator.current_loop_frequency, actuator.current_loop_damping
    if damping is None:
        return np.array([[-w]]), np.array([w]), np.array([1.0])
    return np.array([[0.0, 1.0], [-(w**2), -2 * damping * w]]), np.array([0.0, w**2]), np.array([1.0, 0.0])


def switched(a, b, c, share, z):
    """c x at the end of each period, of requests that arrive a share of it late; by matrix exponentials."""
    n = len(b)
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n] = a, b
    late, rest = expm(whole * share * PERIOD), expm(whole * (1.0 - share) * PERIOD)
    ahead, before, now = rest[:n, :n] @ late[:n, :n], rest[:n, :n] @ late[:n, n], rest[:n, n]
    return np.array([c @ np.linalg.solve(one * np.eye(n) - ahead, before / one + now) for one in z])


def machine_by_hand(actuator, velocity, z, *, mean):
    """From request to position, per period; the force held at its mean over each period, or as it is within it."""
    share = actuator.delay_fraction or 0.0
    table, push = table_by_hand(velocity)
    if actuator.current_loop_frequency is None:
        if not mean:
            return switched(table, push, np.eye(3)[0], share, z)
        force = share / z + (1.0 - share)
    else:
        a, b, c = current_loop_by_hand(actuator)
        n = len(b)
        if not mean:
            both = np.block([[table, np.outer(push, c)], [np.zeros((n, 3)), a]])
            return switched(both, np.r_[np.zeros(3), b], np.eye(3 + n)[0], share, z)
        # of its integral the increase over a period, per period
        with_integral = np.block([[a, np.zeros((n, 1))], [c[None], np.zeros((1, 1))]])
        force = switched(with_integral, np.r_[b, 0.0], np.eye(n + 1)[n], share, z) * (z - 1.0) / PERIOD
    return switched(table, push, np.eye(3)[0], 0.0, z) * force


def law_by_hand(c, z):
    """From position to force command, by python-control where there are filters."""
    speed = (1.0 - z**-c.velocity_samples) * RATE / c.velocity_samples
    speed = speed * by_python_control(PT1(c.velocity_filter_time))(z)
    hold = sum(z**-k for k in range(c.position_every)) / c.position_every
    pi = c.kv * (1.0 + PERIOD / c.reset_time * z / (z - 1.0))
    for one in c.filters:
        pi = pi * by_python_control(one)(z)
    return (c.kp * hold + speed) * pi


@pytest.mark.long
@pytest.mark.parametrize(
    "actuator",
    [
        LATE,
        dataclasses.replace(LATE, current_loop_frequency=900.0),
        dataclasses.replace(LATE, current_loop_frequency=1_200.0, current_loop_damping=0.7),
    ],
    ids=["delay", "current loop of first order", "of second order"],
)
def test_margins_and_response_with_filters_are_those_of_python_control(actuator):
    axis = dd.Axis(dataclasses.replace(IDEAL, actuator=actuator), LINEAR, Sampling(RATE, 32))
    loop = dd.linearise(axis, velocity=0.01)
    frequency = np.geomspace(2.0, 3_900.0, 4_000)
    z = np.exp(2j * np.pi * frequency * PERIOD)
    around = law_by_hand(LINEAR, z) * z**-actuator.delay_samples
    expected = around * machine_by_hand(actuator, 0.01, z, mean=True)
    got = np.asarray(loop.response(frequency))
    np.testing.assert_allclose(got[frequency < 2_000.0], expected[frequency < 2_000.0], rtol=1e-3)
    # what the mean leaves out of a force that changes within a period
    exact = around * machine_by_hand(actuator, 0.01, z, mean=False)
    bound = 1e-3 + (2 * np.pi * frequency / RATE) ** 2 / 8.0
    assert np.all((np.abs(got / exact - 1.0) < bound)[frequency < 1_000.0])
    gain, phase, distance, *_ = control.stability_margins(
        control.FRD(expected, 2 * np.pi * frequency, smooth=True), returnall=True
    )
    found = loop.margins()
    assert bool(found.stable)
    assert float(found.gain_margin_up) == pytest.approx(20.0 * np.log10(np.min(gain[gain > 1.0])), rel=1e-3)
    assert float(found.phase_margin) == pytest.approx(np.min(np.abs(phase)), rel=1e-3)
    assert float(found.peak_sensitivity) == pytest.approx(1.0 / np.min(distance), rel=1e-3)


def test_a_set_point_s_filter_is_not_in_the_loop():
    drive, sampling = as_arrays(smooth(IDEAL)), Sampling(RATE)
    plain = Cascade(90.0, 3e4, reset_time=0.02)
    loops = [
        open_loop(drive, as_arrays(smooth(c)), sampling, OperatingPoint(0.01, 0.0))
        for c in (plain, dataclasses.replace(plain, reference_filter_time=5e-3, reference_delay_samples=7))
    ]
    assert loops[0].a.shape == loops[1].a.shape
    np.testing.assert_allclose(loops[1].closed_loop, loops[0].closed_loop, rtol=1e-9, atol=1e-12)


@pytest.mark.long
def test_derivatives_of_margin_and_error_by_every_gain_and_filter_are_those_of_differences():
    axis = dd.Axis(smooth(IDEAL), smooth(LINEAR), Sampling(RATE, 2))
    gains = {name: jnp.asarray(value) for name, value in axis.gains.items()}
    inputs = loop_inputs(MOVE, np.zeros(len(MOVE.time)))

    @jax.jit
    def worth(gains):
        controller = as_arrays(axis.with_gains(**gains).controller)
        drive = as_arrays(axis.drive)
        loop = open_loop(drive, controller, axis.sampling, OperatingPoint(0.01, 0.0))
        frames = rollout_loop(drive, controller, inputs, axis.sampling)
        error = 1e6 * jnp.sqrt(jnp.mean((inputs.reference.position - frames.table_position) ** 2))
        return jnp.array([margins(loop).phase, jnp.abs(loop_response(loop, jnp.array([300.0])).loop[0]), error])

    slopes = jax.jit(jax.jacfwd(worth))(gains)
    sizes = np.max([np.abs(slope * gains[name]) for name, slope in slopes.items()], axis=0)
    for name, value in gains.items():
        up, down = (np.asarray(worth(gains | {name: factor * value})) for factor in (1.0 + 1e-5, 1.0 - 1e-5))
        np.testing.assert_allclose(slopes[name] * value, (up - down) / 2e-5, rtol=1e-5, atol=1e-5 * np.max(sizes))


# --- files ------------------------------------------------------------------------------------------------------------


def tables_with(**keys):
    tables = axis_tables(dd.paper_axis(controller="cascade"))
    tables["controller"] = {"kind": "cascade", "kp": 50.0, "kv": 2e4} | keys
    return tables


def test_what_is_stated_in_the_terms_of_manufacturers_is_read_in_si():
    axis = parse_axis(
        tables_with(
            kp="3 m/min/mm", reset_time="10 ms", velocity_filter_time="0.2 ms", force_limit="1.5 kN",
            filters=[{"kind": "notch", "frequency": "0.8 kHz", "width": "150 Hz", "depth": "30 dB"},
                     {"kind": "pt1", "time": "100 us"}],
        )
    )  # fmt: skip
    expected = Cascade(
        kp=50.0, kv=2e4, reset_time=0.01, velocity_filter_time=2e-4, force_limit=1_500.0,
        filters=(Notch(800.0, 150.0, 30.0), PT1(1e-4)),
    )  # fmt: skip
    assert jax.tree.structure(axis.controller) == jax.tree.structure(expected)
    np.testing.assert_allclose(jax.tree.leaves(axis.controller), jax.tree.leaves(expected), rtol=1e-12)


def test_the_example_of_the_page_on_cncs_is_read():
    page = Path(__file__).parents[3] / "docs" / "how-to" / "state-a-cnc-controller.md"
    stated = tomllib.loads(re.search(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)[1])
    axis = parse_axis(axis_tables(dd.paper_axis(controller="cascade")) | stated)
    assert axis.rate == 8_000.0
    assert axis.drive.actuator == Actuator(delay_fraction=0.5, current_loop_frequency=900.0, current_loop_damping=0.8)
    assert float(axis.controller.kp) == pytest.approx(50.0)
    assert axis.controller.filters == (Notch(640.0, 200.0, 30.0), PT2(1_999.0, 0.7))
    assert (axis.controller.position_every, axis.controller.reset_time) == (8, 0.01)


@pytest.mark.parametrize("name", [*ONE_EACH, "whole"])
def test_a_cascade_is_written_and_read_back(name):
    controller = ONE_EACH.get(name, WHOLE)
    axis = dd.Axis(IDEAL, controller.with_model(IDEAL), Sampling(RATE))
    read = parse_axis(axis_tables(axis))
    assert bool(eqx.tree_equal(read.controller, axis.controller))


@pytest.mark.parametrize("name", ["feedforward", "velocity_samples", "kp", "kv", "ki", "velocity_feedforward"])
def test_a_plain_cascade_s_table_has_no_further_keys(name):
    assert name in Cascade(50.0, 2e4).table()
    assert len(Cascade(50.0, 2e4).table()) == 6


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"ki": 1e6, "reset_time": 0.01}, r"reset_time: stands in the place of ki: give either, not both"),
        ({"reset_time": 0.0}, r"controller\.reset_time must be above 0 s"),
        ({"force_feedforward": 0.5}, r"force_feedforward: is a share of the feed-forward of inertia and damping"),
        ({"position_every": 0}, r"\[controller\] position_every: must be a whole number of at least 1, got 0"),
        ({"position_every": 2.0}, r"\[controller\] position_every: must be a whole number"),
        ({"reference_delay_samples": -1}, r"\[controller\] reference_delay_samples: must be a whole number of at"),
        ({"filters": {"kind": "pt1"}}, r"\[controller\] filters: must be an array of tables, \[\[controller"),
        ({"filters": [3]}, r"\[controller\.filters\.1\] must be a table, got 3"),
        ({"filters": [{"time": 1e-3}]}, r"\[controller\.filters\.1\] kind: is missing"),
        ({"filters": [{"kind": "lead"}]}, r"\[controller\.filters\.1\] kind: unknown filter 'lead'; known: pt1, pt2"),
        ({"filters": [{"kind": "pt1", "time": 1e-3}, {"kind": "pt1"}]}, r"\[controller\.filters\.2\] time: is missing"),
        (
            {"filters": [{"kind": "notch", "frequency": 800.0, "width": 50.0, "dept": 20.0}]},
            r"\[controller\.filters\.1\] dept: unknown key; did you mean 'depth'\?",
        ),
        (
            {"filters": [{"kind": "notch", "frequency": 6_000.0, "width": 50.0}]},
            r"controller\.filters\.1\.frequency: 6000 Hz is not below half the control rate of 10000 Hz",
        ),
        ({"filters": [{"kind": "pt2", "frequency": "1 ms"}]}, r"\[controller\.filters\.1\] frequency: '1 ms' has the"),
    ],
)  # fmt: skip
def test_what_no_cascade_can_be_is_refused(keys, says):
    with pytest.raises(DriveFileError, match=says):
        parse_axis(tables_with(**keys))


def test_a_filter_above_half_the_rate_is_refused_wherever_it_is_used():
    axis = dd.Axis(IDEAL, Cascade(50.0, 2e4, filters=(Notch(3_000.0, 100.0),)), Sampling(5_000.0))
    move = motions.sine(amplitude=1e-4, frequency=5.0, duration=0.1, rate=5_000.0)
    for use in (lambda: dd.simulate(axis, move), lambda: dd.linearise(axis, velocity=0.01)):
        with pytest.raises(ParameterError, match=r"controller\.filters\.1\.frequency: 3000 Hz is not below half"):
            use()


def test_gains_are_those_that_are_stated():
    axis = dd.Axis(IDEAL, WHOLE, Sampling(RATE))
    assert {"kp", "kv", "reset_time", "filter1_frequency", "filter1_depth", "filter3_time"} <= axis.gains.keys()
    assert "ki" not in axis.gains
    moved = axis.with_gains(filter1_frequency=650.0, reset_time=0.03).controller
    assert (moved.filters[0].frequency, moved.reset_time, moved.filters[1:]) == (650.0, 0.03, FILTERS[1:])
    assert "filter1_depth" not in dd.Axis(IDEAL, Cascade(50.0, 2e4, filters=(Notch(99.0, 9.0),)), Sampling(RATE)).gains
    with pytest.raises(ParameterError, match=re.escape("filter1_frequence: no such gain")):
        axis.with_gains(filter1_frequence=1.0)
