"""The inputs of a machine, drawn for each log: motion, load, noise, disturbances."""

import numpy as np
from jaxtyping import Float

from experiments.studies.withheld.machine import MachineInputs

MIN_DURATION, MAX_DURATION = 8.0, 11.0  # s
STROKE = 0.05  # m, to either side
LOAD_PROBABILITY = 0.3  # of a log with a recorded load
MAX_LOAD = 8e3  # N, of that load
LOAD_RAMP = 0.1  # s, in which a load is applied or removed


def draw_reference(rng: np.random.Generator, rate: float, gentleness: float = 1.0) -> Float[np.ndarray, " n"]:
    """Strokes at several speeds with pauses, and oscillations, as a commissioning engineer would run them (m).

    It takes `gentleness` times as long to reach a speed.
    """
    pieces, position = [np.zeros(round(0.2 * rate))], 0.0
    elapsed, duration = 0.2, rng.uniform(MIN_DURATION, MAX_DURATION)
    while elapsed < duration:
        if rng.random() < 0.25:
            amplitude, frequency = np.exp(rng.uniform(np.log(2e-5), np.log(3e-3))), rng.uniform(0.8, 5.0)
            amplitude = min(amplitude, 4.0 / gentleness / (2 * np.pi * frequency) ** 2)
            time = np.arange(round(max(2.0 / frequency, 0.8) * rate)) / rate
            turns = np.round(time[-1] * frequency)
            smooth = np.sin(np.pi * np.clip(time / time[-1], 0, 1)) ** 2
            piece = position + amplitude * smooth * np.sin(2 * np.pi * turns * time / time[-1])
        else:
            speed = np.exp(rng.uniform(np.log(1e-3), np.log(0.09)))
            stroke = min(speed * rng.uniform(0.3, 1.2), 0.7 * STROKE) * rng.choice([-1.0, 1.0])
            if abs(position + stroke) > STROKE:
                stroke = -stroke
            ramp = gentleness * max(0.04, speed / rng.uniform(0.8, 2.5))
            time = np.arange(round((abs(stroke) / speed + ramp) * rate)) / rate
            share = np.clip(time / ramp, 0, 1)
            rise = share**3 * (10 - 15 * share + 6 * share**2)
            share = np.clip((time[-1] - time) / ramp, 0, 1)
            profile = np.minimum(rise, share**3 * (10 - 15 * share + 6 * share**2))
            piece = position + stroke * np.cumsum(profile) / profile.sum()
        pieces.append(piece)
        position = float(piece[-1])
        rest = rng.uniform(0.02, 0.5)
        pieces.append(np.full(round(rest * rate), position))
        elapsed = sum(map(len, pieces)) / rate
    return np.concatenate(pieces)


def draw_load(rng: np.random.Generator, n: int, rate: float) -> Float[np.ndarray, " n"]:
    """A load (N) that the log records: none, or applied once and perhaps removed again."""
    if rng.random() >= LOAD_PROBABILITY:
        return np.zeros(n)
    load, (start, end) = rng.uniform(0.2, 1.0) * MAX_LOAD, np.sort(rng.uniform(0.5, 1.3 * n / rate, 2))
    time = np.arange(n) / rate
    return load * np.clip((time - start) / LOAD_RAMP, 0, 1) * np.clip((end - time) / LOAD_RAMP, 0, 1)


def _cuts(rng: np.random.Generator, n: int, rate: float, lasting: float) -> Float[np.ndarray, " n"]:
    """Ones while the force is lost, for `lasting` (s) and at least a sample, at instants drawn at random."""
    cut, width = np.zeros(n), max(1, round(lasting * rate))
    for time in rng.uniform(0.5, n / rate - 0.5, rng.integers(8, 20)):
        cut[int(time * rate) : int(time * rate) + width] = 1.0
    return cut


def draw_inputs(
    rng: np.random.Generator,
    load_rng: np.random.Generator,
    rate: float,
    noise: float,
    random_scales: dict[str, float],
    length: float,
    load: float,
    gentleness: float = 1.0,
    motor_rng: np.random.Generator | None = None,
) -> MachineInputs:
    """The inputs of one log at `rate` (Hz) under `noise` (m, rms); `random_scales` as in `faults.InjectedFault`.

    Motions are `length` times as long and as fast as on the paper's axis, loads `load` times as large; the load is
    drawn from `load_rng`, and from `motor_rng` the noise of a motor's encoder, where there is one.
    """
    reference = length * draw_reference(rng, rate, gentleness)
    n = len(reference)
    disturbance, friction_share = np.zeros(n), np.zeros(n)
    if "peak" in random_scales:
        width = max(2, round(3e-3 * rate))
        for time in rng.uniform(0.5, n / rate - 0.5, rng.integers(8, 20)):
            k = int(time * rate)
            peak = random_scales["peak"] * np.exp(rng.normal(0, 0.4)) * rng.choice([-1, 1])
            disturbance[k : k + width] += peak * np.sin(np.pi * (np.arange(width) + 0.5) / width)
    if "pulse" in random_scales:  # a neighbour that starts and stops
        for time in rng.uniform(0.5, n / rate - 0.5, rng.integers(10, 25)):
            k, width = int(time * rate), max(2, round(rng.uniform(0.03, 0.08) * rate))
            disturbance[k : k + width] += random_scales["pulse"] * np.exp(rng.normal(0, 0.4)) * rng.choice([-1, 1])
    if "oil" in random_scales:  # pulses of lubrication, and how they are used up
        time, pulse, lasts = np.arange(n) / rate, rng.uniform(0.5, 1.5), rng.uniform(0.5, 2.0)
        while pulse < n / rate:
            friction_share -= random_scales["oil"] * np.where(time >= pulse, np.exp(-(time - pulse) / lasts), 0.0)
            pulse += rng.uniform(2.0, 3.0)
    if "share" in random_scales:
        fade = np.exp(-1.0 / (0.3 * rate))
        kick = random_scales["share"] * np.sqrt(1 - fade**2) * rng.standard_normal(n)
        for k in range(1, n):
            friction_share[k] = fade * friction_share[k - 1] + kick[k]
    readings = noise * rng.standard_normal(n)
    return MachineInputs(
        reference, load * draw_load(load_rng, n, rate), readings, disturbance, friction_share,
        motor_noise=None if motor_rng is None else motor_rng.standard_normal(n),
        lateness=random_scales["lateness"] * rng.standard_normal(n) if "lateness" in random_scales else None,
        cut=_cuts(rng, n, rate, random_scales["cut"]) if "cut" in random_scales else None,
    )  # fmt: skip
