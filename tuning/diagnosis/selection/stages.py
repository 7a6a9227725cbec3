"""What a diagnosis knows on its way, in words: the gap and where it lies, then what each search finds.

None of it is a verdict: that is judged on data that neither parameters nor choice have seen.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from tuning.diagnosis.fits.fitted import last_candidate
from tuning.diagnosis.gap.gap import ForceGap
from tuning.diagnosis.gap.where import SIGNIFICANT, Region
from tuning.diagnosis.selection.search import Round

LIKELY = 3  # effects that are named


class Stage(NamedTuple):
    """A part of a diagnosis that is done: its name, and what it shows."""

    name: str
    says: str


Tell = Callable[[Stage], None]


def unheard(stage: Stage) -> None:
    """Tell nobody."""


def of_gap(gap: ForceGap, floor: float, is_complete: bool, where: Sequence[Region]) -> Stage:
    """What recalibration leaves; `floor` (N) is what the measuring noise alone makes of a model without a gap."""
    if not gap.is_known:
        return Stage("gap", "the filter loses track of the logs with the recalibrated drive: check units and signs")
    if is_complete:
        return Stage("gap", "the recalibrated drive explains the logs to the noise")
    times = f", {gap.rms / floor:.2g} times the noise floor" if 0.0 < floor < np.inf else ""
    lies = next((f"; {one.says}" for one in where if one.p_value < SIGNIFICANT), "")
    return Stage("gap", f"the recalibrated drive lacks a force of {gap.rms:.3g} N RMS{times}{lies}")


def of_round(looked: Round) -> Stage:
    """The effects that explain most beside what was found before: in -2 log likelihood, less their price; first the one
    that the search goes on with.
    """
    found = [one.name for one in looked.before.model.added_candidates]
    name = f"search beside {' and '.join(found)}" if found else "search"
    gains = [(last_candidate(one).name, looked.before.evidence - one.evidence) for one in looked.fits]
    if not looked.worth_it:
        return Stage(name, "no effect explains enough more")
    first, *others = gains
    likely = [first, *sorted((one for one in others if one[1] > looked.enough), key=lambda one: -one[1])]
    says = ", ".join(f"{effect} (evidence {gain:.0f})" for effect, gain in likely[:LIKELY])
    return Stage(name, f"best candidate{'s' if len(likely) > 1 else ''}: {says}")
