"""The diagnosis in words and rows, for console and page: of what diagnosis.json holds, and of nothing else."""

from collections.abc import Sequence
from typing import Any

from diffdrive.support.spans import format_span
from experiments.reports.readable import shown, unit_of
from experiments.reports.report import Report
from tuning.diagnosis.cause_words import headlines, numbers
from tuning.diagnosis.gap.where import SIGNIFICANT

REGIONS = 10  # that are shown, each with
LEAST = 0.03  # of the gap and more; the JSON has all
NOT_WORTH = "No effect of the catalogue was worth a fit."
NOT_SEARCHED = "No cause was looked for: correct the log first; until then no number of this page means anything."
NOWHERE = f"nowhere in particular: no region with {100 * LEAST:.0f} % of it or more has more than chance would give it"

SIZE = ("model", "missing force, N", "low", "high", "position, um", "command, N")
LADDER = ("model", "missing force, N", "low", "high", "position, um", "command, N", "shrink, %", "low", "high")
LOOP = (
    "Missing force: what the model needs beside its own forces to follow the log while the table slides, RMS, low and "
    "high its 95 % interval; "
    "position and command: the log against the simulation in closed loop, RMS"
)
SHRINK = f"{LOOP}. Shrink: of the missing force's mean square, noise floor and all, against the nominal drive's"
LEAST_CHANCE = 1e-3  # no smaller one means anything
CAUSES = ("effect", "round", "evidence", "confidence", "parameters with 95 % intervals", "not excluded in its place")
NOMINAL = ("parameter", "unit", "drive file", "recalibrated", "low", "high", "with what was found", "low", "high")
FOUND_FIRST = (
    "Causes: what was found, then what else was fitted, the surest first; the rest of the catalogue promised less when "
    "screened, or could not hide where nothing is missing. Round 1: alone, 2 and more: beside what was found before. "
    "Evidence: drop of -2 ln likelihood. Wave: A cos(2 pi x / period - phase), x the table position (or time) from its "
    "zero"
)
LIMITS = ("effect", "parameter", "size, SI", "unit", "these logs would show it")
LIMIT = "Detection limits: an effect of this size brings the evidence that one more effect must bring"
BOTH = "Nominal parameters; damping moves with viscous friction"

Row = list[object]
Details = dict[str, Any]  # of what diagnosis.json holds, an object of objects, lists, texts and numbers


def print_answers(report: Report, details: Details) -> None:
    """Print the verdict, and then the four answers, in their order."""
    gap, regions = details["gap"], regions_in_words(details)
    report.print(f"\n{details['verdict'].upper()}: {details['says']}", style="bold")
    for line in headlines(details["causes"]):
        report.print(f"  {line}")
    report.say(f"\n1. How large is the gap? ({gap['judged_on']})\n  {gap['says']}")
    report.record("gap", SIZE, size_rows(details))
    report.show(LOOP, _SHOWN[:4], _joined(size_rows(details)), notes=odd_notes(details["ladder"][:2]), of="gap")
    report.say("\n2. Where does it lie? (after recalibration)")
    for region in regions:
        report.say(f"  - {region}")
    if not regions:
        report.say(f"  - {NOWHERE}")
    report.say(f"\n3. Which unmodelled effect causes it?\n  {details['verdict'].upper()}: {details['says']}")
    for line in headlines(details["causes"]):
        report.say(f"  {line}")
    if details["causes"]:
        report.table("causes", CAUSES, [cause_row(one) for one in details["causes"]], FOUND_FIRST)
    report.say(f"\n4. How far does the gap shrink once it is added?\n  {details['closed']['says']}")
    report.record("ladder", LADDER, ladder_rows(details))
    report.show(SHRINK, _SHOWN, _joined(ladder_rows(details)), notes=odd_notes(details["ladder"]), of="ladder")
    for reason in loop_reasons(details):
        report.say(f"  {reason}")
    if details["rest"]:
        report.say(f"\n  {details['rest']['says']}.")
    if details["left_looks_like"]:
        report.say(f"\n{details['left_looks_like']}.")
    if details["detection_limits"]:
        report.record("detection_limits", LIMITS, [limit_row(one) for one in details["detection_limits"]])
        report.say(f"\n{details['logs_would_show']}.")
    for one in details["hardly_told_apart"]:
        report.say(f"  {one['says']}.")
    report.say(f"\nNext: {details['next_experiment']['says']}")


_SHOWN = ("model", "missing force, N", "position, um", "command, N", "shrink, %")
FEW = 3  # digits of a number beside its interval


def _joined(rows: list[Row]) -> list[Row]:
    """Rows of `LADDER` or `SIZE` under `_SHOWN`: a number and its interval in one cell."""
    return [
        [model, _with_interval(force, low, high), position, command, *([_with_interval(*shrink)] if shrink else [])]
        for model, force, low, high, position, command, *shrink in rows
    ]


