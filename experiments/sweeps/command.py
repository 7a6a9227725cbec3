"""`diffdrive sweep` and `diffdrive replay`: a sweep run, told and drawn; and one of its machines again."""

import contextlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np

from diffdrive.controllers import Controller
from diffdrive.convergence import advice
from diffdrive.drive_file import drive_tables, parse_drive, write_drive
from diffdrive.errors import ParameterError
from experiments.report import Report, named_file
from experiments.scenario import require_choice
from experiments.single import run_figure, write_run
from experiments.sweeps import figures
from experiments.sweeps.asked import Asked, keep, read_asked
from experiments.sweeps.engine import Precision
from experiments.sweeps.parts import Computed, Engine, Say, here, kept, missing, run
from experiments.sweeps.plan import Plan
from experiments.sweeps.replay import SIGNALS, chosen, costs_again, machine_of, run_of, traces
from experiments.sweeps.samples import Method
from experiments.sweeps.sensitivity import FEWEST, Influence, influences, influences_on_event
from experiments.sweeps.summary import (
    ERRORS,
    SHARES,
    Group,
    Interval,
    compared,
    exceedance,
    first_to_diverge,
    groups,
    quantile,
    worst,
)

PARTS = "parts"
TOLD = 5  # worst machines that are named
Told = tuple[Group, list[Influence]]  # a controller on a motion, and what drives its spread

TOGETHER = "; quantities hang together, so that shares overlap, and one may have its share through another"
ALIKE = 0.01  # of RMS and peak error: what the signals of a machine by itself may be off
RARELY = 0.01  # chance, below which a quantity is said to decide over divergence
STUCK = 0.5  # share of the time at the force limit from which an axis is too weak


def sweep_drive(
    asked: Asked, tolerance: float | None, by: str, engine: Engine | None, recorded: Sequence[str], out: Path | None
) -> bool:
    """`diffdrive sweep`; False if a machine diverged. `recorded` are the signals of the worst machines to keep."""
    require_choice("--by", "error", by.removesuffix("_m"), [one.removesuffix("_m") for one in ERRORS])
    require_choice("--method", "method", asked.method, get_args(Method))
    require_choice("--precision", "precision", asked.precision, get_args(Precision))
    if recorded and out is None:
        raise ParameterError("--record: give --out, a folder for the traces")
    for name in recorded:
        require_choice("--record", "signal", name, SIGNALS)
    plan = asked.plan()
    warned = [
        f"{motion}, {name}: {one}"
        for motion in plan.motions
        for name, controller in plan.controllers.items()
        for one in _warnings(plan, controller, motion)
    ]
    title = f"{asked.name}: {plan.samples} machines, {', '.join(plan.motions)}"
    if out is not None:
        missing(plan, out / PARTS)  # before anything is written: what is there may be of another sweep
    with Report(title, out) as report, _folder(out) as folder:
        for warning in warned:
            report.say(warning)
        runs = plan.samples * len(plan.controllers) * len(plan.motions)
        with report.counted("machines", plan.samples) as done:
            rows = run(plan, folder, done, _noted(asked, engine or here, out), report.console.print)
        _legend(report, asked.origins(plan.axis.sampling.rate))
        report.values(
            "sweep", machines=plan.samples, runs=runs, method=plan.method, seed=plan.seed, parts=plan.parts,
            precision=plan.precision,
        )  # fmt: skip
        found = groups(rows, list(plan.controllers), list(plan.motions))
        told = [(one, _influences(plan, one, by)) for one in found]
        _tell(report, plan, told, tolerance, by)
        for motion in plan.motions if out is not None else ():
            _draw(report, plan, [one for one in told if one[0].motion == motion], tolerance, by)
        if recorded:
            _record(report, plan, found, recorded, by)
        return not any(one.diverged.any() for one in found)


