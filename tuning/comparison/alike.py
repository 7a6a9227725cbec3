"""Both sides identified alike: from as many starting points, the answer before among those after, read in the same way.

A fit leaves the motor's encoder out where a rigid machine does not explain it (lost motion, say); positions and delay
are those of the scale then. Or it takes the rows of a log for snapshots of a faster loop, which makes the mass another.
Beside a fit by both encoders, or of a held command, that would look like a change.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

from diffdrive.axis import Axis
from tuning.checked_logs import CheckedLogs
from tuning.comparison.machine import answer
from tuning.identification.refinement import was_interrupted
from tuning.identification.row_force import BetweenRows
from tuning.identification.unknowns import Unknowns
from tuning.identification.workflow import IdentificationResult, identify_checked
from tuning.progress import Progress
from tuning.store.store import Store

NO_LOGS = CheckedLogs((), ())


class Identified(NamedTuple):
    """The identification of each side, and what is to be said of how they were made alike."""

    before: IdentificationResult
    after: IdentificationResult
    notes: tuple[str, ...]


def identified_alike(
    axis: Axis, before: CheckedLogs, after: CheckedLogs, *, fixed: Sequence[str], starts: int, seed: int,
    store: Store | None, progress: Progress,
) -> Identified:  # fmt: skip
    """Both sides; raises `KeyboardInterrupt` where a search was interrupted: half an answer is no comparison."""

    def of(
        side: CheckedLogs, name: str, start: Unknowns | None = None, between: BetweenRows | None = None
    ) -> IdentificationResult:
        def named(stage: str, done: int, most: int) -> None:
            progress(f"{stage}, {name}", done, most)

        found = identify_checked(
            axis, side, NO_LOGS, fixed=fixed, bounds={}, starts=starts, seed=seed, store=store, progress=named,
            start=start, between=between,
        )  # fmt: skip
        if was_interrupted(found.fit.search):
            raise KeyboardInterrupt
        return found

    first = of(before, "before")
    second = of(after, "after", answer(first.fit))
    notes = []
    if _by_both_encoders(first) != _by_both_encoders(second):
        without = "before" if _by_both_encoders(second) else "after"
        notes.append(f"both sides are fitted by the scale alone: {without}, the motor's encoder is left out of the fit")
        before, after = _by_scale(before), _by_scale(after)
        first = of(before, "before")
        second = of(after, "after", answer(first.fit))
    if first.fit.between is not second.fit.between:
        seen = "before" if first.fit.between is BetweenRows.SMOOTH else "after"
        notes.append(f"the rows of both sides are read as snapshots of a faster loop, as those {seen} show it")
        first = of(before, "before", between=BetweenRows.SMOOTH)
        second = of(after, "after", answer(first.fit), BetweenRows.SMOOTH)
    return Identified(first, second, tuple(notes))


def _by_both_encoders(found: IdentificationResult) -> bool:
    return found.fit.full_fit.problem.lanes.motor is not None


def _by_scale(side: CheckedLogs) -> CheckedLogs:
    return dataclasses.replace(side, logs=tuple(log.replace(motor_position=None) for log in side.logs))
