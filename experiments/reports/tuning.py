"""`diffdrive tune`: gains by gradient within margins, proved on what they were not tuned on."""

import shutil
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from diffdrive.axis import Axis
from diffdrive.controllers import Controller
from diffdrive.loop.linearise import OperatingPoint
from experiments.reports import readable
from experiments.reports.axis_file import write_axis_file
from experiments.reports.charts.responses import bode_chart
from experiments.reports.charts.signals import before_and_after
from experiments.reports.interruption import stop_at_next_step
from experiments.reports.loop_figures import bode, nyquist, responses
from experiments.reports.margins import NO_LIMIT
from experiments.reports.report import Report
from experiments.reports.simulation import MAGNIFIED
from experiments.reports.theme import BLACK, BLUE, DASHES, drawing, legend_below, new_figure, say, style
from tuning.gains.checkpoint import CHECKPOINT
from tuning.gains.handover import handover, worst_margins, write_handover
from tuning.gains.measured import MeasuredMargins
from tuning.gains.pareto import ParetoFront, pareto_front
from tuning.gains.plan import ScenarioResult, TuningPlan
from tuning.gains.requirements import LoopLimits
from tuning.gains.result import TuningResult
from tuning.gains.tune import GainSearch
from tuning.gains.verification import ControllerMargins, ScenarioComparison, is_accepted
from tuning.gains.workflow import tune

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNITS = {
    "phase": "phase_deg",
    "command_noise": "command_noise_N",
    "load_error": "load_error_N",
    "settling": "settling_s",
}
PARETO = "pareto.parts"  # checkpoints of the limits of a front, a folder each
LARGE_LOAD_ERROR = 1.0  # kN


def tune_and_report(axis: Axis, report: Report, *, pareto: Sequence[float] = (), **options: Any) -> TuningResult:
    """Tune as `tuning.tune` with these `options`; what it finds goes to `report`, tuned.toml and handover.toml, too.

    They are written where the result is accepted. `pareto` are limits on the command noise (N), for each of which the
    gains are tuned again.
    """
    checkpoint = None if report.out is None else report.out / CHECKPOINT
    with report.stages() as advance, stop_at_next_step(advance, report.say) as progress:
        result = tune(axis, resume=report.out, progress=progress, **options)
    if result.status.code == "interrupted" and checkpoint is not None and checkpoint.exists():
        report.say(f"The same command continues the search from {CHECKPOINT}.")
    report_tuning(report, result)
    parts = None if report.out is None else report.out / PARETO
    interrupted = False
    if pareto:
        with report.stages() as advance, stop_at_next_step(advance, report.say) as progress:
            front = pareto_front(result, pareto, resume=parts, progress=progress)
        report_pareto(report, front)
        interrupted = front.status.code == "interrupted"
    if parts is not None and not interrupted:
        shutil.rmtree(parts, ignore_errors=True)
    if result.accepted and checkpoint is not None and not interrupted:
        checkpoint.unlink(missing_ok=True)
    return result


def report_tuning(report: Report, result: TuningResult) -> None:
    """The gains, their margins, the verification, figures, and where they are accepted the files that take them on."""
    given, tuned = result.initial_axis, result.search.controller
    with report.result_first() as first:
        for note in result.notes:
            report.say(note)
        gains_table(report, result.search)
        margins_table(report, result.loop_margins)
        measured_table(report, result.measured_margins)
        report.figure("tuning", tuning_figure(result.search, list(result.runs), result.plan), (  # what it gains, first
            "The search of the gains, and the tracking error with the gains as given and as tuned in the worst "
            "scenario that was held out."
        ))  # fmt: skip
        loop_figures(report, given, tuned, result.plan, result.setup.limits)
        verification_table(report, result.runs)
        first(verdict(result.search, result.runs))
        report.conclude(good=result.accepted)
    held_out = [run for run in result.runs if run.role == "held out"]
    if held_out:
        worst = max(held_out, key=lambda run: run.before.rms)
        report.chart("held_out", before_and_after(worst.scenario.name, worst.before.run, worst.after.run))
    report.keep("verdict", accepted=result.accepted)
    if not result.accepted or report.out is None:
        return
    write_axis_file(report, result.axis, "tuned.toml")
    tables = handover(given, result.search, result.loop_margins[1].training, _conditions(result))
    write_handover(report.out / "handover.toml", tables)


