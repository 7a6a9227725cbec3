"""The scorecard: answers against the key."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import binomtest

from diffdrive.errors import ParameterError
from experiments.studies.withheld.records import Answer, Answers, CaseKey, Cause, Key, Number, ScoredCase

CLEAR = 3.0  # times the noise floor, that the gap of the recalibrated drive is
CLEAR_SIZE = 1.0  # the size from which an effect was drawn to be clear
BINS = 10  # of confidence
MAX_EFFECTS = 2  # effects of a case
MAX_ALTERNATIVES = 2  # rivals, as many as an engineer looks at
MIN_GAP = 0.2  # of the floor's square, that is left: too little to speak of a share
UNANSWERED: Answer = {"verdict": "error", "says": "there is no answer", "causes": []}


def visibility(answer: Answer) -> float | None:
    """The largest gap of the recalibrated drive over its noise floor; None for an answer without a gap.

    Infinite where the recalibrated drive diverges in closed loop.
    """
    gap, ladder = answer.get("gap", {}), answer.get("ladder", [])
    base, ratios = ladder[1] if len(ladder) > 1 else {}, list[float]()
    if isinstance(loop_says := base.get("loop_says"), str) and "runs away" in loop_says:
        ratios.append(np.inf)
    for signal, unit in (("force", "N"), ("position", "m"), ("command", "N")):
        rms = gap.get(f"recalibrated_{signal}_rms_{unit}")
        floor = base.get(f"{signal}_floor_{unit}", gap.get(f"noise_floor_{signal}_{unit}"))
        if isinstance(rms, float) and isinstance(floor, float) and floor > 0:
            ratios.append(rms / floor)
    return float(max(ratios)) if ratios else None


def is_clear(answer: Answer, key: CaseKey) -> bool:
    """Whether a case is clearly visible: by the key, else by the gap over its floor, else by the sizes drawn.

    The gap is the answer's, after recalibration: an effect that recalibration absorbs is faint here, and counts in the
    rates by drawn size.
    """
    if key.get("visibility") in ("clear", "faint"):
        return bool(key["visibility"] == "clear")
    gap_ratio = visibility(answer)
    if gap_ratio is None:
        return min((effect["size"] for effect in key["effects"]), default=0.0) >= CLEAR_SIZE
    return gap_ratio >= CLEAR


def score(answers: Answers, key: Key, oracle: Answers | None = None) -> dict[str, Any]:
    """Every figure of the check; `answers` and `key` by case.

    `oracle` are answers with only the true effects to choose from, for the cases where these were not found; without
    it the figures of the oracle are None. An answer that failed or is missing is wrong in every rate in which its case
    counts, and reduces no gap. `intervals` are Wilson's, of 95 %.
    """
    rows = [_row(name, answers.get(name, UNANSWERED), key[name]) for name in sorted(key)]
    oracle_reductions = {row["case"]: _oracle_reduction(row, oracle) for row in rows}
    single = [row for row in rows if row["kind"] == "single"]
    clear, faint = ([row for row in single if row["clear"] == is_clear_row] for is_clear_row in (True, False))
    no_effect = [row for row in rows if row["kind"] == "none"]
    outside = [row for row in rows if row["kind"] == "unknown"]
    compounds = [row for row in rows if row["kind"] == "compound"]
    pitfalls = [row for row in rows if row["kind"] == "pitfall"]
    drawn = [row for row in single + pitfalls if row["size"][0] >= CLEAR_SIZE]
    reductions = [
        _ratio(row["shrink"], oracle_reductions[row["case"]], row["failed"]) for row in clear if oracle is not None
    ]
    shares = {
        "named_clear": [row["named"] for row in clear],
        "exact_clear": [row["exact"] for row in clear],
        "top1_clear": [row["top1"] for row in clear],
        "declared_clear": [row["declared"] for row in clear],
        "declared_clear_of_few": [row["declared_of_few"] for row in clear],
        "top2_clear": [row["top2"] for row in clear],
        "named_drawn_clear": [row["named"] for row in drawn],
        "named_faint": [row["named"] for row in faint],
        "top1_faint": [row["top1"] for row in faint],
        "top2_faint": [row["top2"] for row in faint],
        "confidently_wrong_faint": [row["confidently_wrong"] for row in faint],
        "confidently_wrong": [row["confidently_wrong"] for row in rows],
        "said_none": [row["said_none"] for row in no_effect],
        "false_alarms": [row["alarm"] for row in no_effect],
        "unknown_recall": [row["said_unknown"] for row in outside],
        "unknown_clear": [row["said_unknown"] for row in outside if row["clear"]],
        "both_found": [row["both"] for row in compounds],
        "both_named": [row["exact"] for row in compounds],
        "pitfall_named": [row["named"] for row in pitfalls],
    }
    return {
        "cases": len(rows),
        "errors": sum(row["failed"] for row in rows),
        "clear_single": len(clear),
        "drawn_clear": len(drawn),
        "faint_single": len(faint),
        "none": len(no_effect),
        "outside": len(outside),
        "compounds": len(compounds),
        "pitfalls": len(pitfalls),
        **{name: _share(hits) for name, hits in shares.items()},
        "intervals": {name: _interval(hits) for name, hits in shares.items()},
        "calibration_error": _calibration(_reliability(rows)),
        "reliability": _reliability(rows),
        "interval_coverage": _interval_coverage(rows)[0],
        "intervals_told": _interval_coverage(rows)[1],
        "median_parameter_error": _quantile([row["parameter_error"] for row in clear if row["top1"]], 0.5),
        "median_shrink_held_out": _quantile([row["shrink"] for row in clear], 0.5),
        "quarter_shrink_held_out": _quantile([row["shrink"] for row in clear], 0.25),
        "median_shrink_of_oracle": _quantile(reductions, 0.5),
        "quarter_shrink_of_oracle": _quantile(reductions, 0.25),
        "shrinks_of_oracle": sum(reduction is not None for reduction in reductions),
        "without_ratio": [
            row["case"] for row, reduction in zip(clear, reductions, strict=bool(reductions)) if reduction is None
        ],
        "declared_at_once": _quantile([float(row["rivals"]) for row in clear], 0.5),
        "most_declared": max((row["rivals"] for row in clear), default=0),
        "oracle_asked": sum(row["case"] in (oracle or {}) for row in clear),
        "confusion": _confusion(rows),
        "rows": rows,
    }


def _row(name: str, answer: Answer, key: CaseKey) -> ScoredCase:
    true = [effect["name"] for effect in key["effects"]]
    outside = any(effect["outside"] for effect in key["effects"])
    kind = "unknown" if outside else ("none", "single", "compound")[len(true)]
    kind = "pitfall" if key.get("pitfall") else kind
    causes = answer["causes"]
    found = [cause["effect"] for cause in causes if cause["found"]]
    ranked = [cause["effect"] for cause in causes]
    confident = [cause for cause in causes if cause["found"] and cause["confidence"] >= 0.5]
    first = causes[0] if causes else None
    declared = set(found[:1]) | set(first["indistinguishable_from"] if first and first["found"] else [])
    gap_ratio, failed, said_effect = visibility(answer), answer["verdict"] == "error", answer["verdict"] == "effect"
    top1 = bool(true) and found[:1] == true[:1]
    return {
        "case": name,
        "kind": kind,
        "true": true,
        "size": [round(effect["size"], 2) for effect in key["effects"]],
        "visibility": None if gap_ratio is None else round(gap_ratio, 2),
        "clear": is_clear(answer, key),
        "failed": failed,
        "verdict": answer["verdict"],
        "found": found,
        "top1": top1,
        "named": top1 and said_effect,
        "top2": bool(true) and true[0] in ranked[:2],
        "declared": bool(true) and true[0] in declared,
        "declared_of_few": bool(true) and true[0] in declared and len(declared) <= 1 + MAX_ALTERNATIVES,
        "rivals": len(declared - set(found[:1])),
        "both": set(true) <= set(found),
        "exact": said_effect and set(found) == set(true),
        "said_none": answer["verdict"] == "none",
        "alarm": said_effect or failed,
        "said_unknown": answer["verdict"] == "unknown",
        "confidently_wrong": failed or (said_effect and any(cause["effect"] not in true for cause in confident)),
        "sure": [(cause["effect"], cause["confidence"], cause["effect"] in true) for cause in causes if cause["found"]],
        "within": _interval_hits(first, key["effects"][0].get("true", {}))
        if first and [first["effect"]] == true == found
        else [],
        "parameter_error": _parameter_error(first["parameters"], key["effects"][0]["true"])
        if first and top1 and "true" in key["effects"][0]
        else None,
        "shrink": _gap_reduction(answer),
        "seconds": answer.get("seconds"),
    }


def _oracle_reduction(row: ScoredCase, oracle: Answers | None) -> float | None:
    """The gap reduction with the true effects: the oracle's, or the answer's own where it found exactly these."""
    if oracle is None:
        return None
    if row["case"] in oracle:
        return _gap_reduction(oracle[row["case"]])
    return row["shrink"] if set(row["found"]) == set(row["true"]) else None


def _gap_reduction(answer: Answer) -> float | None:
    """How far the answer reduces the held-out gap to the floor, as a share of what recalibration left.

    None where recalibration leaves none; 0 for an answer that failed.
    """
    if answer["verdict"] == "error":
        return 0.0
    ladder, floor = answer.get("ladder", []), answer.get("gap", {}).get("noise_floor_force_N")
    if len(ladder) < 2:
        return None
    base, last = ladder[1]["force_rms_N"], ladder[-1]["force_rms_N"]
    if not isinstance(base, float):
        return None
    if not isinstance(last, float):  # a filter that diverged reduces no gap
        return 0.0
    if not floor:
        return None
    before, after = (max(rms**2 - floor**2, 0.0) for rms in (base, last))
    return 1.0 - after / before if before > MIN_GAP * floor**2 else None


def _ratio(reduction: float | None, oracle_reduction: float | None, failed: bool) -> float | None:
    if failed:
        return 0.0  # whatever was possible
    if reduction is None or oracle_reduction is None:
        return None
    if oracle_reduction > 0.0:
        return reduction / oracle_reduction
    return 0.0 if reduction < oracle_reduction else None  # where the truth reduces no gap, an answer can only be worse


def _parameter_error(found: dict[str, Number], true: dict[str, Number]) -> float | None:
    """The largest relative error of the numbers that both name, log by log where they differ; zeros are left out.

    `amplitude` is that of cosine and sine.
    """
    values: dict[str, npt.ArrayLike] = dict(found)
    if "cosine" in values:
        values["amplitude"] = np.hypot(values["cosine"], values["sine"])
    errors: list[float] = []
    for name in values.keys() & true.keys():
        estimate, truth = np.broadcast_arrays(*(np.asarray(value, float) for value in (values[name], true[name])))
        nonzero = truth != 0.0
        errors += list(np.abs(estimate[nonzero] / truth[nonzero] - 1.0))
    return float(max(errors)) if errors else None


def _interval_hits(cause: Cause, true: dict[str, Number]) -> list[bool]:
    """Whether the interval of each number that both name holds the true value; one without an end does not."""
    hits: list[bool] = []
    for name in cause["intervals"].keys() & true.keys():
        ends = cause["intervals"][name]
        low, high, value = np.broadcast_arrays(*(np.asarray(number, float) for number in (*ends, true[name])))
        hits += list(map(bool, np.ravel((low <= value) & (value <= high))))
    return hits


def _interval_coverage(rows: list[ScoredCase]) -> tuple[float | None, int]:
    """Share of the 95 % intervals that hold the truth, where one effect acts and was found alone; and their number."""
    hits = [hit for row in rows for hit in row["within"]]
    return (round(float(np.mean(hits)), 3) if hits else None), len(hits)


def _share(hits: list[bool]) -> float | None:
    return round(float(np.mean(hits)), 3) if hits else None


def _interval(hits: list[bool]) -> list[float] | None:
    if not hits:
        return None
    interval = binomtest(sum(hits), len(hits)).proportion_ci(method="wilson")
    return [round(float(interval.low), 3), round(float(interval.high), 3)]


def _quantile(values: list[float | None], share: float) -> float | None:
    finite = [value for value in values if value is not None]
    return round(float(np.quantile(finite, share)), 4) if finite else None


def _reliability(rows: list[ScoredCase]) -> list[list[float]]:
    """Mean confidence of what was found, how many, and the share that was right, bin by bin."""
    pairs = [(confidence, right) for row in rows for _, confidence, right in row["sure"]]
    table = []
    for k in range(BINS):
        members = [pair for pair in pairs if min(int(pair[0] * BINS), BINS - 1) == k]
        if members:
            mean, right = np.mean(np.array(members, float), axis=0)
            table.append([float(mean), len(members), float(right)])
    return table


def _calibration(reliability: list[list[float]]) -> float | None:
    """Expected calibration error: the mean distance of confidence and share that was right, weighted by count."""
    count = sum(many for _, many, _ in reliability)
    off = sum(many * abs(confidence - right) for confidence, many, right in reliability)
    return round(off / count, 4) if count else None


def _confusion(rows: list[ScoredCase]) -> dict[str, dict[str, int]]:
    """How often each answer was given, by the single true effect, none, or one from outside the catalogue."""
    table: dict[str, Counter[str]] = {}
    for row in rows:
        if row["kind"] in ("compound", "pitfall"):
            continue
        answer = row["found"][0] if row["verdict"] == "effect" and row["found"] else row["verdict"]
        table.setdefault(row["true"][0] if row["true"] else "none", Counter())[answer] += 1
    return {name: dict(counts) for name, counts in sorted(table.items())}


def read_answers(folder: Path) -> Answers:
    """The answers in a folder, by case."""
    answers: Answers = {}
    for path in sorted(folder.glob("*/diagnosis.json")):
        answers[path.parent.name] = json.loads(path.read_text(encoding="utf-8"))
    return answers


def read_key(path: Path) -> Key:
    """A key file; where it states no sizes of effects, they follow from its visibility.

    Raises `ParameterError` for a file that is missing or not a key.
    """
    try:
        key: Key = json.loads(path.read_text(encoding="utf-8"))
        for name, case in key.items():
            for effect in case["effects"]:
                effect["name"]
                effect.setdefault("outside", case.get("kind") == "unknown")
                effect.setdefault("size", CLEAR if case.get("visibility") == "clear" else 0.0)
            if len(case["effects"]) > MAX_EFFECTS:
                raise ParameterError(f"{path}: case {name} has more than {MAX_EFFECTS} effects, which cannot be scored")
    except FileNotFoundError:
        raise ParameterError(f"{path}: not there; a folder of machines to examine holds the key to them") from None
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ParameterError(
            f"{path}: no key ({error!r}); it must be an object of cases, each with its `effects`, a list of objects "
            "with a `name`"
        ) from None
    return key
