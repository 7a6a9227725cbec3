"""Where the search for a candidate begins: its grid, and what stands out of the missing force.

A grid fine enough for every line, and for times that differ from log to log, would be too large.
"""

import numpy as np
from jaxtyping import Float

from diffdrive.effects.forces import Cogging, ProcessForce
from diffdrive.effects.friction import AppliedLoad
from diffdrive.effects.scale import InterpolationError, LeadError
from tuning.diagnosis.candidates import Candidate
from tuning.diagnosis.fitting import Fitted
from tuning.diagnosis.lines import lines_in_position, lines_in_time, missing_force

SCALES = {LeadError: ("lead", 1e-3, 0.05), InterpolationError: ("period", 1e-6, 5e-4)}  # m, between which to look
BIN = 0.05  # s, to which the times of a load are looked for
SLOW = 1e-3  # m/s, below which friction may be anything


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


def _level(resisting: Float[np.ndarray, " n"], counts: Float[np.ndarray, " n"], rate: float) -> list[tuple[float, ...]]:
    """When (s) a signal stands at another level, once higher and once lower: begin, end, and what two levels explain.

    All pairs of times are tried; where it lasts to the end, the end is not seen.
    """
    size = max(1, round(BIN * rate))
    begins = np.arange(0, len(resisting), size)
    total = np.r_[0.0, np.cumsum(np.add.reduceat(resisting * counts, begins))]
    samples = np.r_[0.0, np.cumsum(np.add.reduceat(counts, begins))]
    inside, within = total[None, :] - total[:, None], samples[None, :] - samples[:, None]
    outside, without = total[-1] - inside, samples[-1] - within
    step = inside / np.maximum(within, 1.0) - outside / np.maximum(without, 1.0)
    gain = np.where((within > 0) & (without > 0), step**2 * within * without / max(samples[-1], 1.0), 0.0)
    found = []
    for sign in (1.0, -1.0):
        one = np.where(np.triu(sign * step > 0.0, 1), gain, 0.0)
        start, end = np.unravel_index(int(np.argmax(one)), one.shape)
        never = 0.2 * len(begins) if end == len(begins) else 0.0
        found.append((start * size / rate, (end + never) * size / rate, float(one.max())))
    return found


def _loads(fitted: Fitted) -> list[dict[str, np.ndarray]]:
    """When a load was put on and taken off in each log: friction missing there, or too much of it elsewhere."""
    logged = fitted.model.logged
    rate, n = logged.sampling.rate, logged.lanes.position.shape[1]
    velocity, counts = np.asarray(fitted.track.course.velocity), np.asarray(logged.lanes.counts)
    sliding = counts * (np.abs(velocity) > SLOW)
    resisting = -np.sign(velocity) * missing_force(fitted)
    first = np.round(np.asarray(logged.starts) * rate).astype(int)
    windows = []
    for log in range(logged.logs):
        lanes = [lane for lane, owner in enumerate(logged.owner) if owner == log]
        signal, there = (np.zeros(max(first[lane] for lane in lanes) + n) for _ in range(2))
        for lane in lanes:
            kept = slice(first[lane], first[lane] + n)
            signal[kept] += sliding[lane] * resisting[lane]
            there[kept] += sliding[lane]
        windows.append(_level(signal / np.maximum(there, 1.0), np.minimum(there, 1.0), rate))
    both = [[one[way] for one in windows] for way in (0, 1)]
    return [{"start": np.array([one[0] for one in way]), "end": np.array([one[1] for one in way])} for way in both]


def looked_for(fitted: Fitted, candidate: Candidate) -> list[dict[str, np.ndarray]]:
    """The candidate's grid, or where the lines are: each parameter one value for each log."""
    logged = fitted.model.logged
    logs, owner, rate, begins = logged.logs, logged.owner, logged.sampling.rate, np.asarray(logged.starts)

    def everywhere(value: float) -> np.ndarray:
        return np.full(logs, float(value))

    if candidate.effect is Cogging:
        known = [one.get("period", 1e-3) for one in candidate.grid]
        position, counts = np.asarray(fitted.track.course.position), np.asarray(logged.lanes.counts)
        lines = lines_in_position(missing_force(fitted), position, counts, min(known), max(known))
        found = [one.value for one in lines] or list(np.geomspace(min(known), max(known), 4))
        return [{"period": everywhere(k * p)} for p in found for k in (1.0, 2.0)]
    if candidate.effect in SCALES:
        # a scale's error passes for a force that shakes the table at each place alike
        name, shortest, longest = SCALES[candidate.effect]
        position, counts = np.asarray(fitted.track.course.position), np.asarray(logged.lanes.counts)
        lines = lines_in_position(missing_force(fitted), position, counts, shortest, longest)
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
