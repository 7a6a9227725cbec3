"""Where the gap lies: shares of its energy by phase of motion, direction, speed, place, frequency, load and time.

A share means nothing by itself: a third of the energy in a third of the time is what chance would give. Each is held
against what it is when the same energy, in pieces of a quarter of a second, is laid elsewhere over the motion: the
p-value is how often chance does as well. Frequency bands are held against the spectrum that the measuring noise makes,
lines against the median of their neighbourhood, paid for by how many bins were looked at. Of so many regions some would
stand out by chance: every p-value is raised for that (Benjamini and Hochberg 1995).
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.ndimage
import scipy.signal
import scipy.stats
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from tuning.diagnosis.blocks import BLOCK
from tuning.diagnosis.filter.ekf import DISTURBANCE_TIME
from tuning.diagnosis.gap.gap import ForceGap
from tuning.diagnosis.gap.lines import Standing, lines_in_position, lines_in_time, told_apart
from tuning.diagnosis.levels import DECLARED
from tuning.identification.prediction import Lanes
from tuning.identification.shown_motion import SLOWEST

LAID = 4000  # times that the energy is laid elsewhere: a single region must stand out from some forty
TOGETHER = 2**20  # cells that are laid out anew at once
CELL = 5e-3  # s: the resolution within a block, whose cells are laid together
SETTLING = 0.05  # s about a change of direction that count as the reversal
STEADY = 0.15  # of the largest acceleration, below which a motion is a cruise
PLACES, TIMES, SPEEDS = 6, 6, 4
BANDS = (0.0, 2.0, 10.0, 30.0, 100.0)  # Hz; above, the force is the measuring noise
FAINT = 0.01  # of the gap: a line or a band with less is not worth telling, sure as it may be
SIGNIFICANT = DECLARED

Labels = Bool[np.ndarray, "lanes n"]


class Region(NamedTuple):
    """A part of the logs and its share of the gap's energy."""

    dimension: str
    region: str
    share: float
    expected: float  # by chance: see `_shares`; of the noise, for a band of frequencies; 0 for a line
    p_value: float  # that chance does as well in any of the regions looked at
    says: str
    low: float | None = None  # ends of a band, in SI units
    high: float | None = None

    @property
    def is_band(self) -> bool:
        """Whether it is a band of frequencies."""
        return self.dimension == "frequency" and self.low is not None


class Motion(NamedTuple):
    """The motion that the regions are of, [lanes, n] each."""

    position: Float[np.ndarray, "lanes n"]  # m
    velocity: Float[np.ndarray, "lanes n"]  # m/s
    acceleration: Float[np.ndarray, "lanes n"]  # m/s^2


def motion_of(gap: ForceGap, rate: float) -> Motion:
    """The filtered motion, its velocity smoothed over 10 ms and differentiated."""
    width = max(3, round(0.01 * rate))
    velocity = scipy.ndimage.uniform_filter1d(np.asarray(gap.trajectory.velocity), width, axis=1)
    acceleration = scipy.ndimage.uniform_filter1d(np.gradient(velocity, axis=1) * rate, width, axis=1)
    return Motion(np.asarray(gap.trajectory.position), velocity, acceleration)


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


def ranked(regions: Sequence[Region], unlisted: int = 0) -> list[Region]:
    """The regions with p-values paid for by how many were looked at, `unlisted` ones besides these.

    Significant ones first, and among these those with most of the gap beyond what was expected; bands of frequencies
    behind the rest, since most of any gap lies below the noise's. To be called once, with every region of a kind and
    p-values that nothing was paid for yet.
    """
    if not regions:
        return []
    each = np.array([one.p_value for one in regions])
    paid = np.asarray(scipy.stats.false_discovery_control(np.r_[each, np.ones(unlisted)]))[: len(regions)]
    found = [one._replace(p_value=float(p)) for one, p in zip(regions, paid, strict=True)]
    return sorted(found, key=lambda one: (one.p_value >= SIGNIFICANT, one.is_band, one.expected - one.share))


class _Asked(NamedTuple):
    """A region that is looked at; `says` is where, in words."""

    dimension: str
    region: str
    inside: Labels
    says: str
    low: float | None = None
    high: float | None = None


