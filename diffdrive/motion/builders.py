"""Motions of every kind: triangular, trapezoidal, jerk-limited, sines, chirps, staircases, and one of your own.

Every stroke is a chain of pieces of constant jerk, integrated exactly, so that position, velocity and acceleration
agree to rounding at any sample rate.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from diffdrive.errors import MotionError
from diffdrive.motion.motion import Motion, require_samples
from diffdrive.motion.size import guarded_arithmetic, require_motion_memory, require_resolved_positions


def _positive(motion: str, **values: float) -> None:
    bad = [f"{name} = {value!r}" for name, value in values.items() if not (np.isfinite(value) and value > 0)]
    if bad:
        raise MotionError(f"{motion}: {', '.join(bad)} must be positive and finite (SI units: m, s, m/s, m/s^2)")


def _finite(motion: str, **values: float) -> None:
    bad = [f"{name} = {value!r}" for name, value in values.items() if not np.isfinite(value)]
    if bad:
        raise MotionError(f"{motion}: {', '.join(bad)} must be finite (SI units: m, s)")


def _dwell(motion: str, dwell: float) -> list[tuple[float, float, float]]:
    if not (np.isfinite(dwell) and dwell >= 0):
        raise MotionError(f"{motion}: dwell = {dwell!r} must be 0 s or more, and finite")
    return [(dwell, 0.0, 0.0)] if dwell > 0 else []


def _grid(name: str, duration: float, rate: float, *, pieces: int = 0, waves: int = 0) -> np.ndarray:
    _positive("time grid", duration=duration, rate=rate)
    require_motion_memory(name, duration, rate, pieces=pieces, waves=waves)
    samples = round(duration * rate)
    if samples < 2:
        raise MotionError(f"a motion of {duration:g} s at {rate:g} Hz has fewer than three samples: make it longer")
    return np.arange(samples + 1) / rate


def _pieces(
    name: str,
    pieces: Sequence[tuple[float, float, float]],
    rate: float,
    start: float = 0.0,
    duration: float | None = None,
) -> Motion:
    """Integrate pieces (duration, acceleration at its start, jerk) from standstill at `start`.

    Without a `duration` the grid ends with the first sample at or after the last piece.
    """
    _finite(name, start=start)
    _positive(name, rate=rate)
    with guarded_arithmetic(name):
        return _integrated(name, pieces, rate, start, duration)


def _integrated(
    name: str, pieces: Sequence[tuple[float, float, float]], rate: float, start: float, duration: float | None
) -> Motion:
    lengths = np.array([p[0] for p in pieces])
    knots = np.concatenate([[0.0], np.cumsum(lengths)])
    end = duration if duration is not None else float(np.ceil(knots[-1] * rate - 1e-6)) / rate
    time = _grid(name, end, rate, pieces=len(pieces))
    x, v = start, 0.0
    begin = []
    for length, a, jerk in pieces:
        begin.append((x, v, a, jerk))
        x += v * length + a * length**2 / 2 + jerk * length**3 / 6
        v += a * length + jerk * length**2 / 2
    begin.append((x, v, 0.0, 0.0))  # and so on after the end
    # a sample within rounding of a knot belongs to the piece that starts there
    ends = np.searchsorted(time + 1e-9 / rate, knots[1:], side="left")
    samples = np.diff(ends, prepend=0, append=len(time))
    x0, v0, a0, j0, since = (np.repeat(column, samples) for column in np.column_stack([begin, knots]).T)
    s = time - since
    position = x0 + s * (v0 + s * (a0 / 2 + s * j0 / 6))
    velocity = v0 + s * (a0 + s * j0 / 2)
    require_resolved_positions(name, position, velocity)
    return Motion(time, position, velocity, a0 + s * j0, name)


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

    It starts from rest with half a rounding. `stroke` is the distance between the turning points, so that reversals are
    centred stroke / speed + rounding / 2 apart, the first at `first_reversal` (s), by default after one such time.
    """
    _positive("triangular motion", speed=speed, stroke=stroke, rounding=rounding, duration=duration)
    with guarded_arithmetic("triangular motion"):
        apart, acceleration = stroke / speed + rounding / 2.0, 2.0 * speed / rounding
    first = apart if first_reversal is None else first_reversal
    _positive("triangular motion", first_reversal=first)
    if rounding > min(apart, first) * (1 + 1e-9):
        raise MotionError(
            f"triangular motion: a rounding of {rounding:g} s does not fit between reversals {min(apart, first):g} s "
            "apart: round less, or lengthen the stroke"
        )
    _positive("triangular motion", rate=rate)
    if apart * rate < 1.0:
        raise MotionError(
            f"triangular motion: reversals {apart:g} s apart are closer than the samples at {rate:g} Hz: lengthen the "
            "stroke, or slow the motion"
        )
    with guarded_arithmetic("triangular motion"):
        require_motion_memory("triangular motion", duration, rate, pieces=2 * int(duration / apart))
    pieces = [(rounding / 2, acceleration, 0.0), (max(first - rounding, 0.0), 0.0, 0.0)]
    direction, elapsed = 1.0, first - rounding / 2
    while elapsed < duration:
        direction = -direction
        pieces += [(rounding, direction * acceleration, 0.0), (max(apart - rounding, 0.0), 0.0, 0.0)]
        elapsed += apart
    return _pieces("triangular", pieces, rate, start, duration)


