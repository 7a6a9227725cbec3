"""`tuning.compare`: what has changed between two sets of logs of one axis, the controller included."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from diffdrive.axis import Axis, require_axis
from diffdrive.errors import ParameterError
from diffdrive.logs.checks.finding import Finding as LogFinding
from diffdrive.results import Status
from tuning.checked_logs import CheckedLogs, checked_apart, require_different, require_sound
from tuning.comparison.alike import Identified, identified_alike
from tuning.comparison.controller import controller_changes, controllers_of
from tuning.comparison.encoders import encoder_changes, encoders_of
from tuning.comparison.findings import (
    MachineChanges,
    findings_of,
    friction_change,
    limits,
    machine_changes,
    scales_friction_alone,
)
from tuning.comparison.machine import MachineDifference, machine_difference
from tuning.comparison.result import ComparisonResult
from tuning.identification.controller.workflow import known_rate
from tuning.identification.identify import require_search
from tuning.identification.workflow import IdentificationResult
from tuning.progress import Progress, reporting
from tuning.store.folder import FolderStore
from tuning.store.store import Store

LEVEL = 0.01  # a workshop that compares an axis each month is wrongly alarmed once in eight years
# what a check calls the log's fault, and itself says may be a change of the axis: the question that is asked here
A_CHANGE = {"other machine", "other controller"}
FORCE = "force=True compares all the same, and takes that for a change of the axis"


def compare(
    axis: Axis,
    before: object,
    after: object,
    *,
    fixed: Sequence[str] = (),
    loads: Mapping[str, float] | None = None,
    level: float = LEVEL,
    starts: int = 6,
    seed: int = 0,
    force: bool = False,
    resume: str | Path | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> ComparisonResult:
    """What has changed between two sets of logs of one axis: machine, controller, and what two encoders see.

    Both sets are identified alike. The smallest set of changed parameters that
    explains the difference of the answers is named, with intervals, and for the others the smallest change that would
    have been found. Method: docs/method/comparison.md.

    Args:
        axis: What is believed of the machine; names the controller and the sampling, too.
        before: One or several of `Log`, files, data frames or dicts of arrays [n], all at the controller's rate; or
            `CheckedLogs`, which are not looked over again.
        after: The same, of today. The motions may differ; the same motion shows smaller changes.
        fixed: Parameters that stay as they are in both, by path (`plant.mass`) or name.
        loads: Force on the guides (N) by the log's file or name, where the log does not say it.
        level: Share of the comparisons of an unchanged axis in which a change may be found.
        starts: Starting points of each search; one of those after is the answer before.
        seed: Of the starting points.
        force: Compare logs that would mislead, all the same.
        resume: A folder where what is finished is kept: the same call continues from it.
        progress: Called with (stage, done, of how many).
        throw: Raise an error where the result is doubtful.

    Raises:
        LogError: A log cannot be used, would mislead, or is in both sets.
        ParameterError: No parameter or log has this name, `level`, `starts` or `seed` is no such number, or the axis
            has effects, of which identification knows none.
        ResultError: The result is doubtful, with `throw`.

    Examples:
        >>> found = compare(axis, ["commissioning.csv"], ["today.csv"])
        >>> [finding.sentence for finding in found.findings]
        >>> found.change("plant.mass").change

    """
    require_search(starts, seed)
    require_level(level)
    require_axis(axis)
    first, second = checked_apart(axis, before, after, loads=loads)
    with reporting(progress) as advance:
        result = compare_checked(
            axis, first, second, fixed=fixed, level=level, starts=starts, seed=seed, force=force,
            store=FolderStore.of(resume), progress=advance,
        )  # fmt: skip
    return result.require_ok() if throw else result


def require_level(level: float) -> None:
    """Raise `ParameterError` for a level that is no share of false alarms."""
    if not 0.0 < level <= 0.5:
        raise ParameterError(f"level: must be a share of false alarms above 0 and at most 0.5, got {level!r}")


def compare_checked(
    axis: Axis,
    before: CheckedLogs,
    after: CheckedLogs,
    *,
    fixed: Sequence[str],
    level: float,
    starts: int,
    seed: int,
    force: bool,
    store: Store | None,
    progress: Progress,
) -> ComparisonResult:
    """`compare` from logs that were looked over; finished searches are in the `store`."""
    if not (before.logs and after.logs):
        raise ParameterError(f"{'after' if before.logs else 'before'}: no log is given; give one or more")
    require_different([log.name for log in after.logs], after.logs, before.logs)
    ambiguous = [] if force else [*_ambiguous(before), *_ambiguous(after)]
    controllers = controllers_of(before.logs, after.logs, known_rate(axis))
    encoders = encoders_of(axis, before.logs, after.logs)
    sides = identified_alike(axis, before, after, fixed=fixed, starts=starts, seed=seed, store=store, progress=progress)
    # each part that is compared has an equal share of the level (Bonferroni)
    share = level / (1 + controllers.are_comparable + encoders.are_comparable)
    found = machine_difference(sides.before.fit, sides.after.fit)
    machine = machine_changes(found, share)
    gains = controller_changes(controllers, share)
    friction = friction_change(machine, sides.before.axis.drive.friction, mean_load(before), mean_load(after))
    screw = encoder_changes(encoders, friction, share)
    findings = findings_of(machine, gains, screw)
    changes = (*machine.changes, *gains.changes, *screw.changes)
    seen = limits(changes)
    notes = [seen] if seen else []
    notes += [*sides.notes, *_open(found), *gains.notes, *screw.notes, *_incomplete(sides)]
    notes += [f"{name}, {note}" for name, side in (("before", before), ("after", after)) for note in _quoted(side)]
    code = "changed" if findings else "unchanged"
    status = Status(True, f"{len(findings)} found" if findings else "no change found", code=code)
    against = _doubts(sides, machine, ambiguous)
    if against:
        status = Status(False, f"doubtful: {against[0]}", code="doubtful")
    return ComparisonResult(
        findings, changes, machine.explanations, machine.p_unchanged, level, seen, sides.before, sides.after,
        controllers, encoders, tuple(dict.fromkeys((*against, *notes))), status,
    )  # fmt: skip


def mean_load(logs: CheckedLogs) -> float:
    """Force on the guides (N) that stands in the logs, on average."""
    return float(np.mean(np.concatenate([np.zeros(1) if log.load is None else log.load for log in logs.logs])))


def _ambiguous(logs: CheckedLogs) -> list[tuple[str, LogFinding]]:
    """The fatal findings that may be a change of the axis; raises `LogError` for any other."""
    ambiguous = [(log, one) for log, one in logs.fatal if A_CHANGE & {one.cause, *one.rivals}]
    require_sound(CheckedLogs(logs.logs, tuple(one for one in logs.findings if one not in ambiguous)), FORCE)
    return ambiguous


def _doubts(sides: Identified, machine: MachineChanges, ambiguous: Sequence[tuple[str, LogFinding]]) -> list[str]:
    """What speaks against the answer, a sentence each."""
    against = [f"{name}: {side.status.message}" for name, side in _named(sides) if not side.status.ok]
    if not scales_friction_alone(machine):
        against += [f"{log}: {one.message}; {one.remedy}" for log, one in ambiguous]
    return against


def _open(found: MachineDifference) -> list[str]:
    if not found.undetermined:
        return []
    named = ", ".join(path.partition(".")[2] for path in found.undetermined)
    return [f"not compared, since one of the sets does not determine it: {named}"]


def _incomplete(sides: Identified) -> list[str]:
    incomplete = [name for name, side in _named(sides) if side.fit.adequacy.has_structure]
    if not incomplete:
        return []
    return [
        f"the model does not explain all of the logs {' and '.join(incomplete)}: the intervals hold what varies along "
        "them, not what one motion shows and another does not; logs of one motion before and after are compared best"
    ]


def _quoted(side: CheckedLogs) -> list[str]:
    return [f"{log}: {finding.message}" for log, finding in side.notable]


def _named(sides: Identified) -> tuple[tuple[str, IdentificationResult], ...]:
    return ("before", sides.before), ("after", sides.after)