def verdict(tuned: GainSearch, runs: Sequence[ScenarioComparison]) -> str:
    """Whether the gains are accepted, why not, and what they do in scenarios that they were not tuned on."""
    was, now = (1e6 * float(np.mean([one.rms for one in judged])) for judged in _held_out(runs))
    held_out = (
        f"mean RMS error on scenarios not used for tuning {was:.3g} um as given, {now:.3g} um tuned "
        f"({100.0 * (now / was - 1.0):+z.0f} %)"
    )
    if is_accepted(tuned, runs):
        return f"Accepted: {held_out}; every requirement is kept."
    failed = [one.scenario.name for one in runs if not one.after.run.status.ok]
    reasons = [
        f"{name} is missed by {readable.significant(100.0 * share, 3)} %" for name, share in tuned.violated.items()
    ]
    reasons += [f"simulation failed: {', '.join(failed)}"] if failed else []
    reasons += [] if reasons else [f"the search was {tuned.status}"]
    return f"NOT ACCEPTED, and no tuned.toml written: {'; '.join(reasons)}; {held_out}."


def _held_out(runs: Sequence[ScenarioComparison]) -> tuple[list[ScenarioResult], list[ScenarioResult]]:
    off = [one for one in runs if one.role == "held out"]
    return [one.before for one in off], [one.after for one in off]


def gains_table(report: Report, tuned: GainSearch) -> None:
    """The search, and each gain before and after."""
    standing = tuned.best.state
    report.keep(
        "tuning", status=tuned.status, steps=standing.steps, evaluations=standing.evaluations,
        linearisations=standing.linearisations, objective_before=float(tuned.initial_point.objective),
        objective=float(tuned.point.objective), missed_before=float(tuned.initial_point.violation),
        feasible=tuned.feasible, seconds=round(standing.seconds, 1),
    )  # fmt: skip
    rows = [
        [name, float(b), float(a), float(a / b), float(t)]
        for name, b, a, t in zip(tuned.names, tuned.before, tuned.after, tuned.tolerance, strict=True)
    ]
    report.record("gains", ("gain", "before", "after", "ratio", "factor for 5 %"), rows)
    report.show(
        "Gains; changed by the last factor, alone, one costs 5 % of the objective",
        ("gain", "unit", "given", "tuned", "ratio", "factor"),
        [[name, readable.unit_of(unit), *row] for unit, (name, *row) in zip(tuned.units, rows, strict=True)],
        of="gains",
    )
    report.print(
        f"Search: {tuned.status}; {standing.steps} steps, {standing.seconds:.0f} s; objective "
        f"{readable.significant(float(tuned.initial_point.objective))} as given, "
        f"{readable.significant(float(tuned.point.objective))} tuned."
    )
    if len(tuned.start_objectives) > 1:
        report.values("starts", objective=[float(one) for one in tuned.start_objectives])


def margins_table(report: Report, both: Sequence[ControllerMargins]) -> None:
    """The worst of each margin before and after, also on a machine and loads that were not tuned on."""
    rows: list[list[object]] = []
    for name, found in zip(("given", "tuned"), both, strict=True):
        for place, part in (("as tuned", found.training), ("held out", found.held_out)):
            worst = worst_margins(part)
            rows.append([f"{place}, {name}", *(worst.get(key) for key in WORST)])
    rows.sort(key=lambda row: str(row[0]))
    columns = ("where", "gain up dB", "gain down dB", "phase deg", "peak sensitivity", "growth 1/s")
    report.table("margins", columns, rows, "Worst margins over speeds, directions and loads", infinite=NO_LIMIT)