def constant_speed(*, speed: float, ramp: float, duration: float, rate: float, start: float = 0.0) -> Motion:
    """From rest to `speed` (m/s, either sign) at constant acceleration over `ramp` (s), then on at that speed."""
    _positive("constant speed", speed=abs(speed), ramp=ramp, duration=duration)
    with guarded_arithmetic("constant speed"):
        acceleration = speed / ramp
    return _pieces("constant speed", [(ramp, acceleration, 0.0)], rate, start, duration)


def _stroke(distance: float, speed: float, acceleration: float) -> list[tuple[float, float, float]]:
    sign, distance = np.sign(distance), abs(distance)
    peak = min(speed, float(np.sqrt(distance * acceleration)))
    ramp = peak / acceleration
    cruise = distance / peak - ramp
    return [(ramp, sign * acceleration, 0.0), (max(cruise, 0.0), 0.0, 0.0), (ramp, -sign * acceleration, 0.0)]


def _jerk_stroke(distance: float, speed: float, acceleration: float, jerk: float) -> list[tuple[float, float, float]]:
    sign, distance = np.sign(distance), abs(distance)

    def ramp_times(peak: float) -> tuple[float, float]:
        rise = min(acceleration / jerk, float(np.sqrt(peak / jerk)))
        return rise, max(peak / (rise * jerk) - rise, 0.0)

    def ramp_distance(peak: float) -> float:
        rise, hold = ramp_times(peak)
        return peak * (2 * rise + hold)  # both ramps together, each at half the peak on average

    peak = speed
    if ramp_distance(speed) > distance:  # the speed is not reached: find the one that just fits
        low, high = 0.0, speed
        for _ in range(200):
            peak = (low + high) / 2
            low, high = (peak, high) if ramp_distance(peak) <= distance else (low, peak)
    rise, hold = ramp_times(peak)
    top = rise * jerk
    cruise = max((distance - ramp_distance(peak)) / peak, 0.0)
    up = [(rise, 0.0, jerk), (hold, top, 0.0), (rise, top, -jerk)]
    down = [(rise, 0.0, -jerk), (hold, -top, 0.0), (rise, -top, jerk)]
    return [(t, sign * a, sign * j) for t, a, j in (*up, (cruise, 0.0, 0.0), *down)]


