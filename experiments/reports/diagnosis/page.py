"""The diagnosis for its readers: on the console, and as one self-contained HTML page that a colleague can open.

Both are made of what diagnosis.json holds, and of nothing else.
"""

import base64
from collections.abc import Sequence
from html import escape
from typing import Any

from diffdrive.support.atomic_write import write_text
from diffdrive.support.spans import format_span
from experiments.reports.diagnosis import payoff
from experiments.reports.diagnosis.figures import BLANK
from experiments.reports.readable import heading, readable, shown, unit_of
from experiments.reports.report import Report
from tuning.diagnosis.cause_words import headlines, numbers
from tuning.diagnosis.gap.where import SIGNIFICANT

STYLE = """
body { font-family: sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222; line-height: 1.4 }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2rem; border-bottom: 1px solid #ccc }
table { border-collapse: collapse; margin: 1rem 0 } caption { text-align: left; padding-bottom: .3rem }
td, th { padding: .2rem .7rem; text-align: right; border-bottom: 1px solid #eee; vertical-align: top }
td:first-child, th:first-child, .words td, .words th { text-align: left } img { max-width: 100% }
figure { margin: 1rem 0 } caption, figcaption { color: #555; font-size: .9rem }
.verdict { font-size: 1.15rem; padding: .7rem 1rem; background: #eef4fb; border-left: 4px solid #1f77b4 }
"""
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
    "screened. Round 1: alone, 2 and more: beside what was found before. Evidence: drop of -2 ln likelihood. Wave: "
    "A cos(2 pi x / period - phase), x the table position (or time) from its zero"
)
PICTURES = {
    "missing_force": f"The missing force, on held-out data ({BLANK}).",
    "where": "Shares of the gap beside what chance would give.",
    "causes": "How sure each cause is.",
    "ladder": "The gap of each model on held-out data, against the noise floor; bars: 95 %.",
}
LIMITS = ("effect", "parameter", "size, SI", "unit", "these logs would show it")
LIMIT = "Detection limits: an effect of this size brings the evidence that one more effect must bring"
BOTH = "Nominal parameters; damping moves with viscous friction"

Row = list[object]
Details = dict[str, Any]  # of what diagnosis.json holds, an object of objects, lists, texts and numbers


def print_answers(report: Report, details: Details) -> None:
    """Print the verdict, and then the four answers, in their order."""
    gap, regions = details["gap"], _regions(details)
    report.print(f"\n{details['verdict'].upper()}: {details['says']}", style="bold")
    for line in headlines(details["causes"]):
        report.print(f"  {line}")
    report.say(f"\n1. How large is the gap? ({gap['judged_on']})\n  {gap['says']}")
    report.record("gap", SIZE, _sizes(details))
    report.show(LOOP, _SHOWN[:4], _joined(_sizes(details)), notes=_odd(details["ladder"][:2]))
    report.say("\n2. Where does it lie? (after recalibration)")
    for region in regions:
        report.say(f"  - {region}")
    if not regions:
        report.say(f"  - {NOWHERE}")
    report.say(f"\n3. Which unmodelled effect causes it?\n  {details['verdict'].upper()}: {details['says']}")
    for line in headlines(details["causes"]):
        report.say(f"  {line}")
    if details["causes"]:
        report.table("causes", CAUSES, [_cause(one) for one in details["causes"]], FOUND_FIRST)
    report.say(f"\n4. How far does the gap shrink once it is added?\n  {details['closed']['says']}")
    report.record("ladder", LADDER, _ladder(details))
    report.show(SHRINK, _SHOWN, _joined(_ladder(details)), notes=_odd(details["ladder"]))
    for reason in _not_simulated(details):
        report.say(f"  {reason}")
    if details["rest"]:
        report.say(f"\n  {details['rest']['says']}.")
    if details["left_looks_like"]:
        report.say(f"\n{details['left_looks_like']}.")
    if details["detection_limits"]:
        report.record("detection_limits", LIMITS, [_limit(one) for one in details["detection_limits"]])
        report.say(f"\n{details['logs_would_show']}.")
    for one in details["hardly_told_apart"]:
        report.say(f"  {one['says']}")
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


def _odd(ladder: Sequence[Details]) -> list[str]:
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


def write_page(report: Report, details: Details, augmented: str | None) -> None:
    """Write report.html beside the figures, which it holds inside."""
    assert report.out is not None
    gap, title, regions = details["gap"], _html(report.data["title"]), _regions(details)
    loop = "".join(f"<p>{_html(reason)}</p>" for reason in _not_simulated(details))
    parts = [
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{title}</title><style>{STYLE}</style>",
        f"<h1>{title}</h1>",
        f"<p class='verdict'><b>{details['verdict'].upper()}</b>: {_html(details['says'])}{_found(details)}</p>",
        _findings(details["findings"]),
        "<h2>1. How large is the gap?</h2>",
        f"<p>{_html(gap['says'])}.</p>",
        _table(SIZE, _sizes(details), f"{LOOP}; {gap['judged_on']}"),
        *(f"<p>{_html(note)}</p>" for note in _odd(details["ladder"][:2])),
        _image(report, "missing_force"),
        "<h2>2. Where does it lie?</h2>",
        "<ul>" + "".join(f"<li>{_html(one)}</li>" for one in regions) + "</ul>" if regions else f"<p>{NOWHERE}.</p>",
        _image(report, "where"),
        "<h2>3. Which unmodelled effect causes it?</h2>",
        _table(CAUSES, [_cause(one) for one in details["causes"]], FOUND_FIRST, words=True)
        if details["causes"]
        else f"<p>{NOT_WORTH if details['searched'] else NOT_SEARCHED}</p>",
        f"<p>{_html(details['left_looks_like'])}.</p>" if details["left_looks_like"] else "",
        _image(report, "causes"),
        _table(NOMINAL, [_recalibrated(one) for one in details["recalibrated"]], BOTH),
        "<h2>4. How far does the gap shrink once it is added?</h2>",
        f"<p>{_html(details['closed']['says'])}</p>",
        _table(LADDER, _ladder(details), f"{SHRINK}; {gap['judged_on']}"),
        *(f"<p>{_html(note)}</p>" for note in _odd(details["ladder"])),
        loop,
        _image(report, "ladder"),
        f"<p>Drive with what was found, as in log 1: <code>{_html(augmented)}</code></p>" if augmented else "",
        f"<p>{_html(details['scale_noise'])}</p>" if details["scale_noise"] else "",
        _paid(details["payoff"]) if "payoff" in details else "",
        _logs_would_show(details),
        f"<h2>What next?</h2><p>{_html(details['next_experiment']['says'])}</p>",
        "</html>",
    ]
    write_text(report.out / "report.html", "\n".join(parts))


