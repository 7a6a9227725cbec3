"""`experiments.report`: any result as a folder of tables, figures, pages and files that other tools take."""

from functools import singledispatch
from pathlib import Path

from rich.console import Console

from diffdrive.errors import ParameterError
from diffdrive.logs.encoders.result import EncoderComparison
from diffdrive.loop.run import Run
from diffdrive.measured_loop import FrequencyComparison
from diffdrive.results import Result
from experiments.reports.comparison import report_comparison_of_logs
from experiments.reports.controller import report_controller
from experiments.reports.diagnosis.answers import print_answers
from experiments.reports.diagnosis.figures import save_diagnosis_figures
from experiments.reports.diagnosis.files import write_augmented, write_reference
from experiments.reports.diagnosis.page import give_page
from experiments.reports.encoders import report_encoders
from experiments.reports.identification.identification import report_identification
from experiments.reports.margins import report_comparison
from experiments.reports.page.log_rows import log_rows
from experiments.reports.report import Report
from experiments.reports.severity import report_severity
from experiments.reports.simulation import write_simulation
from experiments.reports.start import report_guesses
from experiments.reports.sweep.sweep import introduce, report_sweep
from experiments.reports.tuning import report_pareto, report_tuning
from tuning.accuracy.result import SeverityResult
from tuning.comparison.result import ComparisonResult
from tuning.diagnosis.workflow import DiagnosisResult
from tuning.gains.pareto import ParetoFront
from tuning.gains.result import TuningResult
from tuning.identification.controller.workflow import ControllerEstimate
from tuning.identification.workflow import IdentificationResult
from tuning.sweeps.result import SweepResult
from tuning.unknown_trace.workflow import StartResult


def report(result: Result, folder: str | Path, *, quiet: bool = True) -> Path:
    """Write everything that a result says into a folder, and return it.

    The result as JSON, its tables as CSV, its figures as PNG, all of them on the page `report.html`, and what other
    tools take: `run.csv` of a simulation, `identified.toml`, `tuned.toml`, `augmented.toml` of a diagnosis. A result of
    your own joins them: `@section.register` a function of the result and a `Report`.

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
    ) as writer:
        writer.page.is_command = False
        result.save(out)
        section(result, writer)
        if not writer.page.conclusions:  # else the section has also said whether the result is good
            writer.conclude(result.headline(), good=result.status.ok)
    return out


@singledispatch
def section(result: object, writer: Report) -> None:
    """What is written of a result of this kind."""
    raise ParameterError(f"no report is known of a {type(result).__name__}")


@section.register
def _(result: Run, writer: Report) -> None:
    writer.values("run", status=result.status.message, **result.as_dict())
    for note in result.notes:
        writer.say(note)
    write_simulation(writer, result)


@section.register
def _(result: EncoderComparison, writer: Report) -> None:
    report_encoders(writer, [result])


@section.register
def _(result: ControllerEstimate, writer: Report) -> None:
    report_controller(writer, result)


@section.register
def _(result: FrequencyComparison, writer: Report) -> None:
    report_comparison(writer, result)


@section.register
def _(result: IdentificationResult, writer: Report) -> None:
    writer.page.logs += log_rows([*result.logs.logs, *result.held_out.logs])
    report_identification(writer, result)


@section.register
def _(result: ComparisonResult, writer: Report) -> None:
    report_comparison_of_logs(writer, result)


@section.register
def _(result: DiagnosisResult, writer: Report) -> None:
    details = dict(result.details)
    print_answers(writer, details)
    write_reference(writer, result.next_motion.reference)
    augmented = write_augmented(writer, result)
    save_diagnosis_figures(writer, result.diagnosis, result.logs.logs)
    writer.page.logs += log_rows(result.logs.logs)
    give_page(writer, details, augmented)


@section.register
def _(result: TuningResult, writer: Report) -> None:
    report_tuning(writer, result)


@section.register
def _(result: ParetoFront, writer: Report) -> None:
    report_pareto(writer, result)


@section.register
def _(result: StartResult, writer: Report) -> None:
    report_guesses(writer, result)


@section.register
def _(result: SeverityResult, writer: Report) -> None:
    report_severity(writer, result)


@section.register
def _(result: SweepResult, writer: Report) -> None:
    introduce(writer, result.plan, result.notes)
    report_sweep(writer, result)
