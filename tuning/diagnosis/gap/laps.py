"""What repeats from lap to lap, where a reference does: no model of the motion foresees the scatter between laps.

It holds the measuring noise and whatever acts without regard to the motion, such as another machine's vibration. So it
is told beside the floor, not in its place: a gap that does not repeat is a gap.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive.logs import Log

SHORTEST = 0.2  # s, of a lap
ALIKE = 1e-6  # of the reference's variance, by which laps may differ
SAME = 1e-9  # m, by which references of two logs may differ


class Lap(NamedTuple):
    """Two stretches with the same reference: logs, first samples, and how many samples."""

    logs: tuple[int, int]
    begins: tuple[int, int]
    count: int  # type: ignore[assignment]  # in the place of tuple.count


class Laps(NamedTuple):
    """How far laps of the same reference differ, root mean square, each lap by itself."""

    position: float  # m
    command: float  # N
    force: float  # N, of what the recalibrated drive lacks
    pairs: int
    says: str


def period_of(reference: Float[np.ndarray, " n"], rate: float) -> int | None:
    """After how many samples a reference repeats; None where it does not."""
    signal = reference - np.mean(reference)
    n, spread = len(signal), float(np.var(signal))
    longest, shortest = n // 2, round(SHORTEST * rate)
    if spread == 0.0 or longest <= shortest:
        return None
    lags = np.arange(longest + 1)
    spectrum = np.fft.rfft(signal, 2 * n)
    shared = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[: longest + 1]
    energy = np.r_[0.0, np.cumsum(signal**2)]
    off = (energy[n - lags] + energy[n] - energy[lags] - 2.0 * shared) / (n - lags)
    # a lap has gone away and come back: lags just above none are alike for want of motion
    away = np.flatnonzero(off > 0.1 * spread)
    if not away.size:
        return None
    back = np.flatnonzero((off < ALIKE * spread) & (lags >= max(shortest, away[0])))
    return int(back[0] + np.argmin(off[back[0] : back[0] + shortest])) if back.size else None


def pairs_of(logs: Sequence[Log]) -> list[Lap]:
    """Neighbouring laps within each log, and logs with one reference; logs with gaps are left alone."""
    whole = {k: log.reference for k, log in enumerate(logs) if log.reference is not None and len(log.pieces()) == 1}
    found = []
    for k, reference in whole.items():
        period, n = period_of(reference, logs[k].rate), len(logs[k].time)
        if period is not None:
            found += [Lap((k, k), (a, a + period), min(period, n - a - period)) for a in range(0, n - period, period)]
    for a, b in itertools.pairwise(whole):
        one, other = whole[a], whole[b]
        if len(one) == len(other) and np.ptp(one) > 0.0 and np.abs(one - other).max() < SAME:
            found.append(Lap((a, b), (0, 0), len(one)))
    return found


def laps(
    logs: Sequence[Log],
    force: Float[np.ndarray, "lanes n"],
    counts: Float[np.ndarray, "lanes n"],
    owner: Sequence[int],
    thinning: int,
) -> Laps | None:
    """The scatter from lap to lap; `force` (N) is what is missing where `counts`, at one sample of so many.

    None where no reference repeats.
    """
    pairs = pairs_of(logs)
    if not pairs:
        return None
    off: dict[str, list[np.ndarray]] = {"position": [], "command": [], "force": []}
    repeated: list[np.ndarray] = []
    for lap in pairs:
        ends = [slice(begin, begin + lap.count) for begin in lap.begins]
        for name in ("position", "command"):
            one, other = (getattr(logs[log], name)[end] for log, end in zip(lap.logs, ends, strict=True))
            off[name].append(one - other)
        lanes = [list(owner).index(log) for log in lap.logs]
        rows = [slice(end.start // thinning, end.start // thinning + lap.count // thinning) for end in ends]
        both = np.minimum(*(counts[lane, row] for lane, row in zip(lanes, rows, strict=True))) > 0
        one, other = (force[lane, row][both] for lane, row in zip(lanes, rows, strict=True))
        off["force"].append(one - other)
        repeated += [one, other]
    scatter = {name: _rms(np.concatenate(each)) / np.sqrt(2.0) for name, each in off.items()}
    total = _rms(np.concatenate(repeated))
    share = max(1.0 - (scatter["force"] / total) ** 2, 0.0) if total > 0.0 else 0.0
    says = (
        f"laps of one reference differ by {1e6 * scatter['position']:.3g} um, {scatter['command']:.3g} N of command "
        f"and {scatter['force']:.3g} N of missing force: {100 * share:.0f} % of the latter repeats from lap to lap"
    )
    return Laps(scatter["position"], scatter["command"], scatter["force"], len(pairs), says)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
