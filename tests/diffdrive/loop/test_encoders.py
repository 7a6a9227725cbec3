"""Two encoders: what lies between motor and table shows on the right one, and a loop uses the one that it names."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import diffdrive as dd
from diffdrive.axis_file.drive_file import axis_tables, parse_axis
from diffdrive.controllers import Cascade, Command, Controller
from diffdrive.errors import DriveFileError, ParameterError
from diffdrive.logs.checks.examine import examine
from diffdrive.loop.linearise import OperatingPoint, open_loop, response
from diffdrive.loop.rollout import compiled_rollout, loop_inputs, rollout_loop
from diffdrive.loop.step import Inputs
from diffdrive.model.parameters import Friction, Plant, Sampling, Sensor
from diffdrive.numerics.arrays import as_arrays

MASS, SHARE, FREQUENCY = 100.0, 0.4, 150.0
STIFFNESS = SHARE * (1.0 - SHARE) * MASS * (2.0 * np.pi * FREQUENCY) ** 2
AXIS = dd.paper_axis("cascade", quantised=False)
EXACT = Sensor()
SAMPLING = Sampling(2000.0)


class ConstantForce(Controller):
    """Always the same force (N)."""

    force: float

    def init(self, position):
        return position

    def step(self, state, reference, position, applied, period):
        return state, Command(self.force + 0.0 * position)


def two_encoders(drive, *effects, motor_encoder=EXACT, **changes):
    return dataclasses.replace(drive, effects=effects, motor_encoder=motor_encoder, **changes)


def at_rest(drive, force, disturbance=None, seconds=0.3, key=None, position=0.0):
    """The frames of a table that a constant force of the motor pushes, and a disturbance (N) holds."""
    n = round(seconds * SAMPLING.rate)
    zero, held = jnp.zeros(n), jnp.full(n, -force if disturbance is None else disturbance)
    inputs = Inputs(dd.controllers.Reference(zero + position, zero, zero), zero, held)
    return compiled_rollout(*as_arrays((drive, ConstantForce(force))), inputs, SAMPLING, key)


def screw(kind=dd.effects.Compliance, **more):
    return kind(frequency=FREQUENCY, damping=0.3, motor_share=SHARE, table_friction=1.0, **more)


@pytest.mark.parametrize("force", [40.0, -25.0])
@pytest.mark.parametrize("gap", [None, 3e-5])
def test_a_motor_under_a_constant_force_is_ahead_of_the_table_by_wind_up_and_half_the_gap(force, gap):
    effect = screw() if gap is None else screw(dd.effects.Backlash, gap=gap)
    frames = at_rest(two_encoders(AXIS.drive, effect), force)
    ahead = force / STIFFNESS + (0.0 if gap is None else 0.5 * gap * np.sign(force))
    assert float(frames.motor_position[0] - frames.measured[0]) == 0.0
    assert float(frames.motor_position[-1] - frames.measured[-1]) == pytest.approx(ahead, rel=1e-6)


def test_the_motor_of_a_stiff_axis_is_where_the_table_is():
    frames = at_rest(two_encoders(AXIS.drive), 200.0, disturbance=0.0)
    assert np.ptp(frames.measured) > 1e-3
    np.testing.assert_array_equal(frames.motor_position, frames.measured)


def test_the_wind_up_of_a_motor_encoder_has_its_derivative():
    def ahead(frequency):
        effect = dataclasses.replace(screw(), frequency=frequency)
        frames = at_rest(two_encoders(AXIS.drive, effect), 40.0)
        return frames.motor_position[-1] - frames.measured[-1]

    slope = jax.jit(jax.jacfwd(ahead))(FREQUENCY)
    assert float(slope) == pytest.approx(-2.0 * 40.0 / STIFFNESS / FREQUENCY, rel=1e-4)


LEAD = dd.effects.LeadError(lead=4e-3, cosine=2e-6, sine=-1e-6, linear=3e-5)
LINES = dd.effects.InterpolationError(period=2e-5, cosine=1e-7)


@pytest.mark.parametrize("position", [0.0, 1.23e-3, -0.02])
def test_pitch_errors_show_on_the_motor_encoder_and_errors_of_the_scale_on_the_scale(position):
    still = partial(at_rest, force=0.0, seconds=0.01, position=position)
    frames = still(two_encoders(AXIS.drive, LEAD, LINES))
    assert float(frames.motor_position[0] - position) == pytest.approx(float(LEAD.error(position)), abs=1e-15)
    assert float(frames.measured[0] - position) == pytest.approx(float(LINES.error(position)), abs=1e-15)
    alone = still(two_encoders(AXIS.drive, LEAD, LINES, motor_encoder=None))
    assert alone.motor_position is None
    both = float(LEAD.error(position) + LINES.error(position))
    assert float(alone.measured[0] - position) == pytest.approx(both, abs=1e-15)


def test_each_encoder_has_its_own_steps_and_its_own_noise():
    scale, motor = Sensor(resolution=1e-7, noise=2e-7), Sensor(resolution=1e-9, noise=5e-9)
    drive = two_encoders(AXIS.drive, sensor=scale, motor_encoder=motor)
    still = partial(at_rest, force=0.0, seconds=2.0, key=jax.random.key(3))
    frames, alone = still(drive), still(dataclasses.replace(drive, motor_encoder=None))
    np.testing.assert_array_equal(frames.measured, alone.measured)  # one encoder more changes nothing of the other
    for signal, encoder in ((frames.measured, scale), (frames.motor_position, motor)):
        steps = np.asarray(signal) / encoder.resolution
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    noise = drive.sensor.noise**2 + drive.sensor.resolution**2 / 12.0
    assert float(np.std(frames.measured)) == pytest.approx(np.sqrt(noise), rel=0.05)
    assert float(np.std(frames.motor_position)) == pytest.approx(5e-9, rel=0.05)
    assert abs(np.corrcoef(frames.measured, frames.motor_position)[0, 1]) < 4.0 / np.sqrt(len(frames.measured))


def test_noise_of_the_motor_encoder_alone_is_noise():
    axis = AXIS.with_drive(two_encoders(AXIS.drive, motor_encoder=Sensor(noise=1e-8)))
    assert axis.drive.has_noise
    assert not AXIS.drive.has_noise
    lap = dd.motion.sine(amplitude=1e-4, frequency=10.0, duration=0.05, rate=axis.rate)
    first, second, none = (dd.simulate(axis, lap, seed=seed) for seed in (0, 1, None))
    np.testing.assert_array_equal(first.measured, none.measured)  # the loop is closed over the scale
    np.testing.assert_array_equal(none.motor_position, none.measured)
    assert not np.array_equal(first.motor_position, second.motor_position)


FEEDBACK = [(position, velocity) for position in ("scale", "motor") for velocity in ("scale", "motor")]


def fed_back(axis, position, velocity):
    controller = dataclasses.replace(axis.controller, position_feedback=position, velocity_feedback=velocity)
    return axis.with_controller(controller)


@pytest.mark.parametrize(("position", "velocity"), FEEDBACK)
def test_the_cascade_computes_its_command_from_the_encoders_that_it_names(position, velocity):
    lap = dd.motion.sine(amplitude=3e-4, frequency=5.0, duration=0.2, rate=AXIS.rate)
    gains = Cascade(kp=50.0, kv=1e4, ki=1e5, velocity_feedforward=0.8, velocity_samples=2)
    drive = two_encoders(AXIS.drive, screw(), LEAD)
    axis = fed_back(AXIS.with_drive(drive).with_controller(gains), position, velocity)
    run = dd.simulate(axis, lap).require_ok()
    encoders = {"scale": run.measured, "motor": run.motor_position}
    differenced = np.concatenate([np.full(2, encoders[velocity][0]), encoders[velocity]])
    speed = (differenced[2:] - differenced[:-2]) * axis.rate / 2
    missing = 50.0 * (run.reference - encoders[position]) + 0.8 * run.reference_velocity - speed
    expected = 1e4 * missing + 1e5 * np.cumsum(missing) / axis.rate
    np.testing.assert_allclose(run.command, expected, rtol=1e-6, atol=1e-6 * np.ptp(expected))


def test_feedback_from_an_encoder_that_is_not_there_is_refused():
    lap = dd.motion.sine(amplitude=1e-4, frequency=10.0, duration=0.01, rate=AXIS.rate)
    with pytest.raises(ParameterError, match="feeds back the motor encoder, and the drive has no motor_encoder"):
        dd.simulate(fed_back(AXIS, "scale", "motor"), lap)
    with pytest.raises(ParameterError, match='position_feedback must be "scale" or "motor", got \'resolver\''):
        fed_back(AXIS, "resolver", "scale")


def frictionless(frequency, damping):
    """Two masses with an elastic screw, and next to no friction."""
    friction = Friction(1e-6, 0.0, 0.0, 0.0, 1e-3, 0.0, 1e-3, 0.0)
    effect = dd.effects.Compliance(frequency=frequency, damping=damping, motor_share=SHARE)
    return two_encoders(AXIS.drive, effect, plant=Plant(MASS, 0.0), friction=friction)


@pytest.mark.long
@pytest.mark.parametrize(("position", "velocity"), FEEDBACK[1:])
def test_a_linearised_two_mass_drive_is_the_one_of_the_textbook(position, velocity):
    frequency, damping, kp, kv, ki = 180.0, 0.04, 40.0, 2e4, 3e5
    drive = frictionless(frequency, damping)
    controller = Cascade(kp, kv, ki, 1.0, position_feedback=position, velocity_feedback=velocity)
    sampling = Sampling(4000.0)
    built = open_loop(*as_arrays((drive, controller)), sampling, as_arrays(OperatingPoint(0.01, 0.0)))
    tested = np.geomspace(2.0, 1500.0, 200)
    found = np.asarray(response(built, tested).loop)

    motor, table, reduced = SHARE * MASS, (1 - SHARE) * MASS, SHARE * (1 - SHARE) * MASS
    stiffness, damper = reduced * (2 * np.pi * frequency) ** 2, 2 * damping * reduced * 2 * np.pi * frequency
    a = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-stiffness / motor, -damper / motor, stiffness / motor, damper / motor],
            [0.0, 0.0, 0.0, 1.0],
            [stiffness / table, damper / table, -stiffness / table, -damper / table],
        ]
    )
    b = np.array([0.0, 1.0 / motor, 0.0, 0.0])
    held = expm(np.block([[a, b[:, None]], [np.zeros((1, 5))]]) * sampling.period)
    z = np.exp(2j * np.pi * tested * sampling.period)
    states = np.array([np.linalg.solve(one * np.eye(4) - held[:4, :4], held[:4, 4]) for one in z])
    reading = {"motor": states[:, 0], "scale": states[:, 2]}
    missing = kp * reading[position] + (1 - 1 / z) * sampling.rate * reading[velocity]
    expected = (kv + ki * sampling.period * z / (z - 1)) * missing
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=2e-3 * np.max(np.abs(expected)))


@pytest.mark.long
def test_the_zero_of_a_loaded_motor_has_no_part_in_a_small_motion():
    """Friction winds the screw up by micrometres, which a velocity of their difference would take for a shock."""
    drive = two_encoders(AXIS.drive, screw(dd.effects.Backlash, gap=5e-5))
    axis = dataclasses.replace(fed_back(AXIS.with_drive(drive), "motor", "motor"), sampling=SAMPLING)
    limited = axis.replace({"actuator.force_limit": 500.0})
    growth = [float(dd.linearise(one, velocity=0.01).margins().growth) for one in (axis, limited)]
    assert growth[0] == pytest.approx(growth[1], rel=1e-6)


@pytest.mark.long
def test_lost_motion_of_a_simulated_backlash_is_found_from_the_two_encoders():
    gap = 4e-5
    effect = dd.effects.Backlash(gap=gap, frequency=400.0)
    drive = two_encoders(AXIS.drive, effect, sensor=Sensor(1e-7, 2e-8), motor_encoder=Sensor(1e-8, 5e-9))
    axis = fed_back(AXIS.with_drive(drive), "motor", "motor")
    laps = dd.motion.triangular(stroke=0.02, speed=0.05, rounding=0.02, duration=3.4, rate=axis.rate)
    log = dd.simulate(axis, laps).require_ok().log("lap")
    found = dd.compare_encoders(log, axis)
    resists = drive.friction.breakaway_at(0.0).positive + 0.05 * (drive.friction.viscous + drive.plant.damping).positive
    wind_up = 2.0 * float(resists) / (MASS * SHARE * (1.0 - SHARE) * (2.0 * np.pi * 400.0) ** 2)  # at most
    assert gap - 1e-7 < found.reversal_error.value < gap + wind_up
    assert found.backlash.low <= gap <= found.backlash.high
    assert any(finding.cause == "lost motion" for finding in examine(log, axis))


def test_both_encoders_are_written_and_read_back(tmp_path):
    axis = fed_back(AXIS.with_drive(two_encoders(AXIS.drive, motor_encoder=Sensor(1e-8, 2e-9))), "scale", "motor")
    axis.write(tmp_path / "drive.toml")
    read = dd.read_axis(tmp_path / "drive.toml")
    assert read.drive.motor_encoder == axis.drive.motor_encoder
    assert read.controller == axis.controller
    assert read.value("motor_encoder.resolution") == 1e-8
    assert "motor_encoder" not in axis_tables(AXIS)
    assert "position_feedback" not in axis_tables(AXIS)["controller"]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"motor_encoder": None}, r"\[controller\] velocity_feedback: is \"motor\", .* no table \[motor_encoder\]"),
        ({"motor_encoder": {"steps": 1}}, r"\[motor_encoder\] steps: unknown key"),
        ({"motor_encoder": {"resolution": 0.1}}, r"\[motor_encoder\] resolution: .*coarser than a hundredth"),
        ({"motor_encoder": {"noise": -1e-9}}, r"motor_encoder.noise must be at least 0 m"),
        ({"controller": {"position_feedback": "resolver"}}, r"position_feedback: must be \"scale\" or \"motor\""),
    ],
)
def test_a_file_whose_encoders_do_not_fit_is_refused(changes, says):
    axis = fed_back(AXIS.with_drive(two_encoders(AXIS.drive)), "scale", "motor")
    tables = axis_tables(axis)
    for name, table in changes.items():
        if table is None:
            del tables[name]
        else:
            tables[name] = tables[name] | table
    with pytest.raises(DriveFileError, match=says):
        parse_axis(tables)


def test_an_empty_table_is_an_encoder_without_steps():
    assert parse_axis(axis_tables(AXIS) | {"motor_encoder": {}}).drive.motor_encoder == Sensor()


def test_one_encoder_costs_nothing():
    """The loop of a drive without a motor encoder is the same program, whatever the effects between motor and table."""
    lap = dd.motion.sine(amplitude=1e-4, frequency=10.0, duration=0.01, rate=AXIS.rate)
    inputs = loop_inputs(lap, np.zeros(len(lap.time)))
    drive, controller = as_arrays((AXIS.drive, AXIS.controller))
    outputs = jax.eval_shape(lambda: rollout_loop(drive, controller, inputs, AXIS.sampling))
    assert outputs.motor_position is None