def _warnings(plan: Plan, controller: Controller, motion: str) -> list[str]:
    """What to expect of a controller on a motion. Where settings vary, the first warning of each kind."""
    told = (advice(controller, *one, 1.0 / plan.axis.sampling.rate) for one in plan.extremes(motion))
    return list({text.partition(" at ")[0]: text for texts in told for text in reversed(texts)}.values())


def _legend(report: Report, origins: Mapping[str, str]) -> None:
    """Which motion is meant by each name."""
    report.data["motions"] = dict(origins)
    if len(origins) > 1:
        report.table("motions", ("motion", "as asked for"), [list(one) for one in origins.items()], "Motions")


def _noted(asked: Asked, engine: Engine, out: Path | None) -> Engine:
    """An engine that writes down what was asked when it begins: by then every machine has been found possible."""

    def noted(plan: Plan, wanted: list[int], say: Say) -> Computed:
        results = engine(plan, wanted, say)  # which may find that nobody is there
        if out is not None:
            keep(asked, out)
        yield from results

    return noted


@contextlib.contextmanager
def _folder(out: Path | None) -> Iterator[Path]:
    """Where the parts go: beside the results, or nowhere for long."""
    if out is not None:
        yield out / PARTS
        return
    with tempfile.TemporaryDirectory(prefix="sweep-") as room:
        yield Path(room)


def _range(interval: Interval, factor: float) -> str:
    """A value between its ends, in another unit."""

    def shown(value: float | None) -> str:
        return "-" if value is None else f"{factor * value:.4g}"

    return f"{shown(interval.value)} ({shown(interval.low)} to {shown(interval.high)})"


def _tell(report: Report, plan: Plan, found: Sequence[Told], tolerance: float | None, by: str) -> None:
    report.data["results"] = [_numbers(one, tolerance) for one in found]
    rows, missed = [], []
    for one, _ in found:
        place = [one.motion, one.controller]
        for name, called in ERRORS.items():
            errors = one.error(name)
            told = [_range(quantile(errors, share), 1e6) for share in SHARES]
            rows.append([*place, called, *told, 1e6 * float(np.max(errors))])
        misses = "-" if tolerance is None else _range(exceedance(one.error(by), tolerance), 100)
        missed.append([*place, int(np.sum(one.diverged)), _stuck(one), misses])
    report.table(
        "errors",
        ("motion", "controller", "um", *(f"{100 * share:g} %" for share in SHARES), "worst"),
        rows,
        "Tracking error over the machines, um: quantiles, in brackets their 95 % intervals",
    )
    limit = "no tolerance given" if tolerance is None else f"{ERRORS[by]} beyond {1e6 * tolerance:g} um"
    report.table(
        "misses",
        ("motion", "controller", "diverged", "at the force limit", "miss the tolerance, %"),
        missed,
        f"Machines that diverged, that are at the force limit for half of the time or more, and misses: {limit}",
    )
    _compare(report, [one for one, _ in found], by)
    _blame(report, plan, found, by)
    _blame_for_divergence(report, plan, [one for one, _ in found])
    report.table(
        "worst",
        ("motion", "controller", "largest error first", "diverged, the earliest first"),
        [
            [one.motion, one.controller, _listed(worst(one, TOLD, by)), _listed(first_to_diverge(one, TOLD))]
            for one, _ in found
        ],
        f"Worst machines by {ERRORS[by]}; any machine again: diffdrive replay FOLDER --machine NUMBER",
    )


def _listed(numbers: Sequence[int]) -> str:
    return " ".join(map(str, numbers)) or "-"


def _stuck(group: Group) -> int:
    return int(np.sum(~group.diverged & (group.column("saturated") >= STUCK)))


