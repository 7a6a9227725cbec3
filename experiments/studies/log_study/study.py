"""`diffdrive log-study`: logs with a known fault, sound logs and pairs of logs, and what the checks say of them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from diffdrive.axis import Axis
from diffdrive.errors import DivergenceError, ParameterError
from diffdrive.logs.checks.examine import Finding
from diffdrive.logs.log import Log
from diffdrive.support.resources import counted, require_memory
from experiments.reports.report import Report
from experiments.studies.log_study.drives import StudyDrive, study_drives
from experiments.studies.log_study.fault import Draw, Fault
from experiments.studies.log_study.machines import MACHINES, other_log_of
from experiments.studies.log_study.score import Examine, Score, scored, share
from experiments.studies.log_study.sound import LogCase, logged, motions, sound
from experiments.studies.log_study.timing import TIMES
from experiments.studies.log_study.values import VALUES

FAULTS: tuple[Draw, ...] = (*VALUES, *TIMES, *MACHINES)
MOTIONS, AMOUNTS = 3, 10  # that are tried for a fault that shows
CASES, SOUND, PAIRS = 0, 1, 2  # streams of random numbers
LOG, ROW = 2e6, 2e3  # bytes at most of a log with a fault, which its answer keeps, and of a row of a table

Together = Callable[[Sequence[Log], Axis], Sequence[Finding]]


@dataclass(frozen=True)
class Drawn:
    """A case of the study with its fault, before anybody looks at it."""

    number: int
    kind: str
    case: LogCase
    fault: Fault


class Answered(NamedTuple):
    """A case and how the answer did."""

    drawn: Drawn
    score: Score


def drawn(count: int, seed: int, axes: Sequence[StudyDrive]) -> Iterator[Drawn]:
    """So many logs with a fault: the kinds in turn, each on the axis that has had the fewest of those that show it."""
    had = dict.fromkeys((axis.name for axis in axes), 0)
    order = np.random.default_rng([seed, CASES]).permutation(len(FAULTS))
    for number in range(count):
        kind = FAULTS[order[number % len(FAULTS)]]
        rng = np.random.default_rng([seed, CASES, number])
        by_turn = sorted(rng.permutation(len(axes)), key=lambda k: had[axes[k].name])
        case, fault = next(filter(None, (_on(kind, axes[k], rng) for k in by_turn)), (None, None))
        if case is None or fault is None:
            continue  # none of the axes given shows it
        had[case.drive.name] += 1
        yield Drawn(number, kind.name, case, fault)


def _on(kind: Draw, axis: StudyDrive, rng: np.random.Generator) -> tuple[LogCase, Fault] | None:
    """A case of this kind on this axis, from several motions and amounts; None where the axis cannot show it."""
    for _ in range(MOTIONS if kind.applies(axis) else 0):
        case = sound(axis, rng)
        for _ in range(AMOUNTS):
            if (fault := kind.make(case, rng)) is not None:
                return case, fault
    return None


def log_study(
    report: Report, *, cases: int, healthy: int, pairs: int, seed: int, examine: Examine, together: Together,
    axes: Sequence[StudyDrive] | None = None,
) -> None:  # fmt: skip
    """All three parts into a report: so many faulty logs, sound ones, and pairs of two logs; of all axes by default."""
    for option, count, each in (("--cases", cases, LOG), ("--sound", healthy, ROW), ("--pairs", pairs, ROW)):
        require_memory(ParameterError, f"{option} {counted(count)}: what is kept of them", each * count, "give fewer")
    axes = study_drives() if axes is None else axes
    with report.working("logs with a fault"):
        tell_faulty(report, faulty_logs(report, cases, seed, axes, examine))
    with report.working("sound logs"):
        sound_logs(report, healthy, seed, axes, examine)
    with report.working("pairs of logs"):
        pairs_of_logs(report, pairs, seed, axes, together)


def faulty_logs(report: Report, count: int, seed: int, axes: Sequence[StudyDrive], examine: Examine) -> list[Answered]:
    """Logs with a fault: is it named first, named at all, is a mend right?"""
    answers = []
    with report.stages() as advance:
        for one in drawn(count, seed, axes):
            description, resolution = one.case.description, one.case.drive.resolution
            answers.append(Answered(one, scored(one.fault, description, resolution, examine)))
            advance("logs with a fault", one.number + 1, count)
    return answers


def tell_faulty(report: Report, answers: Sequence[Answered]) -> None:
    """The tables by fault, by axis and by log, and the totals."""
    head = ("what", "logs", "named first", "named", "rivals missing", "mended", "wrong mends")
    for name, of, caption in (
        ("by_fault", lambda one: one.drawn.kind, "By fault"),
        ("by_drive", lambda one: one.drawn.case.drive.name, "By axis"),
    ):
        groups = sorted({of(one) for one in answers})
        rows = [_row(group, [one.score for one in answers if of(one) == group]) for group in groups]
        report.table(name, head, rows, caption)
    report.table(
        "cases",
        ("case", "axis", "motion", "fault", "amount", "first finding", "severity", "named first", "named", "mend"),
        [_line(one) for one in answers],
        "Each log",
    )
    wrong = [one for one in answers if one.score.wrong_mend]
    if wrong:
        rows = [[one.drawn.number, one.drawn.kind, one.drawn.fault.amount, one.score.wrong_mend] for one in wrong]
        report.table("wrong_mends", ("case", "fault", "amount", "wrong in"), rows, "Wrong mends")
    total, scores = len(answers), [one.score for one in answers]
    first, named = sum(one.first for one in scores), sum(one.named for one in scores)
    report.values(
        "faulty_logs", logs=total, axes=len({one.drawn.case.drive.name for one in answers}),
        named_first=first, named_first_share=share(first, total), named=named, named_share=share(named, total),
        not_named=total - named, rivals_missing=sum(not one.rivals for one in scores),
        mended=sum(one.mended for one in scores), wrong_mends=len(wrong), wrong_mends_share=share(len(wrong), total),
    )  # fmt: skip


def _row(name: str, scores: Sequence[Score]) -> list[object]:
    return [
        name, len(scores), sum(one.first for one in scores), sum(one.named for one in scores),
        sum(not one.rivals for one in scores), sum(one.mended for one in scores),
        sum(bool(one.wrong_mend) for one in scores),
    ]  # fmt: skip


def _line(one: Answered) -> list[object]:
    case, fault, score = one.drawn.case, one.drawn.fault, one.score
    mend = "wrong" if score.wrong_mend else "right" if score.mended else "-"
    return [
        one.drawn.number, case.drive.name, case.log.name, one.drawn.kind, fault.amount, score.leading, score.severity,
        _yes(score.first), _yes(score.named), mend,
    ]  # fmt: skip


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def sound_logs(report: Report, count: int, seed: int, axes: Sequence[StudyDrive], examine: Examine) -> None:
    """Sound logs of all axes in turn: what is found in them is a false alarm, but for notes."""
    rows: list[list[object]] = []
    worst: list[str] = []
    alone = 0  # logs of which no more is said than how their motion limits what can be learnt
    with report.stages() as advance:
        for number in range(count):
            case = sound(axes[number % len(axes)], np.random.default_rng([seed, SOUND, number]))
            findings = list(examine(case.log, case.description))
            worst.append(
                next((one for one in ("fatal", "warning", "note") if any(f.severity == one for f in findings)), "none")
            )
            alone += all(one.cause == "motion" for one in findings)
            rows += [
                [number, case.drive.name, case.log.name, one.severity, one.cause, one.channel, one.message]
                for one in findings
            ]
            advance("sound logs", number + 1, count)
    if rows:
        head = ("log", "axis", "motion", "severity", "cause", "channel", "found")
        report.table("sound", head, rows, "What was found in sound logs")
    clean = sum(one in ("none", "note") for one in worst)
    report.values(
        "sound_logs", logs=count, fatal=worst.count("fatal"), fatal_share=share(worst.count("fatal"), count),
        warning_at_worst=worst.count("warning"), note_at_worst=worst.count("note"), nothing=worst.count("none"),
        nothing_share=share(worst.count("none"), count), nothing_but_of_the_motion=alone,
        nothing_but_of_the_motion_share=share(alone, count), neither_fatal_nor_warning=clean,
        neither_share=share(clean, count),
    )  # fmt: skip


def pairs_of_logs(report: Report, count: int, seed: int, axes: Sequence[StudyDrive], together: Together) -> None:
    """Two logs under one name: of one machine, of two that differ in mass, of two that differ in friction, in turn."""
    rows: list[list[object]] = []
    with report.stages() as advance:
        for number in range(count):
            rng = np.random.default_rng([seed, PAIRS, number])
            pair = _pair(axes, ("same", "mass", "friction")[number % 3], number // 3, rng)
            if pair is None:
                continue
            case, other, what = pair
            findings = list(together([case.log, other], case.description))
            said = any(one.cause == "machines differ" for one in findings)
            rows.append([number, case.drive.name, case.log.name, other.name, what, _yes(said), len(findings)])
            advance("pairs of logs", number + 1, count)
    head = ("pair", "axis", "motion", "other motion", "difference", "said to differ", "findings")
    report.table("pairs", head, rows, "Pairs of logs")
    differ = [row for row in rows if row[4] != "none"]
    same = [row for row in rows if row[4] == "none"]
    found, alarms = sum(row[5] == "yes" for row in differ), sum(row[6] != 0 for row in same)
    report.values(
        "pairs_of_logs", mixed=len(differ), found=found, found_share=share(found, len(differ)), same=len(same),
        false_alarms=alarms, false_alarms_share=share(alarms, len(same)),
    )  # fmt: skip


def _pair(
    axes: Sequence[StudyDrive], what: str, turn: int, rng: np.random.Generator
) -> tuple[LogCase, Log, str] | None:
    for k in range(len(axes)):
        axis = axes[(turn + k) % len(axes)]
        case = sound(axis, rng)
        name = str(rng.choice(sorted(motions(axis))))
        try:
            made = motions(axis)[name](rng)
            if what == "same":
                return case, replace(logged(axis, case.machine, made, case.seed + 1), name=name), "none"
            other = other_log_of(case, made, rng, mass=what == "mass")
        except DivergenceError:
            continue
        if other is not None:
            return case, replace(other[0], name=name), other[1]
    return None
