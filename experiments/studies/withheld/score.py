"""The scorecard: answers against the key."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from diffdrive.errors import ParameterError

CLEAR = 3.0  # times the noise floor, that the gap of the recalibrated drive is
CLEAR_SIZE = 1.0  # the size from which an effect was drawn to be clear
BINS = 10  # of confidence
MAX_EFFECTS = 2  # effects of a case
MAX_ALTERNATIVES = 2  # rivals: an engineer looks at as many
MIN_GAP = 0.2  # of the floor's square, that is left: too little to speak of a share
UNANSWERED: dict[str, Any] = {"verdict": "error", "says": "there is no answer", "causes": []}


def visibility(told: dict[str, Any]) -> float | None:
    """Largest gap of the recalibrated drive over its own floor, whatever was found; None of an answer without a gap.

    One with which the simulation in closed loop runs away is off without end.
    """
    gap, found = told.get("gap", {}), []
    base = told["ladder"][1] if len(told.get("ladder", [])) > 1 else {}
    if base.get("loop_says"):
        found += [np.inf] if "runs away" in base["loop_says"] else []
    for signal, unit in (("force", "N"), ("position", "m"), ("command", "N")):
        rms = gap.get(f"recalibrated_{signal}_rms_{unit}")
        floor = base.get(f"{signal}_floor_{unit}", gap.get(f"noise_floor_{signal}_{unit}"))
        if isinstance(rms, float) and isinstance(floor, float) and floor > 0:
            found.append(rms / floor)
    return float(max(found)) if found else None


def is_clear(told: dict[str, Any], key: dict[str, Any]) -> bool:
    """Whether a case is one of clear visibility: the key's word; where it has none, the gap over its floor.

    It is the answer's own gap that counts, after recalibration: what recalibration swallows is faint here, and counts
    in the rates by the size that was drawn. Where the answer has none, as it failed, the sizes drawn.
    """
    if key.get("visibility") in ("clear", "faint"):
        return bool(key["visibility"] == "clear")
    seen = visibility(told)
    if seen is None:
        return min((one["size"] for one in key["effects"]), default=0.0) >= CLEAR_SIZE
    return seen >= CLEAR


def score(
    answers: dict[str, dict[str, Any]],
    key: dict[str, dict[str, Any]],
    oracle: dict[str, dict[str, Any]] | None = None,
) -> dict[str, Any]:
    """Every figure of the check; `answers` and `key` by case.

    `oracle` are answers with nothing but the true effects to choose from, for the cases where these were not found;
    without it nothing is said of an oracle. An answer that failed or is missing is wrong in whatever a case of its kind
    counts for, and closes nothing of the gap. `intervals` are Wilson's, of 95 %.
    """
    rows = [_row(name, answers.get(name, UNANSWERED), key[name]) for name in sorted(key)]
    best = {row["case"]: _oracle_reduction(row, oracle) for row in rows}
    single = [row for row in rows if row["kind"] == "single"]
    clear, faint = ([row for row in single if row["clear"] == wanted] for wanted in (True, False))
    sound = [row for row in rows if row["kind"] == "none"]
    outside = [row for row in rows if row["kind"] == "unknown"]
    two = [row for row in rows if row["kind"] == "compound"]
    pitfalls = [row for row in rows if row["kind"] == "pitfall"]
    drawn = [row for row in single + pitfalls if row["size"][0] >= CLEAR_SIZE]
    shrinks = [_ratio(row["shrink"], best[row["case"]], row["failed"]) for row in clear if oracle is not None]
    shares = {
        "named_clear": (clear, "named"),
        "exact_clear": (clear, "exact"),
        "top1_clear": (clear, "top1"),
        "declared_clear": (clear, "declared"),
        "declared_clear_of_few": (clear, "declared_of_few"),
        "top2_clear": (clear, "top2"),
        "named_drawn_clear": (drawn, "named"),
        "named_faint": (faint, "named"),
        "top1_faint": (faint, "top1"),
        "top2_faint": (faint, "top2"),
        "confidently_wrong_faint": (faint, "confidently_wrong"),
        "confidently_wrong": (rows, "confidently_wrong"),
        "said_none": (sound, "said_none"),
        "false_alarms": (sound, "alarm"),
        "unknown_recall": (outside, "said_unknown"),
        "both_found": (two, "both"),
        "both_named": (two, "exact"),
        "pitfall_named": (pitfalls, "named"),
    }
    return {
        "cases": len(rows),
        "errors": sum(row["failed"] for row in rows),
        "clear_single": len(clear),
        "drawn_clear": len(drawn),
        "faint_single": len(faint),
        "none": len(sound),
        "outside": len(outside),
        "compounds": len(two),
        "pitfalls": len(pitfalls),
        **{name: _share(*which) for name, which in shares.items()},
        "intervals": {name: _interval(*which) for name, which in shares.items()},
        "calibration_error": _calibration(_reliability(rows)),
        "reliability": _reliability(rows),
        "interval_coverage": _interval_coverage(rows)[0],
        "intervals_told": _interval_coverage(rows)[1],
        "median_parameter_error": _quantile([row["parameter_error"] for row in clear if row["top1"]], 0.5),
        "median_shrink_held_out": _quantile([row["shrink"] for row in clear], 0.5),
        "quarter_shrink_held_out": _quantile([row["shrink"] for row in clear], 0.25),
        "median_shrink_of_oracle": _quantile(shrinks, 0.5),
        "quarter_shrink_of_oracle": _quantile(shrinks, 0.25),
        "shrinks_of_oracle": sum(one is not None for one in shrinks),
        "without_ratio": [row["case"] for row, one in zip(clear, shrinks, strict=bool(shrinks)) if one is None],
        "declared_at_once": _quantile([float(row["rivals"]) for row in clear], 0.5),
        "most_declared": max((row["rivals"] for row in clear), default=0),
        "oracle_asked": sum(row["case"] in (oracle or {}) for row in clear),
        "confusion": _confusion(rows),
        "rows": rows,
    }


def _row(name: str, told: dict[str, Any], key: dict[str, Any]) -> dict[str, Any]:
    true = [one["name"] for one in key["effects"]]
    outside = any(one["outside"] for one in key["effects"])
    kind = "unknown" if outside else ("none", "single", "compound")[len(true)]
    kind = "pitfall" if key.get("pitfall") else kind
    causes = told["causes"]
    found = [one["effect"] for one in causes if one["found"]]
    ranked = [one["effect"] for one in causes]
    sure = [one for one in causes if one["found"] and one["confidence"] >= 0.5]
    first = causes[0] if causes else None
    declared = set(found[:1]) | set(first["indistinguishable_from"] if first and first["found"] else [])
    seen, failed, said_effect = visibility(told), told["verdict"] == "error", told["verdict"] == "effect"
    top1 = bool(true) and found[:1] == true[:1]
    return {
        "case": name,
        "kind": kind,
        "true": true,
        "size": [round(one["size"], 2) for one in key["effects"]],
        "visibility": None if seen is None else round(seen, 2),
        "clear": is_clear(told, key),
        "failed": failed,
        "verdict": told["verdict"],
        "found": found,
        "top1": top1,
        "named": top1 and said_effect,
        "top2": bool(true) and true[0] in ranked[:2],
        "declared": bool(true) and true[0] in declared,
        "declared_of_few": bool(true) and true[0] in declared and len(declared) <= 1 + MAX_ALTERNATIVES,
        "rivals": len(declared - set(found[:1])),
        "both": set(true) <= set(found),
        "exact": said_effect and set(found) == set(true),
        "said_none": told["verdict"] == "none",
        "alarm": said_effect or failed,
        "said_unknown": told["verdict"] == "unknown",
        "confidently_wrong": failed or (said_effect and any(one["effect"] not in true for one in sure)),
        "sure": [(one["effect"], one["confidence"], one["effect"] in true) for one in causes if one["found"]],
        "within": _interval_hits(first, key["effects"][0].get("true", {}))
        if first and [first["effect"]] == true == found
        else [],
        "parameter_error": _parameter_error(first["parameters"], key["effects"][0]["true"])
        if first and top1 and "true" in key["effects"][0]
        else None,
        "shrink": _gap_reduction(told),
        "seconds": told.get("seconds"),
    }


def _oracle_reduction(row: dict[str, Any], oracle: dict[str, dict[str, Any]] | None) -> float | None:
    """The shrink with the true effects: the oracle's; where just these were found there was no need to ask it."""
    if oracle is None:
        return None
    if row["case"] in oracle:
        return _gap_reduction(oracle[row["case"]])
    return row["shrink"] if set(row["found"]) == set(row["true"]) else None  # type: ignore[no-any-return]