def _numbers(told: Told, tolerance: float | None) -> dict[str, Any]:
    """What the tables say, for programs: SI units, intervals as numbers."""
    group, every = told
    return {
        "motion": group.motion,
        "controller": group.controller,
        "diverged": int(np.sum(group.diverged)),
        "at_the_force_limit": _stuck(group),
        "quantiles": {
            name: {str(share): quantile(group.error(name), share)._asdict() for share in SHARES} for name in ERRORS
        },
        "misses": None
        if tolerance is None
        else {"tolerance_m": tolerance} | {name: exceedance(group.error(name), tolerance)._asdict() for name in ERRORS},
        "sensitivity": [{name: value for name, value in one._asdict().items() if name != "chance"} for one in every],
    }


def _compare(report: Report, found: Sequence[Group], by: str) -> None:
    """Each controller beside the first of its motion."""
    pairs = [(one, next(first for first in found if first.motion == one.motion)) for one in found]
    rows = []
    for one, first in pairs:
        if one is not first:
            told = compared(one, first, by)
            rows.append([one.motion, told.one, told.other, _range(told.better, 100), told.ratio])
    if rows:
        report.table(
            "compared",
            ("motion", "controller", "beside", "better on, % of machines", "median ratio of errors"),
            rows,
            f"Machine by machine, under the same load and noise: {ERRORS[by]}",
        )


def _blame(report: Report, plan: Plan, found: Sequence[Told], by: str) -> None:
    rows = [
        [one.motion, one.controller, each.name, 100 * each.share, 100 * each.uncertain, 1e6 * each.low, 1e6 * each.high]
        for one, every in found
        for k, each in enumerate(every)
        if each.share > each.uncertain or not k  # the rest is noise; result.json has it
    ]
    if rows:
        report.table(
            "sensitivity",
            ("motion", "controller", "quantity", "share, %", "+-", "um where low", "um where high"),
            rows,
            f"What drives the spread: share of the variance of the logarithm of the {ERRORS[by]}, and its mean in the "
            "lowest and highest sixth" + (TOGETHER if plan.correlation else ""),
        )
    elif plan.varied:
        report.say(f"No sensitivities: they take {FEWEST} machines that did not diverge and are not all alike.")


def _blame_for_divergence(report: Report, plan: Plan, found: Sequence[Group]) -> None:
    """Machines that diverged have no share in the errors' spread: what decides over that is told apart."""
    rows = []
    for one in found:
        if not one.diverged.any():
            continue
        every = influences_on_event(list(plan.units), _values(plan, one), one.diverged, plan.seed)
        clear = [each for each in every if each.share > each.uncertain or each.chance < RARELY]
        for each in clear:
            uncertain = 100 * each.uncertain if np.isfinite(each.uncertain) else None
            shown = [100 * each.share, uncertain, each.chance, 100 * each.low, 100 * each.high]
            rows.append([one.motion, one.controller, each.name, *shown])
        if not clear:
            why = (
                "which nothing that varies tells from the others"
                if every
                else f"and of why nothing is said: that takes {FEWEST} machines, some that stay, and what varies"
            )
            report.say(
                f"{one.motion}, {one.controller}: {np.sum(one.diverged)} machines diverged, {why} (the worst ones are "
                "named below)."
            )
    if rows:
        report.table(
            "divergence",
            (
                "motion",
                "controller",
                "quantity",
                "share, %",
                "+-",
                "by chance",
                "% diverge where low",
                "% diverge where high",
            ),
            rows,
            "What decides whether a machine diverges; those that do are not in the shares above"
            + (TOGETHER if plan.correlation else ""),
        )


def _values(plan: Plan, group: Group) -> np.ndarray:
    return np.stack([group.column(name) for name in plan.units], axis=1)


def _influences(plan: Plan, group: Group, by: str) -> list[Influence]:
    return influences(list(plan.units), _values(plan, group), group.error(by), plan.seed)


