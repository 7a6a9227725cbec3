"""The catalogue in the simulator: nothing at the neutral value, derivatives, drive files."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.axis_file.drive_file import axis_tables, parse_axis
from diffdrive.effects.actuator import ActuatorLag, ForceGain, ForceLimit, LoopDelay
from diffdrive.effects.base import Seen, TableForce
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.effects.forces import Cogging, ConstantForce, FrameVibration, PositionSpring, ProcessForce
from diffdrive.effects.friction import AppliedLoad, FrictionDwell, PositionFriction, PreslidingHysteresis, ViscousDrift
from diffdrive.effects.machine import FrictionAsymmetry, FrictionShape, PayloadMass
from diffdrive.effects.scale import InterpolationError, LeadError
from diffdrive.effects.transmission import Backlash, Compliance
from diffdrive.errors import DriveFileError, ParameterError
from diffdrive.logs import Log
from diffdrive.loop.rollout import compiled_rollout, loop_inputs, rollout_loop
from diffdrive.loop.simulate import simulate_loop
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Sampling, check_drive
from diffdrive.model.quantity import quantity
from diffdrive.motion.builders import triangular
from diffdrive.numerics.arrays import as_arrays
from diffdrive.paper import paper_axis
from tests.support.driven_effects import CONTROLLER, DRIVE, RATE, SAMPLING, with_effects
from tuning.identification.setup import build_problem

MOTION = triangular(speed=0.010, stroke=0.0014, rounding=0.02, duration=0.4, rate=RATE, first_reversal=0.15)
INPUTS = loop_inputs(MOTION, 2_000.0 * np.ones(len(MOTION.time)))

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


@pytest.mark.long
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
