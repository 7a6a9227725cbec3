"""Lines in what is missing: periods in time and in position that stand out, to begin from.

A grid fine enough for a period that is known to a hundredth of a cycle over the whole log is too fine for the
catalogue: the spectrum of the missing force tells where to look.
"""

import numpy as np
from jaxtyping import Float

from diffdrive.effects.forces import Cogging, ProcessForce
from tuning.diagnosis.candidates import Candidate
from tuning.diagnosis.fitting import Fitted

PEAKS = 4
NEIGHBOURS = 40  # bins, whose median a line must stand out from
APART = 3  # bins between two lines


def missing_force(fitted: Fitted) -> Float[np.ndarray, "lanes n"]:
    """The force (N) that the filter had to invent, the lasting and the sudden; zero where nothing was measured."""
    sampling = fitted.model.logged.sampling
    counts = np.asarray(fitted.model.logged.lanes.counts)
    mass = float(fitted.drive.plant.mass)
    sudden = mass * sampling.rate * np.asarray(fitted.track.pull[1]) * np.asarray(fitted.track.innovation)
    return (np.asarray(fitted.track.lacking) + sudden) * counts


def _stand_out(power: Float[np.ndarray, " n"]) -> list[int]:
    """Indices of the highest peaks over their neighbourhood."""
    padded = np.pad(power, NEIGHBOURS, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1)
    over = power / np.maximum(np.median(windows, axis=1), 1e-300)
    found: list[int] = []
    for index in np.argsort(over)[::-1]:
        if all(abs(index - other) > APART for other in found):
            found.append(int(index))
        if len(found) == PEAKS:
            break
    return found


def frequencies(signal: Float[np.ndarray, "lanes n"], rate: float) -> list[float]:
    """Frequencies (Hz) of lines in time, shared by the lanes."""
    n = signal.shape[1]
    power = np.sum(np.abs(np.fft.rfft(signal * np.hanning(n), 2 * n, axis=1)) ** 2, axis=0)
    axis = np.fft.rfftfreq(2 * n, 1.0 / rate)
    usable = (axis > 2.0) & (axis < 0.45 * rate)
    return [float(axis[usable][k]) for k in _stand_out(power[usable])]


def periods(
    signal: Float[np.ndarray, "lanes n"], position: Float[np.ndarray, "lanes n"], shortest: float, longest: float
) -> list[float]:
    """Periods (m) of lines in position, between two bounds."""
    travel = float(np.ptp(position))
    waves = np.arange(1.0 / longest, 1.0 / shortest, 0.25 / travel)
    if len(waves) < 4:
        return [float(p) for p in np.geomspace(shortest, longest, 4)]
    # the signal summed over equal places, then a transform of that
    edges = max(int(8 * travel / shortest), 16)
    power = np.zeros(len(waves))
    for one, at in zip(signal, position, strict=True):
        place = np.clip(((at - position.min()) / travel * edges).astype(int), 0, edges - 1)
        held = np.bincount(place, one, edges)
        centres = position.min() + (np.arange(edges) + 0.5) * travel / edges
        for first in range(0, len(waves), 256):
            phase = np.exp(-2j * np.pi * np.outer(waves[first : first + 256], centres))
            power[first : first + 256] += np.abs(phase @ held) ** 2
    return [float(1.0 / waves[k]) for k in _stand_out(power)]


def _window(signal: Float[np.ndarray, " n"], frequency: float, rate: float) -> tuple[float, float]:
    """When (s) a line at `frequency` is on: where its envelope is above half of its highest."""
    n = len(signal)
    slow = signal * np.exp(-2j * np.pi * frequency * np.arange(n) / rate)
    width = max(3, int(0.2 * rate))
    envelope = np.abs(np.convolve(slow, np.hanning(width) / np.hanning(width).sum(), mode="same"))
    on = np.flatnonzero(envelope > 0.5 * np.percentile(envelope, 95))
    return float(on[0] / rate), float(on[-1] / rate)


def looked_for(fitted: Fitted, candidate: Candidate) -> list[dict[str, np.ndarray]]:
    """The candidate's grid, or where the lines are: each parameter one value for each log."""
    logged = fitted.model.logged
    logs, owner, rate = logged.logs, logged.owner, logged.sampling.rate

    def everywhere(value: float) -> np.ndarray:
        return np.full(logs, float(value))

    if candidate.effect is Cogging:
        known = [one.get("period", 1e-3) for one in candidate.grid]
        position = np.asarray(fitted.track.course.position)
        found = periods(missing_force(fitted), position, min(known), max(known))
        return [{"period": everywhere(k * p)} for p in found for k in (1.0, 2.0)]
    if candidate.effect is ProcessForce:
        force = missing_force(fitted)
        grid = []
        for frequency in frequencies(force, rate):
            # one window for each log, from the longest of its lanes
            windows = [(0.0, 0.0)] * logs
            for lane, log in enumerate(owner):
                start, end = _window(force[lane], frequency, rate)
                if end - start >= windows[log][1] - windows[log][0]:
                    windows[log] = (start, end)
            starts, ends = (np.array(one) for one in zip(*windows, strict=True))
            for multiple in (1.0, 0.5):
                grid.append({"frequency": everywhere(multiple * frequency), "start": starts, "end": ends})
        return grid
    return [{name: everywhere(value) for name, value in point.items()} for point in candidate.grid or ({},)]
