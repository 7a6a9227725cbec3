"""`diffdrive identify`: the drive that logs show, how sure each parameter is, and whether the model suffices."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from diffdrive.controllers import UnknownController
from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.motion.text import number
from experiments.reports import readable
from experiments.reports.axis_file import write_axis_file
from experiments.reports.checked_logs import axis_with_overrides, parse_loads, read_sound_logs
from experiments.reports.identification.figures import save_identification_figures
from experiments.reports.identification.gap_table import gap_table
from experiments.reports.interruption import stop_at_next_step
from experiments.reports.report import Report
from tuning.checked_logs import CheckedLogs
from tuning.identification import inverse_dynamics
from tuning.identification.doubts import HARDLY, determined_sums
from tuning.identification.estimates import EstimateStatus, ParameterEstimate
from tuning.identification.identify import Identification
from tuning.identification.inverse_dynamics import MIN_SPEED
from tuning.identification.parameters import BOUNDABLE, FIXABLE, parameter_called
from tuning.identification.refinement import was_interrupted
from tuning.identification.scale_noise import unstated_noise
from tuning.identification.workflow import IdentificationResult, identify_checked
from tuning.optimisation.least_squares import Outcome
from tuning.store.folder import FolderStore
from tuning.sweeps.identified import write_uncertainty

PARTS = "identification.parts"  # finished searches, from which the same command continues
NEAR = 1.01  # times the best cost, up to which a start has found the same
NO_MOTION = {  # by whether the controller is known
    False: "without a controller none can be simulated",
    True: "the axis limits leave none of those that would be tried",
}
TRY_IT = " (each can be tried: diffdrive simulate --motion ...)"


def identify_drive(
    paths: Sequence[Path],
    drive: Path,
    out: Path | None,
    *,
    columns: Sequence[str] = (),
    units: Sequence[str] = (),
    shifts: Sequence[str] = (),
    fixed: Sequence[str] = (),
    bounds: Sequence[str] = (),
    loads: Sequence[str] = (),
    starts: int = 6,
    seed: int = 0,
    held_out: Sequence[Path] = (),
    force: bool = False,
) -> bool:
    """`diffdrive identify`; False if the search did not converge.

    `columns`, `units`, `shifts`, `fixed`, `bounds`, `loads` are texts as on the command line. Raises `DriveFileError`,
    `LogError` and `ParameterError`, one line each.
    """
    axis = axis_with_overrides(drive, columns, units, shifts, [*paths, *held_out])
    bounded = parse_bounds(bounds, axis.sheet)
    for name in fixed:
        parameter_called(name, FIXABLE, f"--fixed {name}: no such parameter")
    applied = parse_loads(loads, [*paths, *held_out], axis.sheet)
    with Report(f"{drive.name}: identification from {', '.join(path.name for path in paths)}", out) as report:
        checked = partial(read_sound_logs, description=axis, report=report, force=force, loads=applied)
        logs = checked(paths, name="findings")
        others = checked(held_out, name="findings_held_out", beside=logs.logs) if held_out else CheckedLogs((), ())
        parts = FolderStore.in_folder(out, PARTS)
        with report.stages() as advance, stop_at_next_step(advance, report.say) as progress:
            result = identify_checked(
                axis, logs, others, fixed=fixed, bounds=bounded, starts=starts, seed=seed, store=parts,
                progress=progress,
            )  # fmt: skip
        if parts is not None and parts.hits:
            report.print(f"{parts.hits} finished searches of an interrupted identification were used.")
        stopped = was_interrupted(result.fit.search)
        if stopped and parts is not None and parts.folder.exists():
            report.say(f"The same command continues the search from {PARTS}.")
        report_identification(report, result)
        if parts is not None and not stopped:  # while no other run may write here
            parts.remove()
    return result.status.ok


def report_identification(report: Report, result: IdentificationResult) -> None:
    """The identified axis, how sure it is, what it is worth on each log, and what to log next; figures and files."""
    if report.out is not None:
        if name := write_axis_file(report, result.axis, "identified.toml"):
            report.keep("written", file=name)
        write_uncertainty(report.out, result.axis)
    report.conclude(f"{readable.titled(result.headline())}.", good=judged(result))
    for doubt in result.doubts:
        report.say(f"Doubtful: {doubt}.")
    for lack in result.shortcomings:
        report.say(f"{readable.titled(lack.sentence)}.")
    print_identification(report, result.fit)
    if unstated := unstated_noise(result.initial_axis.drive, result.fit.scale_noise):
        report.say(unstated)
    if result.status.ok:
        _next_motions(report, result)
    gap_table(report, result)
    _inverse_dynamics(report, result)
    if report.out is not None:
        with report.working("drawing"):
            save_identification_figures(report, result.fit, result.initial_axis.drive, result.logs.logs)


def judged(result: IdentificationResult) -> bool | None:
    """Whether the result is good; None where the model is incomplete: no error, and nothing to be content with."""
    return None if result.status.ok and result.fit.adequacy.has_structure else result.status.ok


def parse_bounds(texts: Sequence[str], sheet: DataSheet = NO_SHEET) -> dict[str, tuple[float, float]]:
    """Bounds from `NAME=LOW:HIGH`, each a number in SI or with its unit; raises `ParameterError`."""
    bounded: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, equals, limits = (part.strip() for part in text.partition("="))
        low, colon, high = limits.partition(":")
        if not (equals and colon):
            raise ParameterError(f"--bound {text}: write NAME=LOW:HIGH, such as mass=80:120")
        parameter = parameter_called(name, BOUNDABLE, f"--bound {name}: no such parameter")
        if parameter.path in bounded:
            raise ParameterError(f"--bound {text}: {name} is bounded twice")
        unit = parameter.unit if parameter.unit != "periods" else "1"
        where = f"--bound {text}"
        ends = number(low.strip(), unit, where, sheet), number(high.strip(), unit, where, sheet)
        if not ends[0] < ends[1]:
            raise ParameterError(f"--bound {text}: the lower end must be below the higher one")
        bounded[parameter.path] = ends
    return bounded


def _inverse_dynamics(report: Report, result: IdentificationResult) -> None:
    """What the reference method says, which knows neither a bristle nor a delay."""
    logs, held_out = result.logs.logs, result.held_out.logs
    try:
        found = inverse_dynamics.identify(logs, min_speed=MIN_SPEED)
        others = inverse_dynamics.evaluate(found, held_out).error_percent if held_out else None
    except DiffdriveError as problem:
        report.say(f"No inverse dynamics: {problem}")
        return
    report.keep(
        "inverse_dynamics",
        mass_kg=found.values["mass"],
        viscous_Ns_per_m=found.values["viscous"],
        coulomb_N=found.values["coulomb"],
        constant_force_N=found.values["constant_force"],
        force_error_percent=found.fit.error_percent,
        **({} if others is None else {"held_out_force_error_percent": others}),
    )
    for note in found.notes:
        report.say(f"inverse dynamics: {note}")
    report.print("\nFor comparison, fitted by least squares, without bristle and delay")
    report.show_numbers("inverse_dynamics")


def print_identification(report: Report, found: Identification) -> None:
    """What was found, whether it suffices, the table of estimates, and what the numbers mean."""
    if found.search.outcome is not Outcome.CONVERGED:
        report.say("The search did not converge: these are the best parameters that it saw, not the best there are.")
    report.say(f"{readable.titled(found.adequacy.says)}.")
    estimates_table(report, found)
    print_remarks(report, found)


def estimates_table(report: Report, found: Identification) -> None:
    """Every parameter before and after, with its interval and the bounds of the search."""

    def row(one: ParameterEstimate) -> list[object]:
        interval = [one.low, one.high] if one.status is EstimateStatus.FITTED else [None, None]
        free = one.status in (EstimateStatus.FITTED, EstimateStatus.AT_BOUND, EstimateStatus.IN_A_SUM)
        within = [_short(one.lowest), _short(one.highest)] if free else [None, None]
        return [one.name, one.unit, one.believed, one.value, *interval, *within, one.status]

    report.record(
        "estimates",
        ("name", "unit", "drive_file", "identified", "low", "high", "lowest", "highest", "status"),
        [row(one) for one in found.estimates],
    )
    report.show(
        "Parameters in SI units",
        ("parameter", "unit", "drive file", "identified", "95 % interval"),
        [_estimate(one) for one in found.estimates],
        notes=_hardly_determined(found),
        of="estimates",
    )


def _estimate(one: ParameterEstimate) -> list[object]:
    value, between = readable.shown(one.value), str(one.status)
    if one.status is EstimateStatus.FITTED:
        value, between = readable.interval(one.value, one.low, one.high)
    return [one.name, readable.unit_of(one.unit), one.believed, value, between]


def _hardly_determined(found: Identification) -> list[str]:
    """Which fitted parameters the logs say little of, and what each hangs together with."""
    notes, alone = [], []
    for one in found.estimates:
        half = 0.5 * (one.high - one.low)
        as_believed = one.believed == 0.0 and one.low <= 0.0 <= one.high  # nothing is odd about a zero
        if one.status is not EstimateStatus.FITTED or half <= HARDLY * abs(one.value) or as_believed:
            continue
        tied = [(abs(r), other) for a, b, r in found.correlated for mine, other in ((a, b), (b, a)) if mine == one.path]
        wide = "not distinguished from 0" if one.low < 0.0 < one.high else f"± {100.0 * half / abs(one.value):.0f} %"
        if tied:
            other = _named(max(tied)[1])
            notes.append(f"- {one.name}: hardly determined ({wide}): the logs hardly distinguish it from {other}.")
        else:
            alone.append(f"{one.name} ({wide})")
    if alone:
        notes.append(
            f"- Hardly determined: {', '.join(alone)}. The log excites each of them little, or what the model does not "
            "explain widens its interval."
        )
    return notes


def _short(bound: float) -> float:
    return float(f"{bound:.3g}")


def print_remarks(report: Report, found: Identification) -> None:
    """What the numbers mean."""
    report.values("search", status=found.status, steps=found.search.steps, simulations=found.simulations)
    for note in found.notes:
        report.say(f"{readable.titled(note)}.")
    condition, blocks = found.covariance.condition, found.covariance.blocks
    report.keep("accuracy", noise_m=found.noise, white_force_N=found.process_force, condition=condition, blocks=blocks)
    report.print(
        f"Fit: position noise {readable.significant(1e9 * found.noise)} nm, process noise "
        f"{readable.significant(found.process_force)} N per control period, condition number "
        f"{readable.significant(float(f'{condition:.2g}'))}, {blocks} blocks for the intervals"
    )
    report.keep("adequacy", structured=found.adequacy.has_structure, **found.adequacy._asdict())  # said in words
    report.keep("starts", cost_over_best=[round(float(cost), 4) for cost in found.start_costs])
    if len(found.start_costs) > 1:
        near = sum(cost <= NEAR for cost in found.start_costs)
        report.say(
            f"Of {len(found.start_costs)} starts {near} came within {100.0 * (NEAR - 1.0):.0f} % of the best cost."
        )
    if found.correlated:
        rows = [[_named(one), _named(other), r] for one, other, r in found.correlated]
        report.table("correlated", ("one", "other", "correlation"), rows, "Pairs that the logs hardly distinguish")
        for known in determined_sums(found):
            report.say(f"{known.message}.")
    undetermined = [one.name for one in found.estimates if one.status is EstimateStatus.UNDETERMINED]
    if undetermined:
        report.say(f"The logs do not determine {', '.join(undetermined)}: they stay as the drive file says.")
    at_bound = [one.name for one in found.estimates if one.status is EstimateStatus.AT_BOUND]
    if at_bound:
        report.say(f"At the bound of their range, so the optimum may lie beyond: {', '.join(at_bound)}.")


def _next_motions(report: Report, result: IdentificationResult) -> None:
    """Which motion would determine what these logs leave open."""
    undetermined = result.fit.open_unknowns
    if not undetermined:
        return
    with report.working("looking for the motions that would determine them"):
        offers = result.next_motions
    if len(offers) < len(undetermined):
        has_controller = not isinstance(result.initial_axis.controller, UnknownController)
        report.say(f"No motion is proposed{' for the others' if offers else ''}: {NO_MOTION[has_controller]}.")
    if not offers:
        return
    rows = [
        [
            _named(one.parameter),
            readable.unit_of(one.unit),
            _finite(one.before),
            _finite(one.after),
            one.motion or "none of those tried",
        ]
        for one in offers
    ]
    report.table(
        "next_motions",
        ("parameter", "unit", "+- now", "+- then", "log this motion too"),
        rows,
        "What would determine the rest" + (TRY_IT if any(np.isfinite(one.after) for one in offers) else ""),
    )


def _finite(width: float) -> float | None:
    """Half-width of an interval; None where it says nothing."""
    return width if np.isfinite(width) else None


def _named(path: str) -> str:
    """A path in the axis as tables have it, without its part."""
    return path.partition(".")[2]
