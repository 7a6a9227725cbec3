"""The `diffdrive` command."""

import math
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from diffdrive.support.atomic_write import FULL
from diffdrive.support.messages import printable
from experiments.cli.command import Computing
from experiments.cli.ending import INTERRUPTED, out_of, watched
from experiments.cli.options import (
    DEFAULT_MOTION,
    Believed,
    Columns,
    DriveFile,
    Loads,
    LoadText,
    Logs,
    MotionText,
    Out,
    Shifts,
    Units,
    count_of,
    finite,
    seed_of,
)  # fmt: skip
from experiments.cli.studies import studies
from experiments.cli.sweeps import sweeps
from experiments.cli.texts import kept, text

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _say_version(asked: bool) -> None:
    if asked:
        from experiments.reports.report import version_of

        sys.stdout.write(f"diffdrive {version_of('diffdrive')}\n")
        raise typer.Exit


@app.callback()
def everywhere(
    version: Annotated[
        bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Say which edition this is.")
    ] = False,
) -> None:
    """Simulate, tune and check a machine-tool feed drive with friction compensation.

    Start with `diffdrive demo`; then `diffdrive template > drive.toml`, edit it, `diffdrive simulate drive.toml`.
    """


@app.command(cls=Computing)
def demo(
    out: Out = None,
    emps: Annotated[Path | None, typer.Option(help="Folder of the EMPS benchmark's .mat files.")] = None,
    quick: Annotated[bool, typer.Option(help="Searches from fewer starts: half the time.")] = False,
) -> None:
    """The main job: simulate the paper's drive, differentiate it, tune it over loads, and identify a real axis.

    Takes a minute or two. The real axis is the EMPS benchmark; without its files that part is left out, and said so.
    """
    from experiments.studies.demo import demo as run

    run(out, emps_folder=emps, quick=quick)