def measured_table(report: Report, found: Sequence[MeasuredMargins]) -> None:
    """The margins of the loops with a measured plant, before and after; none where nothing was measured."""
    if not found:
        return
    rows = [
        [f"{one.name}, {name}", float(m.gain_margin_up), float(m.gain_margin_down), float(m.phase_margin),
         float(m.peak_sensitivity), "yes" if m.stable else "NO"]
        for one in found
        for name, m in (("given", one.before), ("tuned", one.after))
    ]  # fmt: skip
    columns = ("measured", "gain up dB", "gain down dB", "phase deg", "peak sensitivity", "stable")
    caption = "Margins of the loop with what was measured in the plant's place"
    report.table("measured_margins", columns, rows, caption, infinite=NO_LIMIT)


def loop_figures(report: Report, description: Axis, tuned: Controller, plan: TuningPlan, limits: LoopLimits) -> None:
    """Nyquist and Bode plots of the loop with the gains as given and as tuned."""
    at = [OperatingPoint(v, w) for v in (0.0, 1e-3, plan.top_speed) for w in plan.loads]
    with report.working("drawing the loops"):
        panels = {
            name: responses(description.drive, controller, description.sampling, at)
            for name, controller in (("given", description.controller), ("tuned", tuned))
        }
    report.figure("nyquist", nyquist(panels, limits), (
        "Nyquist plot of the open loop L near -1, gains given and tuned, at each speed and load; shaded: what the "
        "required margins exclude."
    ))  # fmt: skip
    chart = bode_chart(panels)
    report.figure("bode", bode(panels, limits), chart.caption)
    report.chart("bode", chart)


WORST = ("gain_up_dB", "gain_down_dB", "phase_deg", "peak_sensitivity", "growth_per_s")


def verification_table(report: Report, runs: Sequence[ScenarioComparison]) -> None:
    """Every scenario before and after on the exact simulator, and the means of both roles."""
    rows: list[list[Any]] = []
    for one in runs:
        pairs = ((_scaled(one.before, key), _scaled(one.after, key)) for key in MEASURES)
        rows.append([one.scenario.name, one.role, *(value for pair in pairs for value in pair)])
    names = ("RMS um", "peak um", "noise N", "load error kN")
    columns = ("scenario", "role", *(f"{name}{which}" for name in names for which in ("", " tuned")))
    report.record("verification", columns, rows)
    means = []
    for role in ("tuned on", "held out"):
        part = [row for row in rows if row[1] == role]
        mean = [
            "mean",
            role,
            *(None if part[0][k] is None else float(np.mean([row[k] for row in part])) for k in range(2, 10)),
        ]
        means.append(mean)
        for k, what in ((2, "rms_um"), (6, "command_noise_N"), (8, "load_error_kN")):
            if mean[k] is not None:
                report.keep(f"mean_{what}_{role.replace(' ', '_')}", before=mean[k], after=mean[k + 1])
    caption = "Gains as given and as tuned on the exact (quantised, limited) simulator"
    report.show(caption, columns, [*rows, *means], notes=_load_errors(rows), of="verification")


def _load_errors(rows: Sequence[Sequence[Any]]) -> list[str]:
    """Why the load error is large, where it is."""
    large = [row[0] for row in rows if max(row[8] or 0.0, row[9] or 0.0) > LARGE_LOAD_ERROR]
    if not large:
        return []
    return [
        f"Load error above {LARGE_LOAD_ERROR:g} kN: {', '.join(large)}. The estimator takes for load whatever friction "
        "its model does not hold; on another machine than the file's some per cent of friction are kilonewtons of load."
    ]


MEASURES = {"rms": 1e6, "peak": 1e6, "command_noise": 1.0, "load_error": 1e-3}  # and the factor from SI to the table


def _scaled(result: ScenarioResult, measure: str) -> float | None:
    value = getattr(result, measure)
    return None if value is None else MEASURES[measure] * float(value)


def report_pareto(report: Report, front: ParetoFront) -> None:
    """Tracking error against command noise: the gains tuned again under each limit, from the ones given."""
    for note in front.notes if front.status.ok else (front.status.message, *front.notes):
        report.say(note)
    rows = [[*point[:4], 1e6 * point.rms] for point in front.points]
    columns = ("noise limit N", "objective", "feasible", "held-out noise N", "held-out RMS um")
    report.table("pareto", columns, rows, "Tuned again under each limit of the command noise")
    if any(point.feasible for point in front.points):
        report.figure("pareto", pareto_figure(front), (
            "Tracking error over command noise, the gains tuned again under each limit of the noise: on the scenarios "
            "of the search, and on those held out."
        ))  # fmt: skip


