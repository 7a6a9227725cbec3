"""Where the gap lies: shares of its energy by phase of motion, direction, speed, place, frequency, load and time.

A share means nothing by itself: a third of the energy in a third of the time is what chance would give. Each is held
against what it is when the same energy, in the order in which it came, is laid elsewhere over the motion (shifted round
and round the log): the p-value is how often chance does as well. Lines in time and in position are held against the
median of their neighbourhood, and paid for by how many places were looked at.
"""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.ndimage
from jaxtyping import Bool, Float

from tuning.diagnosis.gap import ForceGap
from tuning.diagnosis.lines import Line, lines_in_position, lines_in_time
from tuning.prediction import Lanes

SHIFTS = 400  # of the energy against the motion
SLOWEST = 2e-4  # m/s, below which the table is at rest
SETTLING = 0.05  # s about a change of direction that count as the reversal
STEADY = 0.15  # of the largest acceleration, below which a motion is a cruise
PLACES, TIMES, SPEEDS = 6, 6, 4
BANDS = (0.0, 2.0, 10.0, 30.0, 100.0)  # Hz; above, the force is the measuring noise
SIGNIFICANT = 0.05

Labels = Bool[np.ndarray, "lanes n"]


class Region(NamedTuple):
    """A part of the logs and its share of the gap's energy."""

    dimension: str
    region: str
    share: float
    expected: float  # share of the time
    p_value: float
    says: str


class Motion(NamedTuple):
    """The motion that the regions are of, [lanes, n] each."""

    position: Float[np.ndarray, "lanes n"]  # m
    velocity: Float[np.ndarray, "lanes n"]  # m/s
    acceleration: Float[np.ndarray, "lanes n"]  # m/s^2
    counts: Float[np.ndarray, "lanes n"]


def motion_of(gap: ForceGap, rate: float) -> Motion:
    """The filtered motion, its velocity smoothed over 10 ms and differentiated."""
    width = max(3, round(0.01 * rate))
    velocity = scipy.ndimage.uniform_filter1d(np.asarray(gap.course.velocity), width, axis=1)
    acceleration = scipy.ndimage.uniform_filter1d(np.gradient(velocity, axis=1) * rate, width, axis=1)
    return Motion(np.asarray(gap.course.position), velocity, acceleration, gap.counts)


def phases(motion: Motion, rate: float) -> dict[str, Labels]:
    """Rest, reversal, acceleration, cruise: each sample is in one."""
    moving = np.abs(motion.velocity) > SLOWEST
    direction = np.where(moving, np.sign(motion.velocity), 0.0)
    near = max(1, round(SETTLING * rate))
    ahead = scipy.ndimage.maximum_filter1d(direction, 2 * near + 1, axis=1)
    behind = scipy.ndimage.minimum_filter1d(direction, 2 * near + 1, axis=1)
    turning = (ahead > 0) & (behind < 0)
    starting = (ahead != behind) & ~turning  # between rest and motion
    rest = ~moving & ~turning & ~starting
    strong = np.abs(motion.acceleration) > STEADY * np.percentile(np.abs(motion.acceleration), 99.5)
    left = ~(turning | starting | rest)
    return {
        "rest": rest,
        "reversal": turning,
        "start and stop": starting,
        "acceleration": left & strong,
        "cruise": left & ~strong,
    }


class _Shares:
    """Shares of the energy beyond the floor, and of the energy laid elsewhere."""

    def __init__(self, gap: ForceGap, every: Float[np.ndarray, "lanes n"], seed: int) -> None:
        self.counted = every > 0
        self.energy = gap.surprise[self.counted]
        offsets = np.random.default_rng(seed).integers(1, len(self.energy), SHIFTS)
        self.shifted = [np.roll(self.energy, offset) for offset in offsets]

    def region(self, dimension: str, name: str, inside: Labels, says: Callable[[float, float], str]) -> Region | None:
        """The share of a region, if it is one: neither nothing nor everything."""
        here = inside[self.counted]
        expected = float(here.mean())
        if not 0.005 < expected < 0.995:
            return None
        total = max(float(self.energy.sum()), 1e-300)
        share = float(self.energy[here].sum()) / total
        chance = np.array([one[here].sum() for one in self.shifted]) / total
        p = float((1 + np.sum(chance >= share)) / (1 + SHIFTS))
        return Region(dimension, name, share, expected, p, says(share, expected))


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _plainly(what: str) -> Callable[[float, float], str]:
    return lambda share, expected: f"{_percent(share)} of the gap lies {what}, in {_percent(expected)} of the time"