def _draw(report: Report, plan: Plan, found: Sequence[Told], tolerance: float | None, by: str) -> None:
    every = [one for one, _ in found if not one.diverged.all()]
    if not every:
        return  # nothing but infinite errors
    motion = f"_{named_file(every[0].motion)}" if len(plan.motions) > 1 else ""
    report.figure(f"distribution{motion}", figures.distribution(every, tolerance, by))
    report.figure(f"exceedance{motion}", figures.exceeded(every, tolerance, by))
    for one, told in found:
        if told:
            controller = f"_{named_file(one.controller)}" if len(plan.controllers) > 1 else ""
            report.figure(f"tornado{motion}{controller}", figures.tornado(told, one, by))
    strongest = [told[0].name for _, told in found if told]
    for name in dict.fromkeys([*(name for name in ("load",) if name in plan.units), *strongest]):
        drawn = figures.against(every, name, plan.units[name], tolerance, by)
        report.figure(f"error_against_{named_file(name)}{motion}", drawn)


def _record(report: Report, plan: Plan, found: Sequence[Group], recorded: Sequence[str], by: str) -> None:
    """The signals of every controller's worst machines, under every controller."""
    assert report.out is not None
    for motion in plan.motions:
        mine = [one for one in found if one.motion == motion]
        numbers = sorted({number for one in mine for number in (*worst(one, TOLD, by), *first_to_diverge(one, TOLD))})
        path = report.out / (f"traces_{named_file(motion)}.nc" if len(plan.motions) > 1 else "traces.nc")
        with report.working("recording the worst machines"):
            traces(plan, numbers, plan.controllers, motion, recorded).to_netcdf(path, engine="h5netcdf")
        report.say(f"{path.name}: {', '.join(recorded)} of machines {', '.join(map(str, numbers))}")


def replay_machine(folder: Path, number: int, controller: str | None, motion: str | None, out: Path | None) -> bool:
    """`diffdrive replay`; False if the machine diverged, here or in the sweep, or its run is not to be believed."""
    plan = read_asked(folder).plan()
    controller, motion = chosen(plan, controller, motion)
    machine = machine_of(plan, number, motion)
    with Report(f"{folder.name}: machine {number}, {controller}, {motion}", out) as report:
        report.table(
            "machine",
            ("quantity", "unit", "value"),
            [[name, plan.units[name], value] for name, value in machine.values.items()],
            "What differs from the drive file",
        )
        with report.working("simulating"):
            simulated = run_of(plan, machine, controller, motion)
            costs, diverged_at = costs_again(plan, number, controller, motion)
        counted = simulated.time >= plan.settle
        with np.errstate(over="ignore", invalid="ignore"):
            error = np.abs(simulated.error[counted])
            rms, peak = np.sqrt(np.mean(error**2)), np.max(error)
        report.values("run", status=simulated.status.message)
        report.values("costs", rms_um=1e6 * float(costs.rms[0]), peak_um=1e6 * float(costs.peak[0]))
        if not np.allclose([rms, peak], [costs.rms[0], costs.peak[0]], rtol=ALIKE, atol=0.0, equal_nan=True):
            report.say(
                f"The signals are of a machine by itself, whose last digits differ: RMS error {1e6 * rms:.4g} um, peak "
                f"error {1e6 * peak:.4g} um. On a quantised scale, or at the edge of stability, such runs part."
            )
        told = kept(plan, folder / PARTS, number, controller, motion)
        if told is None:
            report.say("Not compared with the sweep's own numbers: they are not there, or of another edition.")
        else:
            again = [float(costs.rms[0]), float(costs.peak[0])]
            report.values("as_in_the_sweep", to_the_last_bit=np.array_equal(told, again, equal_nan=True))
        if report.out is not None:
            write_run(report.out / "run.csv", simulated)
            # the gains are the axis's; observers and feed-forwards in a file take the file's own model
            tables = drive_tables(plan.axis_of(machine.drive))
            write_drive(report.out / "machine.toml", parse_drive(tables, f"machine {number}"))
            report.figure("run", run_figure(simulated))
    return simulated.status.ok and bool(np.isnan(diverged_at[0]))
