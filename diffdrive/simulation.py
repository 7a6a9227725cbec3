"""An axis simulated: every signal of one motion, or a pure function of the axis for `jit`, `grad` and `vmap`."""

import warnings
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from diffdrive.axis import Axis, require_axis
from diffdrive.errors import LoadEstimatorWarning
from diffdrive.loop.metrics import rms
from diffdrive.loop.rollout import compiled_rollout, loop_inputs
from diffdrive.loop.run import Run
from diffdrive.loop.signals import Signals
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.trace import check_trace
from diffdrive.motion.motion import Motion, require_motion
from diffdrive.numerics.arrays import Scalar, as_arrays
from diffdrive.support.rates import require_same_rate


def simulate(
    axis: Axis,
    motion: Motion,
    load: Float[np.ndarray, " n"] | float = 0.0,
    *,
    machine: Axis | None = None,
    seed: int | None = 0,
    every: int = 1,
    throw: bool = False,
) -> Run:
    """Simulate one motion of an axis, and return every signal with a status that says whether the run is valid.

    A loop that diverges is a status, and an error only with `throw`. Where the controller's load estimator does not
    converge, the run's `notes` say so, and a `LoadEstimatorWarning`.

    Args:
        axis: The drive and its controller.
        motion: The reference, [n] samples at the axis's rate.
        load: Force on the guides (N), one number or one per sample.
        machine: An axis whose drive replaces the axis's own under the axis's controller, so that the controller's model
            and the true machine may differ.
        seed: Of the noise of the encoders (None: no noise). By default there is noise, as in a log; `rollout` has none.
        every: Keep each n-th sample.
        throw: Raise an error where the status is not ok.

    Raises:
        ParameterError: A parameter is out of its range, or the rates differ.
        MotionError: The motion leaves the axis's limits, or the load is not possible.
        DivergenceError: The loop diverged, with `throw`.
        ResultError: The force limit holds back most of the commands, with `throw`.

    Examples:
        >>> run = simulate(axis, motion.sine(amplitude=1e-3, frequency=10.0, duration=0.5, rate=axis.rate), load=8e3)
        >>> run.status.ok, run.rms_error()

    """
    drive = checked_machine(axis, machine).drive
    require_motion(motion)
    check_trace(axis.trace, axis.rate, has_motor_encoder=drive.motor_encoder is not None)
    run = simulate_loop(
        drive, axis.controller, motion, load, sampling=axis.sampling, limits=axis.limits, seed=seed, every=every
    )
    run = replace(run, trace=axis.trace, seed=None if seed is None else int(seed))
    for note in run.notes:
        warnings.warn(note, LoadEstimatorWarning, stacklevel=2)
    return run.require_ok() if throw else run


class Rollout(Signals[Array]):
    """The `Signals` of a roll-out, [n] each. Under `jax.vmap` lanes come first, and an error is a number for each."""

    rate: float = eqx.field(static=True)  # Hz
    start: float = eqx.field(static=True, default=0.0)  # s, of the first sample

    def sample_times(self) -> np.ndarray:
        return self.start + np.arange(self.reference.shape[-1]) / self.rate

    def rms_error(self, start: float = -np.inf, end: float = np.inf) -> Float[Array, "*lanes"]:
        """Root mean square tracking error (m) between `start` and `end` (s); its gradient is never NaN.

        Raises `ParameterError` where no sample is.
        """
        return rms(self.error[..., self.between(start, end)])

    def peak_error(self, start: float = -np.inf, end: float = np.inf) -> Float[Array, "*lanes"]:
        """Largest tracking error (m) between `start` and `end` (s); its gradient is that of the worst sample.

        Raises `ParameterError` where no sample is.
        """
        return jnp.max(jnp.abs(self.error[..., self.between(start, end)]), axis=-1)


def rollout(
    axis: Axis,
    motion: Motion,
    load: Float[Array, " n"] | Scalar = 0.0,
    *,
    machine: Axis | None = None,
    seed: int | None = None,
) -> Rollout:
    """The signals of one motion as a pure function of the axis and the load (N, one number or one per sample).

    For `jit`, `grad`, `jacfwd` and `vmap`, over gains, plant, friction and loads. Values, which may be traced, are not
    checked: `simulate` does that. For gradients take `axis.smooth()`; the exact axis rounds and switches, and its
    derivatives are of no use.

    Args:
        axis: The drive and its controller; its leaves may be traced.
        motion: The reference, [n] samples at the axis's rate.
        load: Force on the guides (N), one number or one per sample; may be traced.
        machine: An axis whose drive replaces the axis's own, as in `simulate`.
        seed: Of the noise of the encoders. By default there is none, since a derivative is of the loop, not of its
            noise; `simulate` has it, with seed 0.

    Raises:
        ParameterError: The motion, or the machine, has another rate than the axis.

    Examples:
        >>> def error(kp, load):
        ...     return rollout(axis.smooth().with_gains(kp=kp), motion, load).rms_error()
        >>> jax.grad(error)(axis.gains["kp"], 8e3)

    """
    drive = checked_machine(axis, machine).drive
    require_motion(motion)
    require_same_rate(f"motion '{motion.name}'", motion.rate, "the axis", axis.rate)
    inputs = loop_inputs(motion, jnp.broadcast_to(jnp.asarray(load, jnp.float64), motion.time.shape))
    key = None if seed is None else jax.random.key(seed)
    frames: PyTree = compiled_rollout(*as_arrays((drive, axis.controller)), inputs, axis.sampling, key)
    estimate = frames.estimate
    return Rollout(
        reference=jnp.asarray(inputs.reference.position),
        load=jnp.asarray(inputs.load),
        measured=frames.measured,
        table_position=frames.table_position,
        velocity=frames.velocity,
        command=frames.command,
        force=frames.force,
        friction=frames.friction,
        friction_estimate=None if estimate is None else estimate.friction,
        load_estimate=None if estimate is None else estimate.load,
        motor_position=frames.motor_position,
        rate=axis.rate,
        start=float(motion.time[0]),
    )


def checked_machine(axis: Axis, machine: Axis | None) -> Axis:
    """The axis whose drive moves: `machine`, or the axis itself; raises `ParameterError` for what is no axis, and for
    another rate.
    """
    require_axis(axis)
    if machine is None:
        return axis
    require_axis(machine, "machine")
    require_same_rate("machine", machine.rate, "the axis", axis.rate)
    return machine
