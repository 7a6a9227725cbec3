"""Diagnoses that are repeated once the key is open, with part of the catalogue excluded.

The oracle has the true effects alone to choose from: how far can the gap be reduced? In the other runs the true effect
is removed: the answer must become `unknown`, or a rival that the first answer had declared.
"""

import math

from diffdrive.effects.catalogue import EFFECTS
from experiments.studies.withheld.records import Answers, Key
from experiments.studies.withheld.score import UNANSWERED, is_clear


def oracle_exclusions(answers: Answers, key: Key) -> dict[str, list[str]]:
    """For each clear case of one known effect for which another answer was given: all other effects, to be excluded."""
    exclusions = {}
    for name, case in key.items():
        true, answer = {effect["name"] for effect in case["effects"]}, answers.get(name, UNANSWERED)
        found = {effect["effect"] for effect in answer["causes"] if effect["found"]}
        alone = len(true) == 1 and true <= set(EFFECTS) and not case.get("pitfall")
        if alone and found != true and is_clear(answer, case):
            exclusions[name] = [name for name in EFFECTS if name not in true]
    return exclusions


def removal_exclusions(answers: Answers, key: Key) -> dict[str, list[str]]:
    """For each effect of the catalogue, the case in which it was found alone and with the most evidence: that effect.

    A case in which it was not found would be `unknown` without it, too, which would show nothing.
    """
    best: dict[str, tuple[float, str]] = {}
    for name, case in key.items():
        answer = answers.get(name, UNANSWERED)
        true = [effect["name"] for effect in case["effects"]]
        found = [cause for cause in answer["causes"] if cause["found"]]
        if answer["verdict"] == "effect" and len(true) == 1 and [cause["effect"] for cause in found] == true:
            best[true[0]] = max(best.get(true[0], (-math.inf, "")), (found[0]["evidence"], name))
    return {name: [effect] for effect, (_, name) in best.items()}


def removal_rows(answers: Answers, rerun: Answers, exclusions: dict[str, list[str]]) -> list[list[str | bool]]:
    """Rows of effect, case, verdict without the effect, what was found, declared rivals, and whether that is right."""
    rows: list[tuple[str, str, str, str, str, bool]] = []
    for name, (effect,) in exclusions.items():
        answer = rerun.get(name)
        if answer is None:
            continue
        found = [cause["effect"] for cause in answer["causes"] if cause["found"]]
        declared = answers[name]["causes"][0]["indistinguishable_from"]
        good = answer["verdict"] == "unknown" or (found != [] and set(found) <= set(declared))
        rows.append((effect, name, answer["verdict"], " + ".join(found), " ".join(declared), good))
    return [list(row) for row in sorted(rows)]
