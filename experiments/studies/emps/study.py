"""The study of the EMPS axis: `diffdrive emps`, and the part of it that the demo shows."""

from collections.abc import Mapping
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from diffdrive.errors import ParameterError
from diffdrive.logs import Log
from diffdrive.logs.checks.examine import examine
from diffdrive.model.friction import steady_friction
from diffdrive.model.parameters import Drive
from experiments.reports import readable
from experiments.reports.page.chart import Chart, Line, Panel
from experiments.reports.report import Report
from experiments.reports.theme import BLACK, DASHES, SKY, drawing, legend_below, new_figure, say, style
from experiments.studies.emps import axis as emps
from experiments.studies.emps.closed_loop_fit import MAX_STEPS, fit_closed_loop
from tuning.identification import inverse_dynamics
from tuning.identification.curves import StribeckCurves, stribeck_curves
from tuning.identification.estimates import EstimateStatus, ParameterEstimate
from tuning.identification.identify import Identification, identify
from tuning.identification.inverse_dynamics import BENCHMARK_BORDERS
from tuning.identification.refinement import was_interrupted
from tuning.identification.replay import ClosedLoopReplay, replay_closed_loop, replay_open_loop
from tuning.store.store import Store

FITTED_TO = "estimation"  # the file; others are held out
PUBLISHED, IDENTIFIED, FITTED = "published", "prediction error", "closed-loop fit"
BENCHMARK = {"mass": 95.1089, "viscous": 203.5034, "coulomb": 20.3935, "offset": -3.1648}  # SI, Janot et al. 2019
BENCHMARK_ERRORS = {"estimation": 4.083, "pulses": 5.982}  # %, of the decimated force
BARS = {"estimation": 2.8, "pulses": 4.2}  # %, that an identification from the estimation file must reach
RIPPLE_SPEED = 5e-3  # m/s; faster, the table passes over the screw's ripple and does not linger in it
REDUCED_MODELS = {  # what a smaller model leaves as published
    "friction per direction": ("breakaway_gap", "stribeck_velocity", "delay"),
    "friction per direction, delay": ("breakaway_gap", "stribeck_velocity"),
    "friction per direction, rising": ("delay",),
}
READINGS = {
    "as read": (True, 0),
    "volts taken as newtons": (False, 0),
    "a unit delay claimed": (True, 1),
}

Records = Mapping[str, emps.Record]


def emps_study(report: Report, folder: Path | None) -> None:
    """Everything: checks, inverse dynamics, both fits from the estimation file alone, and what remains.

    Raises `ParameterError` where the folder (by default the one beside this checkout) does not hold the files.
    """
    data_folder = folder or emps.find_folder()
    if data_folder is None or not (data_folder / emps.FILES["estimation"]).is_file():
        where = "shared/data/emps beside this folder" if folder is None else f"--data {folder}"
        raise ParameterError(f"{where}: no {emps.FILES['estimation']} in it; name the benchmark's folder with --data")
    records = emps.read_all(data_folder)
    _checks(report, data_folder, records)
    _inverse_dynamics(report, records)
    identified = identify_axis(report, records)
    log, controller = records["estimation"].log, emps.controller(records["estimation"])
    with report.progress("fitting in closed loop", MAX_STEPS) as advance:
        fitted, search = fit_closed_loop([log], emps.reference_drive(), controller, identified.drive, progress=advance)
    report.values("closed_loop_fit", status=search.status, steps=search.steps, cost_percent=search.cost)
    drives = {PUBLISHED: emps.reference_drive(), IDENTIFIED: identified.drive, FITTED: fitted}
    replays = force_table(report, drives, records)
    parameter_table(report, identified.estimates, {FITTED: fitted})
    _reduced_models(report, replays[FITTED], records)
    _open_loop(report, drives, records)
    _unexplained(report, identified, log)
    force_figure(report, records["estimation"], {name: replays[name]["estimation"] for name in drives})
    _friction_figure(report, drives, log)
    gaps = {file: replay.force_percent for file, replay in replays[IDENTIFIED].items()}
    held_out = "".join(f", {gap:.3g} % on the file {file}, held out" for file, gap in gaps.items() if file != FITTED_TO)
    report.result(
        f"Identified from the {FITTED_TO} file alone, the model misses {gaps[FITTED_TO]:.3g} % of its force in closed "
        f"loop (RMS){held_out}; at most {' and '.join(f'{BARS[file]:g}' for file in gaps)} % are required.",
        f"{readable.titled(identified.adequacy.says)}.",
        good=False if not report.data["emps_bars"]["met"] else None if identified.adequacy.has_structure else True,
    )


