"""`diffdrive diagnose`: how large the gap to the logs is, where it lies, what causes it, and how far it shrinks."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from diffdrive.controllers import UnknownController
from diffdrive.drive_file import DriveDescription, read_drive, write_drive
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.motion import Motion
from diffdrive.parameters import Drive
from experiments.checked_logs import parse_loads, read_checked
from experiments.diagnose_figures import draw
from experiments.diagnose_page import page
from experiments.payoff import payoff
from experiments.report import Report, plain
from experiments.tuning_cases import Plan
from tuning.diagnosis.calibration import TOLERANCE
from tuning.diagnosis.diagnose import Diagnosis, diagnose, parameters
from tuning.diagnosis.gap import drive_of
from tuning.diagnosis.ladder import Rung
from tuning.diagnosis.leftover import strain
from tuning.diagnosis.next_experiment import Experiment, next_experiment, reference
from tuning.diagnosis.search import MOST_EFFECTS
from tuning.diagnosis.verdict import Belief
from tuning.diagnosis.where import SIGNIFICANT

HIDDEN = 1.05  # times the floor
SHOWN = 8  # regions that are printed; the JSON has all


def diagnose_logs(
    paths: Sequence[Path],
    drive: Path,
    out: Path | None,
    *,
    columns: Sequence[str] = (),
    units: Sequence[str] = (),
    loads: Sequence[str] = (),
    without: Sequence[str] = (),
    most_effects: int = MOST_EFFECTS,
    tolerance: float = TOLERANCE,
    tuned: bool = False,
) -> dict[str, Any]:
    """`diffdrive diagnose`; returns what diagnosis.json holds.

    `columns`, `units` and `loads` are texts as on the command line; with `tuned`, the controller is tuned on the
    nominal drive and on the one with what was found, and both are judged on the latter. Raises `DriveFileError`,
    `LogError` and `ParameterError`, one line each.
    """
    if tuned and out is None:
        raise ParameterError("--tune needs --out: the drive to tune on is written there")
    for name in without:
        if name not in EFFECTS:
            raise ParameterError(f"--without {name}: no such effect; known: {', '.join(EFFECTS)}")
    description = read_drive(drive)
    description = dataclasses.replace(description, mapping=description.mapping.overridden(columns, units))
    with Report(f"{drive.name}: diagnosis from {', '.join(path.name for path in paths)}", out) as report:
        logs = read_checked(
            paths, description, report, name="findings", force=True, loads=parse_loads(loads, list(paths)),
            used=("motor_position",),
        )  # fmt: skip
        with report.stages() as progress:
            found = diagnose(
                description.drive, description.controller, logs,
                without=without, tolerance=tolerance, most_effects=most_effects, progress=progress,
            )  # fmt: skip
        with report.working("looking for the motion that would decide"):
            offer = next_experiment(found, description)
        told = as_json(found, offer)
        _print(report, found, told)
        if report.out is not None:
            text = json.dumps(plain(told), indent=2, allow_nan=False)
            (report.out / "diagnosis.json").write_text(text + "\n", encoding="utf-8")
            augmented = _write(report, description, found)
            _write_reference(report, reference(offer, description))
            with report.working("drawing"):
                draw(report, found, logs)
            page(report, told, augmented)
            if tuned:
                heaviest = max((float(np.max(log.load)) for log in logs if log.load is not None), default=0.0)
                _pay(report, told, description, augmented, heaviest)
    return told


def _pay(
    report: Report, told: dict[str, Any], description: DriveDescription, augmented: str | None, max_load: float
) -> None:
    """Tune on both drives; the comparison goes to the report."""
    assert report.out is not None
    if augmented is None or not told["ladder"][2:]:
        report.say("Nothing to tune on: no effect was added.")
    elif isinstance(description.controller, UnknownController):
        report.say("Nothing to tune: the drive file does not know its controller.")
    else:
        plan = Plan(max_load=max_load, loads=Plan.loads if max_load > 0 else 1)
        payoff(report, description, read_drive(report.out / augmented), plan)


def as_json(found: Diagnosis, offer: Experiment) -> dict[str, Any]:
    """The diagnosis as diagnosis.json holds it."""
    nominal, recalibrated, last = found.rungs[0], found.rungs[1], found.rungs[-1]
    return {
        "verdict": found.verdict.verdict,
        "says": found.verdict.says,
        "unexplained": found.verdict.unexplained,
        "gap": {
            "position_rms_m": nominal.loop and nominal.loop.position_rms,
            "command_rms_N": nominal.loop and nominal.loop.command_rms,
            "force_rms_N": nominal.force.rms,
            "force_interval_N": nominal.interval,
            "noise_floor_position_m": last.loop and last.loop.position_floor,
            "noise_floor_command_N": last.loop and last.loop.command_floor,
            "noise_floor_force_N": found.floor,
            "recalibrated_position_rms_m": recalibrated.loop and recalibrated.loop.position_rms,
            "recalibrated_command_rms_N": recalibrated.loop and recalibrated.loop.command_rms,
            "recalibrated_force_rms_N": recalibrated.force.rms,
            "judged_on": found.split.says,
        },
        "where": [one._asdict() for one in found.where],
        "causes": [_cause(found, one) for one in found.verdict.beliefs],
        "ladder": [_rung(one) for one in found.rungs],
        "lacks": [one._asdict() for one in found.lacks],
        "next_experiment": offer._asdict(),
    }


def _cause(found: Diagnosis, belief: Belief) -> dict[str, Any]:
    member = len(belief.fitted.model.members) - 1
    numbers = parameters(belief.fitted, member)
    kind = EFFECTS[belief.effect]
    units = {field.name: field.metadata["quantity"].unit for field in dataclasses.fields(kind)}
    rungs = {rung.name: rung for rung in found.rungs}
    rung = rungs.get(f"+ {belief.effect}") if belief.found else None
    before = found.rungs[found.rungs.index(rung) - 1] if rung else None
    return {
        "effect": belief.effect,
        "confidence": belief.confidence,
        "found": belief.found,
        "round": belief.round + 1,
        "evidence": belief.gain,
        "parameters": {name: value for name, (value, _) in numbers.items()},
        "intervals": {name: interval for name, (_, interval) in numbers.items()},
        "units": {name: units[name] for name in numbers},
        "gap_before": before and before.force.rms,
        "gap_after": rung and rung.force.rms,
        "held_out": rung and {"shrink": rung.shrink[0], "interval": rung.shrink[1:], "judged_on": found.split.says},
        "indistinguishable_from": belief.alternatives,
    }


def _rung(rung: Rung) -> dict[str, Any]:
    loop = rung.loop
    return {
        "model": rung.name,
        "force_rms_N": rung.force.rms,
        "force_interval_N": rung.interval,
        "shrink": rung.shrink[0],
        "shrink_interval": rung.shrink[1:],
        "position_rms_m": loop and loop.position_rms,
        "command_rms_N": loop and loop.command_rms,
        "deviance": rung.deviance,
    }


def _micro(value: float | None) -> float | None:
    return None if value is None else 1e6 * value


def _print(report: Report, found: Diagnosis, told: dict[str, Any]) -> None:
    """The four answers, in their order."""
    gap = told["gap"]
    report.say(f"\n1. How large is the gap? ({found.split.says})")
    report.table(
        "ladder",
        ("model", "missing force, N", "low", "high", "position, um", "command, N", "shrink"),
        [
            [
                one["model"],
                one["force_rms_N"],
                *one["force_interval_N"],
                _micro(one["position_rms_m"]),
                one["command_rms_N"],
                one["shrink"],
            ]
            for one in told["ladder"]
        ]
        + [
            [
                "noise floor",
                gap["noise_floor_force_N"],
                None,
                None,
                _micro(gap["noise_floor_position_m"]),
                gap["noise_floor_command_N"],
                None,
            ]
        ],
        "RMS of simulation against log; position and command in closed loop",
    )
    report.say("\n2. Where does it lie? (after recalibration)")
    telling = [one for one in found.where if one.p_value < SIGNIFICANT][:SHOWN]
    for region in telling:
        report.say(f"  - {region.says} (p = {region.p_value:.2g})")
    if not telling:
        report.say("  - nowhere in particular: no region has more than chance would give it")
    report.say("\n3. Which unmodelled effect causes it?")
    report.say(f"  {found.verdict.verdict.upper()}: {found.verdict.says}")
    rows = []
    for cause in told["causes"]:
        shown = "; ".join(_parameter(name, cause) for name in cause["parameters"])
        rows.append([cause["effect"], round(cause["confidence"], 3), shown if cause["found"] else ""])
    if rows:
        report.table("causes", ("effect", "confidence", "parameters"), rows, "Causes, the surest first")
    report.say("\n4. How far does the gap shrink once it is added?")
    if len(found.rungs) > 2 and found.rungs[1].force.rms < HIDDEN * found.floor:
        report.say(
            "  Recalibration hides it: the gap is at its floor, but with a nominal parameter moved by "
            f"{strain(found.explanation.base):.0f} standard deviations, against {strain(found.found):.1f} with it"
        )
    elif len(found.rungs) > 2:
        share = _percent(found.rungs[1].force.rms, found.rungs[-1].force.rms, found.floor)
        report.say(
            f"  On {found.split.says}: from {found.rungs[1].force.rms:.3g} N recalibrated to "
            f"{found.rungs[-1].force.rms:.3g} N with it, the floor being {found.floor:.3g} N: {share} of what was left"
        )
    else:
        report.say("  No effect was added.")
    report.say(f"\nNext: {told['next_experiment']['says']}")


def _percent(before: float, after: float, floor: float) -> str:
    left, was = max(after**2 - floor**2, 0.0), max(before**2 - floor**2, 1e-12)
    return f"{100 * max(0.0, 1 - left / was):.0f} %"


def _parameter(name: str, cause: dict[str, Any]) -> str:
    value, unit = cause["parameters"][name], cause["units"][name]
    values = value if isinstance(value, list) else [value]
    shown = ", ".join(f"{one:.4g}" for one in values)
    return f"{name} {shown}{'' if unit == '1' else ' ' + unit}"


def augmented_drive(found: Diagnosis) -> Drive:
    """The recalibrated drive with the effects found, session parameters as in the first log."""
    return jax.tree.map(float, drive_of(found.found, 0))


def _write_reference(report: Report, motion: Motion | None) -> None:
    """next_reference.csv: the motion that would decide, sample by sample, for the machine's controller to run."""
    if motion is None:
        return
    assert report.out is not None
    path = report.out / "next_reference.csv"
    rows = np.stack([motion.time, motion.position], axis=1)
    np.savetxt(path, rows, delimiter=",", header="time_s,reference_m", comments="", fmt="%.9g")
    report.values("next_motion", file=path.name, motion=motion.name)


def _write(report: Report, description: DriveDescription, found: Diagnosis) -> str | None:
    """augmented.toml, which `simulate`, `tune` and `sweep` take."""
    assert report.out is not None
    path = report.out / "augmented.toml"
    try:
        write_drive(path, dataclasses.replace(description, drive=augmented_drive(found)))
    except DiffdriveError as problem:
        report.say(f"augmented.toml is not written, since no drive file can say this: {problem}")
        return None
    report.values("written", file=path.name)
    return path.name
