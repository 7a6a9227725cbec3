"""Motions: the limits check, and what the builders refuse."""

import numpy as np
import pytest

from diffdrive import motion as motions
from diffdrive.errors import MotionError
from diffdrive.motion.motion import Limits, Motion, require_within

RATE = 2000.0


# --- limits -----------------------------------------------------------------------------------------------------------

MOVE = motions.trapezoidal(distance=0.1, speed=0.2, acceleration=4.0, rate=RATE, dwell=0.1)


@pytest.mark.parametrize(
    ("limits", "what", "unit", "at"),
    [
        (Limits(stroke=(0.0, 0.05)), "position", "m", 0.1 + 0.05 / 2 + 0.05 / 0.2),
        (Limits(stroke=(0.01, 0.2)), "position", "m", 0.0),
        (Limits(speed=0.1), "speed", "m/s", 0.1 + 0.1 / 4.0),
        (Limits(acceleration=3.9), "acceleration", "m/s^2", 0.1),
    ],
)
def test_require_within_names_quantity_time_and_mend(limits, what, unit, at):
    with pytest.raises(MotionError) as caught:
        require_within(MOVE, limits)
    message = str(caught.value)
    assert message.startswith(f"motion 'trapezoidal': {what} leaves ")
    assert f" {unit})" in message
    assert "Shorten or slow the motion, or correct the limits" in message
    first = float(message.split("first at t = ")[1].split(" s")[0])
    assert first == pytest.approx(at, abs=1.5 / RATE)


def test_require_within_names_every_limit_at_once():
    with pytest.raises(MotionError, match=r"position.*speed.*acceleration"):
        require_within(MOVE, Limits((0.0, 0.05), 0.1, 1.0))


def test_require_within_returns_the_motion_that_just_fits():
    assert require_within(MOVE, Limits((0.0, 0.1), 0.2, 4.0)) is MOVE
    assert require_within(MOVE, Limits()) is MOVE


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        ("position", np.nan, "position is not finite at sample 200"),
        ("velocity", np.inf, "velocity is not finite at sample 200"),
        ("acceleration", np.nan, "acceleration is not finite at sample 200"),
        ("time", MOVE.time[200] + 0.2 / RATE, "time is not uniform"),
        ("time", 0.0, "time does not increase at sample 200"),
    ],
)
def test_a_hand_made_motion_is_checked_too(column, value, says):
    columns = {name: getattr(MOVE, name).copy() for name in ("time", "position", "velocity", "acceleration")}
    columns[column][200] = value
    with pytest.raises(MotionError, match=f"motion 'mine': {says}"):
        Motion(**columns, name="mine")


@pytest.mark.parametrize(
    ("bad", "named"),
    [
        ({"stroke": (0.1, 0.0)}, "stroke"),
        ({"stroke": (np.nan, 0.0)}, "stroke"),
        ({"speed": np.nan}, "speed"),
        ({"speed": -1.0}, "speed"),
        ({"acceleration": 0.0}, "acceleration"),
    ],
)
def test_limits_that_make_no_sense_are_refused(bad, named):
    with pytest.raises(MotionError, match=named):
        Limits(**bad)


# --- bad input --------------------------------------------------------------------------------------------------------

GOOD = {
    "triangular": (motions.triangular, {"speed": 0.01, "stroke": 0.02, "rounding": 0.1, "duration": 1.0}),
    "trapezoidal": (motions.trapezoidal, {"distance": 0.01, "speed": 0.1, "acceleration": 1.0}),
    "jerk_limited": (motions.jerk_limited, {"distance": 0.01, "speed": 0.1, "acceleration": 1.0, "jerk": 10.0}),
    "constant_speed": (motions.constant_speed, {"speed": 0.01, "ramp": 0.1, "duration": 1.0}),
    "staircase": (motions.staircase, {"speeds": [0.01], "travel": 0.01, "acceleration": 1.0}),
    "sine": (motions.sine, {"amplitude": 1e-3, "frequency": 2.0, "duration": 1.0}),
    "chirp": (motions.chirp, {"amplitude": 1e-3, "from_frequency": 1.0, "to_frequency": 2.0, "duration": 1.0}),
    "multisine": (motions.multisine, {"amplitudes": [1e-3], "frequencies": [2.0], "duration": 1.0}),
}