def _html(text: str) -> str:
    return escape(readable(text))


def _logs_would_show(details: Details) -> str:
    limits = details["detection_limits"]
    if not limits:
        return ""
    shown = _table(LIMITS, [_limit(one) for one in limits], LIMIT, words=True)
    alike = "".join(f"<li>{_html(one['says'])}</li>" for one in details["hardly_told_apart"])
    told = f"<p>Seen, but not told apart:</p><ul>{alike}</ul>" if alike else ""
    return f"<h2>What else would these logs show?</h2>{shown}{told}"


def _limit(one: Details) -> Row:
    return [one["effect"], one["parameter"], one["size"], one["unit"], one["says"]]


def _found(details: Details) -> str:
    return "".join(f"<br>{_html(line)}" for line in headlines(details["causes"]))


def _regions(details: Details) -> list[str]:
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


def _sizes(details: Details) -> list[Row]:
    """The gap before anything is added, against the floor."""
    return [*(_rung(one) for one in details["ladder"][:2]), _floor(details)]


def _ladder(details: Details) -> list[Row]:
    nothing: Row = [None, None, None]
    first, *others = details["ladder"]
    shrinks = [[_percent(share) for share in (one["shrink"], *one["shrink_interval"])] for one in others]
    rows = [_rung(one) + shrink for one, shrink in zip(others, shrinks, strict=True)]
    return [_rung(first) + nothing, *rows, _floor(details) + nothing]


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share


def _not_simulated(details: Details) -> list[str]:
    """Why there are no numbers in closed loop, each reason with the models that it is about."""
    models: dict[str, list[str]] = {}
    for one in details["ladder"]:
        if one["loop_says"]:
            models.setdefault(one["loop_says"], []).append(one["model"])
    return [f"{', '.join(names)}: {reason}" for reason, names in models.items()]


def _cause(one: Details) -> Row:
    return [
        one["effect"],
        one["round"],
        None if one["evidence"] is None else round(one["evidence"]),
        round(one["confidence"], 3),
        "; ".join(numbers(one)) if one["found"] else "",
        ", ".join(one["indistinguishable_from"]),
    ]


def _recalibrated(one: Details) -> Row:
    row = [one["parameter"], unit_of(one["unit"]), one["drive_file"]]
    for key in ("recalibrated", "with_effects"):
        row += format_span((one[key], *one[f"{key}_interval"])) if key in one else ("-", "-", "-")
    return row


def _findings(findings: Sequence[dict[str, str]]) -> str:
    """What the log checks found, or nothing."""
    if not findings:
        return ""
    keys = ("log", "severity", "channel", "found", "mend")
    rows: list[Row] = [[one[key] for key in keys] for one in findings]
    return _table((*keys[:-1], "remedy"), rows, "Before all: the log checks", words=True)


def _paid(paid: Details) -> str:
    """What the controller gains by being tuned on what was found."""
    rows = [
        [name, *(one[key] for key in payoff.COLUMNS), "yes" if one["requirements_kept_where_tuned"] else "no"]
        for name, one in paid["gains"].items()
    ]
    columns = ("gains", *(_spaced(key) for key in payoff.COLUMNS), "requirements kept where tuned")
    return f"<p>{_html(paid['says'])}</p>" + (_table(columns, rows, payoff.CAPTION) if rows else "")


def _spaced(key: str) -> str:
    """A key that ends with its unit, as a heading."""
    *words, unit = key.split("_")
    return f"{' '.join(words)}, {unit}"


def _image(report: Report, name: str) -> str:
    assert report.out is not None
    if f"{name}.png" not in report.data.get("figures", []):
        return ""  # what lies there may be of an earlier diagnosis
    data = base64.b64encode((report.out / f"{name}.png").read_bytes()).decode("ascii")
    picture = f"<img alt='{name}' src='data:image/png;base64,{data}'>"
    return f"<figure>{picture}<figcaption>{_html(PICTURES[name])}</figcaption></figure>"


def _table(columns: tuple[str, ...], rows: list[Row], caption: str = "", words: bool = False) -> str:
    named = [", ".join(part for part in heading(one) if part) for one in columns]
    head = "".join(f"<th>{_html(one)}</th>" for one in named)
    body = "".join("<tr>" + "".join(f"<td>{_cell(one)}</td>" for one in row) + "</tr>" for row in rows)
    kind, above = " class='words'" if words else "", f"<caption>{_html(caption)}</caption>" if caption else ""
    return f"<table{kind}>{above}<tr>{head}</tr>{body}</table>"


def _cell(value: object) -> str:
    return _html(shown(value))
