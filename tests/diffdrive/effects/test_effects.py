"""The catalogue in the simulator: nothing at the neutral value, known solutions, derivatives, drive files."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

from diffdrive.axis_file.drive_file import axis_tables, parse_axis
from diffdrive.controllers import PD
from diffdrive.controllers.base import PDGains, Tracking
from diffdrive.effects import stages
from diffdrive.effects.actuator import ActuatorLag, ForceGain, ForceLimit, LoopDelay
from diffdrive.effects.base import Seen, TableForce
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.effects.forces import Cogging, ConstantForce, FrameVibration, PositionSpring, ProcessForce, window
from diffdrive.effects.friction import AppliedLoad, FrictionDwell, PositionFriction, PreslidingHysteresis, ViscousDrift
from diffdrive.effects.machine import FrictionAsymmetry, FrictionShape, PayloadMass
from diffdrive.effects.oscillator import Oscillator, discretise
from diffdrive.effects.scale import InterpolationError, LeadError
from diffdrive.effects.transmission import Backlash, Compliance
from diffdrive.errors import DriveFileError, ParameterError
from diffdrive.logs import Log
from diffdrive.loop.linearise import OperatingPoint, open_loop, response
from diffdrive.loop.rollout import compiled_rollout, loop_inputs, rollout_loop
from diffdrive.loop.simulate import simulate_loop
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Sampling, Sensor, check_drive
from diffdrive.model.plant import advance, at_rest
from diffdrive.model.presets import paper_drive
from diffdrive.model.quantity import quantity
from diffdrive.motion.builders import triangular
from diffdrive.numerics.arrays import as_arrays
from diffdrive.paper import paper_axis
from tuning.identification.setup import build_problem

RATE = 2_000.0
SAMPLING = Sampling(rate=RATE)
CONTROLLER = PD(Tracking(PDGains(1.0e6, 6_000.0)))
MOTION = triangular(speed=0.010, stroke=0.0014, rounding=0.02, duration=0.4, rate=RATE, first_reversal=0.15)
INPUTS = loop_inputs(MOTION, 2_000.0 * np.ones(len(MOTION.time)))
DRIVE = dataclasses.replace(paper_drive(), sensor=Sensor(None, 0.0))

# values that are plainly there, for derivatives and for drive files
AT_WORK = [
    AppliedLoad(4_000.0, 3_000.0, 0.1, 0.3, 0.03),
    FrictionShape(0.2, 0.4, 0.3, 5.0, 100.0, 500.0),
    FrictionAsymmetry(4.0, 200.0),
    PositionFriction(30.0, 0.0005, 0.001, 0.05, 0.05),
    ViscousDrift(0.3, 0.1, 0.2),
    FrictionDwell(0.3, 0.02, 1e-5),
    PreslidingHysteresis(0.7, 5e-6, 0.3),
    PayloadMass(30.0),
    ConstantForce(8.0),
    PositionSpring(4_000.0, 0.0002),
    Compliance(150.0, 0.05, 0.3, 0.6),
    Backlash(4e-6, 400.0, 0.1, 0.3, 0.6),
    FrameVibration(0.1, 25.0, 0.05),
    ProcessForce(60.0, 2.0, 3.0, 1.0, 0.5, 0.5, 0.1, 0.3),
    Cogging(0.0011, 2.0, 1.0, 0.5, 0.2, 0.3, 0.1),
    ForceGain(0.1),
    ActuatorLag(8e-4),
    LoopDelay(1.3),
    ForceLimit(90.0),
    LeadError(0.005, 2e-6, 1e-6, 1e-4),
    InterpolationError(2e-5, 2e-7, 1e-7, 5e-8, 2e-8),
]
IDS = [effect.name for effect in AT_WORK]


def with_effects(*effects, drive=DRIVE):
    return dataclasses.replace(drive, effects=effects)


def frames(drive):
    return compiled_rollout(*as_arrays((drive, CONTROLLER)), INPUTS, SAMPLING)


def test_a_force_of_ones_own_is_that_of_the_periods_midpoint():
    class Spring(TableForce):
        stiffness: float = quantity("N/m", "force per displacement", default=0.0)

        def push(self, seen):
            return -self.stiffness * (seen.position - 0.0002)

    zero = jnp.zeros(())
    seen = Seen(0.1 + zero, 1e-3 + zero, 0.05 + zero, zero, zero, zero, zero)
    ours, built_in = (one.step((), seen, DRIVE, 5e-4)[1] for one in (Spring(4_000.0), PositionSpring(4_000.0, 0.0002)))
    assert ours == built_in
    assert float(ours.force) == pytest.approx(-4_000.0 * (1e-3 + 0.05 * 2.5e-4 - 0.0002))


def test_what_no_machine_has_beside_each_other_is_refused():
    axis = paper_axis()
    for two, says in (
        (
            (Compliance(), Backlash()),
            r"effects\.backlash: a machine has one screw, and effects\.compliance is one, too",
        ),
        ((ConstantForce(1.0), ConstantForce(2.0)), r"effects\.constant_force: stands there twice"),
    ):
        with pytest.raises(ParameterError, match=says):
            axis.with_effects(*two)
        with pytest.raises(ParameterError, match=says):
            check_drive(with_effects(*two))
    with pytest.raises(ParameterError, match="one screw"):
        axis.with_effects(Compliance()).with_effects(Backlash())
    (kept,) = axis.with_effects(ConstantForce(1.0)).with_effects(ConstantForce(2.0)).drive.effects
    assert kept.force == 2.0


def test_every_effect_of_the_catalogue_is_here():
    assert set(IDS) == set(EFFECTS)


@pytest.mark.parametrize("name", EFFECTS)
def test_at_its_neutral_value_an_effect_changes_nothing(name):
    ours, theirs = frames(with_effects(EFFECTS[name]())), frames(DRIVE)
    loose = 2e-9 if name in ("compliance", "backlash") else 1e-15  # their neutral value is a stiffness without end
    np.testing.assert_allclose(ours.table_position, theirs.table_position, rtol=0, atol=loose)


@pytest.mark.parametrize("effect", AT_WORK, ids=IDS)
def test_at_work_it_moves_the_table(effect):
    assert float(jnp.max(jnp.abs(frames(with_effects(effect)).measured - frames(DRIVE).measured))) > 1e-8


@pytest.mark.parametrize("effect", AT_WORK, ids=IDS)
def test_derivatives_are_those_of_differences(effect):
    machine = as_arrays(smooth(with_effects(effect)))
    leaves, tree = jax.tree.flatten(machine.effects)
    values = jnp.stack(leaves)

    def cost(values):
        changed = eqx.tree_at(lambda d: d.effects, machine, jax.tree.unflatten(tree, list(values)))
        frame = rollout_loop(changed, as_arrays(CONTROLLER), INPUTS, Sampling(rate=RATE, substeps=5))
        return jnp.sqrt(jnp.mean((1e6 * (INPUTS.reference.position - frame.measured)) ** 2))

    @jax.jit  # one program for the points and for the derivatives
    def along(points, directions):
        return jax.vmap(lambda point, direction: jax.jvp(cost, (point,), (direction,)))(points, directions)

    units, steps = jnp.eye(len(values)), 1e-5 * jnp.maximum(jnp.abs(values), 1e-6)
    shifts = units * steps[:, None]
    costs, slopes = along(
        jnp.concatenate([values + 0.0 * shifts, values + shifts, values - shifts]), jnp.tile(units, (3, 1))
    )
    (at_point, ahead, behind), slopes = np.split(np.asarray(costs), 3), np.asarray(slopes)[: len(values)]
    for slope, difference, step in zip(slopes, (ahead - behind) / (2 * steps), steps, strict=True):
        assert slope == pytest.approx(float(difference), rel=2e-3, abs=1e-7 * at_point[0] / float(step))


AT_DEFAULT = [EFFECTS[name]() for name in IDS]
WHOLE_DELAYS = [LoopDelay(delay) for delay in (0.0, 1.0, 2.0, 7.0)]
# A gap, however narrow, lets the screw fly for a substep where its force turns; without one it is always in contact.
# The motions differ by 0.1 nm, so differences have no limit. The derivative is that of the screw in contact.
WITHOUT_LIMIT = {("backlash", "gap")}


@pytest.mark.long
@pytest.mark.parametrize("effect", [*AT_DEFAULT, *WHOLE_DELAYS[1:]], ids=[*IDS, *(f"delay {k}" for k in (1, 2, 7))])
def test_derivatives_at_the_default_are_those_of_differences_ahead(effect):
    """Where parameters are at the lower ends of their ranges, derivatives are those towards what the range allows."""
    machine = as_arrays(smooth(with_effects(effect)))
    leaves, tree = jax.tree.flatten(machine.effects)
    values = jnp.stack(leaves)
    fields = [field for field in dataclasses.fields(effect) if getattr(effect, field.name) is not None]
    usual = jnp.asarray([1e-3 if field.metadata["quantity"].unit == "m" else 1.0 for field in fields])
    finite = np.isfinite(np.asarray(values))

    def signal(values):
        changed = eqx.tree_at(lambda d: d.effects, machine, jax.tree.unflatten(tree, list(values)))
        return rollout_loop(changed, as_arrays(CONTROLLER), INPUTS, Sampling(rate=RATE, substeps=5)).measured

    @jax.jit
    def along(points, directions):
        return jax.vmap(lambda point, direction: jax.jvp(signal, (point,), (direction,)))(points, directions)

    units, step = jnp.eye(len(values)), 1e-6
    shifts = units * (step * jnp.where(finite & (values != 0.0), jnp.abs(values), usual))[:, None]
    points = jnp.concatenate([values + 0.0 * units, values + shifts, values + 2.0 * shifts])
    points = jnp.where(finite, points, values)
    signals, slopes = along(points, jnp.tile(units, (3, 1)))
    (at_point, once, twice), slopes = np.split(np.asarray(signals), 3), np.asarray(slopes)[: len(values)]
    for k, name in enumerate(field.name for field in fields):
        difference = (2.0 * once[k] - 0.5 * twice[k] - 1.5 * at_point[k]) / float(shifts[k, k])
        rounding = 2e-17 / float(shifts[k, k])  # m, of a position of a millimetre
        size = np.max(np.abs(difference))
        assert np.all(np.isfinite(slopes[k]))
        if (effect.name, name) not in WITHOUT_LIMIT:
            np.testing.assert_allclose(slopes[k], difference, rtol=0, atol=2e-3 * size + rounding, err_msg=name)


@pytest.mark.parametrize("effect", [Compliance, Backlash, FrameVibration])
def test_what_does_not_swing_is_no_oscillator(effect):
    with pytest.raises(ParameterError, match=rf"effects\.{effect.name}\.damping must be below 1"):
        check_drive(with_effects(effect(damping=1.0)))


@pytest.mark.parametrize("damping", [0.0, 0.1, 0.9985, 0.9995, 0.99999])
def test_an_oscillator_is_stepped_exactly(damping):
    push, angular = 3.0, 40.0

    def rates(_, q):
        return [q[1], push - 2 * damping * angular * q[1] - angular**2 * q[0]]

    found = scipy.integrate.solve_ivp(rates, (0, 0.13), [1e-3, -0.2], method="DOP853", rtol=1e-12, atol=1e-15)
    ours = discretise(angular, damping, 0.13).step(Oscillator(1e-3, -0.2), push)
    np.testing.assert_allclose([float(ours.deflection), float(ours.rate)], found.y[:, -1], rtol=1e-9)

    def end(damping):
        after = discretise(angular, damping, 0.13).step(Oscillator(1e-3, -0.2), push)
        return jnp.stack([after.deflection, after.rate])

    slope, step = jax.jvp(end, (damping,), (1.0,))[1], 4e-6
    difference = (end(damping + step) - end(damping - step)) / (2.0 * step)
    np.testing.assert_allclose(slope, difference, rtol=1e-5)
    assert np.all(np.asarray(slope) != 0.0)


def test_a_lag_passes_on_the_mean_of_an_exponential():
    lag, period = ActuatorLag(4e-4), 5e-4
    state, (mean, tilt) = lag.step(10.0, 30.0, period)
    time = np.linspace(0, period, 20_001)
    force = 30.0 - 20.0 * np.exp(-time / 4e-4)
    assert float(state) == pytest.approx(force[-1], rel=1e-9)
    assert float(mean) == pytest.approx(np.trapezoid(force, time) / period, rel=1e-8)
    # the straight line carries a free mass as far as the exponential does
    line = float(mean) + float(tilt) * (time / period - 0.5)
    left = period - time
    assert np.trapezoid(left * line, time) == pytest.approx(np.trapezoid(left * force, time), rel=1e-8)


@pytest.mark.parametrize("delay", [0.0, 0.4, 1.0, 2.7, 8.0])
def test_a_delay_moves_a_ramp(delay):
    one = LoopDelay(delay)
    state, out = one.init(jnp.asarray(0.0)), []
    for k in range(40):
        state, (force, tilt) = one.step(state, jnp.asarray(float(k)), 1e-3)
        out.append(float(force))
        part = delay % 1.0
        if k > 10:  # a step of one newton `part` of the way through the period
            assert float(tilt) == pytest.approx(6.0 * part * (1.0 - part), abs=1e-12)
    np.testing.assert_allclose(out[10:], np.arange(10.0, 40.0) - delay, rtol=1e-12)


def test_the_force_is_scaled_before_it_is_limited_whatever_the_order():
    for effects in ((ForceGain(-0.2), ForceLimit(100.0)), (ForceLimit(100.0), ForceGain(-0.2))):
        states = stages.initial_states(effects, jnp.zeros(()))
        assert stages.actuator_output(effects, states, jnp.asarray(110.0), 1e-3)[1].mean == pytest.approx(88.0)
        assert stages.actuator_output(effects, states, jnp.asarray(200.0), 1e-3)[1].mean == pytest.approx(100.0)


@pytest.mark.parametrize("behind", [LoopDelay(0.5), ActuatorLag(2e-3)])
def test_a_command_is_limited_before_it_is_late_or_lags(behind):
    """Behind them only the mean of a period would be."""
    effects = (behind, ForceLimit(100.0))
    states, (alone,) = stages.initial_states(effects, jnp.zeros(())), stages.initial_states((behind,), jnp.zeros(()))
    found = stages.actuator_output(effects, states, jnp.asarray(1000.0), 1e-3)[1]
    expected = behind.step(alone, jnp.asarray(100.0), 1e-3)[1]
    assert found.mean == pytest.approx(expected.mean)
    assert found.slope == pytest.approx(expected.slope)


@pytest.mark.parametrize(("gain", "own", "most"), [(1.0, None, 50.0), (-0.5, None, 200.0), (-0.5, 150.0, 150.0)])
def test_saturation_is_told_of_the_command(gain, own, most):
    limited = dataclasses.replace(DRIVE, actuator=dataclasses.replace(DRIVE.actuator, force_limit=own))
    drive = dataclasses.replace(limited, effects=(ForceGain(gain), ForceLimit(100.0)))
    assert float(stages.force_limit(drive)) == pytest.approx(most)
    assert stages.force_limit(dataclasses.replace(DRIVE, effects=(ForceGain(gain),))) is None


def test_the_friction_recorded_is_that_which_acts():
    """A force balance: what accelerates the table is the force less damping and the friction recorded."""
    drive = with_effects(PositionFriction(0.0, 0.0, 0.02, 0.3, 0.0))
    fast = triangular(speed=0.1, stroke=0.0375, rounding=0.05, duration=0.4, rate=RATE)
    frame = rollout_loop(*as_arrays((drive, CONTROLLER)), loop_inputs(fast, np.zeros(len(fast.time))), SAMPLING)
    speed, friction = np.asarray(frame.velocity), np.asarray(frame.friction)
    resisting = friction + float(drive.plant.damping.positive) * speed
    halfway = 0.5 * (resisting[1:] + resisting[:-1])
    off = drive.plant.mass * np.diff(speed) * RATE - (np.asarray(frame.force)[:-1] - halfway)
    fastest = speed[:-1] > 0.09
    assert np.std(friction[:-1][fastest]) > 10.0
    assert np.sqrt(np.mean(off[fastest] ** 2)) < 5.0  # that of a machine without the wave is off by 95 N


def test_a_lag_turns_the_loop_as_its_transfer_function_does():
    drive = dataclasses.replace(DRIVE, actuator=dataclasses.replace(DRIVE.actuator, delay_samples=1))
    lag = ActuatorLag(8e-4)
    frequency = np.array([5.0, 30.0, 120.0])
    plain, turned = (
        response(open_loop(*as_arrays((smooth(one), CONTROLLER)), SAMPLING, OperatingPoint(0.01, 0.0)), frequency).loop
        for one in (drive, with_effects(lag, drive=drive))
    )
    z = np.exp(2j * np.pi * frequency / RATE)
    share = 8e-4 * RATE
    fade = np.exp(-1.0 / share)
    c = share * (1.0 - fade)
    np.testing.assert_allclose(turned / plain, (1.0 - c) + c * (1.0 - fade) / (z - fade), rtol=1e-6)


def test_age_grows_at_rest_and_is_forgotten_over_a_slip():
    dwell = FrictionDwell(1.0, 0.1, 1e-5)
    drive, age = as_arrays(DRIVE), jnp.zeros(())
    for velocity, time in ((0.0, 1.0), (1e-3, 0.02)):
        seen = Seen(0.0, 0.0, jnp.asarray(velocity), 0.0, 0.0, 0.0, 0.0)
        for _ in range(round(time / 1e-3)):
            age, acts = dwell.step(age, seen, drive, 1e-3)
        if velocity == 0.0:
            assert float(age) == pytest.approx(1.0)
            gap = float(drive.friction.breakaway_gap.positive)
            assert float(acts.gap) == pytest.approx(gap * np.log(11.0), rel=2e-3)
    # after two slip distances: exp(-2) of it, and the age of steady sliding
    assert float(age) == pytest.approx(0.01 + 0.99 * np.exp(-2.0), rel=1e-6)


def test_maxwell_elements_carry_in_sliding_what_the_bristle_carried():
    """No difference in steady sliding; a closed loop of small strokes is another hysteresis."""
    one, drive = PreslidingHysteresis(1.0, 5e-6, 0.2), as_arrays(DRIVE)
    state = one.init()

    @functools.partial(jax.jit, static_argnums=2)
    def stepped(state, speed, period):
        return one.step(state, Seen(0.0, 0.0, speed, 0.0, 0.0, 0.0, 0.0), drive, period)

    for _ in range(200):
        state, acts = stepped(state, jnp.asarray(0.01), 1e-4)
    assert abs(float(acts.force)) < 1e-3
    state, acts = stepped(state, jnp.asarray(-0.005), 5e-4)
    assert abs(float(acts.force)) > 1.0


def test_a_window_is_one_inside():
    time = np.array([0.0, 1.5, 3.0])
    np.testing.assert_allclose(window(time, 1.0, 2.0), [0.0, 1.0, 0.0], atol=1e-12)


def test_a_ripple_of_the_force_moves_the_motor_within_its_gap():
    """Free between the sides of a wide gap: twice integrated, period by period; a constant ripple is more force."""
    friction = DRIVE.friction
    nearly_none = {
        name: jax.tree.map(lambda value: 1e-9 * value, getattr(friction, name))
        for name in ("coulomb_screw", "load_coefficient", "breakaway_gap", "viscous")
    }
    bare = as_arrays(dataclasses.replace(DRIVE, friction=dataclasses.replace(friction, **nearly_none)))
    effect, period = as_arrays(Backlash(1e-3, 400.0, 0.1, 0.3, 0.6)), 5e-4
    ripple = jnp.asarray([9.0, -4.0, 6.0, -8.0, -3.0])

    def deflected(force, ripple):
        seen = stages.seen_by(bare, 0.0, 0.0, 0.0, 0.0, force, 0.0, 0.0)._replace(ripple=ripple)
        return effect.step(effect.init(), seen, bare, period)[0].relative

    level, rippled = deflected(5.0, None), deflected(5.0, ripple)
    part = period / len(ripple)
    left = part * (len(ripple) - 0.5 - np.arange(len(ripple)))  # s, from the middle of each part to the end
    moved = float(np.sum(ripple * part * left)) / (0.3 * float(bare.plant.mass))
    assert float(rippled.deflection - level.deflection) == pytest.approx(moved, rel=5e-3)  # friction is small, not none
    assert float(rippled.rate) == pytest.approx(float(level.rate), rel=2e-3)
    more = deflected(5.0, jnp.full(5, 2.0))
    assert float(more.deflection) == pytest.approx(float(deflected(7.0, None).deflection), rel=1e-9)


def test_a_vibrating_frame_is_two_bodies():
    """Table and base written out, without friction."""
    friction = DRIVE.friction
    nearly_none = {
        name: jax.tree.map(lambda value: 1e-6 * value, getattr(friction, name))
        for name in ("coulomb_screw", "load_coefficient", "breakaway_gap")
    }
    bare = dataclasses.replace(DRIVE, friction=dataclasses.replace(friction, **nearly_none))
    effect = FrameVibration(0.2, 15.0, 0.05)
    period, w, mass = 1.0 / RATE, 2 * np.pi * 15.0, float(bare.plant.mass)
    drag = float(bare.friction.viscous.positive + bare.plant.damping.positive)
    force = 40.0

    def rates(_, y):
        _, v, xb, vb = y  # table and base against the ground
        net = force - drag * (v - vb)
        return [v, net / mass, vb, -0.2 * net / mass - 2 * 0.05 * w * vb - w**2 * xb]

    found = scipy.integrate.solve_ivp(rates, (0, 0.3), [0, 0, 0, 0], method="DOP853", rtol=1e-10, atol=1e-14)
    machine = as_arrays(dataclasses.replace(bare, effects=(effect,)))

    def body(carry, k):
        table, states = carry
        seen = stages.seen_by(machine, k * period, *table, force, 0.0, 0.0)
        states, acts = stages.table_action(machine.effects, states, seen, machine, period)
        return (advance(machine, table, force + acts.force, 0.0, period, 40), states), None

    begin = (at_rest(0.0), stages.initial_states(machine.effects, 0.0))
    (table, _), _ = jax.lax.scan(body, begin, jnp.arange(round(0.3 * RATE), dtype=float))
    assert float(table.position) == pytest.approx(found.y[0, -1] - found.y[2, -1], rel=2e-3)


@pytest.mark.parametrize("effect", AT_WORK, ids=IDS)
def test_a_drive_file_holds_effects(effect):
    text = {
        "plant": {"mass": 100.0, "damping": 300.0},
        "friction": {
            "coulomb_screw": 60.0, "load_coefficient": 3e-4, "initial_load": 1e4, "breakaway_gap": 20.0,
            "stribeck_velocity": 1e-3, "viscous": 1500.0, "bristle_stiffness": 3e7, "bristle_damping": 4e3,
        },
        "controller": {"kind": "pd", "kp": 1e6, "kd": 6e3},
        "effects": {effect.name: {f.name: getattr(effect, f.name) for f in dataclasses.fields(effect)}},
    }  # fmt: skip
    description = parse_axis(text)
    assert description.drive.effects == (effect,)
    assert parse_axis(axis_tables(description)).drive.effects == (effect,)


def test_a_drive_file_names_what_is_wrong_with_an_effect():
    tables = {name: {} for name in ("plant", "friction", "controller")}
    for effects, says in (
        ({"coging": {}}, r"\[effects\] coging: unknown key; did you mean 'cogging'\?"),
        ({"cogging": {"period": -1.0}}, r"effects.cogging.*period must be above 0"),
        ({"cogging": {"amplitude": 1.0}}, r"amplitude: unknown key"),
        ({"cogging": 3.0}, r"\[effects.cogging\] must be a table"),
    ):
        full = axis_tables(parse_axis(_complete())) | {"effects": effects}
        with pytest.raises(DriveFileError, match=says):
            parse_axis(full | {k: v for k, v in tables.items() if not v and k not in full})


def _complete():
    return {
        "plant": {"mass": 100.0, "damping": 300.0},
        "friction": {
            "coulomb_screw": 60.0, "load_coefficient": 3e-4, "initial_load": 1e4, "breakaway_gap": 20.0,
            "stribeck_velocity": 1e-3, "viscous": 1500.0, "bristle_stiffness": 3e7, "bristle_damping": 4e3,
        },
        "controller": {"kind": "pd", "kp": 1e6, "kd": 6e3},
    }  # fmt: skip


def test_a_parameter_out_of_its_range_is_named():
    with pytest.raises(ParameterError, match=r"effects\.compliance\.motor_share must be above 0"):
        simulate_loop(with_effects(Compliance(150.0, 0.05, -0.3, 0.6)), CONTROLLER, MOTION, sampling=SAMPLING)


def test_identification_refuses_a_drive_with_effects():
    time = np.arange(2000) / RATE
    log = Log("log", time, 1e-3 * np.sin(time), np.zeros(2000))
    with pytest.raises(ParameterError, match=r"does not know the drive file's effects \(constant_force\)"):
        build_problem([log], with_effects(ConstantForce(3.0)), (), {})
