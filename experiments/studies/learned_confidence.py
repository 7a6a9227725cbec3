"""Whether confidence learned from stored answers is better than the diagnosis's own.

    python -m experiments.studies.learned_confidence docs/evidence/withheld-seed-*.zip

Each archive holds the answers and the key of one withheld-effect study. A logistic function of numbers that stand in an
answer is fitted to whether each cause that was found acts, and judged on the study that it was not fitted to. Prints a
Markdown table.
"""

import io
import json
import math
import sys
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import minimize
from scipy.special import expit, logit

COARSE = ("compliance", "backlash", "presliding_hysteresis", "friction_dwell", "frame_vibration")
TOLERANCE = 0.02  # of nominal parameters, as the studies had it
NARROWEST = 2e-3  # nearer to 0 or 1 no confidence is counted: one wrong answer would decide
SHRINKAGE = 1.0  # prior of the coefficients, whose columns have a deviation of one
# of `numbers_of`: all, and the three of which most depends
ALL, FEW = slice(0, 13), slice(0, 3)

Vector = Float[np.ndarray, " n"]
Columns = Float[np.ndarray, "n k"]


class Causes(NamedTuple):
    """Causes that were found, one row each."""

    numbers: Columns
    confidence: Vector  # the diagnosis's
    is_unknown: Bool[np.ndarray, " n"]  # whether the verdict is
    acts: Bool[np.ndarray, " n"]
    study: Int[np.ndarray, " n"]


def moved(answer: Mapping[str, Any]) -> float:
    """By how many tolerances the nominal parameter that moved furthest did."""
    furthest = 0.0
    for one in answer["recalibrated"]:
        before, after = one["drive_file"], one["with_effects"]
        if one["parameter"].startswith(("mass", "coulomb", "viscous", "damping")) and before > 0 and (after or 0) > 0:
            furthest = max(furthest, abs(math.log(after / before)) / TOLERANCE)
    return furthest


def numbers_of(answer: Mapping[str, Any], number: int) -> list[float]:
    """What one of the causes found is believed by; FEW first."""
    found = [one for one in answer["causes"] if one["found"]]
    cause, last, interval = found[number], answer["ladder"][-1], answer["closed"].get("interval")
    over_floors = [
        last[f"{signal}_rms_{unit}"] / last[f"{signal}_floor_{unit}"]
        for signal, unit in (("force", "N"), ("position", "m"), ("command", "N"))
        if last.get(f"{signal}_rms_{unit}") and last.get(f"{signal}_floor_{unit}")
    ]
    in_force = over_floors[0] if last.get("force_rms_N") and last.get("force_floor_N") else 1.0
    return [
        math.log10(max(cause["evidence"], 1.0)),
        1.0 if answer["unexplained"] is None else answer["unexplained"],
        math.log(max(in_force, 0.3)),
        interval[0] if interval else 0.0,
        float(interval is None),
        min(moved(answer), 20.0),
        min(len(cause["indistinguishable_from"]), 5),
        float(cause["effect"] in COARSE),
        float(number > 0),
        cause["evidence"] / max(sum(one["evidence"] for one in found), 1e-9),
        float(bool(answer["lacks"])),
        math.log(max([0.3, *over_floors])),
        float("log checks" in (answer["says"] or "")),
    ]


def read_causes(archives: Sequence[Path]) -> Causes:
    """Every cause that was found in the answers of the studies."""
    rows: list[tuple[list[float], float, bool, bool, int]] = []
    for study, path in enumerate(archives):
        with zipfile.ZipFile(io.BytesIO(path.read_bytes())) as archive:
            key = json.loads(archive.read("key.json"))
            for case, drawn in sorted(key.items()):
                answer = json.loads(archive.read(f"answers/{case}/diagnosis.json"))
                acting = {one["name"] for one in drawn["effects"] if not one["outside"]}
                for number, cause in enumerate(one for one in answer["causes"] if one["found"]):
                    is_unknown, acts = answer["verdict"] == "unknown", cause["effect"] in acting
                    rows.append((numbers_of(answer, number), cause["confidence"], is_unknown, acts, study))
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    columns[1] = np.clip(columns[1], NARROWEST, 1.0 - NARROWEST)
    return Causes(*columns)


def fitted_logistic(columns: Columns, acts: Bool[np.ndarray, " n"]) -> Callable[[Columns], Vector]:
    """The probability that a cause acts, as a logistic function of its columns (maximum a posteriori)."""
    middle, spread = columns.mean(axis=0), columns.std(axis=0)
    spread = np.where(spread > 0.0, spread, 1.0)

    def regressors(columns: Columns) -> Columns:
        return np.column_stack([np.ones(len(columns)), (columns - middle) / spread])

    z, shrunk = regressors(columns), np.r_[0.0, np.full(columns.shape[1], SHRINKAGE)]

    def cost(weights: Vector) -> tuple[float, Vector]:
        score = z @ weights
        value = float(np.sum(np.logaddexp(0.0, score) - acts * score) + 0.5 * shrunk @ weights**2)
        return value, z.T @ (expit(score) - acts) + shrunk * weights

    found = minimize(cost, np.zeros(z.shape[1]), jac=True, method="L-BFGS-B")
    weights = np.asarray(found.x)
    return lambda columns: np.asarray(expit(regressors(columns) @ weights))


def judged_elsewhere(causes: Causes, columns: Columns) -> Vector:
    """Of each cause, the probability that the other studies teach."""
    probability = np.zeros(len(columns))
    for study in np.unique(causes.study):
        here = causes.study == study
        probability[here] = fitted_logistic(columns[~here], causes.acts[~here])(columns[here])
    return np.clip(probability, NARROWEST, 1.0 - NARROWEST)


def log_loss(probability: Vector, acts: Bool[np.ndarray, " n"]) -> float:
    """Mean of -log of the probability of what is the case."""
    return float(-np.mean(np.log(np.where(acts, probability, 1.0 - probability))))


def table(causes: Causes) -> str:
    """The log loss and the Brier score of each way to be confident, as Markdown."""
    own = np.column_stack([logit(causes.confidence), causes.is_unknown])
    ways = {
        "the diagnosis's own": causes.confidence,
        "learned, thirteen numbers": judged_elsewhere(causes, causes.numbers[:, ALL]),
        "learned, its own and the verdict": judged_elsewhere(causes, own),
        "learned, the same and three numbers": judged_elsewhere(causes, np.hstack([own, causes.numbers[:, FEW]])),
    }
    lines = [f"{len(causes.acts)} causes, {100 * np.mean(causes.acts):.0f} % of which act", ""]
    lines += ["| confidence | log loss | Brier score |", "|---|---|---|"]
    for name, probability in ways.items():
        brier = float(np.mean((probability - causes.acts) ** 2))
        lines.append(f"| {name} | {log_loss(probability, causes.acts):.3f} | {brier:.3f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(read_causes([Path(name) for name in sys.argv[1:]])))