def _with_interval(value: object, low: object, high: object) -> str:
    if low is None or high is None:
        return shown(value, FEW)
    return f"{shown(value, FEW)} ({shown(low, FEW)} to {shown(high, FEW)})"


MEASURES = {
    "missing force": ("force_rms_N", "force_floor_N"),
    "position": ("position_rms_m", "position_floor_m"),
    "command": ("command_rms_N", "command_floor_N"),
}


def odd_notes(ladder: Sequence[Details]) -> list[str]:
    """Why a model looks worse than the one before it, or better than its noise lets it."""
    notes = []
    if worse := _larger(ladder[0], ladder[1]):
        notes.append(
            f"Recalibrated, the {' and the '.join(worse)} {'is' if len(worse) == 1 else 'are'} larger than nominal. "
            "Recalibration maximises the likelihood of the fitted data, with parameters held near the drive file. It "
            "does not minimise this RMS on held-out data, so the RMS may rise where the missing effect is no nominal "
            "parameter."
        )
    for one in ladder:
        if below := [name for name, (rms, floor) in MEASURES.items() if _is_below(one[rms], one[floor])]:
            notes.append(
                f"{one['model']}: {', '.join(below)} below the noise floor, which is what the noise leaves on average: "
                "here nothing is left that could be seen, and how far below is chance."
            )
    return notes


def _larger(first: Details, second: Details) -> list[str]:
    return [name for name, (rms, _) in MEASURES.items() if _is_below(first[rms], second[rms])]


def _is_below(one: float | None, other: float | None) -> bool:
    return one is not None and other is not None and one < other


def limit_row(one: Details) -> Row:
    """An effect that was not found, under `LIMITS`."""
    return [one["effect"], one["parameter"], one["size"], one["unit"], one["says"]]


def regions_in_words(details: Details) -> list[str]:
    """Where more of the gap lies than chance would give, in words."""
    significant = [one for one in details["where"] if one["p_value"] < SIGNIFICANT and one["share"] >= LEAST][:REGIONS]
    return [f"{one['says']} ({_chance(one['p_value'])})" for one in significant]


def _chance(p: float) -> str:
    return f"p = {p:.2g}" if p >= LEAST_CHANCE else f"p < {LEAST_CHANCE:g}"


def _rung(one: Details) -> Row:
    position = one["position_rms_m"]
    return [
        one["model"],
        one["force_rms_N"],
        *one["force_interval_N"],
        None if position is None else 1e6 * position,
        one["command_rms_N"],
    ]


def _floor(details: Details) -> Row:
    gap = details["gap"]
    floor = {"position_rms_m": gap["noise_floor_position_m"], "command_rms_N": gap["noise_floor_command_N"]}
    force = {"force_rms_N": gap["noise_floor_force_N"], "force_interval_N": [None, None]}
    return _rung({"model": "noise floor"} | force | floor)


def size_rows(details: Details) -> list[Row]:
    """The gap before anything is added, against the floor."""
    return [*(_rung(one) for one in details["ladder"][:2]), _floor(details)]


def ladder_rows(details: Details) -> list[Row]:
    """All models and the floor, under `LADDER`."""
    nothing: Row = [None, None, None]
    first, *others = details["ladder"]
    shrinks = [[_percent(share) for share in (one["shrink"], *one["shrink_interval"])] for one in others]
    rows = [_rung(one) + shrink for one, shrink in zip(others, shrinks, strict=True)]
    return [_rung(first) + nothing, *rows, _floor(details) + nothing]


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share


def loop_reasons(details: Details) -> list[str]:
    """Why there are no numbers in closed loop, each reason with the models that it is about."""
    models: dict[str, list[str]] = {}
    for one in details["ladder"]:
        if one["loop_says"]:
            models.setdefault(one["loop_says"], []).append(one["model"])
    return [f"{', '.join(names)}: {reason}" for reason, names in models.items()]


def cause_row(one: Details) -> Row:
    """A cause, under `CAUSES`."""
    return [
        one["effect"],
        one["round"],
        None if one["evidence"] is None else round(one["evidence"]),
        round(one["confidence"], 3),
        "; ".join(numbers(one)) if one["found"] else "",
        ", ".join(one["indistinguishable_from"]),
    ]


def recalibrated_row(one: Details) -> Row:
    """A nominal parameter, under `NOMINAL`."""
    row = [one["parameter"], unit_of(one["unit"]), one["drive_file"]]
    for key in ("recalibrated", "with_effects"):
        row += format_span((one[key], *one[f"{key}_interval"])) if key in one else ("-", "-", "-")
    return row