def identify_axis(report: Report, records: Records, starts: int = 6, store: Store | None = None) -> Identification:
    """Identification by prediction error from the estimation file alone, starting from the published parameters."""
    with report.progress("identifying the real axis (EMPS)", 1) as advance:
        identified = identify(
            [records["estimation"].log], emps.reference_drive(), starts=starts, store=store, progress=advance
        )
    if was_interrupted(identified.search):
        raise KeyboardInterrupt  # what follows would be of half a search
    report.values(
        "emps_search", status=identified.status, steps=identified.search.steps, simulations=identified.simulations
    )
    return identified


def force_table(
    report: Report, drives: Mapping[str, Drive], records: Records
) -> dict[str, dict[str, ClosedLoopReplay]]:
    """Replay each file with each drive in closed loop; print and return what came out."""
    replays = {
        name: {file: replay_closed_loop(drive, emps.controller(record), record.log) for file, record in records.items()}
        for name, drive in drives.items()
    }
    rows = []
    for name, by_file in replays.items():
        for file, replay in by_file.items():
            rows.append([name, file, replay.force_percent, replay.command_rms, 1e6 * replay.position_rms])
            if not replay.status.ok:
                report.say(f"{name}: {replay.status.message}")
    report.table(
        "emps",
        ("parameters", "file", "force gap %", "missing N", "position gap um"),
        rows,
        "EMPS in closed loop (RMS; the gap is of the force's); fitted to the estimation file only",
    )
    identified = replays[IDENTIFIED]
    met = all(replay.force_percent <= BARS[file] for file, replay in identified.items())
    report.values("emps_bars", **{f"{file}_percent": BARS[file] for file in identified}, met=met)
    return replays


def parameter_table(report: Report, estimates: list[ParameterEstimate], others: Mapping[str, Drive]) -> None:
    """The identified parameters with their intervals, and those of other drives beside them."""
    rows = []
    for estimate in estimates:
        # the benchmark has no load: its slope stays, and Coulomb friction at no load is that of the screw
        if estimate.status is not EstimateStatus.FIXED and not estimate.name.startswith(
            ("load_coefficient", "coulomb_at_no_load")
        ):
            other_values = [_parameter(drive, estimate.name) for drive in others.values()]
            rows.append(
                [
                    f"{estimate.name}, {estimate.unit}",
                    estimate.believed,
                    estimate.value,
                    estimate.low,
                    estimate.high,
                    *other_values,
                ]
            )
    report.table(
        "emps_parameters", ("parameter", PUBLISHED, IDENTIFIED, "low", "high", *others), rows,
        "EMPS parameters with their 95 % intervals, which know the model's own errors only as far as they are noise",
    )  # fmt: skip


def _parameter(drive: Drive, name: str) -> float | None:
    """The value of an estimate's name (tuning/identification/estimates.py) in another drive."""
    key, _, side = name.partition(".")
    if key == "delay":
        return drive.actuator.delay_samples + float(drive.actuator.delay_fraction or 0.0)
    for part in (drive.plant, drive.friction):
        value = getattr(part, key, None)
        if value is not None:
            return float(getattr(value, side or "positive", value))
    return None


def force_figure(report: Report, record: emps.Record, replays: Mapping[str, ClosedLoopReplay]) -> None:
    """Save the figure of the forces."""
    chart = emps_chart(record, replays)
    report.figure("emps", emps_figure(record, replays), chart.caption)
    report.chart("emps", chart)


