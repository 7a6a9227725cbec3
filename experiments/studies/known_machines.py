"""How near `identify` comes to machines whose truth is known: `python -m experiments.studies.known_machines FOLDER`.

FOLDER has key.json and a folder for each machine: rough.toml, a drive file whose numbers are wrong, and healthy-1 and
healthy-2, logs of the sound machine. Each case is identified from both logs, and compared by what acts: the mass, the
force that sliding takes at the logs' own speeds, and every parameter's interval. Then from the first log alone: how far
is the answer from the second, beside the true drive? Each case is a line of OUT, with `--out`; those there are not done
again.
"""

import argparse
import dataclasses
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NotRequired, TypedDict

import numpy as np

import tuning
from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.logs import Log
from diffdrive.model.friction import stribeck_level
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import Directional
from diffdrive.runtime import configure
from experiments.studies.resumed import resumed
from tuning.identification.estimates import EstimateStatus
from tuning.identification.gaps import prediction_gaps

SIDES = {"positive": "+", "negative": "-"}
LOGS = ("healthy-1", "healthy-2")
SLIDING = 0.3  # of the largest speed that way: faster samples count for the force
SPEEDS = (0.1, 0.5, 0.9)  # quantiles of their speeds at which the force is compared
MISSING = "missing force, N"

Truth = Mapping[str, float]


class EstimateRow(TypedDict):
    """One parameter as it was found, and as it is; without truth where the machine has none."""

    path: str
    status: str
    value: float
    low: float
    high: float
    true: NotRequired[float]


class Case(TypedDict):
    """One machine, as a line of the output."""

    case: str
    family: str
    status: str
    seconds: float  # of processor time, from both logs
    mass_error: float  # %
    force_errors: list[float]  # %, of sliding friction, at speeds of both logs and both directions
    constant_force: float  # N; the truth is none
    rows: list[EstimateRow]
    held_out: NotRequired[float]  # missing force on the second log, over that with the true drive
    notes: list[str]


def true_drive(believed: Drive, truth: Truth) -> Drive:
    """The drive of the key, with the exponent of the Stribeck curve that the drive file states."""

    def pair(name: str) -> Directional:
        return Directional(*(truth.get(f"{name}{sign}", truth.get(name, 0.0)) for sign in SIDES.values()))

    names = (
        "coulomb_screw", "load_coefficient", "breakaway_gap", "stribeck_velocity", "viscous", "bristle_stiffness",
        "bristle_damping",
    )  # fmt: skip
    pairs = {name: pair(name) for name in names}
    friction = dataclasses.replace(believed.friction, initial_load=truth["initial_load"], **pairs)  # type: ignore[arg-type]
    plant = dataclasses.replace(believed.plant, mass=truth["mass"], damping=Directional(0.0, 0.0), constant_force=0.0)
    return dataclasses.replace(believed, plant=plant, friction=friction)


def true_values(drive: Drive, has_delay: bool) -> dict[str, float]:
    """The truth by path in an axis; the damping counts as viscous friction, and a slower trace has no delay."""
    friction = drive.friction
    values = {"plant.mass": float(drive.plant.mass), "plant.constant_force": 0.0}
    level = friction.coulomb_at(0.0)
    for side in SIDES:
        one = {"coulomb_at_no_load": level} | {
            name: getattr(friction, name)
            for name in ("coulomb_screw", "load_coefficient", "breakaway_gap", "stribeck_velocity", "viscous")
        }
        values |= {f"friction.{name}.{side}": float(getattr(value, side)) for name, value in one.items()}
    for name in ("bristle_stiffness", "bristle_damping"):
        values[f"friction.{name}"] = float(getattr(friction, name).positive)
    return values if not has_delay else values | {"actuator.delay": 0.0}


def sliding_force(drive: Drive, velocity: float, load: float) -> float:
    """The force (N), in the direction of the velocity, that it takes to slide steadily."""
    side = "positive" if velocity > 0 else "negative"
    slope = float(getattr(drive.friction.viscous, side)) + float(getattr(drive.plant.damping, side))
    pull = float(drive.plant.constant_force) * (1.0 if velocity > 0 else -1.0)
    return float(stribeck_level(drive.friction, velocity, load)) + slope * abs(velocity) - pull


def force_errors(found: Drive, true: Drive, log: Log) -> list[float]:
    """Errors (%) of the force that sliding takes, at speeds of the log, in both directions."""
    velocity = np.gradient(log.position, log.time)
    load = 0.0 if log.load is None else float(np.median(log.load))
    errors = []
    for way in (1.0, -1.0):
        fast = way * velocity > SLIDING * np.max(way * velocity)
        for speed in np.quantile(np.abs(velocity[fast]), SPEEDS):
            force, truth = (sliding_force(drive, way * float(speed), load) for drive in (found, true))
            errors.append(100.0 * (force / truth - 1.0))
    return errors


