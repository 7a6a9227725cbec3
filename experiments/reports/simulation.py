"""The commands that work on one drive file: simulate and convergence."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.controllers import FrictionCompensation
from diffdrive.errors import LoadEstimatorError
from diffdrive.logs.column_unit import FORCES
from diffdrive.logs.log import CHANNELS
from diffdrive.logs.write import write_csv
from diffdrive.loop import metrics
from diffdrive.loop.convergence import convergence_gains, time_constants
from diffdrive.loop.run import Run
from diffdrive.motion.text import numbers, parse_load, parse_motion, require_longer_than
from diffdrive.observers.friction_observer import KalmanObserver
from diffdrive.observers.load_estimator import InnovationLoad
from diffdrive.simulation import simulate
from diffdrive.support.rates import require_same_rate
from experiments.reports import readable
from experiments.reports.charts.signals import run_chart
from experiments.reports.readable import shown, titled
from experiments.reports.report import Report
from experiments.reports.theme import (
    BLACK,
    BLUE,
    DASHES,
    PALE,
    REFERENCE,
    SKY,
    VERMILION,
    drawing,
    legend_below,
    new_figure,
    say,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# what a machine could not log; the velocity gets another name there, as a log's is that which the machine reports
_SIMULATED = {
    "table_position": "table_position",
    "table_velocity": "velocity",
    "force": "force",
    "friction": "friction",
    "friction_estimate": "friction_estimate",
    "load_estimate": "load_estimate",
}


MUCH_LOAD, FAR_OFF = 500.0, 0.2  # N, and share of the load, by which an estimate is far off


def write_run(path: Path, run: Run) -> None:
    """A run as CSV in SI units: the channels of its log, so that `read_log` reads it, then what only it knows there.

    The command says that it is in newtons, since a drive file may know volts and amperes as well.
    """
    signals, rows = {column: getattr(run, name) for column, name in _SIMULATED.items()}, run.rows()
    channels = run.log().channels | {column: values[rows] for column, values in signals.items() if values is not None}
    write_csv(path, channels, {name: CHANNELS[name].unit for name in FORCES if name in channels})


def write_simulation(report: Report, run: Run, settle: float = 0.0) -> None:
    """The files of a run: what the command writes, the report of a result, and a machine of a sweep run again."""
    if report.out is not None:
        write_run(report.out / "run.csv", run)
        chart = run_chart(run)
        report.figure("run", run_figure(run, settle), chart.caption)
        report.chart("run", chart)


def simulate_drive(
    drive: Path, motion: str, load: str, machine: Path | None, settle: float, seed: int, out: Path | None
) -> bool:
    """`diffdrive simulate`; False if the loop diverged."""
    description = read_axis(drive)
    other = description if machine is None else read_axis(machine)
    require_same_rate("--machine", other.rate, "the drive file", description.rate)
    planned = parse_motion(motion, description.sampling.rate, description.sheet)
    require_longer_than(settle, planned.name, planned)
    loads = parse_load(load, planned.time, description.sheet)
    with Report(f"{drive.name}: {planned.name}, {planned.duration:g} s", out) as report:
        with report.working("simulating"):
            run = simulate(description, planned, loads, machine=other, seed=seed)
        if run.status.ok:
            report.keep(
                "result",
                peak_error_um=1e6 * run.peak_error(settle),
                rms_error_um=1e6 * run.rms_error(settle),
                peak_command_N=float(np.max(np.abs(run.command))),
                command_noise_N=float(metrics.command_noise(run.command)),
                from_s=settle,
            )
            report.print(_in_words(report.data["result"]))
            report.conclude(titled(_in_words(report.data["result"]).removeprefix("Result: ")) + ".", good=True)
            if run.load_estimate is not None:
                _load(report, float(run.load[-1]), float(run.load_estimate[-1]))
        else:
            report.conclude(f"Not to be believed: {run.status.message}.", good=False)
        report.values("run", status=run.status.message)
        write_simulation(report, run, settle)
        if report.out is not None:
            run.save(report.out)
    return run.status.ok


def _in_words(result: Mapping[str, float]) -> str:
    peak, rms, command, noise, start = (shown(number) for number in result.values())
    return (
        f"Result: peak error {peak} um, RMS error {rms} um, peak command {command} N, command noise {noise} N RMS; "
        f"counted from {start} s on"
    )


def _load(report: Report, load: float, estimate: float) -> None:
    """The load at the end beside its estimate, and why they differ where they do."""
    report.values("load", final_N=load, final_estimate_N=estimate)
    if abs(estimate - load) > max(MUCH_LOAD, FAR_OFF * load):
        report.say(
            "The estimate is far from the load: the estimator takes for load whatever friction, or other force, its "
            "model does not hold, and a motion without steady sliding shows it little."
        )


MAGNIFIED = 10  # times, the detail of a run: a reversal of some tenths of a second is a line in a run of many seconds


@drawing
def run_figure(run: Run, settle: float = 0.0) -> "Figure":
    """Position, tracking error, forces and load: over the run, and magnified where the error is largest."""
    figure, axes = new_figure(4, 2, height=1.55, share_y="row", width_ratios=(5, 3))
    counted = np.flatnonzero(np.isfinite(run.error) & (run.time >= settle))
    start, end = float(run.time[0]), float(run.time[-1])
    peak = counted[np.argmax(np.abs(run.error[counted]))] if counted.size else 0
    half = 0.5 * (end - start) / MAGNIFIED
    middle = float(np.clip(run.time[peak], start + half, end - half))
    true: dict[str, Any] = {"color": BLACK}
    estimated: dict[str, Any] = {"color": VERMILION, "ls": DASHES[1]}
    forces: list[tuple[str, np.ndarray, dict[str, Any]]] = [
        ("command", run.command, {"color": SKY, "lw": 0.8}),
        ("friction, load", run.friction, true),
    ]
    loads: list[tuple[str, np.ndarray, dict[str, Any]]] = [("friction, load", run.load, true)]
    forces += [] if run.friction_estimate is None else [("estimated", run.friction_estimate, estimated)]
    loads += [] if run.load_estimate is None else [("estimated", run.load_estimate, estimated)]
    for column, between in enumerate(((start, end), (middle - half, middle + half))):
        shown = (run.time >= between[0]) & (run.time <= between[1])
        position, error, force, load = axes[:, column]
        position.plot(run.time[shown], 1e3 * run.reference[shown], color=BLUE)
        error.axhline(0.0, **REFERENCE)
        error.plot(run.time[shown], 1e6 * run.error[shown], color=BLUE, lw=1.0)
        for axis, scale, curves in ((force, 1.0, forces), (load, 1e-3, loads)):
            for name, values, look in curves:
                axis.plot(run.time[shown], scale * values[shown], label=name, **look)
        load.set(xlabel="time, s", xlim=between)
    if settle > start:  # does not count
        for axis in axes[:, 0]:
            axis.axvspan(start, settle, color=PALE, lw=0.0)
    for axis, label in zip(axes[:, 0], ("reference, mm", "tracking error, µm", "force, N", "load, kN"), strict=True):
        axis.set_ylabel(label)
    axes[0, 0].set_title("all of the run")
    axes[0, 1].set_title(f"the {2.0 * half:.3g} s around the largest error")
    legend_below(figure)
    figure.align_ylabels(axes[:, 0])
    say(figure, _finding(run, settle))
    return figure


def _finding(run: Run, settle: float) -> str:
    """What a run shows, in a sentence."""
    if not run.status.ok:
        return readable.titled(run.status.message)
    since = f", from {settle:g} s on" if settle > run.time[0] else ""
    peak, rms = (f"{1e6 * value:.3g}" for value in (run.peak_error(settle), run.rms_error(settle)))
    return f"Tracking error {rms} µm RMS, {peak} µm peak{since}"


def convergence_table(drive: Path, speeds: str, out: Path | None) -> bool:
    """`diffdrive convergence`; False if the estimator fails at one of the speeds."""
    description = read_axis(drive)
    controller = description.controller
    observer = getattr(controller, "observer", None)
    if (
        not isinstance(controller, FrictionCompensation)
        or not isinstance(observer, KalmanObserver)
        or not isinstance(observer.load_estimator, InnovationLoad)
    ):
        raise LoadEstimatorError(
            f'{drive}: [controller] kind must be "pd+fc+le", whose eq. (20) estimator this is about; '
            '"pd+fc+ls" estimates the load at every speed'
        )
    if not speeds.strip(" ;"):
        raise LoadEstimatorError("--speeds is empty: give one or more, such as '1;10;100 mm/s'")
    if not speeds.strip(" ;")[-1:].isalpha():  # 10;20 would be m/s, a thousand times what most will mean
        raise LoadEstimatorError(f"--speeds {speeds}: give the unit behind the last, as '10;20 mm/s'")
    speed = np.abs(numbers(speeds.strip(" ;"), "m/s", "--speeds", description.sheet))
    with Report(f"{drive.name}: convergence of eq. (20)", out) as report:
        period = description.sampling.period
        with report.working("linearising the observer at each speed"):
            columns = [
                (convergence_gains(observer, sign * speed, period), time_constants(observer, sign * speed, period))
                for sign in (1.0, -1.0)
            ]
        (up, up_time), (down, down_time) = columns
        fine = np.isfinite(up_time) & np.isfinite(down_time)
        gated = speed <= float(observer.load_estimator.min_speed)
        verdicts = [
            "no update below min_speed" if g else "converges" if f else "DIVERGES"
            for g, f in zip(gated, fine, strict=True)
        ]
        rows = [
            [1e3 * v, float(a), float(b), float(c), float(d), verdict]
            for v, a, b, c, d, verdict in zip(speed, up, down, up_time, down_time, verdicts, strict=True)
        ]
        ok = bool(np.all(fine | gated))
        report.keep("verdict", converges_everywhere=ok)
        fails = ", ".join(f"{1e3 * v:g}" for v in speed[~(fine | gated)])
        says = f"DIVERGES at {fails} mm/s" if fails else "converges at every one of these speeds at which it is updated"
        report.conclude(f"The load estimator of eq. (20) {says}.", good=ok)
        report.print(report.page.conclusions[0], style="bold")
        if not ok:
            report.say(
                'Use kind = "pd+fc+ls", whose estimator converges at every speed, or change Q and R until G > 0.'
            )
        report.table(
            "convergence", ("mm/s", "G +", "G -", "time constant + s", "time constant - s", "estimate"), rows,
            "Gain G and time constant of eq. (20) over speed, forwards (+) and backwards (-)", infinite="never settles",
        )  # fmt: skip
    return ok