def emps_chart(record: emps.Record, replays: Mapping[str, ClosedLoopReplay]) -> Chart:
    """Logged and simulated command, and their differences, over time."""
    forces = [Line("logged", record.log.time, record.log.command)]
    forces += [Line(name, one.time, one.command) for name, one in replays.items()]
    differences = [Line(name, one.time, one.command_error) for name, one in replays.items()]
    panels = [Panel("time, s", "force, N", forces), Panel("time, s", "difference, N", differences)]
    caption = "Force command of EMPS over time, logged and simulated in closed loop, and their differences: {}."
    return Chart(caption.format(record.log.name), panels)


@drawing
def emps_figure(record: emps.Record, replays: Mapping[str, ClosedLoopReplay]) -> Figure:
    """Logged and simulated command, and their difference in a panel for each drive: one would cover another."""
    figure, axes = new_figure(1 + len(replays), 1, height=1.7)
    log, last = record.log, list(replays.values())[-1]
    axes[0].plot(log.time, log.command, color=BLACK, label="logged")
    axes[0].plot(last.time, last.command, color=SKY, ls=DASHES[1], lw=0.8, label=f"simulated, {list(replays)[-1]}")
    axes[0].set(ylabel="force, N")
    largest = max(float(np.max(np.abs(one.command_error))) for one in replays.values())
    for axis, (name, replay) in zip(axes[1:], replays.items(), strict=True):
        axis.plot(replay.time, replay.command_error, lw=0.8, color=BLACK)
        axis.set(ylabel="difference, N", title=name, ylim=(-1.1 * largest, 1.1 * largest))
    axes[-1].set_xlabel("time, s")
    figure.align_ylabels()
    legend_below(figure)
    errors = (f"{np.sqrt(np.mean(np.square(one.command_error))):.3g} N {name}" for name, one in replays.items())
    say(figure, f"EMPS, estimation file: the force command in closed loop differs by {', '.join(errors)} (RMS)")
    return figure


def _checks(report: Report, folder: Path, records: Records) -> None:
    """The findings of the log checks: in the files, in the files taken literally, and with a wrong drive file."""
    rows = []
    for reading, (newtons, delay) in READINGS.items():
        for file in records:
            record = emps.read(folder / emps.FILES[file], newtons=newtons)
            findings = examine(record.log, emps.nominal_axis(record, delay_samples=delay))
            rows += [[reading, file, finding.severity, finding.channel, finding.message] for finding in findings]
    report.table(
        "emps_checks", ("reading", "file", "severity", "channel", "found"), rows, "What the checks of logs find"
    )
    for file, record in records.items():
        for note in record.log.notes:
            report.say(f"{file}: {note}")


def _inverse_dynamics(report: Report, records: Records) -> None:
    """The benchmark's own method beside its published figures."""
    fitted = inverse_dynamics.identify(records["estimation"].log, borders=BENCHMARK_BORDERS)
    ours = {"offset": -fitted.values["constant_force"]} | fitted.values  # in the benchmark's sign
    rows = [[name, value, ours[name], 100 * (ours[name] / value - 1)] for name, value in BENCHMARK.items()]
    for file, record in records.items():
        # the benchmark judges the total force, with the pulses
        error = inverse_dynamics.evaluate(fitted, record.log).error_percent
        expected = BENCHMARK_ERRORS[file]
        rows.append([f"force error %, {file}", expected, error, 100 * (error / expected - 1)])
    report.table(
        "emps_inverse_dynamics", ("figure", "benchmark", "ours", "difference %"), rows,
        "Inverse dynamics, SI units (offset in the benchmark's sign)",
    )  # fmt: skip


def _reduced_models(report: Report, full: Mapping[str, ClosedLoopReplay], records: Records) -> None:
    """The closed-loop fit without each part of the model."""
    log, controller = records["estimation"].log, emps.controller(records["estimation"])
    rows = []
    for name, fixed in REDUCED_MODELS.items():
        with report.progress(f"fitting with {name}", MAX_STEPS) as advance:
            drive, _ = fit_closed_loop([log], emps.reference_drive(), controller, fixed=fixed, progress=advance)
        replays = [replay_closed_loop(drive, controller, record.log) for record in records.values()]
        rows.append([name, *(replay.force_percent for replay in replays)])
    rows.append(["all of it", *(replay.force_percent for replay in full.values())])
    report.table("emps_parts", ("model", *(f"{file} %" for file in records)), rows, "Force gap of smaller models")


