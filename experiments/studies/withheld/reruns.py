"""The same machines asked again, once the key is open: with nothing but what is true, and without it.

The first is the oracle: how far the gap shrinks when the true effects are fitted and nothing else. In the second the
answer must become `unknown`, or a rival that the first answer had declared.
"""

import math
from typing import Any

from diffdrive.effects.catalogue import EFFECTS
from experiments.studies.withheld.score import UNANSWERED, is_clear

Answers = dict[str, dict[str, Any]]
Key = dict[str, dict[str, Any]]


def oracle_exclusions(answers: Answers, key: Key) -> dict[str, list[str]]:
    """For each clear case of one known effect that was not just what was found: the others, not to be considered."""
    asked = {}
    for name, case in key.items():
        true, told = {one["name"] for one in case["effects"]}, answers.get(name, UNANSWERED)
        found = {one["effect"] for one in told["causes"] if one["found"]}
        alone = len(true) == 1 and true <= set(EFFECTS) and not case.get("pitfall")
        if alone and found != true and is_clear(told, case):
            asked[name] = [one for one in EFFECTS if one not in true]
    return asked


def removal_exclusions(answers: Answers, key: Key) -> dict[str, list[str]]:
    """For each effect of the catalogue the case that showed it best: believed alone, and by the most evidence.

    One that was not believed would be `unknown` without it, too: that would show nothing.
    """
    best: dict[str, tuple[float, str]] = {}
    for name, case in key.items():
        told = answers.get(name, UNANSWERED)
        true = [one["name"] for one in case["effects"]]
        found = [one for one in told["causes"] if one["found"]]
        if told["verdict"] == "effect" and len(true) == 1 and [one["effect"] for one in found] == true:
            best[true[0]] = max(best.get(true[0], (-math.inf, "")), (found[0]["evidence"], name))
    return {name: [effect] for effect, (_, name) in best.items()}


def removal_rows(answers: Answers, again: Answers, asked: dict[str, list[str]]) -> list[list[Any]]:
    """Effect, case, verdict without it, what was found, and whether that is as it must be."""
    rows = []
    for name, (effect,) in asked.items():
        told = again.get(name)
        if told is None:
            continue
        found = [one["effect"] for one in told["causes"] if one["found"]]
        declared = answers[name]["causes"][0]["indistinguishable_from"]
        good = told["verdict"] == "unknown" or (found != [] and set(found) <= set(declared))
        rows.append([effect, name, told["verdict"], " + ".join(found), " ".join(declared), good])
    return sorted(rows)
