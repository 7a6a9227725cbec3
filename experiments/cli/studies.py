"""The commands that measure the tool itself: studies, checks and benchmarks."""

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.command import Computing
from experiments.cli.options import DriveFile, Out, Pdf, Seed, StudyFolder, Svg, count_of, finite, seed_of

PANEL = "Studies of the tool itself"

studies = typer.Typer()


@studies.command("tuning-study", rich_help_panel=PANEL, cls=Computing)
def tuning_study(
    out: Out = None,
    evaluations: Annotated[int, typer.Option(callback=count_of, min=50, help="Of each derivative-free search.")] = 2550,
    runs: Annotated[int, typer.Option(callback=count_of, min=1, help="Of each derivative-free search.")] = 3,
    starts: Annotated[int, typer.Option(callback=count_of, min=1, help="Random starts of the gradient search.")] = 10,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """Gradient tuner against CMA-ES, Nelder-Mead and random search on one ensemble (docs/evidence/tuning-study.md).

    Cost to come near the best against evaluations, time and number of parameters; random starts; held-out scenarios.
    """
    from experiments.reports.report import Report
    from experiments.studies.tuning_study import study

    with Report("gradient tuning against derivative-free searches", out) as report:
        study.tuning_study(report, evaluations=evaluations, runs=runs, starts=starts)


@studies.command(rich_help_panel=PANEL, cls=Computing)
def withheld(
    out: StudyFolder,
    cases: Annotated[
        int | None, typer.Option(callback=count_of, min=1, help="How many machines; by default 120.")
    ] = None,
    seed: Annotated[int | None, typer.Option(callback=seed_of, help="Seed of the machines; by default 0.")] = None,
    axis: Annotated[
        list[str] | None,
        typer.Option(
            help="paper (default), gantry, linear, vertical, cnc or cnc-trace; repeatable: machines of each in turn."
        ),
    ] = None,
    bench: Annotated[
        Path | None,
        typer.Option(help="Machines that are there instead: folders of a drive.toml and log-*.parquet, and key.json."),
    ] = None,
    workers: Annotated[
        int,
        typer.Option(callback=count_of, min=1, help="Machines that are diagnosed at once; each takes 2 to 4 GB."),
    ] = 1,
    twice: Annotated[
        bool, typer.Option("--twice", help="Diagnose again with the true effects alone, and without them.")
    ] = False,
) -> None:
    """Check the diagnosis on machines with an effect that is hidden from it.

    The machines are integrated by numerics of their own, their parameters are up to 3 % off nominal, and the effects
    are drawn at random: none, one of the catalogue, two, one from outside it, or a resonance that other parameters
    absorb. The answering process is given copies of logs and drive files, and never the key. Takes about
    three minutes of one core a machine, up to 20.
    """
    from diffdrive.errors import ParameterError
    from experiments.studies.withheld.study import check_drawn_machines as run
    from experiments.studies.withheld.study import check_given_machines

    if bench is None:
        run(out, 120 if cases is None else cases, seed or 0, workers, twice, tuple(axis or ("paper",)))
    elif cases is not None or seed is not None or axis:
        raise ParameterError("--bench: its machines are there already; leave out --cases, --seed and --axis")
    else:
        check_given_machines(out, bench, bench / "key.json", workers, twice)


@studies.command("real-axes", rich_help_panel=PANEL, cls=Computing)
def real_axes(
    axis: Annotated[str, typer.Option(help="all, emps or laas.")] = "all",
    term: Annotated[
        list[str] | None,
        typer.Option(
            help="A term to withhold from EMPS; `none`: the identified drive as it is, `nothing`: the published one; "
            "repeatable, default all."
        ),
    ] = None,
    out: Out = None,
) -> None:
    """Check the diagnosis on measured axes: EMPS with a known term withheld, and as it is; a motor with strong cogging.

    Needs the data in shared/data beside the checkout; what is not there is left out. Takes a dozen diagnoses, each of
    some minutes.
    """
    from experiments.reports.report import Report
    from experiments.studies.real_axes import real_axes as study

    with Report("diagnosis of measured axes", out) as report:
        study(report, axis, term or ())


@studies.command(cls=Computing)
def convergence(
    drive: DriveFile,
    speeds: Annotated[
        str, typer.Option(help="Speeds, separated by ; with the unit behind the last.")
    ] = "1;3;10;15;20;40;100 mm/s",
    out: Out = None,
) -> None:
    """Say at which speeds the load estimator of the paper's eq. (20) converges, and how fast; code 3 if it fails at
    one of them.

    The drive file's controller must be of kind "pd+fc+le".
    """
    from experiments.reports.simulation import convergence_table

    if not convergence_table(drive, speeds, out):
        raise typer.Exit(3)


@studies.command(rich_help_panel=PANEL, cls=Computing)
def reproduce(
    out: Out = None,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """The paper's Table 1, Figures 4, 5, 7, 8, 9 and 10 and Table 4, ours beside theirs, with every assumption."""
    from experiments.studies.paper.reproduce import reproduce as run

    run(out)


@studies.command(rich_help_panel=PANEL, cls=Computing)
def bench(
    part: Annotated[
        list[str] | None,
        typer.Option(
            help="single, lanes, sweep, controllers, gradients, reverse, tuner, effects, growth, roof, start or "
            "accuracy; repeatable, default all."
        ),
    ] = None,
    out: Out = None,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """How fast is the loop on this machine? Ratios in one run, beside the same step written in C and in numba.

    C needs gcc, numba the extra `diffdrive[bench]`; what is not there is left out. Takes some minutes.
    """
    from experiments.benchmarks.suite import bench as run
    from experiments.reports.report import Report

    with Report("speed on this machine", out) as report:
        run(report, tuple(part or ()))


@studies.command(rich_help_panel=PANEL, cls=Computing)
def emps(
    data: Annotated[
        Path | None, typer.Option(help="Folder of the benchmark's .mat files; by default that beside the checkout.")
    ] = None,
    out: Out = None,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """The EMPS benchmark, a real axis: log checks, inverse dynamics, identification and replay, beside its figures.

    Fits the estimation file only; the pulse file is held out. Takes a minute or two.
    """
    from experiments.reports.report import Report
    from experiments.studies.emps.study import emps_study

    with Report("EMPS: what can be learnt from a real axis", out) as report:
        emps_study(report, data)


@studies.command(rich_help_panel=PANEL, cls=Computing)
def evolution(
    data: Annotated[
        Path | None, typer.Option(help="Folder of the EMPS files; by default that beside the checkout.")
    ] = None,
    synthetic: Annotated[bool, typer.Option(help="A simulated log in place of the EMPS estimation file.")] = False,
    seconds: Annotated[
        float, typer.Option(callback=finite, min=1.0, help="The most that one evolution may take.")
    ] = 300.0,
    runs: Annotated[
        int, typer.Option(callback=count_of, min=1, max=20, help="How often both searches run, by turns.")
    ] = 3,
    out: Out = None,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """Gradient search against differential evolution on one identification problem: what equal quality costs.

    Then the paper's route beside them: Stribeck curve first, bristle after. Takes some minutes.
    """
    from experiments.reports.report import Report
    from experiments.studies.evolution.study import emps_case, evolution_study, synthetic_case

    with Report("Gradient search against differential evolution", out) as report:
        evolution_study(report, synthetic_case() if synthetic else emps_case(data), seconds=seconds, runs=runs)


@studies.command(rich_help_panel=PANEL, cls=Computing)
def recovery(
    out: StudyFolder,
    draws: Annotated[int, typer.Option(callback=count_of, min=1, help="How many random drives.")] = 200,
    workers: Annotated[
        int | None, typer.Option(callback=count_of, min=1, help="Processes; by default one per core.")
    ] = None,
    svg: Svg = False,
    pdf: Pdf = False,
) -> None:
    """How well identification recovers known drives, and whether its intervals hold the truth.

    A drive takes some 30 s of one core.
    """
    from experiments.studies.recovery.study import study

    study(out, draws, workers)


@studies.command("log-study", rich_help_panel=PANEL, cls=Computing)
def log_study(
    out: Out = None,
    cases: Annotated[int, typer.Option(min=1, callback=count_of, help="How many logs with a fault.")] = 60,
    sound: Annotated[int, typer.Option(min=0, callback=count_of, help="How many fault-free logs.")] = 40,
    pairs: Annotated[
        int,
        typer.Option(min=0, callback=count_of, help="How many pairs of logs, two thirds of them of two machines."),
    ] = 30,
    seed: Seed = 1,
) -> None:
    """The log checks on logs whose fault is known (docs/evidence/log-study.md): is it named, is a remedy right?

    Simulates axes of ten kinds, does something to their logs, and asks the checks; then the same with fault-free logs,
    and with pairs of logs of one machine or of two. Takes two minutes of one core.
    """
    from diffdrive.logs.checks.examine import examine, examine_together
    from experiments.reports.report import Report
    from experiments.studies.log_study.study import log_study as study

    with Report(f"log checks on logs whose fault is known, seed {seed}", out) as report:
        study(report, cases=cases, healthy=sound, pairs=pairs, seed=seed, examine=examine, together=examine_together)