@drawing
def pareto_figure(front: ParetoFront) -> "Figure":
    """Tracking error over command noise: what was tuned on, and what was held out."""
    figure, axis = new_figure(height=3.2)
    kept = [point for point in front.points if point.feasible]
    axis.plot(
        [point.noise_limit for point in kept], [point.objective for point in kept], "o", label="objective at its limit",
        **style(0),
    )  # fmt: skip
    held_out = [(point.command_noise, 1e6 * point.rms) for point in kept]
    axis.plot(*zip(*held_out, strict=True), "s", label="held out: mean RMS", **style(1))
    axis.set(xlabel="command noise, N", ylabel="tracking error, µm", ylim=(0, None))
    legend_below(figure)
    (quiet, largest), (loud, least) = min(held_out), max(held_out)
    ends = f"{largest:.3g} µm at {quiet:.3g} N" + (f" to {least:.3g} µm at {loud:.3g} N" if len(held_out) > 1 else "")
    say(figure, f"What quietness costs: held-out tracking error {ends} of command noise")
    return figure


def _conditions(result: TuningResult) -> dict[str, object]:
    """What the gains rest on."""
    axis, plan = result.initial_axis, result.plan
    required = {
        UNITS.get(name, name): np.max(np.asarray(value) * (180.0 / np.pi if name == "phase" else 1.0)).item()
        for name, value in result.setup.limits._asdict().items()
        if value is not None
    }
    return {
        "loads_N": list(plan.loads),
        "reversal_speed_m_per_s": plan.top_speed,
        "margins_at_speeds_m_per_s": [float(speed) for speed in result.setup.speeds],
        "parameter_uncertainty": plan.spread,
        **({} if plan.uncertainty is None else {"uncertain_parameters": list(plan.uncertainty.names)}),
        "control_rate_Hz": float(axis.rate),
        "delay_samples": int(axis.drive.actuator.delay_samples),
        "required": required,
    }


@drawing
def tuning_figure(tuned: GainSearch, runs: list[ScenarioComparison], plan: TuningPlan) -> "Figure":
    """The search, and the worst held-out scenario before and after; the latter magnified at its largest error."""
    figure, (left, right, turn) = new_figure(1, 3, height=3.0, share_x=False)
    history = tuned.best.state.history
    left.plot([entry[1] for entry in history], [entry[3] for entry in history], "o-", ms=3, color=BLACK)
    left.xaxis.get_major_locator().set_params(integer=True)
    left.set(xlabel="linearisations (count)", ylabel="objective, µm", title="search", ylim=(0, None))
    shown = max((run for run in runs if run.role == "held out"), key=lambda run: run.before.rms)
    old, new = shown.before, shown.after
    counted = old.run.time > plan.settle
    errors = np.where(counted, np.abs(old.run.error), 0.0)
    peak, half = old.run.time[np.argmax(errors)], 0.5 * (old.run.time[-1] - plan.settle) / MAGNIFIED
    for axis in (right, turn):
        for name, result, look in (("given", old, {"color": BLACK}), ("tuned", new, {"color": BLUE, "ls": DASHES[1]})):
            axis.plot(result.run.time, 1e6 * result.run.error, label=name, **look)
        axis.set(xlabel="time, s", ylabel="tracking error, µm")
    right.set(title="the worst held-out scenario", xlim=(plan.settle, old.run.time[-1]))
    turn.set(title="at the largest error", xlim=(peak - half, peak + half))
    most = 1.1e6 * max(np.abs(result.run.error[counted]).max() for result in (old, new))
    for axis in (right, turn):
        axis.set_ylim(-most, most)
    legend_below(figure, right)
    before, after = (float(np.mean([one.rms for one in part])) for part in _held_out(runs))
    say(figure, f"Held-out tracking error {1e6 * before:.3g} µm RMS given, {1e6 * after:.3g} µm tuned; "
                f"worst, {shown.scenario.name}: {1e6 * old.rms:.3g} given, {1e6 * new.rms:.3g} tuned")  # fmt: skip
    return figure
