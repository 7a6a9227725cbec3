"""Motions: each builder's mathematics and its promises."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from diffdrive import motion as motions
from diffdrive.motion.motion import Motion

RATE = 2000.0
ROUNDING = 1e-9

few = settings(max_examples=40, deadline=None)


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    """Spread evenly over the decades from `low` to `high`."""
    return st.floats(np.log(low), np.log(high)).map(lambda x: float(np.exp(x)))


strokes = st.fixed_dictionaries(
    {
        "distance": st.tuples(st.sampled_from([-1.0, 1.0]), numbers(1e-4, 0.1)).map(lambda p: p[0] * p[1]),
        "speed": numbers(5e-3, 1.0),
        "acceleration": numbers(0.1, 20.0),
        "dwell": st.floats(2 / RATE, 0.1),
        "repeats": st.integers(1, 2),
        "start": st.floats(-0.1, 0.1),
    }
)


def one_of_each() -> dict[str, Motion]:
    return {
        "triangular": motions.triangular(speed=0.01, stroke=0.0185, rounding=0.3, duration=4.5, rate=RATE),
        "trapezoidal": motions.trapezoidal(distance=0.05, speed=0.1, acceleration=2.0, rate=RATE),
        "jerk-limited": motions.jerk_limited(distance=0.05, speed=0.1, acceleration=2.0, jerk=100.0, rate=RATE),
        "constant speed": motions.constant_speed(speed=-0.02, ramp=0.1, duration=1.0, rate=RATE),
        "staircase": motions.staircase(speeds=[0.01, 0.05], travel=0.02, acceleration=1.0, rate=RATE),
        "multisine": motions.multisine(amplitudes=[1e-3, 2e-4], frequencies=[1.0, 7.0], duration=2.0, rate=RATE),
        "sine": motions.sine(amplitude=1e-3, frequency=3.0, duration=2.0, rate=RATE),
        "chirp": motions.chirp(amplitude=1e-3, from_frequency=1.0, to_frequency=20.0, duration=2.0, rate=RATE),
        "own array": motions.from_array(np.arange(100) / RATE, np.linspace(0, 1, 100) ** 3),
    }


def gaps(integral: np.ndarray, derivative: np.ndarray, rate: float) -> np.ndarray:
    """How far each step of `integral` is from the trapezoidal rule on `derivative`, as a derivative."""
    return np.abs(np.diff(integral) * rate - (derivative[1:] + derivative[:-1]) / 2)


def assert_derivatives(motion: Motion, jerk: float, pieces: int, top: float = 0.0) -> None:
    """Where the jerk is bounded by `jerk` save at the ends of `pieces`, where the acceleration may jump to `top`.

    A ramp that begins and ends between two samples shows in the acceleration of neither.
    """
    h = 1 / motion.rate
    top = max(top, np.max(np.abs(motion.acceleration)))
    assert np.max(gaps(motion.position, motion.velocity, motion.rate)) <= top * h / 4 + ROUNDING
    steps = gaps(motion.velocity, motion.acceleration, motion.rate)
    assert np.max(steps) <= top + ROUNDING
    assert np.sum(steps > jerk * h / 4 + 1e-7 * top + ROUNDING) <= pieces


@pytest.mark.parametrize("motion", one_of_each().values(), ids=one_of_each().keys())
def test_time_grid_is_uniform_from_zero_and_arrays_are_equally_long(motion):
    assert motion.time[0] == 0
    np.testing.assert_allclose(np.diff(motion.time), 1 / RATE, rtol=1e-9)
    assert motion.rate == pytest.approx(RATE, rel=1e-12)
    assert motion.duration == pytest.approx((len(motion.time) - 1) / RATE)
    shapes = {a.shape for a in (motion.time, motion.position, motion.velocity, motion.acceleration)}
    assert shapes == {motion.time.shape}


@pytest.mark.parametrize(
    ("name", "motion"), [(n, m) for n, m in one_of_each().items() if n not in ("multisine", "own array")]
)
def test_starts_from_rest_where_told(name, motion):
    assert motion.position[0] == 0
    assert abs(motion.velocity[0]) < 1e-15


BETWEEN_SAMPLES = {"distance": -0.04, "speed": 5e-3, "acceleration": 15.0, "dwell": 0.047, "repeats": 1, "start": 0.0}


@few
@given(strokes)
@example(BETWEEN_SAMPLES)
def test_trapezoidal_keeps_its_promises(stroke):
    motion = motions.trapezoidal(**stroke, rate=RATE)
    assert_strokes(motion, stroke)
    assert_derivatives(motion, jerk=0.0, pieces=9 * stroke["repeats"], top=stroke["acceleration"])


@few
@given(strokes, numbers(1.0, 1e4))
def test_jerk_limited_keeps_its_promises(stroke, jerk):
    motion = motions.jerk_limited(**stroke, jerk=jerk, rate=RATE)
    assert_strokes(motion, stroke)
    assert_derivatives(motion, jerk=jerk, pieces=0)
    assert np.max(np.abs(np.diff(motion.acceleration))) * RATE <= jerk * (1 + ROUNDING) + ROUNDING


def assert_strokes(motion: Motion, stroke: dict) -> None:
    start, distance = stroke["start"], stroke["distance"]
    assert np.max(np.abs(motion.velocity)) <= stroke["speed"] * (1 + ROUNDING)
    assert np.max(np.abs(motion.acceleration)) <= stroke["acceleration"] * (1 + ROUNDING)
    travelled = np.sign(distance) * (motion.position - start)
    assert np.max(travelled) == pytest.approx(abs(distance), abs=1e-12)
    assert np.min(travelled) >= -1e-12
    assert (motion.position[0], motion.position[-1]) == pytest.approx((start, start), abs=1e-12)
    assert motion.velocity[-1] == pytest.approx(0, abs=1e-12)
    assert motion.acceleration[-1] == 0
    # it rests at both ends for the whole dwell
    resting = np.abs(motion.velocity) < 1e-12
    for end in (start, start + distance):
        there = resting & (np.abs(motion.position - end) < 1e-12)
        assert np.sum(there) / RATE >= stroke["repeats"] * (stroke["dwell"] - 1 / RATE)


@few
@given(strokes, numbers(1.0, 1e4))
def test_ends_at_rest_also_without_a_dwell(stroke, jerk):
    stroke = stroke | {"dwell": 0.0}
    for motion in (
        motions.trapezoidal(**stroke, rate=RATE),
        motions.jerk_limited(**stroke, jerk=jerk, rate=RATE),
        motions.staircase(speeds=[0.1], travel=0.01, acceleration=stroke["acceleration"], rate=RATE, dwell=0.0),
    ):
        assert abs(motion.velocity[-1]) < 2e-6 * stroke["acceleration"] / RATE  # a millionth of a sample early, at most
        assert motion.position[-1] == pytest.approx(motion.position[0], abs=1e-12)


def test_long_trapezoid_cruises_at_speed_and_takes_the_textbook_time():
    motion = motions.trapezoidal(distance=0.1, speed=0.2, acceleration=4.0, rate=RATE, dwell=0.1)
    assert np.max(motion.velocity) == pytest.approx(0.2)
    assert motion.duration == pytest.approx(3 * 0.1 + 2 * (0.1 / 0.2 + 0.2 / 4.0))


def test_jerk_limited_stroke_tends_to_the_trapezoid_as_the_jerk_grows():
    common = {"distance": 0.03, "speed": 0.1, "acceleration": 2.0, "rate": RATE}
    hard = motions.trapezoidal(**common)
    soft = motions.jerk_limited(**common, jerk=1e7)
    n = min(len(hard.time), len(soft.time))
    np.testing.assert_allclose(soft.position[:n], hard.position[:n], atol=1e-6)


triangles = st.fixed_dictionaries(
    {"speed": numbers(1e-3, 0.5), "rounding": st.floats(0.01, 0.2), "start": st.floats(-0.1, 0.1)}
)


@few
@given(triangles, st.floats(0.2, 1.0), st.floats(0.2, 1.0))
def test_triangular_reverses_when_promised(triangle, apart, first):
    speed, rounding = triangle["speed"], triangle["rounding"]
    motion = motions.triangular(
        **triangle, stroke=speed * (apart - rounding / 2), duration=3.0, rate=RATE, first_reversal=first
    )
    assert np.max(np.abs(motion.velocity)) <= speed * (1 + ROUNDING)
    assert np.max(np.abs(motion.acceleration)) <= 2 * speed / rounding * (1 + ROUNDING)
    assert_derivatives(motion, jerk=0.0, pieces=2 * int(3.0 / apart) + 5)

    reversals = np.arange(first, 3.0 - rounding, apart)
    half = np.floor(rounding / 2 * RATE) / RATE
    for number, at in enumerate(reversals):
        direction = (-1) ** number  # from + to -, then back
        around = at + np.array([-half, -half / 2, 0.0, half / 2, half])
        expected = direction * speed * (at - around) * 2 / rounding
        np.testing.assert_allclose(np.interp(around, motion.time, motion.velocity), expected, atol=speed / RATE / 0.01)
    between = np.abs(motion.time[:, None] - reversals).min(axis=1) > rounding / 2 + 1 / RATE
    cruising = between & (motion.time > rounding / 2 + 1 / RATE) & (motion.time < reversals[-1])
    np.testing.assert_allclose(np.abs(motion.velocity[cruising]), speed, rtol=1e-9)


def test_triangular_turning_points_are_the_stroke_apart():
    motion = motions.triangular(speed=0.01, stroke=0.0185, rounding=0.3, duration=4.5, rate=RATE, first_reversal=2.05)
    turns = motion.position[np.isin(np.round(motion.time, 9), [2.05, 4.05])]
    assert abs(np.diff(turns)[0]) == pytest.approx(0.0185, abs=1e-12)


@few
@given(st.sampled_from([-1.0, 1.0]), numbers(1e-3, 0.5), st.floats(0.01, 0.5), st.floats(-0.1, 0.1))
def test_constant_speed_is_reached_by_the_end_of_its_ramp_and_kept(sign, speed, ramp, start):
    motion = motions.constant_speed(speed=sign * speed, ramp=ramp, duration=1.0, rate=RATE, start=start)
    up = motion.time < ramp - 1e-6 / RATE
    np.testing.assert_allclose(motion.velocity[~up], sign * speed, rtol=1e-6)
    np.testing.assert_allclose(motion.acceleration[up], sign * speed / ramp, rtol=1e-12)
    assert np.all(motion.acceleration[~up] == 0)
    assert (motion.position[0], motion.velocity[0]) == (start, 0.0)
    assert motion.position[-1] == pytest.approx(start + sign * speed * (1.0 - ramp / 2), abs=1e-12)
    assert_derivatives(motion, jerk=0.0, pieces=2)


def test_staircase_dwells_at_each_speed_in_both_directions():
    speeds = [0.0021, 0.0107, 0.0503]  # none is passed by the ramp to a higher one
    motion = motions.staircase(speeds=speeds, travel=0.02, acceleration=2.0, rate=RATE, dwell=0.2, start=0.01)
    for speed in speeds:
        ramp = speed**2 / 2.0  # both ramps together
        for sign in (1, -1):
            there = np.abs(motion.velocity - sign * speed) < 1e-12
            assert np.sum(there) / RATE == pytest.approx((0.02 - ramp) / speed, abs=1.5 / RATE)
            assert np.all(motion.acceleration[there][:-1] == 0)
    assert np.ptp(motion.position) == pytest.approx(0.02, abs=1e-12)
    assert (motion.position[0], motion.position[-1]) == pytest.approx((0.01, 0.01), abs=1e-12)
    assert np.max(np.abs(motion.acceleration)) <= 2.0
    assert_derivatives(motion, jerk=0.0, pieces=8 * len(speeds) + 1)


waves = {"amplitude": numbers(1e-6, 0.1), "start": st.floats(-0.1, 0.1)}


def assert_smooth_derivatives(motion: Motion, amplitude: float, omega: float) -> None:
    """The trapezoidal rule errs by h^2 / 12 times the second derivative of what it integrates."""
    h, scale = 1 / motion.rate, 1.5 / 12
    assert np.max(gaps(motion.position, motion.velocity, motion.rate)) <= scale * amplitude * omega**3 * h**2 + 1e-9
    assert np.max(gaps(motion.velocity, motion.acceleration, motion.rate)) <= scale * amplitude * omega**4 * h**2 + 1e-6


@few
@given(st.fixed_dictionaries(waves), numbers(0.5, 100.0))
def test_sine_starts_at_rest_at_its_turning_point(wave, frequency):
    motion = motions.sine(**wave, frequency=frequency, duration=1.0, rate=RATE)
    a, omega = wave["amplitude"], 2 * np.pi * frequency
    assert motion.position[0] == wave["start"]
    assert abs(motion.velocity[0]) < 1e-12 * omega
    np.testing.assert_allclose(motion.position, wave["start"] + a * (1 - np.cos(omega * motion.time)), atol=1e-12)
    assert_smooth_derivatives(motion, a, omega)


@few
@given(st.fixed_dictionaries(waves), numbers(0.5, 100.0), numbers(0.5, 100.0))
def test_chirp_starts_at_rest_and_sweeps_between_its_frequencies(wave, low, high):
    motion = motions.chirp(**wave, from_frequency=low, to_frequency=high, duration=1.0, rate=RATE)
    assert motion.position[0] == wave["start"]
    assert abs(motion.velocity[0]) < 1e-12
    omega = 2 * np.pi * max(low, high)
    assert_smooth_derivatives(motion, wave["amplitude"], omega + np.sqrt(2 * np.pi * abs(high - low)))
    # turning points: one per half turn of the phase
    turns = np.sum(np.diff(np.sign(motion.velocity[1:])) != 0)
    assert turns == pytest.approx(low + high, abs=2)  # 2 * mean frequency * 1 s


@few
@given(
    # of different frequencies: two of one may cancel, and there is no motion
    st.lists(
        st.tuples(numbers(1e-5, 1e-2), numbers(0.5, 50.0), st.floats(-np.pi, np.pi)),
        min_size=1,
        max_size=6,
        unique_by=lambda tone: tone[1],
    ),
    st.booleans(),
)
def test_multisine_is_the_sum_of_its_sines(tones, own_phases):
    amplitudes, frequencies, phases = map(list, zip(*tones, strict=True))
    motion = motions.multisine(
        amplitudes=amplitudes,
        frequencies=frequencies,
        phases=phases if own_phases else None,
        duration=1.0,
        rate=RATE,
        start=0.02,
    )
    assert motion.position[0] == 0.02
    assert_smooth_derivatives(motion, sum(amplitudes), 2 * np.pi * max(frequencies))


def test_schroeder_phases_keep_the_peak_below_that_of_equal_phases():
    tones = {"amplitudes": [1e-3] * 16, "frequencies": np.arange(1.0, 17.0), "duration": 1.0, "rate": RATE}
    spread, aligned = motions.multisine(**tones), motions.multisine(**tones, phases=[np.pi / 2] * 16)
    assert np.ptp(spread.position) < 0.6 * np.ptp(aligned.position)


def test_from_array_finds_the_analytic_derivatives():
    t = 3.0 + np.arange(2001) / RATE  # a log need not start at zero
    omega = 2 * np.pi * 5
    motion = motions.from_array(t, 0.01 * np.sin(omega * t), name="log")
    inner = slice(5, -5)
    np.testing.assert_allclose(motion.velocity, 0.01 * omega * np.cos(omega * t), atol=1e-4 * 0.01 * omega)
    exact = -0.01 * omega**2 * np.sin(omega * t)
    np.testing.assert_allclose(motion.acceleration[inner], exact[inner], atol=1e-3 * 0.01 * omega**2)
    assert motion.time[0] == 0
    assert motion.name == "log"


def test_from_array_is_exact_for_a_cubic():
    t = np.arange(50) / RATE
    x = 2 * t**3 - t**2 + 0.5 * t
    motion = motions.from_array(t, x)
    np.testing.assert_allclose(motion.velocity, 6 * t**2 - 2 * t + 0.5, rtol=1e-9)
    np.testing.assert_allclose(motion.acceleration, 12 * t - 2, atol=1e-6)
    np.testing.assert_array_equal(motion.position, x)


def test_from_array_accepts_time_stamps_rounded_to_a_microsecond():
    t = np.round(np.arange(100) / 3000.0, 7)
    assert motions.from_array(t, t**2).rate == pytest.approx(3000.0, rel=1e-5)
