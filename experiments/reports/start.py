"""`diffdrive start`: a drive file from a trace, with the reason for each value; what is open is a question."""

import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from diffdrive.errors import ParameterError
from diffdrive.logs.guess.result import Question
from experiments.reports.checked_logs import assignments, list_findings
from experiments.reports.log_checks import findings_in_words
from experiments.reports.page.log_rows import log_rows
from experiments.reports.report import Report
from tuning.unknown_trace.workflow import StartResult, require_new, start

Ask = Callable[[Question], str]


def start_from_trace(
    log: Path,
    drive: Path,
    out: Path | None,
    *,
    columns: Sequence[str] = (),
    units: Sequence[str] = (),
    numbers: Mapping[str, str | None],
    ask: Ask | None = None,
) -> bool:
    """Write a drive file for a trace; whether nothing fatal was found in the log with it.

    `columns` and `units` are texts as on the command line, `numbers` further arguments of `start`. `ask` answers what
    is open; without it that raises `ParameterError`, in one line that names the options.
    """
    require_new(drive)
    stated: dict[str, Any] = {name: value for name, value in numbers.items() if value is not None}
    stated["columns"], stated["units"] = assignments(columns, "--column"), assignments(units, "--unit")
    with Report(f"{log.name}: what it is, and a drive file to start from", out) as report:
        result = _answered(log, report, stated, ask)
        written = result.write(drive)
        assert result.findings is not None
        found, fatal = result.findings.findings, result.findings.fatal
        if report.out is not None:
            report.page.logs += log_rows(result.findings.logs, [log])
        with report.result_first() as say:
            say(f"{written} is a drive file for {log.name}: what is sure, likely, stated and usual stands in it.")
            report_guesses(report, result)
            for note in result.notes:
                report.say(f"- {note}")
            report.print("\nThe check of the log with this drive file", style="bold")
            report.keep("verdict", fatal=len(fatal), findings=len(found))
            report.conclude(good=not fatal)
            report.say(findings_in_words(len(found), len(fatal)))
            list_findings(report, "findings", result.findings.logs, found)
            report.say(_next(log, written, bool(fatal)))
    return not fatal


def _answered(log: Path, report: Report, stated: dict[str, Any], ask: Ask | None) -> StartResult:
    """The result without open questions."""
    answered: set[tuple[str, str]] = set()
    while True:
        with report.working(f"looking at {log.name}"):
            result = start(log, **stated)
        if not result.questions:
            return result
        again = [one for one in result.questions if (one.argument, one.channel) in answered]
        if ask is None or again:
            raise ParameterError(f"{log}: " + "; ".join(str(question) for question in again or result.questions))
        report_guesses(report, result)
        for question in result.questions:
            answered.add((question.argument, question.channel))
            answer = ask(question)
            if question.channel:
                stated[question.argument][question.channel] = answer
            else:
                stated[question.argument] = answer


def report_guesses(report: Report, result: StartResult) -> None:
    """Print and keep what a trace holds, each guess with how sure it is and why, and what is open."""
    report.record("guesses", ("what", "value", "how sure", "why"), [list(one) for one in result.guesses])
    report.print("\nWhat the trace holds", style="bold")
    for guess in result.guesses:
        report.print(f"- {guess}")
    for question in result.questions:
        report.print(f"- open: {question}")


def _next(log: Path, drive: Path, is_fatal: bool) -> str:
    files = f"{shlex.quote(str(log))} --drive {shlex.quote(str(drive))}"
    if is_fatal:
        return f"Next: correct what is fatal, in the log or in {drive}, then diffdrive check {files}"
    return f"Next: diffdrive identify {files} --out found"