def _gap_reduction(told: dict[str, Any]) -> float | None:
    """How far the whole answer closes the gap to the floor on what was held out, as a share of what recalibration left.

    None where recalibration leaves nothing; nothing of it by an answer that failed.
    """
    if told["verdict"] == "error":
        return 0.0
    ladder, floor = told.get("ladder", []), told.get("gap", {}).get("noise_floor_force_N")
    if len(ladder) < 2:
        return None
    base, last = ladder[1]["force_rms_N"], ladder[-1]["force_rms_N"]
    if not isinstance(base, float):
        return None
    if not isinstance(last, float):  # a filter that ran away, or is lost, closes nothing
        return 0.0
    if not floor:
        return None
    before, after = (max(rms**2 - floor**2, 0.0) for rms in (base, last))
    return 1.0 - after / before if before > MIN_GAP * floor**2 else None


def _ratio(one: float | None, other: float | None, failed: bool) -> float | None:
    if failed:
        return 0.0  # whatever could have been
    if one is None or other is None:
        return None
    if other > 0.0:
        return one / other
    return 0.0 if one < other else None  # where the truth itself closes nothing, one can only be worse


def _parameter_error(found: dict[str, Any], true: dict[str, Any]) -> float | None:
    """The largest relative error of the numbers that both name, log by log where they differ; of zero there is none.

    An amplitude is that of cosine and sine.
    """
    told = dict(found)
    if "cosine" in told:
        told["amplitude"] = np.hypot(told["cosine"], told["sine"])
    errors: list[float] = []
    for name in told.keys() & true.keys():
        ours, theirs = np.broadcast_arrays(*(np.asarray(one, float) for one in (told[name], true[name])))
        there = theirs != 0.0
        errors += list(np.abs(ours[there] / theirs[there] - 1.0))
    return float(max(errors)) if errors else None


