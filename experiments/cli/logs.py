"""The commands that take logs: start, check, identify, compare, diagnose."""

from pathlib import Path
from typing import Annotated

import typer

from diffdrive.errors import ParameterError
from experiments.cli.command import BETWEEN, Comparing, Computing
from experiments.cli.options import (
    Columns,
    DriveOption,
    Fixed,
    Loads,
    Logs,
    Out,
    Pdf,
    Seed,
    Shifts,
    Svg,
    Units,
    count_of,
    finite,
)

logs = typer.Typer()


@logs.command(cls=Computing)
def start(
    log: Annotated[
        Path,
        typer.Argument(
            help="A trace of the axis, of any format that logs may have.", metavar="LOG", show_default=False
        ),
    ],
    drive: Annotated[
        Path, typer.Option("--drive", help="Drive file to write; one that exists is never overwritten.")
    ] = Path("drive.toml"),
    mass: Annotated[
        str | None,
        typer.Option(help="Moving mass, motor and screw included: `500kg`; of a rotary axis its inertia, `0.5kg*m^2`."),
    ] = None,
    lead: Annotated[
        str | None, typer.Option(help="Travel per turn of the screw, where a column is in units of the motor: `10mm`.")
    ] = None,
    gear_ratio: Annotated[str | None, typer.Option(help="Turns of the motor per turn of the screw or table.")] = None,
    rated_torque: Annotated[
        str | None, typer.Option(help="Of the motor, where the command is in per cent of it: `5Nm`.")
    ] = None,
    rated_current: Annotated[str | None, typer.Option(help="Of the motor: `4A`.")] = None,
    torque_constant: Annotated[
        str | None, typer.Option(help="Of the motor, where the command is a current: `1.2N*m/A`.")
    ] = None,
    encoder_counts: Annotated[
        str | None,
        typer.Option(help="Counts of the motor's encoder per turn of the motor, where a position is in counts."),
    ] = None,
    kind: Annotated[str, typer.Option(help="Of the axis: linear or rotary.")] = "linear",
    rate: Annotated[str | None, typer.Option(help="Rate of the rows, where no column is a time: `1kHz`.")] = None,
    out: Out = None,
    column: Columns = None,
    unit: Units = None,
) -> None:
    """Begin with nothing but a trace: write a drive file with its columns, units, signs and a first guess of friction.

    Each guess is said with its reason and how sure it is. What cannot be guessed is asked, at a terminal; elsewhere the
    command is refused in one line that names the options. Then the log is checked with the new drive file, and the next
    command is printed: `identify`. Ends with code 3 where a finding is fatal.

    Example: `diffdrive start trace.csv --mass 500kg --lead 10mm --rated-torque 5Nm`
    """
    import sys

    from experiments.reports.start import start_from_trace

    numbers = {
        "mass": mass, "lead": lead, "gear_ratio": gear_ratio, "rated_torque": rated_torque,
        "rated_current": rated_current, "torque_constant": torque_constant, "encoder_counts": encoder_counts,
        "kind": kind, "rate": rate,
    }  # fmt: skip
    ask = (lambda question: typer.prompt(question.prompt)) if sys.stdin.isatty() else None
    if not start_from_trace(log, drive, out, columns=column or (), units=unit or (), numbers=numbers, ask=ask):
        raise typer.Exit(3)


