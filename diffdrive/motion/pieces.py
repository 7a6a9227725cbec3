"""Chains of pieces of constant jerk: strokes, and what every motion checks of its numbers.

A piece is (duration s, acceleration at its start m/s^2, jerk m/s^3).
"""

from collections.abc import Sequence

import numpy as np

from diffdrive.errors import MotionError
from diffdrive.motion.motion import Motion
from diffdrive.motion.size import guarded_arithmetic, require_motion_memory, require_resolved_positions

Piece = tuple[float, float, float]


def require_positive(motion: str, **values: float) -> None:
    """Raise `MotionError` unless all values are positive and finite."""
    invalid = [f"{name} = {value!r}" for name, value in values.items() if not (np.isfinite(value) and value > 0)]
    if invalid:
        raise MotionError(f"{motion}: {', '.join(invalid)} must be positive and finite (SI units: m, s, m/s, m/s^2)")


def require_finite(motion: str, **values: float) -> None:
    """Raise `MotionError` unless all values are finite."""
    invalid = [f"{name} = {value!r}" for name, value in values.items() if not np.isfinite(value)]
    if invalid:
        raise MotionError(f"{motion}: {', '.join(invalid)} must be finite (SI units: m, s)")


def dwell_pieces(motion: str, dwell: float) -> list[Piece]:
    """A rest of so many seconds."""
    if not (np.isfinite(dwell) and dwell >= 0):
        raise MotionError(f"{motion}: dwell = {dwell!r} must be 0 s or more, and finite")
    return [(dwell, 0.0, 0.0)] if dwell > 0 else []


def time_grid(name: str, duration: float, rate: float, *, pieces: int = 0, waves: int = 0) -> np.ndarray:
    """The times of the samples (s)."""
    require_positive("time grid", duration=duration, rate=rate)
    require_motion_memory(name, duration, rate, pieces=pieces, waves=waves)
    samples = round(duration * rate)
    if samples < 2:
        raise MotionError(f"a motion of {duration:g} s at {rate:g} Hz has fewer than three samples: make it longer")
    return np.arange(samples + 1) / rate


def motion_of_pieces(
    name: str,
    pieces: Sequence[Piece],
    rate: float,
    start: float = 0.0,
    duration: float | None = None,
) -> Motion:
    """Integrate pieces (duration, acceleration at its start, jerk) from standstill at `start`.

    Without a `duration` the grid ends with the first sample at or after the last piece.
    """
    require_finite(name, start=start)
    require_positive(name, rate=rate)
    with guarded_arithmetic(name):
        return _integrate(name, pieces, rate, start, duration)


def _integrate(name: str, pieces: Sequence[Piece], rate: float, start: float, duration: float | None) -> Motion:
    lengths = np.array([p[0] for p in pieces])
    knots = np.concatenate([[0.0], np.cumsum(lengths)])
    end = duration if duration is not None else float(np.ceil(knots[-1] * rate - 1e-6)) / rate
    time = time_grid(name, end, rate, pieces=len(pieces))
    x, v = start, 0.0
    initial = []
    for length, a, jerk in pieces:
        initial.append((x, v, a, jerk))
        x += v * length + a * length**2 / 2 + jerk * length**3 / 6
        v += a * length + jerk * length**2 / 2
    initial.append((x, v, 0.0, 0.0))  # and so on after the end
    # a sample within rounding of a knot belongs to the piece that starts there
    ends = np.searchsorted(time + 1e-9 / rate, knots[1:], side="left")
    samples = np.diff(ends, prepend=0, append=len(time))
    x0, v0, a0, j0, piece_start = (np.repeat(column, samples) for column in np.column_stack([initial, knots]).T)
    s = time - piece_start
    position = x0 + s * (v0 + s * (a0 / 2 + s * j0 / 6))
    velocity = v0 + s * (a0 + s * j0 / 2)
    require_resolved_positions(name, position, velocity)
    return Motion(time, position, velocity, a0 + s * j0, name)


def stroke_pieces(distance: float, speed: float, acceleration: float) -> list[Piece]:
    """A stroke of a signed distance (m), limited in speed and acceleration."""
    sign, distance = np.sign(distance), abs(distance)
    peak = min(speed, float(np.sqrt(distance * acceleration)))
    ramp = peak / acceleration
    cruise = distance / peak - ramp
    return [(ramp, sign * acceleration, 0.0), (max(cruise, 0.0), 0.0, 0.0), (ramp, -sign * acceleration, 0.0)]


def jerk_stroke_pieces(distance: float, speed: float, acceleration: float, jerk: float) -> list[Piece]:
    """A stroke of a signed distance (m), limited in speed, acceleration and jerk."""
    sign, distance = np.sign(distance), abs(distance)

    def ramp_times(peak: float) -> tuple[float, float]:
        rise = min(acceleration / jerk, float(np.sqrt(peak / jerk)))
        return rise, max(peak / (rise * jerk) - rise, 0.0)

    def ramp_distance(peak: float) -> float:
        rise, hold = ramp_times(peak)
        return peak * (2 * rise + hold)  # both ramps together, each at half the peak on average

    peak = speed
    if ramp_distance(speed) > distance:  # the speed is not reached: find the one that just fits
        peak = float(np.cbrt(jerk * (distance / 2) * (distance / 2)))
        longest = acceleration / jerk  # s, of a rise
        if peak > acceleration * longest:  # the acceleration is reached, and held
            peak = acceleration / 2 * (float(np.sqrt(longest * longest + 4 * distance / acceleration)) - longest)
    rise, hold = ramp_times(peak)
    top = rise * jerk
    cruise = max((distance - ramp_distance(peak)) / peak, 0.0)
    up = [(rise, 0.0, jerk), (hold, top, 0.0), (rise, top, -jerk)]
    down = [(rise, 0.0, -jerk), (hold, -top, 0.0), (rise, -top, jerk)]
    return [(t, sign * a, sign * j) for t, a, j in (*up, (cruise, 0.0, 0.0), *down)]
