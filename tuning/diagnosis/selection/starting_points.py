"""Where the search for a candidate begins: its grid, and what stands out of the missing force.

A grid fine enough for every line, and for times that differ from log to log, would be too large.
"""

import itertools

import numpy as np
from jaxtyping import Float
from scipy.signal import savgol_filter

from diffdrive.effects.forces import Cogging, ProcessForce
from diffdrive.effects.friction import AppliedLoad
from diffdrive.effects.scale import InterpolationError, LeadError
from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.gap.lines import lines_in_position, lines_in_time, missing_force
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.levels import LOST

SCALES = {LeadError: ("lead", 1e-3, 0.05), InterpolationError: ("period", 1e-6, 5e-4)}  # m, between which to look
BIN = 0.05  # s, to which the times of a load are looked for
MOST_BINS = 600  # of those: a longer log has coarser ones
SLOW = 1e-3  # m/s, below which friction may be anything
SMOOTH, PARABOLA = 11, 2  # samples, within which a table moves along a parabola


def _window(signal: Float[np.ndarray, " n"], frequency: float, rate: float) -> tuple[float, float]:
    """When (s) a line at `frequency` is on: the stretch in which its envelope is most above half of its highest.

    The stretch of the largest sum (Kadane): a blow long after it does not draw its end along.
    """
    n = len(signal)
    slow = signal * np.exp(-2j * np.pi * frequency * np.arange(n) / rate)
    width = max(3, int(0.2 * rate))
    envelope = np.abs(np.convolve(slow, np.hanning(width) / np.hanning(width).sum(), mode="same"))
    level = np.percentile(envelope, 95)
    total = np.cumsum(np.r_[0.0, np.minimum(envelope, level) - 0.5 * level])
    end = int(np.argmax(total[1:] - np.minimum.accumulate(total[:-1])))
    start = int(np.argmin(total[: end + 1]))
    return start / rate, end / rate


