"""What a sweep found, as tables and as numbers for programs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.reports.report import Report
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.sensitivity import MIN_MACHINES, Influence, influences_on_event
from tuning.sweeps.summary import (
    ERRORS,
    SHARES,
    Group,
    Interval,
    compare,
    exceedance,
    first_to_diverge,
    quantile,
    worst,
)
from tuning.sweeps.workflow import varied_values

TOLD = 5  # worst machines that are named
Told = tuple[Group, list[Influence]]  # a controller on a motion, and what drives its spread

TOGETHER = "; quantities hang together, so that shares overlap, and one may have its share through another"
RARELY = 0.01  # chance, below which a quantity is said to decide over divergence
STUCK = 0.5  # share of the time at the force limit from which an axis is too weak


def announce(report: Report, plan: SweepPlan) -> None:
    """What varies, and how far: a range without its unit is seen here."""
    numbers, motion = plan.numbers(0), next(iter(plan.motions))
    values = plan.values(numbers, motion)
    rows = [
        [one.name, one.unit, one.text.partition("=")[2], *np.quantile(values[one.name], (0.0, 0.5, 1.0))]
        for one in plan.varied
    ]
    if rows:
        report.table(
            "varied", ("quantity", "unit", "as asked for", "least", "median", "most"), rows,
            f"What varies, in SI units: of the first {len(numbers)} machines"
            + (f", on {motion}" if len(plan.motions) > 1 else ""),
        )  # fmt: skip


def _range(interval: Interval, factor: float) -> str:
    """A value between its ends, in another unit."""

    def shown(value: float | None) -> str:
        return "-" if value is None else f"{factor * value:.4g}"

    return f"{shown(interval.value)} ({shown(interval.low)} to {shown(interval.high)})"


def tell(report: Report, plan: SweepPlan, found: Sequence[Told], tolerance: float | None, by: str) -> None:
    """Errors, misses, comparisons, what drives the spread, what decides over divergence, and the worst machines."""
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
            told = compare(one, first, by)
            rows.append([one.motion, told.one, told.other, _range(told.better, 100), told.ratio])
    if rows:
        report.table(
            "compared",
            ("motion", "controller", "beside", "better on, % of machines", "median ratio of errors"),
            rows,
            f"Machine by machine, under the same load and noise: {ERRORS[by]}",
        )


def _blame(report: Report, plan: SweepPlan, found: Sequence[Told], by: str) -> None:
    rows = [
        [one.motion, one.controller, each.name, 100 * each.share, 100 * each.uncertain, 1e6 * each.low, 1e6 * each.high]
        for one, every in found
        for each in every
        if each.is_significant  # result.json has the others
    ]
    if rows:
        report.table(
            "sensitivity",
            ("motion", "controller", "quantity", "share, %", "+-", "um where low", "um where high"),
            rows,
            f"What drives the spread: share of the variance of the logarithm of the {ERRORS[by]}, and its mean in the "
            "lowest and highest sixth" + (TOGETHER if plan.correlation else ""),
        )
    for one, every in found if plan.varied else ():
        place = f"{one.motion}, {one.controller}"
        if not every:
            report.say(
                f"{place}: no sensitivities: they take {MIN_MACHINES} machines that did not diverge and are not all "
                "alike."
            )
        elif not any(each.is_significant for each in every):
            report.say(
                f"{place}: no quantity stands out by its share of the spread; more machines tell smaller shares."
            )


def _blame_for_divergence(report: Report, plan: SweepPlan, found: Sequence[Group]) -> None:
    """Machines that diverged have no share in the errors' spread: what decides over that is told apart."""
    rows = []
    for one in found:
        if not one.diverged.any():
            continue
        every = influences_on_event(list(plan.units), varied_values(plan, one), one.diverged, plan.seed)
        clear = [each for each in every if each.is_significant or each.chance < RARELY]
        for each in clear:
            uncertain = 100 * each.uncertain if np.isfinite(each.uncertain) else None
            shown = [100 * each.share, uncertain, each.chance, 100 * each.low, 100 * each.high]
            rows.append([one.motion, one.controller, each.name, *shown])
        if not clear:
            why = (
                "which nothing that varies tells from the others"
                if every
                else f"and of why nothing is said: that takes {MIN_MACHINES} machines, some that stay, and what varies"
            )
            report.say(
                f"{one.motion}, {one.controller}: {np.sum(one.diverged)} machines diverged, {why} (the first ones "
                "are named below)."
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