def _nonsense() -> list[tuple[str, str, float]]:
    """Each field with each value that it cannot have; a start may be anything finite, and some point either way."""
    cases = []
    for name, (_, good) in GOOD.items():
        for field in [*good, "rate", "start"]:
            finite = {"start": [], "distance": [0.0], "amplitudes": []}.get(field, [0.0, -1.0])
            finite = [0.0] if (name, field) == ("constant_speed", "speed") else finite
            cases += [(name, field, value) for value in [np.nan, np.inf, *finite]]
    return cases


@pytest.mark.parametrize(("name", "field", "value"), _nonsense())
def test_builders_refuse_nonsense_and_name_it(name, field, value):
    build, good = GOOD[name]
    listed = isinstance(good.get(field), list)
    with pytest.raises(MotionError, match=field.removesuffix("s") if listed else field):
        build(**({"rate": RATE} | good | {field: [value] if listed else value}))


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("triangular", {"rounding": 5.0}, "rounding of 5 s does not fit.*round less"),
        ("triangular", {"first_reversal": 0.05}, "does not fit"),
        ("triangular", {"first_reversal": np.nan}, "first_reversal = nan"),
        ("triangular", {"duration": 1e-4}, "fewer than three samples: make it longer"),
        ("sine", {"duration": 1e-4}, "fewer than three samples"),
        ("sine", {"frequency": 1000.0}, "1000 Hz is beyond half of the rate 2000 Hz: lower it"),
        ("chirp", {"to_frequency": 1500.0}, "1500 Hz is beyond half of the rate"),
        ("chirp", {"from_frequency": 1500.0}, "1500 Hz is beyond half of the rate"),
        ("multisine", {"frequencies": [2000.0]}, "beyond half of the rate"),
        ("multisine", {"frequencies": [1.0, 2.0]}, "as many amplitudes as frequencies"),
        ("multisine", {"amplitudes": [], "frequencies": []}, "at least one"),
        ("multisine", {"phases": [0.0, 1.0]}, "as many phases"),
        ("multisine", {"phases": [np.nan]}, "phases"),
        ("staircase", {"speeds": []}, "at least one speed"),
        ("staircase", {"speeds": [0.1, -0.1]}, r"speeds\[1\] = -0.1"),
        ("staircase", {"dwell": -1.0}, "dwell"),
        ("staircase", {"dwell": np.nan}, "dwell"),
        ("trapezoidal", {"dwell": np.nan}, "dwell"),
        ("trapezoidal", {"repeats": 0}, "repeats = 0 must be a whole number"),
        ("trapezoidal", {"repeats": 1.5}, "repeats = 1.5 must be a whole number"),
        ("jerk_limited", {"repeats": np.nan}, "repeats = nan must be a whole number"),
    ],
)
def test_builders_say_what_does_not_fit(name, change, says):
    build, good = GOOD[name]
    with pytest.raises(MotionError, match=says):
        build(**({"rate": RATE} | good | change))


def _array(change: str) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(20) / RATE
    x = t.copy()
    match change:
        case "NaN position":
            x[7] = np.nan
        case "infinite time":
            t[3] = np.inf
        case "missed sample":
            t[10:] += 1 / RATE
        case "decreasing":
            t[5] = t[3]
        case "repeated":
            t[5] = t[4]
        case "too few":
            t, x = t[:3], x[:3]
        case "lengths":
            x = x[:-1]
        case "two columns":
            t, x = np.stack([t, t]), np.stack([x, x])
    return t, x


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("NaN position", "position is not finite at sample 7"),
        ("infinite time", "time is not finite at sample 3"),
        ("missed sample", r"not uniform: step 0\.001 s at t = 0\.0045 s, .* resample it first"),
        ("decreasing", "time does not increase at sample 5"),
        ("repeated", "time does not increase at sample 5"),
        ("too few", "at least 4 samples"),
        ("lengths", "equally long"),
        ("two columns", "one-dimensional"),
    ],
)
def test_from_array_says_what_is_wrong_with_the_array(change, says):
    with pytest.raises(MotionError, match=f"own array: .*{says}"):
        motions.from_array(*_array(change))
