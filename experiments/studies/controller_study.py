"""Gains of random cascades, estimated from logs of a naive loop: `python -m experiments.studies.controller_study`.

The loop is its own: NumPy alone, a mass with viscous and Coulomb friction, stepped at a multiple of the control rate.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diffdrive.logs import Log
from tuning.identification.controller.compare import differences, needed
from tuning.identification.controller.gains import Gain, gains_of, pooled
from tuning.identification.controller.workflow import identify_controller

SUBSTEPS = 4


@dataclass(frozen=True)
class NaiveCascade:
    """A cascade on a mass: what its log shows depends on `ratio`, the samples of the loop to a row."""

    kp: float = 50.0  # 1/s
    kv: float = 1e5  # N s/m
    reset_time: float = 0.015  # s
    velocity_feedforward: float = 0.0
    acceleration_feedforward: float = 0.0  # kg
    velocity_samples: int = 2
    rate: float = 4000.0  # Hz
    ratio: int = 4
    mass: float = 400.0  # kg
    coulomb: float = 150.0  # N
    viscous: float = 800.0  # N s/m
    resolution: float = 1e-7  # m
    noise: float = 3e-8  # m
    late: float = 0.0  # s by which the command is logged late, whole periods
    backward: bool = False  # the reference's speed is differenced from the last sample, not about this one

    def log(self, seconds: float, seed: int, name: str = "log") -> Log:
        """A log of a random motion; each row is a snapshot of the loop."""
        rng = np.random.default_rng(seed)
        period, count = 1.0 / self.rate, round(seconds * self.rate)
        reference = random_motion(count, period, rng)
        speed, acceleration = np.gradient(reference, period), np.gradient(np.gradient(reference, period), period)
        if self.backward:
            speed = np.diff(reference, prepend=reference[0]) / period
        noise = (self.noise * rng.standard_normal(count)).tolist()
        measured: list[float] = []
        command: list[float] = []
        x, v, integral, step = float(reference[0]), 0.0, 0.0, period / SUBSTEPS
        ki = self.kv / self.reset_time
        for r, rate, change, error in zip(
            reference.tolist(), speed.tolist(), acceleration.tolist(), noise, strict=True
        ):
            y = round((x + error) / self.resolution) * self.resolution
            measured.append(y)
            before = measured[max(len(measured) - 1 - self.velocity_samples, 0)]
            wanted = (
                self.kp * (r - y) + self.velocity_feedforward * rate - (y - before) / (self.velocity_samples * period)
            )
            integral += ki * period * wanted
            u = self.kv * wanted + integral + self.acceleration_feedforward * change
            command.append(u)
            for _ in range(SUBSTEPS):
                free = v + step * (u - self.viscous * v) / self.mass
                stop = step * self.coulomb / self.mass
                v = free - stop if free > stop else free + stop if free < -stop else 0.0
                x += step * v
        shown = slice(0, count, self.ratio)
        late = np.roll(command, round(self.late * self.rate))
        time = np.arange(count)[shown] * period
        return Log(name, time, np.array(measured)[shown], np.round(late[shown], 2), reference[shown])


def random_motion(count: int, period: float, rng: np.random.Generator) -> np.ndarray:
    """Strokes of random length and speed with some rests, of limited jerk (m)."""
    speed = np.zeros(count)
    begin = round(0.1 / period)
    while begin < count:
        length = round(rng.uniform(0.2, 0.7) / period)
        speed[begin : begin + length] = rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.3)
        begin += length + int(rng.choice([0, round(0.15 / period)]))
    for smoothing in (rng.uniform(0.03, 0.08), rng.uniform(0.01, 0.03)):
        width = round(smoothing / period)
        speed = np.convolve(np.concatenate([np.zeros(width - 1), speed]), np.ones(width) / width, "valid")
    return period * np.cumsum(speed)


def random_cascade(seed: int) -> NaiveCascade:
    """Gains as machines have them: each loop two to six times faster than the one around it."""
    rng = np.random.default_rng(seed)
    mass = float(np.exp(rng.uniform(np.log(30.0), np.log(1500.0))))
    bandwidth = rng.uniform(120.0, 350.0)  # 1/s, of the velocity loop
    rate = float(rng.choice([2000.0, 4000.0, 8000.0]))
    return NaiveCascade(
        kp=bandwidth / rng.uniform(3.0, 8.0),
        kv=mass * bandwidth,
        reset_time=rng.uniform(2.5, 8.0) / bandwidth,
        velocity_feedforward=float(rng.choice([0.0, 0.0, rng.uniform(0.3, 0.95), 1.0])),
        acceleration_feedforward=mass * float(rng.choice([0.0, 0.0, 1.0])),
        velocity_samples=int(rng.choice([1, 2, 4])),
        rate=rate,
        ratio=int(rng.choice([1, 2, 4] if rate < 3000.0 else [1, 2, 4, 8])),
        mass=mass,
        coulomb=mass * rng.uniform(0.2, 0.6),
        viscous=mass * rng.uniform(0.5, 4.0),
        resolution=float(rng.choice([1e-8, 1e-7, 2e-7])),
        noise=float(rng.choice([5e-9, 3e-8])),
    )


@dataclass(frozen=True)
class Row:
    """One cascade: its truth, its gains, and whether changes of `CHANGES` were found between two logs.

    `permitted` says whether the intervals of the two logs permit it: a change of 10 % is then missed by chance in one
    of forty.
    """

    seed: int
    cascade: NaiveCascade
    gains: tuple[Gain, ...]
    alarm: str  # a difference between two logs of one controller, in words; empty where none was found
    found: tuple[bool, ...]
    permitted: tuple[bool, ...]

    def relative(self, name: str) -> tuple[float, float, float]:
        """Error of a gain, and the ends of its interval, relative to the truth."""
        gain = next(gain for gain in self.gains if gain.name == name)
        truth = float(getattr(self.cascade, name))
        return gain.value / truth - 1.0, gain.low / truth - 1.0, gain.high / truth - 1.0


CHANGES = ("kp", "kv", "reset_time")
NEAR = 0.02  # half of an interval that shows a gain
CHANGE = 1.1  # of one gain
SHOWN = ("K_v", "the velocity gain", "the reset time")


def study(cascades: int, seconds: float = 5.0) -> Iterator[Row]:
    """Each random cascade: two logs of it, and one of each change of a gain by 10 %."""
    for seed in range(cascades):
        cascade = random_cascade(seed)
        changed = [replace(cascade, **{name: CHANGE * getattr(cascade, name)}) for name in CHANGES]
        machines = [cascade, cascade, *changed]
        logs = [one.log(seconds, seed=1000 + 10 * seed + k, name=f"log {k}") for k, one in enumerate(machines)]
        first, second, *others = [
            identify_controller(None, log, control_rate=cascade.rate).logs[0].parts for log in logs
        ]
        alarm = "; ".join(one.sentence for one in differences(first, second, ("log 0", "log 1")))
        found = tuple(
            any(one.name == shown for one in differences(first, other, ("log 0", "changed")))
            for shown, other in zip(SHOWN, others, strict=True)
        )
        change = np.array([np.log(CHANGE), np.log(CHANGE), (1.0 - 1.0 / CHANGE) / cascade.reset_time])
        permitted = tuple(bool(change[k] > needed(first, other, missed=0.025)[k]) for k, other in enumerate(others))
        yield Row(seed, cascade, gains_of(pooled([first, second])), alarm, found, permitted)


def _changes(row: Row) -> str:
    """Of each change: y where it was found, n where it was missed, - where the intervals do not permit it."""
    return "".join("y" if found else "n" if due else "-" for found, due in zip(row.found, row.permitted, strict=True))


def _summary(rows: Sequence[Row]) -> str:
    errors = np.array([[row.relative(name) for name in CHANGES] for row in rows])
    value, low, high = np.moveaxis(errors, 2, 0)
    covered = (low <= 0.0) & (high >= 0.0)
    shown = high - low < 2.0 * NEAR
    found, due = np.array([row.found for row in rows]), np.array([row.permitted for row in rows])
    return "; ".join(
        [
            f"{len(rows)} cascades: {np.sum(covered)} of {covered.size} intervals hold the truth",
            f"{np.sum(shown)} have ends within {100 * NEAR:g} % of their middle",
            f"the largest error of these is {100 * np.max(np.abs(value[shown])):.2f} %",
            f"{np.sum(found & due)} of {np.sum(due)} changes that intervals permit were found",
            f"{np.sum(found & ~due)} of {np.sum(~due)} others",
            f"{sum(bool(row.alarm) for row in rows)} of {len(rows)} pairs without a change were said to differ",
        ]
    )


def main() -> None:
    """Print a line for each cascade."""
    cascades = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    rows: list[Row] = []
    for row in study(cascades):
        rows.append(row)
        cascade = row.cascade
        errors = "  ".join(
            f"{name} {100 * error:+7.3f} ({100 * low:+7.3f} {100 * high:+7.3f})"
            for name in CHANGES
            for error, low, high in [row.relative(name)]
        )
        print(
            f"{row.seed:2d} ratio {cascade.ratio} ff {cascade.velocity_feedforward:.2f} s {cascade.velocity_samples}  "
            f"{errors}  found {_changes(row)}  {row.alarm}",
            flush=True,
        )
    print(_summary(rows))


if __name__ == "__main__":
    main()
