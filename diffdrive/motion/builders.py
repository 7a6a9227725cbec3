"""Motions: triangular, trapezoidal, jerk-limited, sines, chirps, staircases, and arrays of the user.

Every stroke is a chain of pieces of constant jerk, integrated exactly, so that position, velocity and acceleration
agree to rounding at any sample rate.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from diffdrive.errors import MotionError
from diffdrive.motion.motion import Motion, require_samples
from diffdrive.motion.pieces import (
    Piece,
    dwell_pieces,
    jerk_stroke_pieces,
    motion_of_pieces,
    require_finite,
    require_positive,
    stroke_pieces,
    time_grid,
)
from diffdrive.motion.size import guarded_arithmetic, require_motion_memory, require_resolved_positions


def triangular(
    *,
    speed: float,
    stroke: float,
    rounding: float,
    duration: float,
    rate: float,
    first_reversal: float | None = None,
    start: float = 0.0,
) -> Motion:
    """To and fro at constant `speed` (m/s) over `stroke` (m), each velocity reversal linear over `rounding` (s).

    It starts from rest with half a rounding. Reversals are centred stroke / speed + rounding / 2 apart, so that
    `stroke` is the distance between the turning points.

    Args:
        speed: Between the reversals (m/s).
        stroke: Distance between the turning points (m).
        rounding: Time that a reversal takes (s).
        duration: Length of the motion (s).
        rate: Samples per second (Hz), the axis's.
        first_reversal: When the first one is centred (s); by default one such time after the start.
        start: Position of the first sample (m).

    Raises:
        MotionError: A value is not positive and finite, or the motion has too many or too few samples.

    Examples:
        >>> triangular(speed=0.010, stroke=0.005, rounding=0.1, duration=1.0, rate=10_000.0)

    """
    require_positive("triangular motion", speed=speed, stroke=stroke, rounding=rounding, duration=duration)
    with guarded_arithmetic("triangular motion"):
        reversal_interval, acceleration = stroke / speed + rounding / 2.0, 2.0 * speed / rounding
    first = reversal_interval if first_reversal is None else first_reversal
    require_positive("triangular motion", first_reversal=first)
    if rounding > min(reversal_interval, first) * (1 + 1e-9):
        raise MotionError(
            f"triangular motion: a rounding of {rounding:g} s does not fit between reversals "
            f"{min(reversal_interval, first):g} s apart: round less, or lengthen the stroke"
        )
    require_positive("triangular motion", rate=rate)
    if reversal_interval * rate < 1.0:
        raise MotionError(
            f"triangular motion: reversals {reversal_interval:g} s apart are closer than the samples at {rate:g} Hz: "
            "lengthen the stroke, or slow the motion"
        )
    with guarded_arithmetic("triangular motion"):
        require_motion_memory("triangular motion", duration, rate, pieces=2 * int(duration / reversal_interval))
    pieces = [(rounding / 2, acceleration, 0.0), (max(first - rounding, 0.0), 0.0, 0.0)]
    direction, elapsed = 1.0, first - rounding / 2
    while elapsed < duration:
        direction = -direction
        pieces += [(rounding, direction * acceleration, 0.0), (max(reversal_interval - rounding, 0.0), 0.0, 0.0)]
        elapsed += reversal_interval
    return motion_of_pieces("triangular", pieces, rate, start, duration)


def constant_speed(*, speed: float, ramp: float, duration: float, rate: float, start: float = 0.0) -> Motion:
    """From rest to `speed` (m/s, either sign) at constant acceleration over `ramp` (s), then on at that speed.

    Args:
        speed: Of either sign (m/s).
        ramp: Time to get there (s).
        duration: Length of the motion (s).
        rate: Samples per second (Hz), the axis's.
        start: Position of the first sample (m).

    Raises:
        MotionError: A value is not positive and finite, or the motion has too many or too few samples.

    """
    require_positive("constant speed", speed=abs(speed), ramp=ramp, duration=duration)
    with guarded_arithmetic("constant speed"):
        acceleration = speed / ramp
    return motion_of_pieces("constant speed", [(ramp, acceleration, 0.0)], rate, start, duration)


def _there_and_back(
    name: str, stroke: Callable[[float], list[Piece]], distance: float,
    dwell: float, repeats: int, rate: float, start: float,
) -> Motion:  # fmt: skip
    """There and back by strokes of a signed distance (m)."""
    if not (np.isfinite(repeats) and repeats >= 1 and int(repeats) == repeats):
        raise MotionError(f"{name}: repeats = {repeats!r} must be a whole number of at least 1")
    require_positive(name, rate=rate)
    rest = dwell_pieces(name, dwell)
    with guarded_arithmetic(name):
        cycle = rest + stroke(distance) + rest + stroke(-distance)
        require_motion_memory(
            name, repeats * sum(length for length, _, _ in cycle), rate, pieces=int(repeats) * len(cycle)
        )
    return motion_of_pieces(name, cycle * int(repeats) + rest, rate, start)


def trapezoidal(
    *,
    distance: float,
    speed: float,
    acceleration: float,
    rate: float,
    dwell: float = 0.1,
    repeats: int = 1,
    start: float = 0.0,
) -> Motion:
    """Strokes of `distance` (m) there and back, acceleration-limited, resting `dwell` (s) in between.

    Args:
        distance: Of a stroke, of either sign (m).
        speed: Highest (m/s).
        acceleration: Highest (m/s^2).
        rate: Samples per second (Hz), the axis's.
        dwell: Rest before and after each stroke (s).
        repeats: Strokes there and back.
        start: Position of the first sample (m).

    Raises:
        MotionError: A value is not positive and finite, or the motion has too many or too few samples.

    """
    require_positive("trapezoidal stroke", distance=abs(distance), speed=speed, acceleration=acceleration)
    stroke = partial(stroke_pieces, speed=speed, acceleration=acceleration)
    return _there_and_back("trapezoidal", stroke, distance, dwell, repeats, rate, start)


def jerk_limited(
    *,
    distance: float,
    speed: float,
    acceleration: float,
    jerk: float,
    rate: float,
    dwell: float = 0.1,
    repeats: int = 1,
    start: float = 0.0,
) -> Motion:
    """Strokes of `distance` (m) there and back with limited `jerk` (m/s^3), resting `dwell` (s) in between.

    Args:
        distance: Of a stroke, of either sign (m).
        speed: Highest (m/s).
        acceleration: Highest (m/s^2).
        jerk: Highest (m/s^3).
        rate: Samples per second (Hz), the axis's.
        dwell: Rest before and after each stroke (s).
        repeats: Strokes there and back.
        start: Position of the first sample (m).

    Raises:
        MotionError: A value is not positive and finite, or the motion has too many or too few samples.

    """
    require_positive("jerk-limited stroke", distance=abs(distance), speed=speed, acceleration=acceleration, jerk=jerk)
    stroke = partial(jerk_stroke_pieces, speed=speed, acceleration=acceleration, jerk=jerk)
    return _there_and_back("jerk-limited", stroke, distance, dwell, repeats, rate, start)


def multisine(
    *,
    amplitudes: Sequence[float],
    frequencies: Sequence[float],
    duration: float,
    rate: float,
    phases: Sequence[float] | None = None,
    start: float = 0.0,
) -> Motion:
    """A sum of sines (amplitudes m, frequencies Hz, phases rad; by default Schroeder's, which keep the peak low).

    Its first velocity is not zero in general: fade in with a `from_array` of your own if the axis must start from rest.

    Args:
        amplitudes: Of each sine (m).
        frequencies: Of each sine (Hz), below half of the rate.
        duration: Length of the motion (s).
        rate: Samples per second (Hz), the axis's.
        phases: Of each sine (rad); by default Schroeder's, which keep the peak low.
        start: Position of the first sample (m).

    Raises:
        MotionError: A value is not positive and finite, or the motion has too many or too few samples.

    """
    return _waves("multisine", amplitudes, frequencies, phases, duration, rate, start)


def _waves(
    name: str, amplitudes: Sequence[float], frequencies: Sequence[float], phases: Sequence[float] | None,
    duration: float, rate: float, start: float,
) -> Motion:  # fmt: skip
    amplitude, frequency = np.asarray(amplitudes, float), np.asarray(frequencies, float)
    if amplitude.shape != frequency.shape or amplitude.ndim != 1 or not len(amplitude):
        raise MotionError(f"{name}: give as many amplitudes as frequencies, at least one of each")
    if not (np.all(np.isfinite(amplitude)) and np.all(np.isfinite(frequency)) and np.all(frequency > 0)):
        raise MotionError(f"{name}: amplitudes and frequencies must be finite, frequencies positive")
    require_finite(name, start=start)
    time = time_grid(name, duration, rate, waves=len(amplitude))
    if np.any(frequency >= rate / 2):
        raise MotionError(f"{name}: {frequency.max():g} Hz is beyond half of the rate {rate:g} Hz: lower it")
    number = np.arange(len(amplitude))
    phase = -np.pi * number * (number + 1) / len(amplitude) if phases is None else np.asarray(phases, float)
    if phase.shape != amplitude.shape or not np.all(np.isfinite(phase)):
        raise MotionError(f"{name}: give as many phases (rad, finite) as amplitudes, or none")
    with guarded_arithmetic(name):
        angle = 2 * np.pi * np.outer(time, frequency) + phase
        omega = 2 * np.pi * frequency
        displacement = np.sin(angle) @ amplitude
        position = start + (displacement - displacement[0])
        velocity = np.cos(angle) @ (amplitude * omega)
        acceleration = -np.sin(angle) @ (amplitude * omega**2)
    require_resolved_positions(name, position, velocity)
    return Motion(time, position, velocity, acceleration, name)


def sine(*, amplitude: float, frequency: float, duration: float, rate: float, start: float = 0.0) -> Motion:
    """One sine that begins at its turning point, hence from rest: start + amplitude (1 - cos(2 pi f t)).

    Args:
        amplitude: Half of the stroke (m).
        frequency: Of the sine (Hz).
        duration: Length of the motion (s).
        rate: Samples per second (Hz), the axis's.
        start: Position of the first sample (m).

    Raises:
        MotionError: A value is not positive and finite, or the motion has too many or too few samples.

    Examples:
        >>> sine(amplitude=0.015, frequency=0.5, duration=6.0, rate=10_000.0)

    """
    require_positive("sine", amplitude=amplitude, frequency=frequency)
    return _waves("sine", [amplitude], [frequency], [-np.pi / 2], duration, rate, start)


def chirp(
    *, amplitude: float, from_frequency: float, to_frequency: float, duration: float, rate: float, start: float = 0.0
) -> Motion:
    """A sine whose frequency rises linearly from `from_frequency` to `to_frequency` (Hz), starting from rest.

    Args:
        amplitude: Half of the stroke (m).
        from_frequency: At the start (Hz).
        to_frequency: At the end (Hz).
        duration: Length of the motion (s).
        rate: Samples per second (Hz), the axis's.
        start: Position of the first sample (m).

    Raises:
        MotionError: A value is not positive and finite, or the motion has too many or too few samples.

    """
    require_positive("chirp", amplitude=amplitude, from_frequency=from_frequency, to_frequency=to_frequency)
    require_finite("chirp", start=start)
    time = time_grid("chirp", duration, rate)
    if max(from_frequency, to_frequency) >= rate / 2:
        raise MotionError(
            f"chirp: {max(from_frequency, to_frequency):g} Hz is beyond half of the rate {rate:g} Hz: lower it"
        )
    from scipy.signal import chirp as scipy_chirp  # half a second to import

    wave = [
        scipy_chirp(time, from_frequency, duration, to_frequency, method="linear", phi=phi) for phi in (0.0, 90.0)
    ]  # cos(angle), cos(angle + 90 deg) = -sin(angle)
    with guarded_arithmetic("chirp"):
        slope = (to_frequency - from_frequency) / duration
        omega = 2 * np.pi * (from_frequency + slope * time)
        position = start + amplitude * (1.0 - wave[0])
        velocity = -amplitude * wave[1] * omega
        acceleration = amplitude * (wave[0] * omega**2 - wave[1] * 2 * np.pi * slope)
    require_resolved_positions("chirp", position, velocity)
    return Motion(time, position, velocity, acceleration, "chirp")


def staircase(
    *, speeds: Sequence[float], travel: float, acceleration: float, rate: float, dwell: float = 0.2, start: float = 0.0
) -> Motion:
    """For each of `speeds` (m/s): a stroke of `travel` (m) out and back with dwells (s), as for a Stribeck curve.

    Args:
        speeds: One for each step (m/s).
        travel: Length of the strokes (m).
        acceleration: Highest (m/s^2).
        rate: Samples per second (Hz), the axis's.
        dwell: Rest between the strokes (s).
        start: Position of the first sample (m).

    Raises:
        MotionError: A value is not positive and finite, or the motion has too many or too few samples.

    """
    if not len(speeds):
        raise MotionError("staircase: give at least one speed")
    require_positive(
        "staircase", travel=travel, acceleration=acceleration, **{f"speeds[{i}]": s for i, s in enumerate(speeds)}
    )
    rest = dwell_pieces("staircase", dwell)
    pieces = list(rest)
    with guarded_arithmetic("staircase"):
        for speed in speeds:
            pieces += (
                stroke_pieces(travel, speed, acceleration) + rest + stroke_pieces(-travel, speed, acceleration) + rest
            )
    return motion_of_pieces("staircase", pieces, rate, start)


def from_array(
    time: Sequence[float] | np.ndarray, position: Sequence[float] | np.ndarray, *, name: str = "own array"
) -> Motion:
    """Your own reference (s, m) on a uniform time grid; velocity and acceleration from its cubic spline.

    Args:
        time: Of the samples, [n], uniform (s).
        position: Where the table should be, [n] (m).
        name: What messages call it.

    Raises:
        MotionError: The samples are not uniform in time, not finite, or not equally many.

    Examples:
        >>> from_array(np.arange(1001) / 1000.0, 1e-3 * np.sin(np.arange(1001) / 100.0))

    """
    t, x = np.asarray(time, float), np.asarray(position, float)
    if t.ndim != 1 or t.shape != x.shape or len(t) < 4:
        raise MotionError(f"{name}: time and position must be one-dimensional, equally long, with at least 4 samples")
    require_samples(name, t, position=x)
    mean = (t[-1] - t[0]) / (len(t) - 1)
    grid = t[0] + mean * np.arange(len(t))
    from scipy.interpolate import make_interp_spline  # a quarter of a second to import

    spline = make_interp_spline(grid, x, k=3)
    return Motion(grid - grid[0], x, spline.derivative(1)(grid), spline.derivative(2)(grid), name)