@app.command(cls=Computing)
def simulate(
    drive: DriveFile,
    motion: MotionText = DEFAULT_MOTION,
    load: LoadText = "0",
    machine: Annotated[
        Path | None,
        typer.Option(help="Drive file of the machine itself, where it differs from what the controller believes."),
    ] = None,
    settle: Annotated[
        float, typer.Option(callback=finite, min=0.0, help="Seconds at the start that do not count.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(callback=seed_of, help="Seed of the sensor noise.")] = 0,
    out: Out = None,
) -> None:
    """Simulate one motion of a drive under its controller, and say how well it follows.

    Writes the run as run.csv and a figure of its signals. A loop that diverges is reported with the signal and the
    time, and the command then ends with code 3.

    Example: `diffdrive simulate drive.toml --motion "sine:amplitude=5mm,frequency=2Hz,duration=2s" --load 8kN`
    """
    from experiments.reports.simulation import simulate_drive

    if not simulate_drive(drive, motion, load, machine, settle, seed, out):
        raise typer.Exit(3)


@app.command(cls=Computing)
def tune(
    drive: DriveFile,
    out: Out = None,
    speed: Annotated[str, typer.Option(help="Speed of the reversal that it is tuned on.")] = "10 mm/s",
    max_load: Annotated[str, typer.Option(help="Highest load; the lowest is none.")] = "12.6 kN",
    loads: Annotated[int, typer.Option(min=2, max=64, help="How many loads, evenly spaced.")] = 4,
    machines: Annotated[int, typer.Option(min=1, max=32, help="How many machines; the first is the file's own.")] = 2,
    spread: Annotated[
        float, typer.Option(callback=finite, min=0.0, max=0.5, help="Uncertainty of the machine's parameters.")
    ] = 0.03,
    gain_margin: Annotated[float, typer.Option(callback=finite, min=0.0, help="dB, up and down.")] = 6.0,
    phase_margin: Annotated[float, typer.Option(callback=finite, min=0.0, max=90.0, help="Degrees.")] = 30.0,
    sensitivity: Annotated[
        float | None,
        typer.Option(callback=finite, min=1.0, help="Largest peak of the sensitivity, Ms; none by default."),
    ] = None,
    noise: Annotated[
        str | None, typer.Option(help="Largest command noise, RMS; by default twice that of the gains as given.")
    ] = None,
    load_error: Annotated[
        str | None, typer.Option(help="Largest RMS load error; by default 1.1 times that of the gains as given.")
    ] = None,
    peak: Annotated[
        float, typer.Option(callback=finite, min=0.0, help="Weight of the peak error beside the RMS error.")
    ] = 0.0,
    aggregation: Annotated[str, typer.Option(help="Over the scenarios: mean, worst or cvar.")] = "mean",
    friction: Annotated[
        bool, typer.Option("--friction", help="Tune the observer's friction parameters along.")
    ] = False,
    starts: Annotated[
        int, typer.Option(callback=count_of, min=1, help="How many starts; the first is the file's gains.")
    ] = 4,
    seed: Annotated[int, typer.Option(callback=seed_of, help="Seed of the machines and of the other starts.")] = 0,
    steps: Annotated[int, typer.Option(callback=count_of, min=1, help="Most search steps from each start.")] = 40,
    pareto: Annotated[str, typer.Option(help="Limits of the command noise for a Pareto front: `5;10;20;40 N`.")] = "",
) -> None:
    """Tune the controller's gains by gradient over loads and machines, within margins, and verify them held out.

    The gains minimise the tracking error within stability margins (of the linearised loop, delay and observer included,
    from standstill to twice the speed, both directions, no load and the highest), command noise, force limit and load
    error. Writes tuned.toml and handover.toml, unless a requirement cannot be kept or a verification run is not ok:
    then it says which and by how much, and ends with code 3. Interrupted or killed, the same command with the same
    --out goes on where it stopped.

    Example: `diffdrive tune drive.toml --noise 20N --phase-margin 35 --out tuned`
    """
    from diffdrive.axis_file.drive_file import read_axis
    from diffdrive.errors import ParameterError
    from diffdrive.motion.text import nonnegative_number, number, numbers, require_choice
    from experiments.reports.report import Report
    from experiments.reports.tuning import tune_drive
    from tuning.gains.objective import AGGREGATIONS, Objective
    from tuning.gains.plan import TuningPlan
    from tuning.gains.requirements import MOST_GAIN_MARGIN, Required

    description = read_axis(drive)
    require_choice("--aggregation", "aggregation", aggregation, AGGREGATIONS)
    highest = nonnegative_number(max_load, "N", "--max-load")
    if gain_margin > MOST_GAIN_MARGIN:
        raise ParameterError(
            f"--gain-margin {gain_margin:g}: must be at most {MOST_GAIN_MARGIN:.0f} dB, beyond which the loop's gain "
            "is lost in rounding; 6 to 12 dB are usual"
        )
    factor = 10.0 ** (gain_margin / 20.0)
    limits = Required(
        gain_up=factor,
        gain_down=factor,
        phase=math.radians(phase_margin),
        sensitivity=sensitivity,
        command_noise=None if noise is None else nonnegative_number(noise, "N", "--noise"),
        load_error=None if load_error is None else nonnegative_number(load_error, "N", "--load-error"),
    )
    plan = TuningPlan(
        speed=number(speed, "m/s", "--speed"), max_load=highest, loads=loads, spread=spread, machines=machines,
        seed=seed,
    )  # fmt: skip
    objective = Objective(peak=1e6 * peak, aggregation=aggregation)
    front = numbers(pareto, "N", "--pareto") if pareto else []
    if any(limit <= 0.0 for limit in front):
        raise ParameterError(f"--pareto {pareto}: each limit must be above 0")
    with Report(f"{drive.name}: gradient tuning over loads and machines", out) as report:
        _, accepted = tune_drive(
            description, report, plan=plan, limits=limits, objective=objective, friction=friction, starts=starts,
            max_steps=steps, pareto=front,
        )  # fmt: skip
    if not accepted:
        raise typer.Exit(3)


@app.command(cls=Computing)
def check(
    logs: Logs,
    drive: Believed,
    out: Out = None,
    column: Columns = None,
    unit: Units = None,
    shift: Shifts = None,
    load: Loads = None,
) -> None:
    """Look over logs before anything is made of them: how they read, what was repaired, what they would mislead about.

    Each finding (volts for newtons, a shifted command, a filtered position, lost rows) comes with its numbers and what
    to do. Ends with code 3 where one is fatal.

    Example: `diffdrive check lap1.csv lap2.csv --drive drive.toml --column "position=Istposition [mm]"`
    """
    from experiments.reports.log_checks import check_logs

    if not check_logs(logs, drive, out, columns=column or (), units=unit or (), shifts=shift or (), loads=load or ()):
        raise typer.Exit(3)


@app.command(cls=Computing)
def identify(
    logs: Logs,
    drive: Believed,
    out: Out = None,
    column: Columns = None,
    unit: Units = None,
    shift: Shifts = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(help="A parameter, as the drive file calls it, that stays as believed; repeatable."),
    ] = None,
    bound: Annotated[
        list[str] | None, typer.Option(help="NAME=LOW:HIGH, in SI or with units: `mass=80:120`; repeatable.")
    ] = None,
    load: Loads = None,
    starts: Annotated[
        int, typer.Option(callback=count_of, min=1, help="How many starts; the first is the inverse dynamics' answer.")
    ] = 6,
    seed: Annotated[int, typer.Option(callback=seed_of, help="Seed of the other starts.")] = 0,
    held_out: Annotated[
        list[Path] | None, typer.Option(help="A log that is only looked at afterwards; repeatable.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Go on over fatal findings in a log.")] = False,
) -> None:
    """Identify friction, mass and delay of a drive from its logs, with intervals, and say whether the model suffices.

    The logs are looked over first, and one with a fatal finding (volts for newtons, a shifted command) is refused.
    Writes identified.toml, a drive file with the drive that was found, the table of estimates and figures. A parameter
    that the logs do not determine is named and stays as believed. Structure that the model leaves is said, and is no
    failure; a search that does not converge, or is interrupted by Ctrl-C, ends with code 3 and the best so far. Stopped
    or killed, the same command with the same --out continues where it was.

    Example: `diffdrive identify lap1.csv lap2.csv --drive drive.toml --unit command=V --held-out lap3.csv --out found`
    """
    from experiments.reports.identification.identification import identify_drive

    converged = identify_drive(
        logs, drive, out, columns=column or (), units=unit or (), shifts=shift or (),
        fixed=fix or (), bounds=bound or (), loads=load or (),
        starts=starts, seed=seed, held_out=held_out or (), force=force,
    )  # fmt: skip
    if not converged:
        raise typer.Exit(3)


@app.command(cls=Computing)
def diagnose(
    logs: Logs,
    drive: Believed,
    out: Out = None,
    column: Columns = None,
    unit: Units = None,
    shift: Shifts = None,
    load: Loads = None,
    without: Annotated[
        list[str] | None, typer.Option(help="An effect of the catalogue that is not to be considered; repeatable.")
    ] = None,
    most_effects: Annotated[int, typer.Option(min=1, max=4, help="How many effects at once, at most.")] = 2,
    tolerance: Annotated[
        float,
        typer.Option(
            callback=finite,
            min=1e-4,
            max=1.0,
            help="How well the drive file is known: 0.02 is right to 2 %, give or take (a standard deviation).",
        ),
    ] = 0.02,
    tune: Annotated[
        bool, typer.Option("--tune", help="Tune the controller on both drives, and show what closing the gap pays.")
    ] = False,
) -> None:
    """Say how large the gap between a drive and its logs is, where it lies, what causes it, and how far it shrinks.

    The nominal parameters are recalibrated first; only what that cannot explain speaks for an effect. How far it closes
    the gap is judged on held-out data: with several logs the last that the others can spare. Writes diagnosis.json,
    report.html (one page, self-contained), figures, and augmented.toml: the drive with what was found, for `simulate`,
    `tune` and `sweep`. No log is refused for what it shows, but a fatal finding in one (volts for newtons, a shifted
    command) leaves no confidence above 0.5, and in a command with a reversed sign no cause is looked for. Stopped or
    killed, the same command with the same --out continues where it was and ends with the same numbers.

    Example: `diffdrive diagnose lap1.csv lap2.csv --drive drive.toml --out diagnosis`
    """
    from experiments.reports.diagnosis.diagnosis import diagnose_logs

    diagnose_logs(
        logs, drive, out, columns=column or (), units=unit or (), shifts=shift or (), loads=load or (),
        without=without or (),
        most_effects=most_effects, tolerance=tolerance, tuned=tune,
    )  # fmt: skip


@app.command()
def template(
    out: Out = None,
    controller: Annotated[
        str, typer.Option(help="Its controller: pd+fc+ls, cascade (as most CNCs), pd, or another of the paper's.")
    ] = "pd+fc+ls",
) -> None:
    """Print a complete drive file, the paper's testbed, to start from; with --out, write it as drive.toml.

    Its friction observer estimates the load at every speed. `--controller cascade` is the loop of most CNCs,
    `--controller pd+fc+le` the paper's own.
    """
    from experiments.cli.template import template as text_of

    text(lambda: text_of(controller), out, "drive.toml")


@app.command()
def keys(out: Out = None) -> None:
    """Print every key that a drive file may hold, with unit, range, default and meaning (a Markdown table)."""
    text(lambda: kept(_keys, "keys.md"), out, "keys.md")


def _keys() -> str:
    from diffdrive.axis_file.reference import markdown

    return markdown()


@app.command()
def motions(out: Out = None) -> None:
    """Print every motion and every shape of load, with settings, units and defaults (two Markdown tables)."""
    text(lambda: kept(_motions, "motions.md"), out, "motions.md")


def _motions() -> str:
    from diffdrive.motion.reference import markdown

    return markdown()


def _plain_warning(error: Console) -> Callable[..., None]:
    def show(message: Warning | str, *_: object, **__: object) -> None:
        error.print(f"warning: {printable(str(message))}", style="yellow", soft_wrap=True)

    return show


app.add_typer(sweeps)
app.add_typer(studies)


def main() -> None:
    """Run the command line: expected errors in one line, without a traceback, and code 2."""
    error = Console(stderr=True, markup=False, emoji=False, highlight=False)
    warnings.showwarning = _plain_warning(error)
    with watched(out_of(sys.argv[1:])) as watch:
        try:
            _expected(error)
        except SystemExit as ended:
            # typer makes that code of a Ctrl-C, and a search ends on it with its best; threads may go on computing
            if ended.code == INTERRUPTED or (watch.came is not None and not ended.code):
                watch.leave("and what was written so far stays")
            raise


def _expected(error: Console) -> None:
    """The command line; what may be expected to fail in one line."""
    from diffdrive.errors import DiffdriveError

    try:
        app()
    except DiffdriveError as problem:
        error.print(f"error: {problem}", style="red", soft_wrap=True)
        sys.exit(2)
    except OSError as problem:
        if problem.errno not in FULL:
            raise
        error.print(
            "error: no room is left on the disk: make some, or name another folder; what was written so far stays, and "
            "where a sweep, a search or a study was under way the same command goes on",
            style="red", soft_wrap=True,
        )  # fmt: skip
        sys.exit(2)
