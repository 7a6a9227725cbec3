"""`diffdrive sweep` and `diffdrive replay`: a sweep run, reported and drawn; and one of its machines again."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import axis_tables, parse_axis, write_axis
from diffdrive.errors import ParameterError
from diffdrive.motion.text import require_choice
from diffdrive.support.atomic_write import atomic_write
from experiments.reports.charts.distribution import distribution_chart
from experiments.reports.readable import significant, unit_of
from experiments.reports.report import RESULT, Report, named_file
from experiments.reports.simulation import write_simulation
from experiments.reports.sweep import figures
from experiments.reports.sweep.tables import LISTED, GroupInfluences, print_sweep, print_varied
from tuning.progress import Progress
from tuning.sweeps.parts import stored_errors
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.replay import SIGNALS, choose_names, machine_run, repeat_costs, run_errors, sweep_machine, traces
from tuning.sweeps.result import SweepResult, group_influences
from tuning.sweeps.spec import FILE, read_spec
from tuning.sweeps.summary import ERRORS, first_to_diverge, worst
from tuning.sweeps.workflow import PARTS, Started, sweep

ALIKE = 0.01  # of RMS and peak error: what the signals of a machine by itself may be off


def sweep_and_report(
    axis: Axis, motions: Sequence[str], recorded: Sequence[str], out: Path | None, **options: Any
) -> bool:
    """Run `tuning.sweep` with these `options`, and write what it finds; False if a machine diverged.

    `recorded` are the signals of the worst machines to keep.
    """
    if recorded and out is None:
        raise ParameterError("--record: give --out, a folder for the traces")
    for name in recorded:
        require_choice("--record", "signal", name, SIGNALS)
    if out is not None and (out / RESULT).exists() and not (out / FILE).exists():
        raise ParameterError(f"--out {out}: holds the results of another command; name another folder")
    names = dict.fromkeys(Path(text.partition(":")[0]).name for text in motions)
    with Report(f"{axis.name}: {options['samples']} machines, {', '.join(names)}", out) as report:
        with _machines_bar(report, f"simulating machines of {axis.name}") as (started, progress):
            result = sweep(
                axis, motions, resume=out, progress=progress, started=started, notify=report.console.print, **options
            )
        _legend(report, result.plan, motions)
        report_sweep(report, result)
        if recorded:
            _record(report, result, recorded)
    return result.status.ok


@contextlib.contextmanager
def _machines_bar(report: Report, what: str) -> Iterator[tuple[Started, Progress]]:
    """What a sweep calls as it starts, and with its progress: the bar is drawn from the start on, so that a sweep that
    is refused shows none.
    """
    finished = 0
    advance: Callable[[int], None] | None = None

    def start(plan: SweepPlan, notes: tuple[str, ...]) -> None:
        nonlocal advance
        introduce(report, plan, notes)
        advance = stack.enter_context(report.counted(what, plan.samples))
        advance(finished)

    def progress(_stage: str, count: int, _most: int) -> None:
        nonlocal finished
        finished = count
        if advance is not None:
            advance(count)

    with contextlib.ExitStack() as stack:
        yield start, progress


def introduce(report: Report, plan: SweepPlan, notes: Sequence[str]) -> None:
    """What to expect, and what varies."""
    for note in notes:
        report.say(note)
    print_varied(report, plan)


def report_sweep(report: Report, result: SweepResult) -> None:
    """How often each controller misses, what drives the spread, the worst machines, and the figures."""
    plan = result.plan
    report.keep(
        "sweep", machines=plan.samples, runs=plan.samples * len(plan.controllers) * len(plan.motions),
        method=plan.method, seed=plan.seed, parts=plan.parts, precision=plan.precision,
    )  # fmt: skip
    influences = [(group, group_influences(plan, group, result.by)) for group in result.groups()]
    print_sweep(report, plan, influences, result.tolerance, result.by)
    report.show_numbers("sweep")
    for motion in plan.motions if report.out is not None else ():
        of_motion = [found for found in influences if found[0].motion == motion]
        save_sweep_figures(report, plan, of_motion, result.tolerance, result.by)


def _legend(report: Report, plan: SweepPlan, motions: Sequence[str]) -> None:
    """Which motion is meant by each name."""
    given = dict(zip(plan.motions, motions, strict=True))
    report.data["motions"] = given
    if len(given) > 1:
        report.table("motions", ("motion", "as given"), [list(one) for one in given.items()], "Motions")


def save_sweep_figures(
    report: Report, plan: SweepPlan, found: Sequence[GroupInfluences], tolerance: float | None, by: str
) -> None:
    """The figures of one motion."""
    all_groups = [one for one, _ in found]
    if all(one.diverged.all() for one in all_groups):
        report.say(f"{all_groups[0].motion}: no figures, since every machine diverged.")
        return
    motion = f"_{named_file(all_groups[0].motion)}" if len(plan.motions) > 1 else ""
    on = f"of {plan.samples} machines, {all_groups[0].motion}"
    report.figure(
        f"distribution{motion}", figures.distribution(all_groups, tolerance, by),
        f"Distribution of the {ERRORS[by]} {on}; further left is better.",
    )  # fmt: skip
    if (chart := distribution_chart(all_groups, tolerance, by)) is not None:
        report.chart(f"distribution{motion}", chart)
    report.figure(
        f"exceedance{motion}", figures.exceedance_figure(all_groups, tolerance, by),
        f"Share {on} that misses a tolerance on the {ERRORS[by]}, over the tolerance, with 95 % intervals.",
    )  # fmt: skip
    for one, influences in found:
        if influences:
            controller = f"_{named_file(one.controller)}" if len(plan.controllers) > 1 else ""
            report.figure(
                f"tornado{motion}{controller}", figures.tornado(influences, one, by),
                f"Mean {ERRORS[by]} where each quantity is low and where it is high (lowest and highest sixth {on}), "
                f"{one.controller}.",
            )  # fmt: skip
    strongest = [influences[0].name for _, influences in found if influences and influences[0].is_significant]
    for name in dict.fromkeys([*(name for name in ("load",) if name in plan.units), *strongest]):
        drawn = figures.error_against(all_groups, name, plan.units[name], tolerance, by)
        caption = f"{ERRORS[by]} {on}, over {name}."
        report.figure(f"error_against_{named_file(name)}{motion}", drawn, f"{caption[:1].upper()}{caption[1:]}")


def _record(report: Report, result: SweepResult, recorded: Sequence[str]) -> None:
    """The signals of every controller's worst machines, under every controller."""
    assert report.out is not None
    plan, found, by = result.plan, result.groups(), result.by
    for motion in plan.motions:
        of_motion = [one for one in found if one.motion == motion]
        numbers = sorted(
            {number for one in of_motion for number in (*worst(one, LISTED, by), *first_to_diverge(one, LISTED))}
        )
        path = report.out / (f"traces_{named_file(motion)}.nc" if len(plan.motions) > 1 else "traces.nc")
        with report.working("recording the worst machines"):
            recordings = traces(plan, numbers, plan.controllers, motion, recorded)
            with atomic_write(path) as file:
                file.write(
                    recordings.to_netcdf(engine="h5netcdf")
                )  # in memory: on a full disk HDF5 fails without saying so
        report.say(f"{path.name}: {', '.join(recorded)} of machines {', '.join(map(str, numbers))}")
        for one in of_motion:
            repeated = recordings.sel(controller=one.controller)
            differing = [
                number
                for k, number in enumerate(numbers)
                if not all(
                    np.isclose(repeated[name][k], one.column(name)[number], rtol=ALIKE, atol=0.0, equal_nan=True)
                    for name in ("rms_m", "peak_m")
                )
            ]
            if differing:
                report.say(
                    f"{one.controller}, machines {', '.join(map(str, differing))}: {_why_different(plan)}: "
                    f"their errors are in {path.name} as rms_m and peak_m."
                )