@logs.command(cls=Computing)
def check(
    log: Logs,
    drive: DriveOption,
    out: Out = None,
    column: Columns = None,
    unit: Units = None,
    shift: Shifts = None,
    load: Loads = None,
    controller: Annotated[
        bool,
        typer.Option(
            "--controller",
            help="Print the gains of the position and speed cascade that made the commands, with 95 % intervals; with "
            "--out, write the drive file with them, controller.toml.",
        ),
    ] = False,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """Check logs before use: channels, units, repairs, and faults that would bias a fit.

    Each finding (volts for newtons, a shifted command, a filtered position, lost rows) comes with its numbers and what
    to do. Ends with code 3 where one is fatal.

    Example: `diffdrive check lap1.csv lap2.csv --drive drive.toml --column "position=Istposition [mm]"`
    """
    from experiments.reports.log_checks import check_logs

    usable = check_logs(
        log, drive, out, columns=column or (), units=unit or (), shifts=shift or (), loads=load or (),
        controller=controller,
    )  # fmt: skip
    if not usable:
        raise typer.Exit(3)


@logs.command(cls=Computing)
def identify(
    log: Logs,
    drive: DriveOption,
    out: Out = None,
    column: Columns = None,
    unit: Units = None,
    shift: Shifts = None,
    fixed: Fixed = None,
    bound: Annotated[
        list[str] | None, typer.Option(help="NAME=LOW:HIGH, in SI or with units: `mass=80:120`; repeatable.")
    ] = None,
    load: Loads = None,
    starts: Annotated[
        int,
        typer.Option(
            callback=count_of,
            min=1,
            help="Number of searches; the first starts from the inverse dynamics, the others elsewhere.",
        ),
    ] = 6,
    seed: Seed = 0,
    held_out: Annotated[
        list[Path] | None,
        typer.Option(help="A log that is not fitted, only predicted, to validate the result; repeatable."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Identify in spite of fatal findings.")] = False,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """Identify friction, mass and delay of a drive from its logs, with intervals, and say whether the model suffices.

    The logs are checked first, and one with a fatal finding (volts for newtons, a shifted command) is refused. Writes
    identified.toml, a drive file with the drive that was found, the table of estimates and figures. A parameter that
    the logs do not determine is named and stays at the drive file's value. An incomplete model is reported, and is not
    an error; a search that does not converge, or is interrupted by Ctrl-C, ends with code 3 and the best so far.
    Stopped or killed, the same command with the same --out continues where it was.

    Example: `diffdrive identify lap1.csv lap2.csv --drive drive.toml --unit command=V --held-out lap3.csv --out found`
    """
    from experiments.reports.identification.identification import identify_drive

    converged = identify_drive(
        log, drive, out, columns=column or (), units=unit or (), shifts=shift or (),
        fixed=fixed or (), bounds=bound or (), loads=load or (),
        starts=starts, seed=seed, held_out=held_out or (), force=force,
    )  # fmt: skip
    if not converged:
        raise typer.Exit(3)


@logs.command(cls=Comparing)
def compare(
    log: Annotated[
        list[Path],
        typer.Argument(
            help="Logs of the axis before, then `--`, then logs of it after.",
            metavar="BEFORE... -- AFTER...",
            show_default=False,
        ),
    ],
    drive: DriveOption,
    out: Out = None,
    column: Columns = None,
    unit: Units = None,
    shift: Shifts = None,
    fixed: Fixed = None,
    load: Loads = None,
    level: Annotated[
        float,
        typer.Option(
            callback=finite,
            help="Share of the comparisons of an unchanged axis in which a change may be found.",
        ),
    ] = 0.01,
    starts: Annotated[int, typer.Option(callback=count_of, min=1, help="Number of searches of each side.")] = 6,
    seed: Seed = 0,
    force: Annotated[bool, typer.Option("--force", help="Compare in spite of fatal findings.")] = False,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """Say what has changed between two sets of logs of one axis: friction, mass, controller gains, backlash.

    Each change has one sentence and a 95 % interval; for the rest the smallest change is said that would have been
    found. Lost preload (friction down, backlash up) is one sentence. The motions may differ; the same motion before and
    after shows smaller changes. Backlash needs two encoders, and the controller's gains need the reference. Writes
    comparison.json, the table and figure of all changes, and identified.toml, the axis as it is after. Ends with code
    3 where the result is doubtful. Stopped or killed, the same command with the same --out continues where it was.

    Example: `diffdrive compare monday1.csv monday2.csv -- today.csv --drive drive.toml --out changes`
    """
    before, after = _two_sets(log)

    from experiments.reports.comparison import compare_logs

    sure = compare_logs(
        before, after, drive, out, columns=column or (), units=unit or (), shifts=shift or (), fixed=fixed or (),
        loads=load or (), level=level, starts=starts, seed=seed, force=force,
    )  # fmt: skip
    if not sure:
        raise typer.Exit(3)


def _two_sets(paths: list[Path]) -> tuple[list[Path], list[Path]]:
    """The files before and after the `--`."""
    places = [k for k, path in enumerate(paths) if str(path) == BETWEEN]
    how = "write the logs before, then --, then those after: before.csv -- after.csv"
    if len(places) != 1:
        raise ParameterError(f"compare: {'no' if not places else 'more than one'} -- between the logs; {how}")
    before, after = paths[: places[0]], paths[places[0] + 1 :]
    if not (before and after):
        raise ParameterError(f"compare: no log {'before' if not before else 'after'} the --; {how}")
    return before, after


@logs.command(cls=Computing)
def diagnose(
    log: Logs,
    drive: DriveOption,
    out: Out = None,
    column: Columns = None,
    unit: Units = None,
    shift: Shifts = None,
    load: Loads = None,
    without: Annotated[
        list[str] | None, typer.Option(help="An effect of the catalogue to leave out; repeatable.")
    ] = None,
    most_effects: Annotated[int, typer.Option(min=1, max=4, help="Largest number of effects at once.")] = 2,
    tolerance: Annotated[
        float,
        typer.Option(
            callback=finite,
            min=1e-4,
            max=1.0,
            help="How well the drive file is known: 0.02 is right to 2 % (one standard deviation of each parameter).",
        ),
    ] = 0.02,
    tune: Annotated[
        bool,
        typer.Option(
            "--tune",
            help="Tune the controller on the nominal drive and on the one with what was found, and compare the gains.",
        ),
    ] = False,
    svg: Svg = False,
    pdf: Pdf = False,
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
        log, drive, out, columns=column or (), units=unit or (), shifts=shift or (), loads=load or (),
        without=without or (),
        most_effects=most_effects, tolerance=tolerance, tuned=tune,
    )  # fmt: skip