def _open_loop(report: Report, drives: Mapping[str, Drive], records: Records) -> None:
    """The figure that benchmarks usually state, and why it misleads."""
    rows = []
    for name, drive in drives.items():
        replays = [replay_open_loop(drive, record.log) for record in records.values()]
        rows.append([name, *(replay.position_rms_mm for replay in replays)])
    report.table(
        "emps_open_loop", ("parameters", *(f"{file}, mm" for file in records)), rows,
        "RMS position error of an open-loop simulation under the logged command",
    )  # fmt: skip
    report.say(replays[0].note)


def _unexplained(report: Report, identified: Identification, log: Log) -> None:
    """What the model does not explain."""
    for first, second, correlation in identified.correlated:
        report.say(f"hardly distinguished: {first} and {second} (correlation {correlation:.3f})")
    ripples = ripple(log.position, identified.velocity[0], identified.missing_force[0])
    names = ("forwards_N", "backwards_N")
    report.values(
        "emps_ripple_once_a_turn",
        **dict(zip(names, ripples, strict=True)),
        of_missing_rms_N=identified.adequacy.missing,
    )


def ripple(
    position: Float[np.ndarray, " n"], velocity: Float[np.ndarray, " n"], missing: Float[np.ndarray, " n"]
) -> tuple[float, float]:
    """Amplitude (N) of the missing force that repeats with each turn of the screw, forwards and backwards."""
    angle = 2 * np.pi * position / emps.LEAD
    columns = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)

    def amplitude(selected: np.ndarray) -> float:
        return float(np.hypot(*np.linalg.lstsq(columns[selected], missing[selected], rcond=None)[0][:2]))

    known = np.isfinite(missing)
    return amplitude(known & (velocity > RIPPLE_SPEED)), amplitude(known & (velocity < -RIPPLE_SPEED))


def _friction_figure(report: Report, drives: Mapping[str, Drive], log: Log) -> None:
    """The force that a constant velocity takes: friction less the constant force, which can hardly be told apart."""
    measured = stribeck_curves(log, drives[IDENTIFIED])
    constant_force = float(drives[IDENTIFIED].plant.constant_force)
    report.figure("emps_friction", emps_friction_figure(measured, drives, constant_force), (
        f"Force that a constant velocity takes, less the constant force: measured in {log.name}, and of each drive."
    ))  # fmt: skip


@drawing
def emps_friction_figure(measured: StribeckCurves, drives: Mapping[str, Drive], constant_force: float) -> Figure:
    """Measured cruises, and the steady friction of each drive."""
    figure, axis = new_figure(height=3.4)
    apart = dict.fromkeys(drives, 0.0)
    for curve in measured.curves:
        force = curve.friction - constant_force
        axis.errorbar(
            1e3 * curve.velocity, force, curve.standard_error, fmt="o", ms=4, color=BLACK, label="measured, cruises"
        )
        for name, drive in drives.items():
            steady = steady_friction(drive.friction, jnp.asarray(curve.velocity)) - float(drive.plant.constant_force)
            apart[name] = max(apart[name], float(np.max(np.abs(np.asarray(steady) - force))))
    speed = np.geomspace(1e-4, 0.14, 200)
    for k, (name, drive) in enumerate(drives.items()):
        for side in (-1.0, 1.0):
            steady = steady_friction(drive.friction, jnp.asarray(side * speed)) - float(drive.plant.constant_force)
            axis.plot(1e3 * side * speed, steady, label=name if side > 0 else None, **style(k))
    axis.set(xlabel="velocity, mm/s", ylabel="force, N")
    legend_below(figure)
    found = ", ".join(f"{most:.3g} N {name}" for name, most in apart.items())
    say(figure, f"EMPS: the force that a constant velocity takes is met within {found}")
    return figure