def _why_different(plan: SweepPlan) -> str:
    if plan.precision == "single":
        return f"The signals are computed in double precision, the sweep in single, and differ by more than {ALIKE:.0%}"
    return (
        "The signals are of a machine by itself, whose last digits differ; on a quantised scale, or at the edge of "
        f"stability, such runs part, here by more than {ALIKE:.0%}"
    )


def replay_machine(folder: Path, number: int, controller: str | None, motion: str | None, out: Path | None) -> bool:
    """`diffdrive replay`; False if the machine diverged, here or in the sweep, or its run is not to be believed."""
    if out is not None and (out / FILE).exists():
        raise ParameterError(f"--out {out}: holds a sweep, whose results this would overwrite; name another folder")
    plan = read_spec(folder).plan()
    controller, motion = choose_names(plan, controller, motion)
    machine = sweep_machine(plan, number, motion)
    with Report(f"{folder.name}: machine {number}, {controller}, {motion}", out) as report:
        report.table(
            "machine",
            ("quantity", "unit", "value"),
            [[name, unit_of(plan.units[name]), value] for name, value in machine.values.items()],
            "What differs from the drive file",
        )
        with report.working("simulating"):
            simulated = machine_run(plan, machine, controller, motion)
            costs, diverged_at = repeat_costs(plan, number, controller, motion)
            repeated_rms, repeated_peak = np.asarray(costs.rms)[0], np.asarray(costs.peak)[0]
        rms, peak = run_errors(plan, simulated)
        report.values("run", status=simulated.status.message)
        report.keep("costs", rms_um=1e6 * float(repeated_rms), peak_um=1e6 * float(repeated_peak))
        is_ok = simulated.status.ok and bool(np.isnan(diverged_at[0]))
        errors = " and ".join(
            f"{name} {significant(1e6 * float(value))} um"
            for name, value in ((ERRORS["rms"], repeated_rms), (ERRORS["peak"], repeated_peak))
        )
        report.result(f"Machine {number} of {folder.name}, {controller} on {motion}: {errors}.", good=is_ok)
        if not np.allclose([rms, peak], [repeated_rms, repeated_peak], rtol=ALIKE, atol=0.0, equal_nan=True):
            report.say(f"{_why_different(plan)}: RMS error {1e6 * rms:.4g} um, peak error {1e6 * peak:.4g} um.")
        stored = stored_errors(plan, folder / PARTS, number, controller, motion)
        if stored is None:
            report.say("Not compared with the sweep's own numbers: they are not there, or of another version.")
        else:
            repeated = [float(repeated_rms), float(repeated_peak), float(diverged_at[0])]
            alike = bool(np.array_equal(stored, repeated, equal_nan=True))
            report.keep("as_in_the_sweep", to_the_last_bit=alike)
            report.say(
                "The errors are those of the sweep, to the last bit."
                if alike
                else "The errors are NOT those of the sweep: another processor, or another version of what it uses?"
            )
        write_simulation(report, simulated)
        if report.out is not None:
            # the gains are the axis's; observers and feed-forwards in a file take the file's own model
            tables = axis_tables(plan.axis_of(machine.drive))
            write_axis(report.out / "machine.toml", parse_axis(tables, f"machine {number}"))
    return is_ok
