"""`experiments.report`: any result as a folder of tables, figures, pages and files that other tools take."""

from functools import singledispatch
from pathlib import Path
from typing import Any

from rich.console import Console

from diffdrive.errors import ParameterError
from diffdrive.loop.run import Run
from diffdrive.results import Result
from experiments.reports.axis_file import write_axis_file
from experiments.reports.diagnosis.figures import draw as draw_diagnosis
from experiments.reports.diagnosis.files import write_augmented, write_reference
from experiments.reports.diagnosis.page import page, tell
from experiments.reports.identification.figures import draw as draw_identification
from experiments.reports.identification.identification import tell as tell_identified
from experiments.reports.identification.left_open import write_uncertainty
from experiments.reports.report import Report
from experiments.reports.simulation import run_figure, write_run
from experiments.reports.sweep.sweep import draw as draw_sweep
from experiments.reports.sweep.tables import tell as tell_sweep
from experiments.reports.tuning import figure_of, gains_table, loop_figures, margins_table, verification_table
from tuning.diagnosis.workflow import DiagnosisResult
from tuning.gains.workflow import TuningResult, margins_at
from tuning.identification.workflow import IdentificationResult
from tuning.sweeps.summary import groups
from tuning.sweeps.workflow import SweepResult, as_dataset, group_influences


def report(result: Result, folder: str | Path, *, quiet: bool = True) -> Path:
    """Write everything that a result tells into a folder, and return it.

    The result as JSON, its tables as CSV, its figures as PNG, and what other tools take: `run.csv` of a simulation,
    `identified.toml`, `tuned.toml`, and of a diagnosis `augmented.toml` and the page `report.html`. A result of your
    own joins them: `@section.register` a function of the result and a `Report`.

    Args:
        result: Of `simulate`, or a function of `tuning`.
        folder: Where the files go; made if need be.
        quiet: Print nothing; otherwise what the command would print.

    Raises:
        ParameterError: No report is known of such a result, or the folder cannot be written to.

    Examples:
        >>> report(simulate(axis, lap), "run")

    """
    out = Path(folder)
    with Report(
        f"{result.schema.split('/')[0]}: {result.headline()}", out, Console(quiet=True) if quiet else None
    ) as one:
        result.save(out)
        section(result, one)
    return out


@singledispatch
def section(result: Any, one: Report) -> None:
    """What is written of a result of this kind."""
    raise ParameterError(f"no report is known of a {type(result).__name__}")


@section.register
def _(result: Run, one: Report) -> None:
    one.values("run", status=result.status.message, **result.as_dict())
    write_run(_out(one) / "run.csv", result)
    one.figure("run", run_figure(result))


@section.register
def _(result: IdentificationResult, one: Report) -> None:
    tell_identified(one, result.fit)
    write_uncertainty(_out(one), result.fit)
    write_axis_file(one, result.axis, "identified.toml")
    draw_identification(one, result.fit, result.initial_axis.drive, result.logs.logs)


@section.register
def _(result: DiagnosisResult, one: Report) -> None:
    told = dict(result.details)
    tell(one, told)
    write_reference(one, result.next_motion.reference)
    augmented = write_augmented(one, result)
    draw_diagnosis(one, result.diagnosis, result.logs.logs)
    page(one, told, augmented)


@section.register
def _(result: TuningResult, one: Report) -> None:
    gains_table(one, result.search)
    for note in result.notes:
        one.say(note)
    given = result.initial_axis
    margins_table(one, margins_at(given, [given.controller, result.search.controller], result.plan))
    loop_figures(one, given, result.search.controller, result.plan, result.limits)
    verification_table(one, list(result.runs))
    one.figure("tuning", figure_of(result.search, list(result.runs), result.plan))
    if result.accepted:
        write_axis_file(one, result.axis, "tuned.toml")


@section.register
def _(result: SweepResult, one: Report) -> None:
    plan = result.plan
    found = groups(as_dataset(result.frame), list(plan.controllers), list(plan.motions))
    told = [(each, group_influences(plan, each, result.by)) for each in found]
    tell_sweep(one, plan, told, result.tolerance, result.by)
    for motion in plan.motions:
        draw_sweep(one, plan, [each for each in told if each[0].motion == motion], result.tolerance, result.by)


def _out(one: Report) -> Path:
    assert one.out is not None
    return one.out