def _shares(
    gap: ForceGap,
    every: Float[np.ndarray, "lanes n"],
    asked: list[_Asked],
    rate: float,
    within: Labels | bool = True,
    alike: str = "in {} of the time",
) -> list[Region]:
    """The regions that are neither nothing nor everything of what lies `within`; each p-value is how often chance does
    as well there, which gives a region the same share of what lies within as of its time; `alike` says what that is.
    """
    total, counted = gap.surprise[every > 0].sum(), (every > 0) & within
    if not counted.any():
        return []
    asked = [one for one in asked if 0.005 < one.inside[counted].mean() < 0.995]
    energy = gap.surprise[counted]
    if not asked or not energy.sum() > 0.0:
        return []
    starts = np.arange(0, len(energy), max(1, round(CELL * rate)))
    lengths = np.diff(np.r_[starts, len(energy)])
    cells = np.add.reduceat(energy, starts) / energy.sum()
    inside = np.array([np.add.reduceat(one.inside[counted].astype(float), starts) / lengths for one in asked])
    observed, as_well = inside @ cells, np.zeros(len(asked))
    piece = np.arange(len(cells)) // max(1, round(BLOCK / CELL))
    room = np.random.default_rng(0)
    for laid in np.diff(np.r_[0 : LAID : max(1, TOGETHER // len(cells)), LAID]):
        order = np.argsort(room.random((laid, piece[-1] + 1))[:, piece], axis=1, kind="stable")
        turned = (order + room.integers(len(cells), size=(laid, 1))) % len(cells)
        as_well += np.sum(inside @ cells[turned].T >= observed[:, None] * (1.0 - 1e-9), axis=1)
    found = []
    for one, chance in zip(asked, (1 + as_well) / (1 + LAID), strict=True):
        here = one.inside[counted]
        share, expected = float(energy[here].sum() / total), float(here.mean() * energy.sum() / total)
        says = f"{_percent(share)} of the gap lies {one.says}, {alike.format(_percent(expected))}"
        found.append(Region(one.dimension, one.region, share, expected, float(chance), says, one.low, one.high))
    return found


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def localise(
    gap: ForceGap,
    lanes: Lanes,
    owner: tuple[int, ...],
    rate: float,
    *,
    starts: ArrayLike = 0.0,
    noise: Float[np.ndarray, "lanes n draws"] | None = None,
    lead: float | None = None,
    others: Sequence[Region] = (),
) -> list[Region]:
    """Every region of every dimension, the most telling first, and those of `others` behind the rest.

    `starts` (s) is when each lane begins in its log. `noise` (N) is the force that a sound model would seem to lack,
    from the measuring noise alone: without it no band of frequencies is significant, since the filter colours noise;
    where the filter was lost, none is told.
    With `lead` (m), where that of the screw is known, periods are given per turn as well. `others` are regions from
    elsewhere, their p-values not yet paid for: they are paid for among themselves, since what explains a gap is next to
    certain to do so, and would pay for all that stand beside it.
    """
    motion, every = motion_of(gap, rate), np.asarray(lanes.counts)
    asked: list[_Asked] = []
    words = {
        "rest": "where the table rests",
        "reversal": "at reversals",
        "start and stop": "where the table starts or stops",
        "acceleration": "where it accelerates or brakes",
        "cruise": "at constant speed",
    }
    asked += [_Asked("phase", name, inside, words[name]) for name, inside in phases(motion, rate).items()]
    ahead, back = motion.velocity > SLOWEST, motion.velocity < -SLOWEST
    speed = np.abs(motion.velocity)
    moved = [
        _Asked("direction", "positive", ahead, "in positive direction"),
        _Asked("direction", "negative", back, "in negative direction"),
        *_bands("speed", speed, speed > SLOWEST, every, SPEEDS, 1e3, "mm/s", "at speeds of"),
    ]
    asked += _bands("position", motion.position, every > 0, every, PLACES, 1e3, "mm", "at positions of")
    load = np.asarray(lanes.load)
    if np.ptp(load[every > 0]) > 0.0:
        asked += _bands("load", load, every > 0, every, 3, 1.0, "N", "under loads of")
    time = np.broadcast_to(np.reshape(starts, (-1, 1)) + np.arange(gap.force.shape[1]) / rate, gap.force.shape)
    for log in sorted(set(owner)):
        mine = np.array([one == log for one in owner])[:, None] & (every > 0)
        if len(set(owner)) > 1:
            asked.append(_Asked("log", f"log {log + 1}", mine, f"in log {log + 1}"))
        named = f"in log {log + 1} at times of" if len(set(owner)) > 1 else "at times of"
        asked += _bands("time", time, mine, every, TIMES, 1.0, "s", named)
    # held against motion alone: of a table that rests much, every direction and every speed would have more than chance
    alike = "where {} would, were it alike in all motion"
    moving = _shares(gap, every, moved, rate, within=speed > SLOWEST, alike=alike)
    regions = [*_shares(gap, every, asked, rate), *moving]
    if not gap.is_known:  # a lost filter's force has a spectrum, too
        return [*ranked(regions), *ranked(others)]
    bands = _frequencies(gap, rate, noise)
    lines = [*lines_in_time(gap.force, rate), *lines_in_position(gap.force, motion.position, gap.counts)]
    clear = [one for one in lines if one.p_value < SIGNIFICANT]
    apart = told_apart(clear, gap.force, motion.position, motion.velocity, gap.counts, rate)
    large = [one for one in (*bands, *(_line(one, lead) for one in apart)) if one.share > FAINT]
    return [*ranked([*regions, *large], len(bands) + len(lines) - len(large)), *ranked(others)]


def _bands(
    dimension: str,
    signal: np.ndarray,
    where: Labels,
    counts: np.ndarray,
    number: int,
    scale: float,
    unit: str,
    what: str,
) -> list[_Asked]:
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
        found.append(_Asked(dimension, name, here, f"{what} {name}", float(low), float(high)))
    return found


def _frequencies(gap: ForceGap, rate: float, noise: Float[np.ndarray, "lanes n draws"] | None) -> list[Region]:
    """Shares of frequency bands; expected is the share that the noise has there.

    Where the noise is not given, white innovations stand for it, and nothing is significant.
    """
    known = noise is not None and bool(np.all(np.isfinite(noise)))
    if noise is None or not known:
        white = np.random.default_rng(0).standard_normal(gap.force.shape)
        noise = scipy.signal.lfilter([1.0], [1.0, -np.exp(-1.0 / (DISTURBANCE_TIME * rate))], white, axis=1)[..., None]
    power, floor = (
        np.sum(np.abs(np.fft.rfft(one * gap.counts[..., None], axis=1)) ** 2, axis=(0, 2))
        for one in (gap.force[..., None], noise)
    )
    axis = np.fft.rfftfreq(gap.force.shape[1], 1.0 / rate)
    found = []
    for low, high in itertools.pairwise(BANDS):
        inside = (axis >= low) & (axis < high)
        if not inside.any() or low > 0.5 * rate:
            continue
        share, expected = (float(one[inside].sum() / max(one.sum(), 1e-300)) for one in (power, floor))
        # chance makes both the band's power and that of all others; each weighs as many cells as are about equal in it
        over = share * (1.0 - expected) / max(expected * (1.0 - share), 1e-9)
        cells = [gap.counts.sum() / gap.counts.shape[1] * _alike(floor[one]) for one in (inside, ~inside)]
        p = float(scipy.stats.f.sf(over, 2.0 * cells[0], 2.0 * cells[1])) if known else 1.0
        name = f"{low:g} to {min(high, 0.5 * rate):g} Hz"
        says = f"{_percent(share)} of the gap lies at {name}"
        says += f", where the noise has {_percent(expected)}" if known else ""
        found.append(Region("frequency", name, share, expected, p, says, low, min(high, 0.5 * rate)))
    return found


def _alike(power: Float[np.ndarray, " n"]) -> float:
    """As many equal cells would scatter as much as these: Satterthwaite's degrees of freedom."""
    return float(np.sum(power) ** 2 / max(np.sum(power**2), 1e-300))


def _line(standing: Standing, lead: float | None) -> Region:
    """A line in words: locked to time or to position only where the motion tells which."""
    line, rival = standing
    in_time = line.dimension == "frequency"
    name = f"line at {line.value:.4g} Hz" if in_time else f"period of {1e3 * line.value:.4g} mm"
    if rival is None:
        locked = "locked to time" if in_time else "locked to position"
    else:
        speed = line.value * rival.value
        other = f"{_wave(rival.value, not in_time, lead)} at one speed ({1e3 * speed:.3g} mm/s)"
        locked = f"which cannot be distinguished from {other}"
    says = f"{_wave(line.value, in_time, lead)}, {locked}, with {_percent(line.share)} of the gap"
    return Region(line.dimension, name, line.share, 0.0, line.p_value, says)


def _wave(value: float, in_time: bool, lead: float | None) -> str:
    if in_time:
        return f"a line at {value:.4g} Hz"
    turns = "" if lead is None else f" ({lead / value:.3g} to a turn of the screw)"
    return f"a ripple every {1e3 * value:.4g} mm of travel{turns}"
