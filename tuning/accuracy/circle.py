"""The circular test (ISO 230-4): an axis draws a circle with another one, and the grid encoder sees how round it is.

The other axis is a sound one of the same kind, a quarter of a turn ahead or behind, so that lags that both have make a
smaller circle and no oval. What is left is what the axis does at its reversals and along its stroke:

    G  circular deviation: the range of radii about the centre of the least-squares circle (ISO 230-4, 3.5)
    H  circular hysteresis: the largest difference of radii between the two senses of rotation (3.6)
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive.motion import builders
from diffdrive.motion.motion import Motion

TURNS = 3  # the last is measured: before it, observers and friction settle
STROKE_SHARE = 0.25  # of the stroke: the radius
FASTEST_SHARE = 0.5  # of the speed


class Circle(NamedTuple):
    """The axis's share of a circle."""

    motion: Motion  # of the axis: `TURNS` turns from a turning point
    radius: float  # m
    samples: int  # of a turn, a multiple of four


class Roundness(NamedTuple):
    """What the test says of an axis, in m."""

    deviation: float  # G, of the worse sense of rotation
    hysteresis: float  # H


def circle_between(low: float, high: float, speed: float, acceleration: float, rate: float) -> Circle:
    """A circle in the middle of `low` to `high` (m), as fast as `speed` and `acceleration` permit."""
    radius = STROKE_SHARE * (high - low)
    feed = min(FASTEST_SHARE * speed, float(np.sqrt(radius * acceleration)))
    samples = 4 * int(np.ceil(0.25 * rate * 2.0 * np.pi * radius / feed))
    motion = builders.sine(
        amplitude=radius, frequency=rate / samples, duration=TURNS * samples / rate, rate=rate,
        start=0.5 * (low + high) - radius,
    )  # fmt: skip
    return Circle(motion, radius, samples)


def last_turn(position: Float[np.ndarray, " n"], circle: Circle) -> Float[np.ndarray, " t"]:
    """A run's last turn (m) about the middle of the circle."""
    return position[-1 - circle.samples : -1] - (circle.motion.position[0] + circle.radius)


def roundness(axis: Float[np.ndarray, " t"], other: Float[np.ndarray, " t"]) -> Roundness:
    """ISO 230-4 of one turn of the axis (m, about the middle) beside the same turn of the other, which is shifted."""
    quarter = len(axis) // 4
    senses = [np.hypot(axis, np.roll(other, shift)) for shift in (quarter, -quarter)]
    there = [np.stack([axis, np.roll(other, shift)]) for shift in (quarter, -quarter)]
    backwards = np.roll(senses[1][::-1], 1)  # at the angles of the other sense
    return Roundness(
        deviation=max(_range_about_centre(path) for path in there),
        hysteresis=float(np.max(np.abs(senses[0] - backwards))),
    )


def _range_about_centre(path: Float[np.ndarray, "2 t"]) -> float:
    """Range of the radii about the centre of the least-squares circle (Kasa 1976: linear in centre and radius^2)."""
    columns = np.column_stack([2.0 * path.T, np.ones(path.shape[1])])
    centre = np.linalg.lstsq(columns, np.sum(path**2, axis=0))[0][:2]
    return float(np.ptp(np.hypot(*(path - centre[:, None]))))
