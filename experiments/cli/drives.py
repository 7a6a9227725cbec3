"""The commands about one drive file: demo, simulate, margins, tune."""

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.command import Computing
from experiments.cli.options import (
    DEFAULT_MOTION,
    DriveFile,
    LoadText,
    Machine,
    MeasuredOf,
    MeasuredUnit,
    MotionText,
    Out,
    Pdf,
    Seed,
    Settle,
    Svg,
    count_of,
    finite,
    parse_folder,
)  # fmt: skip

drives = typer.Typer()


@drives.command(cls=Computing)
def demo(
    out: Out = None,
    emps: Annotated[Path | None, typer.Option(help="Folder of the EMPS benchmark's .mat files.")] = None,
    quick: Annotated[bool, typer.Option(help="Searches from fewer starts: half the time.")] = False,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """A first run without files of your own: simulate, differentiate and tune the paper's drive, identify a real axis.

    Takes a minute or two. The real axis is the EMPS benchmark; without its files that part is left out, and said so.
    """
    from experiments.studies.demo import demo as run

    run(out, emps_folder=emps, quick=quick)


@drives.command(cls=Computing)
def simulate(
    drive: DriveFile,
    motion: MotionText = DEFAULT_MOTION,
    load: LoadText = "0",
    machine: Machine = None,
    settle: Settle = 0.0,
    seed: Seed = 0,
    out: Out = None,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """Simulate one motion of a drive under its controller, and say how well it follows.

    Writes the run as run.csv and a figure of its signals. A loop that diverges is reported with the signal and the
    time, and the command then ends with code 3.

    Example: `diffdrive simulate drive.toml --motion "sine:amplitude=5mm,frequency=2Hz,duration=2s" --load 8kN`
    """
    from experiments.reports.simulation import simulate_drive

    if not simulate_drive(drive, motion, load, machine, settle, seed, out):
        raise typer.Exit(3)


@drives.command(cls=Computing)
def margins(
    drive: DriveFile,
    measured: Annotated[
        Path | None,
        typer.Option(help="Measured frequency response: CSV, or the XML of SINUMERIK's auto servo tuning."),
    ] = None,
    of: MeasuredOf = None,
    unit: MeasuredUnit = None,
    velocity: Annotated[
        str, typer.Option(help="Velocity at which the loop is linearised; 0 is standstill.")
    ] = "10 mm/s",
    load: Annotated[str, typer.Option(help="Load on the guides.")] = "0 N",
    out: Out = None,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """Stability margins of the linearised loop, and of that with a measured frequency response in its plant's place.

    With --measured it says which resonances each loop has and where they part, and draws both. A loop that is unstable
    ends the command with code 3.

    Example: `diffdrive margins drive.toml --measured plant.csv --of plant --unit "(rad/s)/(N*m)" --out margins`
    """
    from diffdrive.axis_file.drive_file import read_axis
    from diffdrive.frequency.read import read_frequency_response
    from diffdrive.motion.text import nonnegative_number, number
    from experiments.reports.margins import report_margins
    from experiments.reports.report import Report

    axis = read_axis(drive)
    about = number(velocity, "m/s", "--velocity", axis.sheet)
    force = nonnegative_number(load, "N", "--load", axis.sheet)
    response = None if measured is None else read_frequency_response(measured, of, unit=unit)
    with Report(f"{drive.name}: margins", out) as report:
        stable = report_margins(report, axis, response, velocity=about, load=force)
    if not stable:
        raise typer.Exit(3)


@drives.command(cls=Computing)
def severity(
    drive: DriveFile,
    tolerance: Annotated[
        str | None, typer.Option(help="What accuracy A and circular deviation G may be: a length, or an angle.")
    ] = None,
    stroke: Annotated[
        tuple[str, str] | None,
        typer.Option(help="Lowest and highest position of the tests; by default the middle 90 % of the stroke."),
    ] = None,
    speed: Annotated[str | None, typer.Option(help="Speed of the tests; by default the drive file's limit.")] = None,
    acceleration: Annotated[
        str | None, typer.Option(help="Acceleration of the tests; by default the drive file's limit.")
    ] = None,
    load: Annotated[str, typer.Option(help="Load on the guides.")] = "0 N",
    seed: Seed = 0,
    out: Out = None,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """What each unmodelled effect of a drive file costs of its accuracy (ISO 230-2, 230-4), and what to mend first.

    The drive file is one with [effects], such as the augmented.toml of `diagnose`. Positioning and circular test are
    simulated as it is, without each effect in turn, and without any. Beyond the tolerance the code is 3.

    Example: `diffdrive severity augmented.toml --tolerance 5um --speed 100mm/s --acceleration 1m/s^2 --out severity`
    """
    from diffdrive.axis_file.drive_file import read_axis
    from diffdrive.motion.text import nonnegative_number, number
    from experiments.reports.report import Report
    from experiments.reports.severity import report_severity
    from tuning.accuracy.severity import severity as measure

    axis = read_axis(drive)
    sheet = axis.sheet

    def optional(text: str | None, unit: str, option: str) -> float | None:
        return None if text is None else nonnegative_number(text, unit, option, sheet)

    between = None
    if stroke is not None:
        between = number(stroke[0], "m", "--stroke", sheet), number(stroke[1], "m", "--stroke", sheet)
    with Report(f"{drive.name}: what its effects cost", out) as report:
        with report.stages() as progress:
            found = measure(
                axis, tolerance=optional(tolerance, "m", "--tolerance"), stroke=between,
                speed=optional(speed, "m/s", "--speed"), acceleration=optional(acceleration, "m/s^2", "--acceleration"),
                load=nonnegative_number(load, "N", "--load", sheet), seed=seed, progress=progress,
            )  # fmt: skip
        report_severity(report, found)
    if found.beyond:
        raise typer.Exit(3)


@drives.command(cls=Computing)
def tune(
    drive: DriveFile,
    out: Out = None,
    speed: Annotated[
        str, typer.Option(help="Speed of the reversal used for tuning: state that of your axis.")
    ] = "10 mm/s",
    max_load: Annotated[
        str, typer.Option(help="Highest load on the guides, the lowest is 0: state that of your axis.")
    ] = "12.6 kN",
    loads: Annotated[int, typer.Option(min=2, max=64, help="Number of loads, evenly spaced.")] = 4,
    machines: Annotated[
        int,
        typer.Option(
            min=1,
            max=32,
            help="Number of machines that the gains must suit: the file's, and others.",
        ),
    ] = 2,
    spread: Annotated[
        str | None,
        typer.Option(
            help="Relative deviation of the other machines' parameters, as 3% or 0.03; at most 50%. By default as "
            "the drive file's table uncertainty says, and 3% of what that does not name."
        ),
    ] = None,
    gain_margin: Annotated[
        float, typer.Option(callback=finite, min=0.0, help="Smallest gain margin in dB, up and down.")
    ] = 6.0,
    phase_margin: Annotated[
        float, typer.Option(callback=finite, min=0.0, max=90.0, help="Smallest phase margin in degrees.")
    ] = 30.0,
    peak_sensitivity: Annotated[
        float | None,
        typer.Option(
            callback=finite,
            min=1.0,
            help="Largest peak sensitivity, Ms (1.8 keeps a modulus margin of 0.55); by default not limited.",
        ),
    ] = None,
    command_noise: Annotated[
        str | None,
        typer.Option(help="Largest command noise, RMS, or none; by default twice that of the gains as given."),
    ] = None,
    load_error: Annotated[
        str | None,
        typer.Option(help="Largest RMS load error, or none; by default 1.1 times that of the gains as given."),
    ] = None,
    peak: Annotated[
        float,
        typer.Option(
            callback=finite,
            min=0.0,
            help="Weight of the peak tracking error beside the RMS error; 0: the RMS error alone.",
        ),
    ] = 0.0,
    aggregation: Annotated[
        str,
        typer.Option(
            help="How the errors of all scenarios become one: mean, worst or cvar (mean of the worst quarter)."
        ),
    ] = "mean",
    measured: Annotated[
        list[Path] | None,
        typer.Option(
            help="Measured frequency response, in whose loop the margins are kept, too: CSV, or the XML of "
            "SINUMERIK's auto servo tuning; repeatable."
        ),
    ] = None,
    of: MeasuredOf = None,
    unit: MeasuredUnit = None,
    friction: Annotated[bool, typer.Option("--friction", help="Also tune the observer's friction parameters.")] = False,
    starts: Annotated[
        int, typer.Option(callback=count_of, min=1, help="Number of starts; the first is the file's gains.")
    ] = 4,
    seed: Seed = 0,
    steps: Annotated[
        int, typer.Option(callback=count_of, min=1, help="Largest number of search steps per start.")
    ] = 40,
    pareto: Annotated[str, typer.Option(help="Limits of the command noise for a Pareto front: `5;10;20;40 N`.")] = "",
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """Tune the controller's gains by gradient within margins; verify them on scenarios that were not used for tuning.

    The gains minimise the tracking error within stability margins (of the linearised loop, delay and observer included,
    from standstill to twice the speed, both directions, no load and the highest), command noise, force limit and load
    error. Writes tuned.toml and handover.toml, unless a requirement cannot be kept or a verification run is not ok:
    then it says which and by how much, and ends with code 3. Interrupted or killed, the same command with the same
    --out goes on where it stopped.

    Example: `diffdrive tune drive.toml --command-noise 20N --phase-margin 35 --out tuned`
    """
    from diffdrive.axis_file.drive_file import read_axis
    from diffdrive.errors import ParameterError
    from diffdrive.frequency.read import read_frequency_response
    from diffdrive.motion.text import nonnegative_number, number, numbers, require_choice
    from experiments.reports.report import Report
    from experiments.reports.tuning import tune_and_report
    from tuning.gains.objective import AGGREGATIONS, Objective
    from tuning.gains.requirements import MAX_GAIN_MARGIN, Requirements

    axis = read_axis(drive)
    require_choice("--aggregation", "aggregation", aggregation, AGGREGATIONS)
    highest = nonnegative_number(max_load, "N", "--max-load", axis.sheet)
    if gain_margin > MAX_GAIN_MARGIN:
        raise ParameterError(
            f"--gain-margin {gain_margin:g}: must be at most {MAX_GAIN_MARGIN:.0f} dB, beyond which the loop's gain "
            "is lost in rounding; 6 to 12 dB are usual"
        )
    limits = {
        name: None if text.strip().lower() == "none" else nonnegative_number(text, "N", option, axis.sheet)
        for name, option, text in (
            ("command_noise", "--command-noise", command_noise),
            ("load_error", "--load-error", load_error),
        )
        if text is not None
    }
    requirements = Requirements(
        gain_margin=gain_margin, phase_margin=phase_margin, peak_sensitivity=peak_sensitivity, **limits
    )
    speed_of_reversal = number(speed, "m/s", "--speed", axis.sheet)
    front = numbers(pareto, "N", "--pareto", axis.sheet) if pareto else []
    if any(limit <= 0.0 for limit in front):
        raise ParameterError(f"--pareto {pareto}: each limit must be above 0")
    responses = [read_frequency_response(one, of, unit=unit) for one in measured or ()]
    with Report(f"{drive.name}: gradient tuning over loads and machines", out) as report:
        result = tune_and_report(
            axis, report, pareto=front, speed=speed_of_reversal, loads=(0.0, highest), load_steps=loads,
            requirements=requirements, objective=Objective(peak=1e6 * peak, aggregation=aggregation),
            measured=responses, friction=friction, spread=spread, machines=machines, starts=starts, seed=seed,
            max_steps=steps,
        )  # fmt: skip
    if not result.accepted:
        raise typer.Exit(3)


@drives.command(name="export", cls=Computing)
def export_controller(
    drive: DriveFile,
    out: Annotated[Path, typer.Option("--out", parser=parse_folder, metavar="PATH", help="Folder for the code.")],
    target: Annotated[str, typer.Option(help="c99, structured-text, fmu or hal.")] = "c99",
    name: Annotated[str | None, typer.Option(help="What names in the code begin with; by default the file's.")] = None,
    precision: Annotated[str, typer.Option(help="double or single.")] = "double",
    motion: MotionText = DEFAULT_MOTION,
    load: LoadText = "0",
    machine: Machine = None,
) -> None:
    """Write the controller of a drive file as code for its target, with a simulated run that its bench replays.

    The code comes from the step that `simulate` runs, observer and filters included. C code is compiled and replayed
    at once, where this machine has a compiler.

    Example: `diffdrive export tuned.toml --target structured-text --out code`
    """
    from experiments.reports.exported import export_drive

    export_drive(drive, out, target, name, precision, motion, load, machine)
