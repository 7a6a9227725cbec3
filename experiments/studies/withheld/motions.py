"""What a machine is told to do, and what happens to it meanwhile: motions, loads, noise, disturbances; log by log."""

import numpy as np
from jaxtyping import Float

from experiments.studies.withheld.machine import MachineInputs

MIN_DURATION, MAX_DURATION = 8.0, 11.0  # s
STROKE = 0.05  # m, to either side
LOAD_PROBABILITY = 0.3  # of the logs have a load that the log tells
MAX_LOAD = 8e3  # N, of that load
LOAD_RAMP = 0.1  # s, that a load takes to be put on or off
ROOM = np.random.Generator


def draw_reference(room: ROOM, rate: float) -> Float[np.ndarray, " n"]:
    """Strokes at several speeds with pauses, and vibrations to and fro, as a commissioning engineer would run them."""
    pieces, at = [np.zeros(round(0.2 * rate))], 0.0
    total, wanted = 0.2, room.uniform(MIN_DURATION, MAX_DURATION)
    while total < wanted:
        if room.random() < 0.25:
            amplitude, frequency = np.exp(room.uniform(np.log(2e-5), np.log(3e-3))), room.uniform(0.8, 5.0)
            amplitude = min(amplitude, 4.0 / (2 * np.pi * frequency) ** 2)
            time = np.arange(round(max(2.0 / frequency, 0.8) * rate)) / rate
            turns = np.round(time[-1] * frequency)
            smooth = np.sin(np.pi * np.clip(time / time[-1], 0, 1)) ** 2
            piece = at + amplitude * smooth * np.sin(2 * np.pi * turns * time / time[-1])
        else:
            speed = np.exp(room.uniform(np.log(1e-3), np.log(0.09)))
            stroke = min(speed * room.uniform(0.3, 1.2), 0.7 * STROKE) * room.choice([-1.0, 1.0])
            if abs(at + stroke) > STROKE:
                stroke = -stroke
            ramp = max(0.04, speed / room.uniform(0.8, 2.5))
            time = np.arange(round((abs(stroke) / speed + ramp) * rate)) / rate
            share = np.clip(time / ramp, 0, 1)
            rise = share**3 * (10 - 15 * share + 6 * share**2)
            share = np.clip((time[-1] - time) / ramp, 0, 1)
            profile = np.minimum(rise, share**3 * (10 - 15 * share + 6 * share**2))
            piece = at + stroke * np.cumsum(profile) / profile.sum()
        pieces.append(piece)
        at = float(piece[-1])
        rest = room.uniform(0.02, 0.5)
        pieces.append(np.full(round(rest * rate), at))
        total = sum(map(len, pieces)) / rate
    return np.concatenate(pieces)


def draw_load(room: ROOM, n: int, rate: float) -> Float[np.ndarray, " n"]:
    """A load (N) that the log tells: none, or put on once and perhaps taken off again."""
    if room.random() >= LOAD_PROBABILITY:
        return np.zeros(n)
    load, (start, end) = room.uniform(0.2, 1.0) * MAX_LOAD, np.sort(room.uniform(0.5, 1.3 * n / rate, 2))
    time = np.arange(n) / rate
    return load * np.clip((time - start) / LOAD_RAMP, 0, 1) * np.clip((end - time) / LOAD_RAMP, 0, 1)


def draw_inputs(
    room: ROOM, apart: ROOM, rate: float, noise: float, traces: dict[str, float], length: float, load: float
) -> MachineInputs:
    """One log's instructions at `rate` (Hz) under `noise` (m, rms); `traces` as in `faults.Fault`.

    Motions are so many times as long and as fast as on the paper's axis, loads so many times as large; these are drawn
    from a stream `apart`.
    """
    reference = length * draw_reference(room, rate)
    n = len(reference)
    push, rub = np.zeros(n), np.zeros(n)
    if "peak" in traces:
        width = max(2, round(3e-3 * rate))
        for at in room.uniform(0.5, n / rate - 0.5, room.integers(8, 20)):
            k = int(at * rate)
            peak = traces["peak"] * np.exp(room.normal(0, 0.4)) * room.choice([-1, 1])
            push[k : k + width] += peak * np.sin(np.pi * (np.arange(width) + 0.5) / width)
    if "share" in traces:
        fade = np.exp(-1.0 / (0.3 * rate))
        kick = traces["share"] * np.sqrt(1 - fade**2) * room.standard_normal(n)
        for k in range(1, n):
            rub[k] = fade * rub[k - 1] + kick[k]
    return MachineInputs(reference, load * draw_load(apart, n, rate), noise * room.standard_normal(n), push, rub)
