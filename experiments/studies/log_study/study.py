"""`diffdrive log-study`: logs with a known fault, sound logs and pairs of logs, and what the checks say of them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from diffdrive.axis import Axis
from diffdrive.errors import ParameterError, ResultError
from diffdrive.logs.checks.examine import Finding
from diffdrive.logs.log import Log
from diffdrive.support.resources import format_count, require_memory
from experiments.reports.report import Report
from experiments.studies.log_study.drives import StudyDrive, study_drives
from experiments.studies.log_study.fault import FaultKind, LogFault
from experiments.studies.log_study.machines import MACHINE_FAULTS, log_of_altered_machine
from experiments.studies.log_study.score import Examine, Score, score_fault, share
from experiments.studies.log_study.sound import LogCase, motions, simulate_log, sound_log
from experiments.studies.log_study.timing import TIMING_FAULTS
from experiments.studies.log_study.values import VALUE_FAULTS

FAULTS: tuple[FaultKind, ...] = (*VALUE_FAULTS, *TIMING_FAULTS, *MACHINE_FAULTS)
MOTIONS, AMOUNTS = 3, 10  # that are tried for a fault that shows
FAULTY, SOUND, PAIRS = 0, 1, 2  # streams of random numbers
LOG, ROW = 2e6, 2e3  # bytes at most of a log with a fault, which is kept with its score, and of a row of a table

ExamineTogether = Callable[[Sequence[Log], Axis], Sequence[Finding]]


@dataclass(frozen=True)
class DrawnLog:
    """A case of the study with its fault, not examined yet."""

    number: int
    kind: str
    case: LogCase
    fault: LogFault


class ScoredLog(NamedTuple):
    """A case and the score of the findings in it."""

    log: DrawnLog
    score: Score


def draw_faulty_logs(count: int, seed: int, axes: Sequence[StudyDrive]) -> Iterator[DrawnLog]:
    """`count` logs with a fault: the kinds in turn, each on the axis with the fewest logs of those that show it."""
    drawn_count = dict.fromkeys((axis.name for axis in axes), 0)
    order = np.random.default_rng([seed, FAULTY]).permutation(len(FAULTS))
    for number in range(count):
        kind = FAULTS[order[number % len(FAULTS)]]
        rng = np.random.default_rng([seed, FAULTY, number])
        by_turn = sorted(rng.permutation(len(axes)), key=lambda k: drawn_count[axes[k].name])
        case, fault = next(filter(None, (_draw_on_axis(kind, axes[k], rng) for k in by_turn)), (None, None))
        if case is None or fault is None:
            continue  # no axis can show it
        drawn_count[case.drive.name] += 1
        yield DrawnLog(number, kind.name, case, fault)


def _draw_on_axis(kind: FaultKind, axis: StudyDrive, rng: np.random.Generator) -> tuple[LogCase, LogFault] | None:
    """A case of this kind on this axis, from several motions and amounts; None where the axis cannot show it."""
    for _ in range(MOTIONS if kind.applies(axis) else 0):
        case = sound_log(axis, rng)
        for _ in range(AMOUNTS):
            if (fault := kind.draw(case, rng)) is not None:
                return case, fault
    return None


def log_study(
    report: Report, *, cases: int, healthy: int, pairs: int, seed: int, examine: Examine, together: ExamineTogether,
    axes: Sequence[StudyDrive] | None = None,
) -> None:  # fmt: skip
    """Report all three parts: faulty logs, sound logs, and pairs of logs; of all axes by default."""
    for option, count, each in (("--cases", cases, LOG), ("--sound", healthy, ROW), ("--pairs", pairs, ROW)):
        require_memory(
            ParameterError, f"{option} {format_count(count)}: what is kept of them", each * count, "give fewer"
        )
    axes = study_drives() if axes is None else axes
    with report.working("logs with a fault"):
        report_faulty_logs(report, score_faulty_logs(report, cases, seed, axes, examine))
    with report.working("fault-free logs"):
        sound_logs(report, healthy, seed, axes, examine)
    with report.working("pairs of logs"):
        pairs_of_logs(report, pairs, seed, axes, together)
    report.result(*in_words(report.data))


def in_words(data: Mapping[str, Any]) -> list[str]:
    """The totals of all parts, in sentences."""
    faulty, sound, pairs = (data[name] for name in ("faulty_logs", "sound_logs", "pairs_of_logs"))
    return [
        f"Of {counted(faulty['logs'], 'log')} with a fault, the checks name the fault of {faulty['named']}, "
        f"{faulty['named_first']} of them first; {counted(faulty['wrong_mends'], 'repair')} would be wrong.",
        f"Of {counted(sound['logs'], 'log')} without a fault, {sound['fatal']} would be refused, and "
        f"{sound['warning_at_worst']} are warned of.",
        f"Of {counted(pairs['mixed'], 'pair')} of logs of two machines, {pairs['found']} are distinguished; of "
        f"{counted(pairs['same'], 'pair')} of one machine, {pairs['false_alarms']} raise a false alarm.",
    ]


def counted(count: int, name: str) -> str:
    """`1 log`, `2 logs`."""
    return f"{count} {name}{'' if count == 1 else 's'}"


def score_faulty_logs(
    report: Report, count: int, seed: int, axes: Sequence[StudyDrive], examine: Examine
) -> list[ScoredLog]:
    """Logs with a fault: is it named first, named at all, is a repair right?"""
    answers = []
    with report.stages() as advance:
        for log in draw_faulty_logs(count, seed, axes):
            axis, resolution = log.case.axis, log.case.drive.resolution
            answers.append(ScoredLog(log, score_fault(log.fault, axis, resolution, examine)))
            advance("logs with a fault", log.number + 1, count)
    return answers


def report_faulty_logs(report: Report, answers: Sequence[ScoredLog]) -> None:
    """The tables by fault, by axis and by log, and the totals."""
    head = ("what", "logs", "named first", "named", "rivals missing", "repaired", "wrong repairs")

    def by_fault(answer: ScoredLog) -> str:
        return answer.log.kind

    def by_drive(answer: ScoredLog) -> str:
        return answer.log.case.drive.name

    for name, group_of, caption in (("by_fault", by_fault, "By fault"), ("by_drive", by_drive, "By axis")):
        groups = sorted({group_of(answer) for answer in answers})
        rows = [
            _counts_row(group, [answer.score for answer in answers if group_of(answer) == group]) for group in groups
        ]
        report.table(name, head, rows, caption)
    report.table(
        "cases",
        ("case", "axis", "motion", "fault", "amount", "first finding", "severity", "named first", "named", "repair"),
        [_log_row(answer) for answer in answers],
        "Each log",
    )
    wrong = [answer for answer in answers if answer.score.wrong_repair]
    if wrong:
        rows = [
            [answer.log.number, answer.log.kind, answer.log.fault.amount, answer.score.wrong_repair] for answer in wrong
        ]
        report.table("wrong_mends", ("case", "fault", "amount", "wrong in"), rows, "Wrong repairs")
    total, scores = len(answers), [answer.score for answer in answers]
    first, named = sum(answer.first for answer in scores), sum(answer.named for answer in scores)
    report.values(
        "faulty_logs", logs=total, axes=len({answer.log.case.drive.name for answer in answers}),
        named_first=first, named_first_share=share(first, total), named=named, named_share=share(named, total),
        not_named=total - named, rivals_missing=sum(not answer.rivals for answer in scores),
        mended=sum(answer.repaired for answer in scores), wrong_mends=len(wrong),
        wrong_mends_share=share(len(wrong), total),
    )  # fmt: skip


def _counts_row(name: str, scores: Sequence[Score]) -> list[object]:
    return [
        name, len(scores), sum(score.first for score in scores), sum(score.named for score in scores),
        sum(not score.rivals for score in scores), sum(score.repaired for score in scores),
        sum(bool(score.wrong_repair) for score in scores),
    ]  # fmt: skip


def _log_row(answer: ScoredLog) -> list[object]:
    case, fault, score = answer.log.case, answer.log.fault, answer.score
    mend = "wrong" if score.wrong_repair else "right" if score.repaired else "-"
    return [
        answer.log.number, case.drive.name, case.log.name, answer.log.kind, fault.amount, score.summary, score.severity,
        _yes(score.first), _yes(score.named), mend,
    ]  # fmt: skip


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def sound_logs(report: Report, count: int, seed: int, axes: Sequence[StudyDrive], examine: Examine) -> None:
    """Sound logs of all axes in turn: what is found in them is a false alarm, but for notes."""
    rows: list[list[object]] = []
    worst: list[str] = []
    motion_only = 0  # logs with no finding but that their motion limits what can be learnt
    with report.stages() as advance:
        for number in range(count):
            case = sound_log(axes[number % len(axes)], np.random.default_rng([seed, SOUND, number]))
            findings = list(examine(case.log, case.axis))
            worst.append(
                next((one for one in ("fatal", "warning", "note") if any(f.severity == one for f in findings)), "none")
            )
            motion_only += all(one.cause == "motion" for one in findings)
            rows += [
                [number, case.drive.name, case.log.name, one.severity, one.cause, one.channel, one.message]
                for one in findings
            ]
            advance("fault-free logs", number + 1, count)
    if rows:
        head = ("log", "axis", "motion", "severity", "cause", "channel", "found")
        report.table("sound", head, rows, "What was found in fault-free logs")
    clean = sum(one in ("none", "note") for one in worst)
    report.values(
        "sound_logs", logs=count, fatal=worst.count("fatal"), fatal_share=share(worst.count("fatal"), count),
        warning_at_worst=worst.count("warning"), note_at_worst=worst.count("note"), nothing=worst.count("none"),
        nothing_share=share(worst.count("none"), count), nothing_but_of_the_motion=motion_only,
        nothing_but_of_the_motion_share=share(motion_only, count), neither_fatal_nor_warning=clean,
        neither_share=share(clean, count),
    )  # fmt: skip


def pairs_of_logs(report: Report, count: int, seed: int, axes: Sequence[StudyDrive], together: ExamineTogether) -> None:
    """Two logs under one name: of one machine, of two that differ in mass, of two that differ in friction, in turn."""
    rows: list[list[object]] = []
    with report.stages() as advance:
        for number in range(count):
            rng = np.random.default_rng([seed, PAIRS, number])
            pair = _pair(axes, ("same", "mass", "friction")[number % 3], number // 3, rng)
            if pair is None:
                continue
            case, other, what = pair
            findings = list(together([case.log, other], case.axis))
            reported = any(finding.cause == "machines differ" for finding in findings)
            rows.append([number, case.drive.name, case.log.name, other.name, what, _yes(reported), len(findings)])
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
        case = sound_log(axis, rng)
        name = str(rng.choice(sorted(motions(axis))))
        try:
            reference = motions(axis)[name](rng)
            if what == "same":
                return case, replace(simulate_log(axis, case.machine, reference, case.seed + 1), name=name), "none"
            other = log_of_altered_machine(case, reference, rng, mass=what == "mass")
        except ResultError:
            continue
        if other is not None:
            return case, replace(other[0], name=name), other[1]
    return None