def localise(gap: ForceGap, lanes: Lanes, owner: tuple[int, ...], rate: float, seed: int = 0) -> list[Region]:
    """Every region of every dimension, the most telling first."""
    motion, every = motion_of(gap, rate), np.asarray(lanes.counts)
    shares = _Shares(gap, every, seed)
    asked: list[tuple[str, str, Labels, str]] = []
    words = {
        "rest": "where the table rests",
        "reversal": "at reversals",
        "start and stop": "where the table starts or stops",
        "acceleration": "where it accelerates or brakes",
        "cruise": "at constant speed",
    }
    asked += [("phase", name, inside, words[name]) for name, inside in phases(motion, rate).items()]
    ahead, back = motion.velocity > SLOWEST, motion.velocity < -SLOWEST
    asked += [("direction", "positive", ahead, "in positive direction")]
    asked += [("direction", "negative", back, "in negative direction")]
    speed = np.abs(motion.velocity)
    asked += _bands("speed", speed, speed > SLOWEST, every, SPEEDS, 1e3, "mm/s", "at speeds of")
    asked += _bands("position", motion.position, every > 0, every, PLACES, 1e3, "mm", "at positions of")
    load = np.asarray(lanes.load)
    if np.ptp(load[every > 0]) > 0.0:
        asked += _bands("load", load, every > 0, every, 3, 1.0, "N", "under loads of")
    time = np.broadcast_to(np.arange(gap.force.shape[1]) / rate, gap.force.shape)
    for log in sorted(set(owner)):
        mine = np.array([one == log for one in owner])[:, None] & (every > 0)
        if len(set(owner)) > 1:
            asked.append(("log", f"log {log + 1}", mine, f"in log {log + 1}"))
        named = f"in log {log + 1} at times of" if len(set(owner)) > 1 else "at times of"
        asked += _bands("time", time, mine, every, TIMES, 1.0, "s", named)
    found = [shares.region(dimension, name, inside, _plainly(what)) for dimension, name, inside, what in asked]
    regions = [one for one in found if one is not None]
    regions += _frequencies(gap, rate)
    regions += [_line(one) for one in lines_in_time(gap.force, rate) if one.p_value < SIGNIFICANT]
    for one in lines_in_position(gap.force, motion.position, gap.counts):
        if one.p_value < SIGNIFICANT:
            regions.append(_line(one))
    return sorted(regions, key=lambda one: (one.p_value > SIGNIFICANT, -(one.share - one.expected)))


def _bands(
    dimension: str,
    signal: np.ndarray,
    where: Labels,
    counts: np.ndarray,
    number: int,
    scale: float,
    unit: str,
    what: str,
) -> list[tuple[str, str, Labels, str]]:
    """Bands with equal shares of the time."""
    inside = where & (counts > 0)
    if not inside.any():
        return []
    edges = np.unique(np.percentile(signal[inside], np.linspace(0, 100, number + 1)))
    found = []
    for low, high in itertools.pairwise(edges):
        last = high == edges[-1]
        name = f"{scale * low:.3g} to {scale * high:.3g} {unit}"
        here = inside & (signal >= low) & ((signal <= high) if last else (signal < high))
        found.append((dimension, name, here, f"{what} {name}"))
    return found


def _frequencies(gap: ForceGap, rate: float) -> list[Region]:
    """Shares of frequency bands; expected is the share that the floor, a filtered white noise, has there."""
    power = np.sum(np.abs(np.fft.rfft(gap.force, axis=1)) ** 2, axis=0)
    noise = np.random.default_rng(0).standard_normal(gap.force.shape) * gap.counts
    fade = np.exp(-1.0 / (0.02 * rate))
    floor = np.sum(np.abs(np.fft.rfft(noise, axis=1)) ** 2, axis=0)
    axis = np.fft.rfftfreq(gap.force.shape[1], 1.0 / rate)
    floor = floor / np.abs(1.0 - fade * np.exp(-2j * np.pi * axis / rate)) ** 2
    found = []
    for low, high in itertools.pairwise(BANDS):
        inside = (axis >= low) & (axis < high)
        if not inside.any() or low > 0.5 * rate:
            continue
        share, expected = (float(one[inside].sum() / max(one.sum(), 1e-300)) for one in (power, floor))
        # independent cells of the spectrum: how often would white noise have as much here
        cells = max(1, int(inside.sum()))
        ratio = share / max(expected, 1e-9)
        p = float(np.exp(-cells * (ratio - 1.0 - np.log(ratio)))) if ratio > 1.0 else 1.0
        name = f"{low:g} to {min(high, 0.5 * rate):g} Hz"
        found.append(Region("frequency", name, share, expected, p, f"{_percent(share)} of the gap lies at {name}"))
    return found


def _line(line: Line) -> Region:
    if line.dimension == "frequency":
        says = f"a line at {line.value:.4g} Hz, locked to time, with {_percent(line.share)} of the gap"
        return Region("frequency", f"line at {line.value:.4g} Hz", line.share, 0.0, line.p_value, says)
    millimetres = 1e3 * line.value
    says = f"a ripple every {millimetres:.4g} mm of travel, locked to position, with {_percent(line.share)} of the gap"
    return Region("position", f"period of {millimetres:.4g} mm", line.share, 0.0, line.p_value, says)