def _to_and_fro(
    name: str, stroke: Callable[[float], list[tuple[float, float, float]]], distance: float,
    dwell: float, repeats: int, rate: float, start: float,
) -> Motion:  # fmt: skip
    """There and back by strokes of a signed distance (m)."""
    if not (np.isfinite(repeats) and repeats >= 1 and int(repeats) == repeats):
        raise MotionError(f"{name}: repeats = {repeats!r} must be a whole number of at least 1")
    _positive(name, rate=rate)
    rest = _dwell(name, dwell)
    with guarded_arithmetic(name):
        cycle = rest + stroke(distance) + rest + stroke(-distance)
        require_motion_memory(
            name, repeats * sum(length for length, _, _ in cycle), rate, pieces=int(repeats) * len(cycle)
        )
    return _pieces(name, cycle * int(repeats) + rest, rate, start)


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
    """Strokes of `distance` (m) there and back, acceleration-limited, resting `dwell` (s) in between."""
    _positive("trapezoidal stroke", distance=abs(distance), speed=speed, acceleration=acceleration)
    stroke = partial(_stroke, speed=speed, acceleration=acceleration)
    return _to_and_fro("trapezoidal", stroke, distance, dwell, repeats, rate, start)


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
    """Strokes of `distance` (m) there and back with limited `jerk` (m/s^3), resting `dwell` (s) in between."""
    _positive("jerk-limited stroke", distance=abs(distance), speed=speed, acceleration=acceleration, jerk=jerk)
    stroke = partial(_jerk_stroke, speed=speed, acceleration=acceleration, jerk=jerk)
    return _to_and_fro("jerk-limited", stroke, distance, dwell, repeats, rate, start)


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

    It starts at `start`; its first velocity is not zero in general: fade in with a `from_array` of your own if the axis
    must start from rest.
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
    _finite(name, start=start)
    time = _grid(name, duration, rate, waves=len(amplitude))
    if np.any(frequency >= rate / 2):
        raise MotionError(f"{name}: {frequency.max():g} Hz is beyond half of the rate {rate:g} Hz: lower it")
    number = np.arange(len(amplitude))
    phase = -np.pi * number * (number + 1) / len(amplitude) if phases is None else np.asarray(phases, float)
    if phase.shape != amplitude.shape or not np.all(np.isfinite(phase)):
        raise MotionError(f"{name}: give as many phases (rad, finite) as amplitudes, or none")
    with guarded_arithmetic(name):
        angle = 2 * np.pi * np.outer(time, frequency) + phase
        omega = 2 * np.pi * frequency
        place = np.sin(angle) @ amplitude
        position = start + (place - place[0])
        velocity = np.cos(angle) @ (amplitude * omega)
        acceleration = -np.sin(angle) @ (amplitude * omega**2)
    require_resolved_positions(name, position, velocity)
    return Motion(time, position, velocity, acceleration, name)


def sine(*, amplitude: float, frequency: float, duration: float, rate: float, start: float = 0.0) -> Motion:
    """One sine that begins at its turning point, hence from rest: start + amplitude (1 - cos(2 pi f t))."""
    _positive("sine", amplitude=amplitude, frequency=frequency)
    return _waves("sine", [amplitude], [frequency], [-np.pi / 2], duration, rate, start)


def chirp(
    *, amplitude: float, from_frequency: float, to_frequency: float, duration: float, rate: float, start: float = 0.0
) -> Motion:
    """A sine whose frequency rises linearly from `from_frequency` to `to_frequency` (Hz), starting from rest."""
    _positive("chirp", amplitude=amplitude, from_frequency=from_frequency, to_frequency=to_frequency)
    _finite("chirp", start=start)
    time = _grid("chirp", duration, rate)
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
    """For each of `speeds` (m/s): a stroke of `travel` (m) out and back with dwells (s), as for a Stribeck curve."""
    if not len(speeds):
        raise MotionError("staircase: give at least one speed")
    _positive(
        "staircase", travel=travel, acceleration=acceleration, **{f"speeds[{i}]": s for i, s in enumerate(speeds)}
    )
    rest = _dwell("staircase", dwell)
    pieces = list(rest)
    with guarded_arithmetic("staircase"):
        for speed in speeds:
            pieces += _stroke(travel, speed, acceleration) + rest + _stroke(-travel, speed, acceleration) + rest
    return _pieces("staircase", pieces, rate, start)


def from_array(time: Sequence[float], position: Sequence[float], *, name: str = "own array") -> Motion:
    """Your own reference (s, m) on a uniform time grid; velocity and acceleration from its cubic spline."""
    t, x = np.asarray(time, float), np.asarray(position, float)
    if t.ndim != 1 or t.shape != x.shape or len(t) < 4:
        raise MotionError(f"{name}: time and position must be one-dimensional, equally long, with at least 4 samples")
    require_samples(name, t, position=x)
    mean = (t[-1] - t[0]) / (len(t) - 1)
    grid = t[0] + mean * np.arange(len(t))
    from scipy.interpolate import make_interp_spline  # a quarter of a second to import

    spline = make_interp_spline(grid, x, k=3)
    return Motion(grid - grid[0], x, spline.derivative(1)(grid), spline.derivative(2)(grid), name)
