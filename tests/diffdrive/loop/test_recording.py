"""What a trace records, against loops over its rows: when a row is taken, of what, and what its command column is."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffdrive as dd
from diffdrive.axis_file.drive_file import axis_tables, parse_axis
from diffdrive.controllers import Cascade
from diffdrive.errors import DriveFileError, LogError, ParameterError
from diffdrive.loop.run import Run
from diffdrive.model.parameters import Actuator, Sampling, Sensor
from diffdrive.model.trace import Trace, check_trace

RATE, N = 4000.0, 43
PERIOD = 1.0 / RATE
RNG = np.random.default_rng(5)
NAMES = ("reference", "load", "measured", "table_position", "velocity", "command", "force", "friction")
SIGNALS = dict(zip(NAMES, RNG.standard_normal((len(NAMES), N)), strict=True))
MOTOR = RNG.standard_normal(N)
ROLLOUT = dd.Rollout(
    **{name: jnp.asarray(values) for name, values in SIGNALS.items()},
    friction_estimate=None, load_estimate=None, motor_position=jnp.asarray(MOTOR), rate=RATE, start=2.0,
)  # fmt: skip
RUN = Run(
    **SIGNALS, friction_estimate=None, load_estimate=None, motor_position=MOTOR,
    time=2.0 + np.arange(N) * PERIOD, reference_velocity=np.zeros(N),
)  # fmt: skip
COLUMNS = {"reference": "reference", "position": "measured", "command": "command", "load": "load"}


def held(command, time):
    """The value at `time` (s) of a command that is held from one sample to the next."""
    return command[min(max(int(np.floor(time * RATE + 1e-6)), 0), N - 1)]


@pytest.mark.parametrize("signals", [ROLLOUT, RUN], ids=["rollout", "run"])
def test_by_default_every_sample_is_recorded_as_it_is(signals):
    rows = dd.record(signals, Trace())
    for column, name in COLUMNS.items():
        np.testing.assert_array_equal(getattr(rows, column), SIGNALS[name])
    np.testing.assert_array_equal(rows.motor_position, MOTOR)
    np.testing.assert_array_equal(rows.time, signals.sample_times())


@pytest.mark.parametrize("stride", [2, 5, 43])
def test_snapshots_are_of_one_step_and_means_of_the_steps_since_the_row_before(stride):
    snapshots, means = (dd.record(ROLLOUT, Trace(rate=RATE / stride, sample=sample)) for sample in ("snapshot", "mean"))
    first, last = list(range(0, N, stride)), list(range(stride - 1, N, stride))
    np.testing.assert_allclose(snapshots.time, 2.0 + PERIOD * np.array(first), rtol=1e-15)
    np.testing.assert_allclose(means.time, 2.0 + PERIOD * np.array(last), rtol=1e-15)
    for column, signal in {
        **{column: SIGNALS[name] for column, name in COLUMNS.items()},
        "motor_position": MOTOR,
    }.items():
        np.testing.assert_array_equal(getattr(snapshots, column), [signal[k] for k in first])
        expected = [np.mean(signal[k - stride + 1 : k + 1]) for k in last]
        np.testing.assert_allclose(getattr(means, column), expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("steps", [-4, -1, 0, 3, 4])
def test_a_command_of_another_step_is_exactly_the_one_held_then(steps):
    rows = dd.record(ROLLOUT, Trace(rate=RATE / 4, command_offset=steps * PERIOD))
    expected = [held(SIGNALS["command"], (k + steps) * PERIOD) for k in range(0, N, 4)]
    np.testing.assert_allclose(rows.command, expected, rtol=1e-12)
    np.testing.assert_array_equal(rows.position, SIGNALS["measured"][::4])


@pytest.mark.parametrize("sample", ["snapshot", "mean"])
@pytest.mark.parametrize("offset", [-0.9e-3, -0.13e-3, 0.31e-3])
def test_a_command_between_steps_is_the_mean_of_what_is_held(sample, offset):
    rows = dd.record(ROLLOUT, Trace(rate=RATE / 4, sample=sample, command_offset=offset))
    fine = (np.arange(4000) + 0.5) / 4000
    first = 3 if sample == "mean" else 0
    window = (np.arange(-3, 1) if sample == "mean" else np.arange(1))[:, None]
    expected = [
        np.mean(
            [held(SIGNALS["command"], (k + step + part) * PERIOD + offset) for step in window[:, 0] for part in fine]
        )
        for k in range(first, N, 4)
    ]
    np.testing.assert_allclose(rows.command, expected, atol=3e-3)


def test_the_force_that_acts_is_in_the_place_of_the_set_point():
    rows = dd.record(ROLLOUT, Trace(command="force"))
    np.testing.assert_array_equal(rows.command, SIGNALS["force"])


def test_the_position_is_that_of_the_encoder_that_is_traced():
    scale, motor = (dd.record(ROLLOUT, Trace(encoders=which)) for which in ("scale", "motor"))
    assert scale.motor_position is None
    assert motor.motor_position is None
    np.testing.assert_array_equal(scale.position, SIGNALS["measured"])
    np.testing.assert_array_equal(motor.position, MOTOR)


def test_the_noise_of_the_command_column_is_white_and_its_own():
    lanes = dataclasses.replace(ROLLOUT, command=jnp.zeros((200, N)))
    key = jax.random.key(7)
    rows = dd.record(lanes, Trace(command_noise=3.0), key)
    assert float(np.std(rows.command)) == pytest.approx(3.0, rel=0.03)
    assert not np.any(dd.record(lanes, Trace(command_noise=3.0)).command)
    np.testing.assert_array_equal(rows.position, SIGNALS["measured"])
    scale = np.array([jax.random.normal(jax.random.fold_in(key, k)) for k in range(N)])
    assert np.max(np.abs(np.corrcoef(np.vstack([scale, rows.command[:20]]))[0, 1:])) < 0.7


def test_lanes_are_recorded_side_by_side():
    lanes = jax.vmap(lambda gain: dataclasses.replace(ROLLOUT, command=gain * ROLLOUT.command))(jnp.array([1.0, 2.0]))
    trace = Trace(rate=1000.0, sample="mean", command_offset=0.1e-3)
    rows, one = dd.record(lanes, trace), dd.record(ROLLOUT, trace)
    assert rows.command.shape == (2, 10)
    np.testing.assert_allclose(rows.command, [one.command, 2.0 * np.asarray(one.command)], rtol=1e-14)


@pytest.mark.parametrize("sample", ["snapshot", "mean"])
def test_what_is_recorded_has_its_derivatives(sample):
    def cost(offset, noise, command):
        trace = Trace(rate=1000.0, sample=sample, command_offset=offset, command_noise=noise)
        rows = dd.record(dataclasses.replace(ROLLOUT, command=command), trace, jax.random.key(0))
        return jnp.sum(jnp.sin(rows.command))

    at = (0.13e-3, 0.7, ROLLOUT.command)
    by_offset, by_noise, by_command = jax.jit(jax.grad(cost, argnums=(0, 1, 2)))(*at)
    for k, (slope, step) in enumerate(((by_offset, 1e-8), (by_noise, 1e-6), (by_command[17], 1e-6))):
        bump = jnp.eye(N)[17] if k == 2 else 1.0
        above, below = (cost(*at[:k], at[k] + sign * step * bump, *at[k + 1 :]) for sign in (1.0, -1.0))
        assert float(slope) == pytest.approx(float(above - below) / (2 * step), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("sample", "median", 'trace.sample must be "snapshot" or "mean", got \'median\''),
        ("command", "current", 'trace.command must be "set-point" or "force"'),
        ("encoders", "both", 'trace.encoders must be "all" or "scale" or "motor"'),
        ("rate", -1.0, "trace.rate must be a positive number in Hz, got -1"),
        ("rate", "fast", "trace.rate must be a positive number in Hz"),
    ],
)
def test_a_trace_that_no_control_has_is_refused(field, value, says):
    with pytest.raises(ParameterError, match=says):
        Trace(**{field: value})


@pytest.mark.parametrize(
    ("trace", "says"),
    [
        (Trace(rate=3000.0), r"trace.rate of 3000 Hz is 1.33333 samples of 4000 Hz"),
        (Trace(rate=8000.0), r"trace.rate of 8000 Hz is 0.5 samples of 4000 Hz"),
        (Trace(rate=1000.0, command_offset=1.1e-3), "must be within one row, 0.001 s early or late, got 0.0011"),
        (Trace(command_noise=-1.0), "trace.command_noise must be at least 0 N"),
        (Trace(encoders="motor"), 'trace.encoders is "motor", and the drive has no motor_encoder'),
    ],
)
def test_a_trace_that_this_control_cannot_write_is_refused(trace, says):
    with pytest.raises(ParameterError, match=says):
        check_trace(trace, RATE, has_motor_encoder=False)
    axis = dataclasses.replace(dd.paper_axis(), sampling=Sampling(RATE), trace=trace)
    with pytest.raises(ParameterError, match=says):
        dd.simulate(axis, dd.motion.sine(amplitude=1e-4, frequency=10.0, duration=0.01, rate=RATE))
    with pytest.raises(DriveFileError, match=says):
        parse_axis(axis_tables(axis))


def test_a_run_that_kept_too_few_samples_for_its_trace_writes_no_log():
    few = dataclasses.replace(RUN, trace=Trace(rate=RATE / 43, sample="mean"))
    with pytest.raises(LogError, match="time: has 1 samples"):
        few.log()
    thinned = Run(
        **{name: values[::3] for name, values in SIGNALS.items()}, friction_estimate=None, load_estimate=None,
        time=RUN.time[::3], reference_velocity=np.zeros(15), trace=Trace(rate=1000.0),
    )  # fmt: skip
    with pytest.raises(ParameterError, match=r"1000 Hz is 1.33333 samples of 1333.33 Hz"):
        thinned.log()


TRACES = [
    Trace(),
    Trace(rate=1000.0),
    Trace(rate=2000.0, sample="mean", command="force", command_noise=2.0, command_offset=-0.2e-3),
    Trace(encoders="motor"),
    Trace(encoders="scale", command_offset=0.0),
]


@pytest.mark.parametrize("trace", TRACES)
def test_a_trace_is_written_and_read_back(trace, tmp_path):
    axis = dd.paper_axis("cascade")
    drive = dataclasses.replace(axis.drive, motor_encoder=Sensor(1e-8))
    axis = dataclasses.replace(axis.with_drive(drive), sampling=Sampling(RATE), trace=trace)
    axis.write(tmp_path / "drive.toml")
    assert dd.read_axis(tmp_path / "drive.toml").trace == trace
    assert ("trace" in axis_tables(axis)) == (trace != Trace())


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"rate": "1 m"}, r"\[trace\] rate: "),
        ({"sample": "median"}, 'trace.sample must be "snapshot" or "mean"'),
        ({"every": 4}, r"\[trace\] every: unknown key"),
        ({"command_offset": "0.2 mm"}, r"\[trace\] command_offset: "),
    ],
)
def test_a_table_that_states_no_trace_is_refused(table, says):
    with pytest.raises(DriveFileError, match=says):
        parse_axis(axis_tables(dd.paper_axis()) | {"trace": table})


LAP = dd.motion.sine(amplitude=1e-3, frequency=5.0, duration=0.2, rate=RATE)


def cascade_axis(**trace):
    axis = dd.paper_axis("cascade").with_controller(Cascade(50.0, 2e4, 1e5, 1.0))
    drive = dataclasses.replace(axis.drive, sensor=Sensor(1e-7, 2e-8), motor_encoder=Sensor(1e-8, 5e-9))
    return dataclasses.replace(axis.with_drive(drive), sampling=Sampling(RATE), trace=Trace(**trace))


def test_a_simulated_log_is_what_the_control_would_have_written():
    run = dd.simulate(cascade_axis(), LAP, load=500.0)
    log = run.log("lap")
    assert log.name == "lap"
    for channel, signal in {"position": run.measured, "motor_position": run.motor_position, "load": run.load}.items():
        np.testing.assert_array_equal(getattr(log, channel), signal)
    slow = dd.simulate(cascade_axis(rate=1000.0, command_noise=1.5), LAP, load=500.0)
    np.testing.assert_array_equal(slow.command, run.command)  # the trace changes nothing of the loop
    rows = slow.log()
    assert rows.rate == pytest.approx(1000.0, rel=1e-9)
    np.testing.assert_array_equal(rows.position, run.measured[::4])
    assert float(np.std(rows.command - run.command[::4])) == pytest.approx(1.5, rel=0.2)
    np.testing.assert_array_equal(rows.command, slow.log().command)
    quiet = dd.simulate(cascade_axis(rate=1000.0, command_noise=1.5), LAP, load=500.0, seed=None)
    np.testing.assert_array_equal(quiet.log().command, quiet.command[::4])


def test_an_axis_as_its_logs_show_it():
    plain = dd.paper_axis("cascade")
    assert plain.as_logged() is plain
    assert plain.with_logged_drive(plain.drive).drive == plain.drive
    assert plain.unseen_controller == ""
    slow = cascade_axis(rate=1000.0, command_offset=0.25e-3).replace({"actuator.force_limit": 900.0})
    actuator = dataclasses.replace(slow.drive.actuator, delay_samples=7)
    slow = slow.with_drive(dataclasses.replace(slow.drive, actuator=actuator))
    seen = slow.as_logged()
    assert seen.rate == slow.log_rate == 1000.0
    assert not seen.controller.can_simulate
    assert (seen.drive.actuator.delay_samples, seen.drive.actuator.delay_fraction) == (2, None)  # 7 steps and 1, of 4
    assert seen.as_logged() is seen
    assert "one in 4 samples of the controller" in slow.unseen_controller
    heavier = slow.with_logged_drive(seen.replace({"plant.mass": 130.0}).drive)
    assert heavier.value("plant.mass") == 130.0
    assert heavier.drive.actuator == slow.drive.actuator
    assert heavier.trace == slow.trace


def test_a_log_of_the_motor_encoder_is_measured_by_it():
    axis = cascade_axis(encoders="motor")
    assert "feeds back the scale encoder" in axis.unseen_controller
    assert axis.as_logged().drive.sensor == axis.drive.motor_encoder
    both = dataclasses.replace(axis.controller, position_feedback="motor", velocity_feedback="motor")
    assert axis.with_controller(both).unseen_controller == ""
    assert axis.with_controller(both).as_logged().controller == both
    beside = dataclasses.replace(axis.with_controller(both), trace=Trace())
    assert "feeds back the motor encoder" in beside.unseen_controller


def test_effects_that_count_periods_keep_their_seconds():
    axis = cascade_axis(rate=1000.0).with_effects(dd.effects.LoopDelay(delay=2.0), dd.effects.ForceGain(gain=0.1))
    seen = axis.as_logged()
    assert [effect.name for effect in seen.drive.effects] == [effect.name for effect in axis.drive.effects]
    assert float(seen.value("effects.loop_delay.delay")) == 0.5
    assert axis.with_logged_drive(seen.drive).drive.effects == axis.drive.effects
    late = dataclasses.replace(axis.drive, actuator=Actuator(force_limit=800.0, delay_samples=2, delay_fraction=0.5))
    forced = dataclasses.replace(axis.with_drive(late), trace=Trace(command="force"))
    assert forced.as_logged().drive.actuator == Actuator(force_limit=800.0)
    assert forced.with_logged_drive(forced.as_logged().drive).drive.actuator == late.actuator
    assert forced.as_logged().drive.effects == ()
    assert forced.with_logged_drive(forced.as_logged().drive).drive.effects == axis.drive.effects


def test_a_delay_that_the_rows_show_is_taken_over_and_no_other():
    axis = cascade_axis()
    motor = axis.with_controller(dataclasses.replace(axis.controller, velocity_feedback="motor"))
    late = dataclasses.replace(motor.drive, actuator=dataclasses.replace(motor.drive.actuator, delay_samples=3))
    assert motor.as_logged() is not motor
    assert motor.with_logged_drive(late).drive.actuator.delay_samples == 3
    for trace in (Trace(rate=1000.0), Trace(command="force"), Trace(command_offset=1e-4)):
        assert dataclasses.replace(axis, trace=trace).with_logged_drive(late).drive.actuator == axis.drive.actuator
