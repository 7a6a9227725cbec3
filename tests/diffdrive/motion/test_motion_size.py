"""Every setting of every motion at values that nobody means: a motion, or one line, before memory or time is gone."""

import inspect
import time
import tracemalloc

import numpy as np
import pytest

from diffdrive.errors import MotionError
from diffdrive.motion import size as motion_size
from diffdrive.motion.motion import Motion
from diffdrive.motion.text import MOTIONS, motion_recipe
from diffdrive.support import resources

RATE = 10_000.0
SENSIBLE = {
    "triangular": "speed=10mm/s,stroke=2mm,rounding=0.05s,duration=0.3s",
    "constant_speed": "speed=10mm/s,ramp=0.1s,duration=0.3s",
    "trapezoidal": "distance=2mm,speed=10mm/s,acceleration=1",
    "jerk_limited": "distance=2mm,speed=10mm/s,acceleration=1,jerk=100",
    "sine": "amplitude=1mm,frequency=5Hz,duration=0.3s",
    "multisine": "amplitudes=1;2mm,frequencies=5;9Hz,duration=0.3s",
    "chirp": "amplitude=1mm,from_frequency=1Hz,to_frequency=20Hz,duration=0.3s",
    "staircase": "speeds=5;10mm/s,travel=2mm,acceleration=1",
}
STRANGE = [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-300, 1e-30, 1e-12, 1e-6, 1e6, 1e9, 1e12, 1e30, 1e300, 5e-324]
SECONDS = 5.0  # which the largest motion that fits into the memory below takes far less than


@pytest.fixture
def little_memory(monkeypatch):
    """So that what fits is small on every machine."""
    monkeypatch.setattr(resources, "memory_available", lambda: 60e6)


def optional_settings(name: str) -> set[str]:
    """The settings of a motion that have a default."""
    parameters = inspect.signature(MOTIONS[name]).parameters
    return {key for key, parameter in parameters.items() if parameter.default is not parameter.empty}


def strange() -> list[tuple[str, str, float]]:
    """Each setting of each motion that is a number, or a list of them, with each strange value."""
    return [
        (name, key, value)
        for name, text in SENSIBLE.items()
        for key in (*motion_recipe(f"{name}:{text}").settings, "repeats", "dwell", "start", "first_reversal", "rate")
        if key == "rate" or key in optional_settings(name) or f"{key}=" in text
        for value in STRANGE
    ]


@pytest.mark.parametrize(("name", "key", "value"), strange())
def test_a_strange_setting_makes_a_sound_motion_or_one_line(name, key, value, little_memory):
    recipe = motion_recipe(f"{name}:{SENSIBLE[name]}")
    asked = [value, value] if isinstance(recipe.settings.get(key), list) else value
    began = time.perf_counter()
    made, said = None, ""
    try:
        made = recipe.build(**{"rate": RATE, key: asked})
    except MotionError as problem:
        said = str(problem)
    assert time.perf_counter() - began < SECONDS
    if made is None:
        assert "\n" not in said
        assert len(said) < 400
        assert said.startswith((name.split("_")[0], "jerk-limited", "constant speed", "a motion of", "time grid"))
        return
    assert isinstance(made, Motion)
    assert all(np.all(np.isfinite(one)) for one in (made.position, made.velocity, made.acceleration))
    assert len(made.time) * 8 * motion_size.ARRAYS_PER_SAMPLE < 60e6


@pytest.mark.parametrize(("name", "text"), SENSIBLE.items())
def test_a_motion_takes_the_memory_that_is_reckoned_with(name, text, monkeypatch):
    reckoned = []
    monkeypatch.setattr(motion_size, "require_memory", lambda *asked: reckoned.append(asked[2]))
    long = {"duration": 5.0} if "duration" in text else {"dwell": 1.0}
    motion_recipe(f"{name}:{text}").build(rate=1000.0)  # what is imported once counts for nothing
    tracemalloc.start()
    motion_recipe(f"{name}:{text}").build(rate=20_000.0, **long)
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert 0.5 * reckoned[-1] < taken < 1.1 * reckoned[-1]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "sine:amplitude=1mm,frequency=2Hz,duration=1e6",
            r"^sine: 1e\+06 s at 10000 Hz are 1e\+10 samples, which would take ",
        ),
        (
            "trapezoidal:distance=10mm,speed=0.1,acceleration=1e-12",
            r"samples, which would take about 480 GB of memory, ",
        ),
        ("trapezoidal:distance=10mm,speed=0.1,acceleration=1,repeats=1000000000", r"and 60 MB are free: shorten or"),
        (
            "triangular:speed=1,stroke=1e-9,rounding=1e-9,duration=1",
            "reversals 1.5e-09 s apart are closer than the samples",
        ),
        ("sine:amplitude=1mm,frequency=2Hz,duration=1,start=1e300", "sine: a travel of 0 m at 1e.300 m is lost in the"),
        ("jerk_limited:distance=1e300,speed=1e-300,acceleration=1,jerk=1", "floating-point numbers: check their units"),
    ],
)
def test_what_a_motion_would_take_is_said(text, says, little_memory):
    with pytest.raises(MotionError, match=says):
        motion_recipe(text).build(rate=RATE)
