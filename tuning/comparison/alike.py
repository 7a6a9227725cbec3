"""Both sides identified alike: from as many starting points, the answer before among those after, by the same encoders.

A fit leaves the motor's encoder out where a rigid machine does not explain it (lost motion, say); positions and delay
are those of the scale then. Beside a fit by both encoders that would look like a change.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

from diffdrive.axis import Axis
from tuning.checked_logs import CheckedLogs
from tuning.comparison.machine import answer
from tuning.identification.refinement import was_interrupted
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

    def of(side: CheckedLogs, name: str, start: Unknowns | None = None) -> IdentificationResult:
        def named(stage: str, done: int, most: int) -> None:
            progress(f"{stage}, {name}", done, most)

        found = identify_checked(
            axis, side, NO_LOGS, fixed=fixed, bounds={}, starts=starts, seed=seed, store=store, progress=named,
            start=start,
        )  # fmt: skip
        if was_interrupted(found.fit.search):
            raise KeyboardInterrupt
        return found

    first = of(before, "before")
    second = of(after, "after", answer(first.fit))
    if _by_both_encoders(first) == _by_both_encoders(second):
        return Identified(first, second, ())
    without = "before" if _by_both_encoders(second) else "after"
    note = f"both sides are fitted by the scale alone: {without}, the motor's encoder is left out of the fit"
    first = of(_by_scale(before), "before")
    return Identified(first, of(_by_scale(after), "after", answer(first.fit)), (note,))


def _by_both_encoders(found: IdentificationResult) -> bool:
    return found.fit.full_fit.problem.lanes.motor is not None


def _by_scale(side: CheckedLogs) -> CheckedLogs:
    return dataclasses.replace(side, logs=tuple(log.replace(motor_position=None) for log in side.logs))
