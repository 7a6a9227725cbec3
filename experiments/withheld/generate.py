"""Cases as a user would have them: a drive file and two logs each. The key stays with whoever holds the seed."""

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from diffdrive.controllers import PD, Gains, Tracking
from diffdrive.drive_file import DriveDescription, write_drive
from diffdrive.errors import DivergenceError
from diffdrive.logs import Log, write_log
from diffdrive.motion import Limits
from diffdrive.parameters import Sampling
from experiments.withheld.draw import KNOWN, OUTSIDE, Case, draw, of_log
from experiments.withheld.machine import run

NONE, TWO, UNKNOWN = 0.12, 0.12, 0.12  # shares of cases
RESOLUTION = 1e-7  # m
ATTEMPTS = 5  # at a machine whose loop is stable


def kinds(seed: int, count: int) -> list[tuple[str, ...]]:
    """Which effects each case has: every effect of the catalogue in turn, and none, two, and others mixed in."""
    room = np.random.default_rng([seed, 0])
    names = list(KNOWN)
    mixed: list[tuple[str, ...]] = [()] * round(NONE * count)
    mixed += [tuple(room.choice(names, 2, replace=False)) for _ in range(round(TWO * count))]
    mixed += [(str(room.choice(list(OUTSIDE))),) for _ in range(round(UNKNOWN * count))]
    left = count - len(mixed)
    singles: list[tuple[str, ...]] = [(names[k % len(names)],) for k in range(left)]
    cases = [*mixed, *singles]
    return [tuple(map(str, cases[k])) for k in room.permutation(len(cases))]


def cases(seed: int, count: int) -> Iterator[tuple[str, Case, list[Log]]]:
    """Name, machine and logs of each case."""
    for number, effects in enumerate(kinds(seed, count)):
        for attempt in range(ATTEMPTS):
            case = draw(np.random.default_rng([seed, 1 + number, attempt]), effects)
            logs = [_log(case, log) for log in range(2)]
            if all(_followed(log) for log in logs):
                break
        else:
            raise DivergenceError(f"case {number} ({', '.join(effects)}) does not follow its reference")
        yield f"{number + 1:03d}", case, logs


def _followed(log: Log) -> bool:
    assert log.reference is not None
    return bool(np.all(np.abs(log.position - log.reference) < 2e-3))


def _log(case: Case, log: int) -> Log:
    told, peak = case.told[log], None
    for _ in range(2):  # a limit is set by the peak that there is without it
        faults, kind = of_log(case, log, peak)
        position, command = run(case.true, faults, kind, case.gains, RESOLUTION, told, case.rate)
        if not any(fault.effect == "force_limit" for fault in case.faults) or peak is not None:
            break
        peak = float(np.abs(command).max())
    time = np.arange(len(position)) / case.rate
    return Log("ab"[log], time, position, command, reference=told.reference, load=told.load)


def key_of(case: Case) -> dict[str, Any]:
    """What was done to a machine."""
    return {
        "effects": [
            {"name": fault.effect, "size": fault.size, "outside": fault.effect in OUTSIDE, "true": fault.true}
            for fault in case.faults
        ],
        "rate": case.rate,
    }


def generate(folder: Path, seed: int, count: int) -> Iterator[str]:
    """Write the cases that are not there yet; yields the name of each."""
    for name, case, logs in cases(seed, count):
        place = folder / name
        if not (place / "drive.toml").exists():
            place.mkdir(parents=True, exist_ok=True)
            for log in logs:
                write_log(place / f"log-{log.name}.parquet", log)
            write_drive(place / "drive.toml", _believed(case))
        yield name


def _believed(case: Case) -> DriveDescription:
    kp, kd = case.gains
    nominal = dataclasses.replace(case.nominal)
    return DriveDescription(nominal, PD(Tracking(Gains(kp, kd))), Sampling(case.rate, 10), Limits())


def write_key(path: Path, seed: int, count: int) -> dict[str, Any]:
    """The key, drawn again from the seed."""
    drawn = {}
    for name, case, _ in cases(seed, count):
        drawn[name] = key_of(case)
    path.write_text(json.dumps(drawn, indent=1) + "\n", encoding="utf-8")
    return drawn