def _interval_hits(cause: dict[str, Any], true: dict[str, Any]) -> list[bool]:
    """Whether the interval of each number that both name holds the true one; one without an end holds nothing."""
    held: list[bool] = []
    for name in cause["intervals"].keys() & true.keys():
        low, high = cause["intervals"][name]
        low, high, value = np.broadcast_arrays(*(np.asarray(one, float) for one in (low, high, true[name])))
        held += list(map(bool, np.ravel((low <= value) & (value <= high))))
    return held


def _interval_coverage(rows: list[dict[str, Any]]) -> tuple[float | None, int]:
    """Share of the 95 % intervals that hold the truth, where one effect acts and was found alone; and of how many."""
    held = [one for row in rows for one in row["within"]]
    return (round(float(np.mean(held)), 3) if held else None), len(held)


def _share(rows: list[dict[str, Any]], what: str) -> float | None:
    return round(float(np.mean([row[what] for row in rows])), 3) if rows else None


def _interval(rows: list[dict[str, Any]], what: str) -> list[float] | None:
    if not rows:
        return None
    interval = binomtest(sum(row[what] for row in rows), len(rows)).proportion_ci(method="wilson")
    return [round(float(interval.low), 3), round(float(interval.high), 3)]


def _quantile(values: list[float | None], share: float) -> float | None:
    there = [one for one in values if one is not None]
    return round(float(np.quantile(there, share)), 4) if there else None


def _reliability(rows: list[dict[str, Any]]) -> list[list[Any]]:
    """Mean confidence of what was found, how many, and the share that was right, bin by bin."""
    pairs = [(confidence, right) for row in rows for _, confidence, right in row["sure"]]
    table = []
    for k in range(BINS):
        some = [pair for pair in pairs if min(int(pair[0] * BINS), BINS - 1) == k]
        if some:
            mean, right = np.mean(np.array(some, float), axis=0)
            table.append([float(mean), len(some), float(right)])
    return table


def _calibration(reliability: list[list[Any]]) -> float | None:
    """Expected calibration error: how far confidence and share are apart, weighed by how many."""
    count = sum(many for _, many, _ in reliability)
    off = sum(many * abs(confidence - right) for confidence, many, right in reliability)
    return round(off / count, 4) if count else None


def _confusion(rows: list[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """What was answered for each effect that was there alone, for none, and for what lies outside."""
    table: dict[str, Counter[str]] = {}
    for row in rows:
        if row["kind"] in ("compound", "pitfall"):
            continue
        said = row["found"][0] if row["verdict"] == "effect" and row["found"] else row["verdict"]
        table.setdefault(row["true"][0] if row["true"] else "none", Counter())[said] += 1
    return {name: dict(counts) for name, counts in sorted(table.items())}


def read_answers(folder: Path) -> dict[str, dict[str, Any]]:
    """The answers that are there."""
    found = {}
    for path in sorted(folder.glob("*/diagnosis.json")):
        found[path.parent.name] = json.loads(path.read_text(encoding="utf-8"))
    return found


def read_key(path: Path) -> dict[str, dict[str, Any]]:
    """A key file; where the sizes of the effects are not said, whether they are clear.

    Raises `ParameterError` for a file that is not there or not a key.
    """
    try:
        opened: dict[str, dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
        for name, case in opened.items():
            for one in case["effects"]:
                one["name"]
                one.setdefault("outside", case.get("kind") == "unknown")
                one.setdefault("size", CLEAR if case.get("visibility") == "clear" else 0.0)
            if len(case["effects"]) > MAX_EFFECTS:
                raise ParameterError(f"{path}: case {name} has more than {MAX_EFFECTS} effects, which cannot be scored")
    except FileNotFoundError:
        raise ParameterError(f"{path}: not there; a folder of machines to examine holds the key to them") from None
    except (ValueError, TypeError, KeyError, AttributeError) as problem:
        raise ParameterError(
            f"{path}: no key ({problem!r}); it must be an object of cases, each with its `effects`, a list of objects "
            "with a `name`"
        ) from None
    return opened
