"""A motion: the reference of the table at each control step; and the limits of an axis."""

from dataclasses import dataclass

import numpy as np

from diffdrive.errors import MotionError
from diffdrive.support.bounds import require_a


@dataclass(frozen=True)
class Motion:
    """A reference on a uniform time grid; arrays of shape [n] in s, m, m/s, m/s^2."""

    time: np.ndarray  # s, of the samples
    position: np.ndarray  # m
    velocity: np.ndarray  # m/s
    acceleration: np.ndarray  # m/s^2
    name: str = "motion"  # what messages and results call it

    def __post_init__(self) -> None:
        require_samples(
            f"motion '{self.name}'",
            self.time,
            position=self.position,
            velocity=self.velocity,
            acceleration=self.acceleration,
        )

    @property
    def rate(self) -> float:
        """Samples per second."""
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])

    @property
    def duration(self) -> float:
        """Seconds from the first sample to the last."""
        return float(self.time[-1] - self.time[0])


@dataclass(frozen=True)
class Limits:
    """Limits of an axis: stroke [lowest, highest] (m), speed (m/s), acceleration (m/s^2)."""

    stroke: tuple[float, float] = (-np.inf, np.inf)  # m, lowest and highest position
    speed: float = np.inf  # m/s
    acceleration: float = np.inf  # m/s^2

    def __post_init__(self) -> None:
        low, high = self.stroke
        if not low < high:
            raise MotionError(f"limits: stroke must be (lowest, highest) in m, got {self.stroke!r}")
        for name in ("speed", "acceleration"):
            if not getattr(self, name) > 0:
                raise MotionError(f"limits: {name} must be positive, got {getattr(self, name)!r}")


def require_motion(motion: object) -> None:
    """Raise `ParameterError` for what is no motion, such as a line of text."""
    require_a(Motion, "motion", motion, "make one with diffdrive.motion")


def require_within(motion: Motion, limits: Limits) -> Motion:
    """The motion unchanged; raises `MotionError` naming the first sample beyond each limit."""
    tolerance = 1e-9
    low, high = limits.stroke
    cases = (
        ("position", motion.position, np.clip(motion.position, low, high), f"the stroke {low:g} to {high:g} m", "m"),
        (
            "speed",
            motion.velocity,
            np.clip(motion.velocity, -limits.speed, limits.speed),
            f"{limits.speed:g} m/s",
            "m/s",
        ),
        (
            "acceleration",
            motion.acceleration,
            np.clip(motion.acceleration, -limits.acceleration, limits.acceleration),
            f"{limits.acceleration:g} m/s^2",
            "m/s^2",
        ),
    )
    problems = []
    for quantity, signal, allowed, limit, unit in cases:
        beyond = np.abs(signal - allowed) > tolerance * max(1.0, float(np.max(np.abs(allowed))))
        if beyond.any():
            k = int(np.argmax(beyond))
            largest = float(signal[np.argmax(np.abs(signal - allowed))])
            problems.append(f"{quantity} leaves {limit} first at t = {motion.time[k]:g} s (worst {largest:g} {unit})")
    if problems:
        raise MotionError(
            f"motion '{motion.name}': " + "; ".join(problems) + ". Shorten or slow the motion, or correct the limits"
        )
    return motion


def require_samples(name: str, time: np.ndarray, **signals: np.ndarray) -> None:
    """Raise `MotionError` unless time is uniform and increasing, and all are finite and equally long."""
    if np.ndim(time) != 1 or any(np.shape(signal) != np.shape(time) for signal in signals.values()) or len(time) < 2:
        raise MotionError(f"{name}: time, {', '.join(signals)} must be one-dimensional and equally long")
    for name_of, signal in {"time": time, **signals}.items():
        if not np.all(np.isfinite(signal)):
            raise MotionError(
                f"{name}: {name_of} is not finite at sample {int(np.argmin(np.isfinite(signal)))}: fill or cut the gap"
            )
    steps = np.diff(time)
    if not np.all(steps > 0):
        raise MotionError(
            f"{name}: time does not increase at sample {int(np.argmin(steps > 0)) + 1}: sort it, drop repeats"
        )
    mean = (time[-1] - time[0]) / (len(time) - 1)
    if np.max(np.abs(steps - mean)) > 1e-3 * mean:
        k = int(np.argmax(np.abs(steps - mean)))
        raise MotionError(
            f"{name}: time is not uniform: step {steps[k]:g} s at t = {time[k]:g} s, {mean:g} s on average; "
            "resample it first"
        )
