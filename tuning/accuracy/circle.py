"""The circular test (ISO 230-4:1996): an axis draws a circle with another, and a grid encoder sees how round it is.

The other axis is a sound one of the same kind, a quarter of a turn ahead or behind, so that lags that both have make a
smaller circle and no oval. What is left is what the axis does at its reversals and along its stroke:

    G  circular deviation: the range of radii about the centre of the least-squares circle
    H  circular hysteresis: the largest difference of radii, at one angle, between the two senses of rotation
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
    paths = _paths(axis, other)
    common = _centre(np.concatenate(paths, axis=1))
    one, reverse = (_radii(path, common) for path in paths)
    return Roundness(
        deviation=max(float(np.ptp(np.hypot(*(path - _centre(path))))) for path in paths),
        hysteresis=float(np.max(np.abs(one - reverse))),
    )


def radial_deviations(axis: Float[np.ndarray, " t"], other: Float[np.ndarray, " t"]) -> Float[np.ndarray, "2 t"]:
    """Radii less their mean (m) at as many even angles from 0 on, each about its centre: counter-clockwise, clockwise.

    The range of a row is the circular deviation of that sense of rotation.
    """
    radii = np.stack([_radii(path, _centre(path)) for path in _paths(axis, other)])
    return np.asarray(radii - np.mean(radii, axis=1, keepdims=True))


def _paths(axis: Float[np.ndarray, " t"], other: Float[np.ndarray, " t"]) -> list[Float[np.ndarray, "2 t"]]:
    """Both senses of rotation: the other axis a quarter of a turn behind, and ahead."""
    quarter = len(axis) // 4
    return [np.stack([axis, np.roll(other, shift)]) for shift in (quarter, -quarter)]


def _centre(path: Float[np.ndarray, "2 t"]) -> Float[np.ndarray, "2 1"]:
    """That of the least-squares circle (Kasa 1976: linear in centre and radius^2)."""
    columns = np.column_stack([2.0 * path.T, np.ones(path.shape[1])])
    return np.linalg.lstsq(columns, np.sum(path**2, axis=0))[0][:2, None]


def _radii(path: Float[np.ndarray, "2 t"], centre: Float[np.ndarray, "2 1"]) -> Float[np.ndarray, " t"]:
    """The radii at as many even angles: a lag puts samples of the two senses at others."""
    x, y = path - centre
    angles = np.linspace(0.0, 2.0 * np.pi, path.shape[1], endpoint=False)
    return np.interp(angles, np.arctan2(y, x), np.hypot(x, y), period=2.0 * np.pi)