def _level(signal: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"], rate: float) -> list[tuple[float, float]]:
    """When (s) a signal, known at some times, stands at another level, once higher and once lower: begin and end.

    All pairs of times are tried; where it lasts to the end, the end is not seen.
    """
    if not signal.size:
        return [(0.0, 0.0)] * 2
    size = max(1, round(BIN * rate), -(-len(signal) // MOST_BINS))
    begins = np.arange(0, len(signal), size)
    edges = np.r_[time[begins], time[-1] + 1.0 / rate]
    total = np.r_[0.0, np.cumsum(np.add.reduceat(signal, begins))]
    samples = np.r_[begins, len(signal)].astype(float)
    inside, within = total[None, :] - total[:, None], samples[None, :] - samples[:, None]
    outside, without = total[-1] - inside, samples[-1] - within
    step = inside / np.maximum(within, 1.0) - outside / np.maximum(without, 1.0)
    gain = np.where((within > 0) & (without > 0), step**2 * within * without / samples[-1], 0.0)
    found = []
    for sign in (1.0, -1.0):
        one = np.where(np.triu(sign * step > 0.0, 1), gain, 0.0)
        start, end = np.unravel_index(int(np.argmax(one)), one.shape)
        never = 0.2 * (edges[-1] - edges[0]) if end == len(begins) else 0.0
        found.append((float(edges[start]), float(edges[end] + never)))
    return found


def _loads(fitted: Fitted) -> list[dict[str, np.ndarray]]:
    """When a load was put on and taken off in each log: friction missing there, or too much of it elsewhere."""
    logged = fitted.model.logged
    rate, velocity = logged.sampling.rate, np.asarray(fitted.filtered.trajectory.velocity)
    sliding = (np.asarray(logged.lanes.counts) > 0.0) & (np.abs(velocity) > SLOW)
    resisting = -np.sign(velocity) * missing_force(fitted)
    time = np.asarray(logged.starts)[:, None] + np.arange(velocity.shape[1]) / rate
    owner, windows = np.asarray(logged.owner), []
    for log in range(logged.logs):
        there = sliding[owner == log]
        windows.append(_level(resisting[owner == log][there], time[owner == log][there], rate))
    both = [[one[way] for one in windows] for way in (0, 1)]
    return [{"start": np.array([one[0] for one in way]), "end": np.array([one[1] for one in way])} for way in both]


def _unsmooth(position: Float[np.ndarray, "lanes n"]) -> Float[np.ndarray, "lanes n"]:
    """What of a measured position is no smooth motion: what is quicker than some samples, as it is and without a lag.

    What a filter makes of an error has another phase at every speed, and where the error's frequency is above half of
    the rate, turns backwards: over a log with many speeds it adds up to nothing.
    """
    if position.shape[1] < SMOOTH:
        return np.zeros_like(position)
    return position - savgol_filter(position, SMOOTH, PARABOLA, axis=1)


def _decades(low: float, high: float) -> Float[np.ndarray, " k"]:
    """About a decade from one to the next: of all periods together most are short, and most of what stands out by
    chance is.
    """
    return np.geomspace(low, high, max(1, round(np.log10(high / low))) + 1)


def starting_points(fitted: Fitted, candidate: Candidate) -> list[dict[str, np.ndarray]]:
    """The candidate's grid, or where the lines are: each parameter one value for each log."""
    logged = fitted.model.logged
    logs, owner, rate, begins = logged.logs, logged.owner, logged.sampling.rate, np.asarray(logged.starts)

    def everywhere(value: float) -> np.ndarray:
        return np.full(logs, float(value))

    if candidate.effect is Cogging:
        known = [one.get("period", 1e-3) for one in candidate.grid]
        position, counts = np.asarray(fitted.filtered.trajectory.position), np.asarray(logged.lanes.counts)
        force, edges = missing_force(fitted), _decades(min(known), max(known))
        lines = [one for ends in itertools.pairwise(edges) for one in lines_in_position(force, position, counts, *ends)]
        found = [one.value for one in lines] or list(np.geomspace(min(known), max(known), 4))
        return [{"period": everywhere(k * p)} for p in found for k in (1.0, 2.0)]
    if candidate.effect in SCALES:
        # a scale's error passes for a force that shakes the table at each place alike or, too quick for one, for noise;
        # where the table goes through several periods a sample, only what is no smooth motion of it is alike
        name, shortest, longest = SCALES[candidate.effect]
        finest = next((low for bound, low, _ in candidate.bounds if bound == name), 0.0)
        position, counts = np.asarray(fitted.filtered.trajectory.position), np.asarray(logged.lanes.counts)
        surprise = np.asarray(fitted.filtered.normalised_innovation) * counts
        surprise = np.where(np.abs(surprise) < LOST, surprise, 0.0)
        lines = [
            one
            for signal in (missing_force(fitted), surprise, _unsmooth(np.asarray(logged.lanes.position)))
            for one in lines_in_position(signal, position, counts, max(shortest, finest), longest)
        ]
        known = [one[name] for one in candidate.grid]
        return [{name: everywhere(value)} for value in (*known, *(one.value for one in lines))]
    if candidate.effect is ProcessForce:
        force = missing_force(fitted)
        grid = []
        for frequency in (one.value for one in lines_in_time(force, rate)):
            # one window for each log, from the longest of its lanes
            windows = [(0.0, 0.0)] * logs
            for lane, log in enumerate(owner):
                start, end = _window(force[lane], frequency, rate)
                if end - start >= windows[log][1] - windows[log][0]:
                    windows[log] = (begins[lane] + start, begins[lane] + end)
            starts, ends = (np.array(one) for one in zip(*windows, strict=True))
            for multiple in (1.0, 0.5):
                grid.append({"frequency": everywhere(multiple * frequency), "start": starts, "end": ends})
        return grid
    grid = [{name: everywhere(value) for name, value in point.items()} for point in candidate.grid or ({},)]
    steps = candidate.effect is AppliedLoad and any(one.name == "start" for one in candidate.parameters)
    return [*grid, *_loads(fitted)] if steps else grid
