"""The commands about many machines."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from diffdrive.errors import ParameterError
from experiments.cli.command import Computing
from experiments.cli.options import DEFAULT_MOTION, DriveFile, LoadText, Machine, Out, Pdf, Seed, Settle, Svg, count_of

if TYPE_CHECKING:
    from diffdrive.axis import Axis

sweeps = typer.Typer()


@sweeps.command(cls=Computing)
def sweep(
    drive: DriveFile,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            help="What varies: `plant.mass=lognormal:3%`, `load=uniform:0..12 kN`, "
            "`effects.cogging.cosine=normal:2 N`; uniform, loguniform, triangular, normal, lognormal, fixed; "
            "repeatable. A load may change over time: load.change, load.change.begin, load.change.end. Settings "
            "of --motion and --load may vary from machine to machine, too: "
            "`motion.speed=uniform:5..20 mm/s`, `load.workpiece=...`.",
        ),
    ] = None,
    spread: Annotated[
        str | None,
        typer.Option(
            help="Relative deviation of all plant and friction parameters that --vary leaves; by default 2% where "
            "nothing else varies."
        ),
    ] = None,
    identified: Annotated[
        Path | None,
        typer.Option(
            help="uncertainty.toml of `diffdrive identify`: what it identified varies within its uncertainty. By "
            "default what the drive file's table uncertainty names."
        ),
    ] = None,
    motion: Annotated[
        list[str] | None,
        typer.Option(help="As of `diffdrive simulate`; repeatable.", show_default=DEFAULT_MOTION),
    ] = None,
    load: LoadText = "0",
    machine: Machine = None,
    against: Annotated[
        list[Path] | None,
        typer.Option(
            help="Drive file, or axis by name, whose controller gets the same machines, loads and noise; repeatable."
        ),
    ] = None,
    samples: Annotated[
        int, typer.Option(callback=count_of, min=1, help="Number of machines; powers of two for sobol.")
    ] = 1024,
    method: Annotated[str, typer.Option(help="sobol, latin-hypercube or random.")] = "sobol",
    tolerance: Annotated[str | None, typer.Option(help="Largest tracking error that is allowed: `2um`.")] = None,
    by: Annotated[str, typer.Option(help="The error that counts: peak or rms.")] = "peak",
    settle: Settle = 0.5,
    seed: Seed = 0,
    record: Annotated[
        str, typer.Option(help="Signals of the worst machines to write as netCDF: `error,command,load_estimate`.")
    ] = "",
    workers: Annotated[
        int | None,
        typer.Option(callback=count_of, min=1, help="Worker processes; by default this process, on all cores."),
    ] = None,
    cluster: Annotated[str | None, typer.Option(help="Address of a Dask scheduler: `tcp://host:8786`.")] = None,
    precision: Annotated[
        str,
        typer.Option(help="double; or single, in about half the time, errors off by some nm and more on long strokes."),
    ] = "double",
    out: Out = None,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """Monte Carlo: over machines, loads and noise, how often does the error exceed the tolerance, and why?

    Quantiles of the error and the probability of a miss with their intervals, controllers side by side on the same
    machines, what drives the spread, and the worst machines, each of which `diffdrive replay` runs again. Machines that
    diverge are counted and kept, and the command then ends with code 3. Interrupted or killed, the same command with
    the same --out goes on where it stopped and ends with the same numbers.

    Example: `diffdrive sweep drive.toml --spread 3% --vary "load=uniform:0..12 kN" --tolerance 2um --out swept`
    """
    from diffdrive.axis_file.drive_file import read_axis
    from diffdrive.runtime import allow_accelerator
    from experiments.reports.sweep.sweep import sweep_and_report

    if workers is None or cluster is not None:  # workers of this machine are processes on its cores
        allow_accelerator()
    if not sweep_and_report(
        read_axis(drive), motion or [DEFAULT_MOTION], _names(record), out, vary=parse_vary(vary or ()), spread=spread,
        identified=identified, machine=None if machine is None else read_axis(machine),
        against=_read_others(drive, against or ()), samples=samples, load=load, tolerance=parse_tolerance(tolerance),
        by=by, settle=settle, seed=seed, method=method, precision=precision, workers=workers, cluster=cluster,
    ):  # fmt: skip
        raise typer.Exit(3)


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def parse_vary(texts: Sequence[str]) -> dict[str, str]:
    """Distributions by the names of quantities, from `NAME=KIND:NUMBERS`."""
    found: dict[str, str] = {}
    for text in texts:
        name, _, distribution = (part.strip() for part in text.partition("="))
        if name in found:
            raise ParameterError(f"--vary: {name} is given more than once")
        found[name] = distribution
    return found


def parse_tolerance(text: str | None) -> float | None:
    """A tolerance in m."""
    from diffdrive.motion.text import number

    if text is None:
        return None
    if not text.strip()[-1:].isalpha():
        raise ParameterError(f"--tolerance {text}: give it with its unit, as 2um")
    return number(text, "m", "--tolerance")


def _read_others(drive: Path, others: Sequence[Path]) -> dict[str, "Axis"]:
    """The axes of further drive files by the files' names."""
    from diffdrive.axis_file.drive_file import read_axis

    names = [path.stem for path in (drive, *others)]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ParameterError(f"--against: two files are called {', '.join(twice)}: give them names of their own")
    return {path.stem: read_axis(path) for path in others}


@sweeps.command(cls=Computing)
def replay(
    folder: Annotated[Path, typer.Argument(help="Folder of a sweep (its --out).")],
    machine: Annotated[int, typer.Option(callback=count_of, min=0, help="Number of the machine, as in worst.csv.")],
    controller: Annotated[str | None, typer.Option(help="By the name of its drive file; default the first.")] = None,
    motion: Annotated[str | None, typer.Option(help="By its name in the sweep; default the first.")] = None,
    out: Out = None,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """Run one machine of a sweep again: every signal, its figure, and the machine as a drive file."""
    from diffdrive.runtime import allow_accelerator
    from experiments.reports.sweep.sweep import replay_machine

    allow_accelerator()
    if not replay_machine(folder, machine, controller, motion, out):
        raise typer.Exit(3)