def study_case(folder: Path, name: str, facts: Mapping[str, object], truth: Truth, held_out: bool) -> Case:
    """Identify one machine from both of its logs, and with `held_out` from the first alone."""
    axis = read_axis(folder / name / "rough.toml")
    paths = [folder / name / f"{log}.parquet" for log in LOGS]
    true = true_drive(axis.drive, truth)
    begun = time.process_time()
    found = tuning.identify(axis, paths, force=True)
    seconds = time.process_time() - begun
    values = true_values(true, facts["trace_rate"] == facts["control_rate"])
    rows = [
        EstimateRow(path=one.path, status=str(one.status), value=one.value, low=one.low, high=one.high)
        | ({"true": values[one.path]} if one.path in values else {})
        for one in found.estimates
    ]
    drive = found.axis.drive
    case = Case(
        case=name,
        family=str(facts["family"]),
        status=found.status.code or "ok",
        seconds=seconds,
        mass_error=100.0 * (float(drive.plant.mass) / truth["mass"] - 1.0),
        force_errors=[error for log in found.logs.logs for error in force_errors(drive, true, log)],
        constant_force=float(drive.plant.constant_force),
        rows=rows,
        notes=list(found.notes),
    )
    if held_out:
        case["held_out"] = held_out_ratio(axis, paths, true)
    return case


def held_out_ratio(axis: Axis, paths: Sequence[Path], true: Drive) -> float:
    """Missing force on the second log of the drive identified from the first, over that of the true drive.

    Both with the delay that was found: it belongs to the trace.
    """
    found = tuning.identify(axis, paths[:1], held_out=paths[1:], force=True)
    delay, log = found.estimate("delay").value, found.held_out.logs[0]
    seen = found.initial_axis
    was, floor = (
        prediction_gaps(dataclasses.replace(seen, drive=drive), delay, log, found.fit.between)[MISSING]
        for drive in (found.fit.drive, true)
    )
    return was / floor


def study(folder: Path, cases: Sequence[str], out: Path | None, held_out: bool) -> Iterator[Case]:
    """Each case, those in `out` first, the others as they are done."""
    key = json.loads((folder / "key.json").read_text(encoding="utf-8"))
    yield from resumed(
        out, cases or sorted(key), lambda name: study_case(folder, name, key[name], key[name]["healthy"], held_out)
    )


def covered(cases: Sequence[Case]) -> tuple[int, int, list[str]]:
    """How many intervals hold the truth, of how many, and those that do not."""
    missed, count = [], 0
    for case in cases:
        for row in case["rows"]:
            if row["status"] != EstimateStatus.FITTED or "true" not in row:
                continue
            count += 1
            if not row["low"] <= row["true"] <= row["high"]:
                half = max(row["high"] - row["value"], row["value"] - row["low"])
                off = (row["value"] - row["true"]) / half if half > 0.0 else np.inf
                missed.append(f"{case['case']} {row['path']} by {off:+.2g} half-widths")
    return count - len(missed), count, missed


def line(case: Case) -> str:
    """A row of the table."""
    errors = np.abs(case["force_errors"])
    inside, of, _ = covered([case])
    held = f"{case['held_out']:.3f}" if "held_out" in case else "-"
    return (
        f"| {case['case']} | {case['family']} | {case['status']} | {case['mass_error']:+.3f} | {np.median(errors):.3f} "
        f"| {errors.max():.3f} | {case['constant_force']:+.2f} | {inside} of {of} | {held} | {case['seconds']:.0f} |"
    )


def main() -> None:
    """Print a row for each case, and how many intervals hold the truth."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="has key.json and the cases")
    parser.add_argument("--case", action="append", default=[], help="of these cases only")
    parser.add_argument("--out", type=Path, help="keeps a line of JSON for each case, and goes on from it")
    parser.add_argument("--held-out", action="store_true", help="also from the first log alone, judged on the second")
    given = parser.parse_args()
    configure()
    print(
        "| case | family | status | mass, % | sliding force, median % | worst % | constant force, N | intervals that "
        "hold | held out | processor, s |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    cases = []
    for case in study(given.folder, given.case, given.out, given.held_out):
        cases.append(case)
        print(line(case), flush=True)
    inside, count, missed = covered(cases)
    print(f"\n{inside} of {count} intervals hold the truth ({100.0 * inside / max(count, 1):.1f} %)")
    print("\n".join(missed))


if __name__ == "__main__":
    main()
