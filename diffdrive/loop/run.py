"""The result of a simulation: its signals, and a status that says whether they are valid."""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from diffdrive.logs.log import Log
from diffdrive.loop.recording import record, rows_of
from diffdrive.loop.signals import Signals
from diffdrive.model.trace import Trace
from diffdrive.motion.motion import Limits, Motion
from diffdrive.results import Result, Status

OK = Status(True)


class Run(Result, Signals[np.ndarray]):
    """One simulated motion: its `Signals`, arrays of shape [n], and a status that says whether they are valid."""

    time: np.ndarray  # s
    reference_velocity: np.ndarray  # m/s
    status: Status = OK
    notes: tuple[str, ...] = ()
    trace: Trace = Trace()  # of the control
    seed: int | None = eqx.field(static=True, default=None)  # of the noise of the trace

    schema: ClassVar[str] = "run/1"

    def summary(self) -> str:
        return "\n".join([self.headline(), *(f"- {note}" for note in self.notes)])

    def headline(self) -> str:
        rms, peak = (f"{1e6 * value:.3g} µm" for value in (self.rms_error(), self.peak_error()))
        message = self.status.message if self.status.ok else f"NOT OK: {self.status.message}"
        return f"{message}; tracking error {rms} RMS, {peak} peak over {self.time[-1] - self.time[0]:.4g} s"

    def as_dict(self) -> dict[str, object]:
        """Duration, errors and largest command: what `save` writes.

        The signals are written by `experiments.report`, as `run.csv`, and as a log by `write_log(path, run.log())`.
        """
        return {
            "duration_s": float(self.time[-1] - self.time[0]),
            "rms_error_m": self.rms_error(),
            "peak_error_m": self.peak_error(),
            "peak_command_N": float(np.max(np.abs(self.command))),
        }

    @classmethod
    def from_frames(cls, motion: Motion, load: np.ndarray, frames: PyTree, every: int) -> "Run":
        """From the frames of a roll-out that recorded each `every`-th sample."""
        count = len(frames.table_position)
        samples = slice(0, count * every, every)
        estimate = frames.estimate
        return cls(
            time=motion.time[samples],
            reference=motion.position[samples],
            reference_velocity=motion.velocity[samples],
            load=load[samples],
            measured=np.asarray(frames.measured),
            table_position=np.asarray(frames.table_position),
            velocity=np.asarray(frames.velocity),
            command=np.asarray(frames.command),
            force=np.asarray(frames.force),
            friction=np.asarray(frames.friction),
            friction_estimate=None if estimate is None else np.asarray(estimate.friction),
            load_estimate=None if estimate is None or estimate.load is None else np.asarray(estimate.load),
            motor_position=None if frames.motor_position is None else np.asarray(frames.motor_position),
        )

    def sample_times(self) -> np.ndarray:
        return self.time

    def peak_error(self, start: float = -np.inf, end: float = np.inf) -> float:
        """Largest tracking error (m) between `start` and `end` (s); raises `ParameterError` where no sample is."""
        return float(np.max(np.abs(self.error[self.between(start, end)])))

    def rms_error(self, start: float = -np.inf, end: float = np.inf) -> float:
        """Root mean square tracking error (m) between `start` and `end` (s); raises `ParameterError` as `between`."""
        return float(np.sqrt(np.mean(self.error[self.between(start, end)] ** 2)))

    def log(self, name: str = "run") -> Log:
        """The log that the machine itself would have written of this run: the rows of its control's trace.

        Raises `ParameterError` where the trace's rate does not divide that of the samples that were kept.
        """
        rows = record(self, self.trace, None if self.seed is None else jax.random.key(self.seed))
        motor = None if rows.motor_position is None else np.asarray(rows.motor_position, dtype=np.float64)
        channels = (rows.time, rows.position, rows.command, rows.reference, rows.load)
        time, position, command, reference, load = (np.asarray(signal, dtype=np.float64) for signal in channels)
        return Log(
            name, time=time, position=position, command=command, reference=reference, load=load, motor_position=motor
        )

    def rows(self) -> slice:
        """The samples at which the trace writes its rows."""
        return rows_of(self, self.trace)


def divergence_bound(reference: np.ndarray, limits: Limits) -> float:
    """The tracking error (m) beyond which a loop has diverged: ten times the travel, a tenth of a metre, the stroke."""
    low, high = limits.stroke
    return min(max(10.0 * float(np.ptp(reference)), 0.1), (high - low) if np.isfinite(high - low) else np.inf)


def with_status(run: Run, limits: Limits, force_limit: float | None, effects: Sequence[str] = ()) -> Run:
    """The run with its status: whether it is finite, has diverged or saturates.

    `effects` are the names of those without which the same loop does not diverge, for the message.
    """
    largest_error = divergence_bound(run.reference, limits)
    limit = np.inf if force_limit is None else force_limit
    with np.errstate(invalid="ignore", over="ignore"):
        faults = [("tracking error", run.error, ~(np.abs(run.error) <= largest_error), f"{largest_error:g} m")]
        for name in ("command", "friction_estimate", "load_estimate", "velocity"):
            signal = getattr(run, name)
            if signal is not None:
                faults.append((name.replace("_", " "), signal, ~np.isfinite(signal), "all bounds"))
        limited = np.abs(run.command) > limit
    first = [(int(np.argmax(bad)), name, signal, bound) for name, signal, bad, bound in faults if bad.any()]
    if not first:
        last_quarter = limited[-len(limited) // 4 :]
        if np.mean(last_quarter) > 0.5:
            first_saturation = float(run.time[int(np.argmax(limited))])
            message = (
                f"saturated: the command exceeds the force limit of {limit:g} N in {100 * np.mean(last_quarter):.0f} % "
                f"of the last quarter, first at t = {first_saturation:g} s: the axis is too weak for this motion "
                "and load, or the loop oscillates between its limits; raise force_limit, slow the motion, or lower kp "
                "and kd"
            )
            return replace(run, status=Status(False, message, "command", first_saturation, "saturated"))
        if not limited.any():
            return run
        message = f"ok, but the force limit of {limit:g} N held back {100 * np.mean(limited):.2g} % of the commands"
        return replace(run, status=Status(True, message))
    k, name, signal, bound = min(first, key=lambda fault: fault[0])
    if effects:
        cause = (
            f"without {' and '.join(f'effects.{name}' for name in effects)} it stays within them; check the units there"
        )
    elif np.mean(limited[: k + 1]) > 0.5:
        cause = f"the force sits at its limit of {limit:g} N; raise force_limit, or slow the motion"
    elif np.isnan(signal[k]):
        cause = (
            "numbers leave the range of floating point; check the units of the drive's parameters, or lower kd, kp or "
            "the delay"
        )
    else:
        cause = (
            "the loop is unstable with these gains, delay and sampling; lower kd, kp or the delay, or check their units"
        )
    message = f"diverged: {name} leaves {bound} at t = {run.time[k]:g} s (value {signal[k]:g}): {cause}"
    return replace(run, status=Status(False, message, name, float(run.time[k]), "diverged"))
