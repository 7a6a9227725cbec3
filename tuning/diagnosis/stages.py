"""What a diagnosis knows on its way, in words: the gap and where it lies, then what each search finds.

None of it is a verdict: that is judged on data that neither parameters nor choice have seen.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from tuning.diagnosis.gap import ForceGap
from tuning.diagnosis.search import Round
from tuning.diagnosis.where import SIGNIFICANT, Region

LIKELY = 3  # effects that are named


class Stage(NamedTuple):
    """A part of a diagnosis that is done: its name, and what it shows."""

    name: str
    says: str


Tell = Callable[[Stage], None]


def untold(stage: Stage) -> None:
    """Tell nobody."""


def of_gap(gap: ForceGap, floor: float, is_complete: bool, where: Sequence[Region]) -> Stage:
    """What recalibration leaves; `floor` (N) is what the measuring noise alone makes of a model without a gap."""
    if not gap.told:
        return Stage("gap", "the filter loses track of the logs with the recalibrated drive: check units and signs")
    if is_complete:
        return Stage("gap", "the recalibrated drive explains the logs to the noise")
    times = f", {gap.rms / floor:.2g} times the noise floor" if 0.0 < floor < np.inf else ""
    lies = next((f"; {one.says}" for one in where if one.p_value < SIGNIFICANT), "")
    return Stage("gap", f"the recalibrated drive lacks a force of {gap.rms:.3g} N RMS{times}{lies}")


def of_round(looked: Round) -> Stage:
    """The effects that explain most beside what was found before: in -2 log likelihood, less their price."""
    there = looked.before.model
    found = [one.candidate.name for one in there.members[len(there.members) - there.added :]]
    name = f"beside {' and '.join(found)}" if found else "search"
    gains = [(one.model.members[-1].candidate.name, looked.before.evidence - one.evidence) for one in looked.fits]
    likely = [f"{effect} ({gain:.0f})" for effect, gain in gains[:LIKELY] if gain > looked.enough]
    if not likely:
        return Stage(name, "no effect explains more")
    return Stage(name, f"in -2 log likelihood the most is explained by {', '.join(likely)}")
