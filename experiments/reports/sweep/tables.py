"""What a sweep found, as tables and as numbers for programs."""

from collections.abc import Sequence

import numpy as np

from experiments.reports.readable import significant, unit_of
from experiments.reports.report import Report
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.result import varied_values
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

RANGE_DIGITS = 3  # of a quantile whose interval stands beside it
LISTED = 5  # worst machines that are named
GroupInfluences = tuple[Group, list[Influence]]  # a controller on a motion, and what drives its spread

TOGETHER = "; quantities hang together, so that shares overlap, and one may have its share through another"
RARELY = 0.01  # chance, below which a quantity is said to decide over divergence
STUCK = 0.5  # share of the time at the force limit from which an axis is too weak


def print_varied(report: Report, plan: SweepPlan) -> None:
    """What varies, and how far: a range without its unit is seen here."""
    numbers, motion = plan.numbers(0), next(iter(plan.motions))
    values = plan.values(numbers, motion)
    rows = [
        [one.name, unit_of(one.unit), one.text.partition("=")[2], *np.quantile(values[one.name], (0.0, 0.5, 1.0))]
        for one in plan.varied
    ]
    if rows:
        report.table(
            "varied", ("quantity", "unit", "as given", "least", "median", "most"), rows,
            f"What varies, in SI units: of the first {len(numbers)} machines"
            + (f", on {motion}" if len(plan.motions) > 1 else ""),
        )  # fmt: skip


def _range(interval: Interval, factor: float) -> str:
    """A value between its ends, in another unit; an end is None where the machines are too few to say."""
    value, low, high = (None if one is None else significant(factor * one, RANGE_DIGITS) for one in interval)
    if low is not None and high is not None:
        between = f"{low} to {high}"
    elif low is not None or high is not None:
        between = f"at most {high}" if low is None else f"at least {low}"
    else:
        between = "-"
    return f"{value or '-'} ({between})"


def _of_groups(
    found: Sequence[Group], columns: Sequence[str], rows: Sequence[Sequence[object]]
) -> tuple[list[str], list[list[object]]]:
    """A table whose first columns are motion and controller, without those that are the same for all."""
    several = len({one.motion for one in found}) > 1, len({one.controller for one in found}) > 1
    used = [k for k in range(len(columns)) if k > 1 or several[k]]
    return [columns[k] for k in used], [[row[k] for k in used] for row in rows]


def verdict(found: Sequence[Group], tolerance: float | None, by: str) -> list[str]:
    """A sentence on each controller: how often it misses the tolerance, or else how large its error is."""
    lines = []
    for one in found:
        if tolerance is None:
            bound = _range(quantile(one.error(by), 0.95), 1e6)
            text = f"95 % of the machines have a {ERRORS[by]} of at most {bound} um"
        else:
            misses = _range(exceedance(one.error(by), tolerance), 100)
            text = f"{misses} % of the machines miss the tolerance: {ERRORS[by]} beyond {1e6 * tolerance:g} um"
        if diverged := int(np.sum(one.diverged)):
            text += f"; {diverged} DIVERGED"
        _, [names] = _of_groups(found, ("motion", "controller"), [[one.motion, one.controller]])
        lines.append(": ".join([*([", ".join(map(str, names))] if names else []), f"{text}."]))
    return lines


def print_sweep(
    report: Report, plan: SweepPlan, found: Sequence[GroupInfluences], tolerance: float | None, by: str
) -> None:
    """Errors, misses, comparisons, what drives the spread, what decides over divergence, and the worst machines."""
    report.data["results"] = [_numbers(one, tolerance) for one in found]
    all_groups = [one for one, _ in found]
    sentences = verdict(all_groups, tolerance, by)
    report.conclude(*sentences, good=False if any(one.diverged.any() for one in all_groups) else None)
    for sentence in sentences:
        report.print(sentence, style="bold")
    rows: list[list[object]] = []
    missed: list[list[object]] = []
    listed: list[list[object]] = []
    for one, _ in found:
        place = [one.motion, one.controller]
        for name, label in ERRORS.items():
            errors = one.error(name)
            ranges = [_range(quantile(errors, share), 1e6) for share in SHARES]
            largest = 1e6 * float(np.max(errors))
            rows.append([*place, label, *ranges, largest])
            listed += [
                [*place, label, f"{100 * share:g}", *text.rstrip(")").split(" (")]
                for share, text in zip(SHARES, ranges, strict=True)
            ]
            listed.append([*place, label, "100", significant(largest, RANGE_DIGITS), None])
        misses = "-" if tolerance is None else _range(exceedance(one.error(by), tolerance), 100)
        missed.append([*place, int(np.sum(one.diverged)), _stuck(one), misses])
    report.record("errors", ("motion", "controller", "um", *(f"{100 * share:g} %" for share in SHARES), "worst"), rows)
    columns: tuple[str, ...] = ("motion", "controller", "error", "of machines, %", "at most, um", "95 % interval, um")
    report.show("Tracking error over the machines", *_of_groups(all_groups, columns, listed), of="errors")
    limit = "no tolerance given" if tolerance is None else f"{ERRORS[by]} beyond {1e6 * tolerance:g} um"
    columns = ("motion", "controller", "diverged", "at the force limit", "miss the tolerance, %")
    report.record("misses", columns, missed)
    report.show(
        f"Machines that diverged, that are at the force limit for half of the time or more, and misses: {limit}",
        *_of_groups(all_groups, columns, missed),
        of="misses",
    )
    _compare(report, [one for one, _ in found], by)
    _blame(report, plan, found, by)
    _blame_for_divergence(report, plan, [one for one, _ in found])
    columns = ("motion", "controller", "largest error first", "diverged, the earliest first")
    named = [
        [
            one.motion,
            one.controller,
            _listed(worst(one, LISTED, by)),
            _listed(first_to_diverge(one, LISTED)),
        ]
        for one in all_groups
    ]
    report.record("worst", columns, named)
    report.show(
        f"Worst machines by {ERRORS[by]}; any machine again: diffdrive replay FOLDER --machine NUMBER",
        *_of_groups(all_groups, columns, named),
        of="worst",
    )


def _listed(numbers: Sequence[int]) -> str:
    return " ".join(map(str, numbers)) or "-"


def _stuck(group: Group) -> int:
    return int(np.sum(~group.diverged & (group.column("saturated") >= STUCK)))


def _numbers(analysed: GroupInfluences, tolerance: float | None) -> dict[str, object]:
    """What the tables say, for programs: SI units, intervals as numbers."""
    group, influences = analysed
    return {
        "motion": group.motion,
        "controller": group.controller,
        "diverged": int(np.sum(group.diverged)),
        "at_the_force_limit": _stuck(group),
        "quantiles": {
            f"{by}_m": {str(share): quantile(group.error(by), share)._asdict() for share in SHARES} for by in ERRORS
        },
        "misses": None
        if tolerance is None
        else {"tolerance_m": tolerance}
        | {f"{by}_m": exceedance(group.error(by), tolerance)._asdict() for by in ERRORS},
        "sensitivity": [
            {name: value for name, value in one._asdict().items() if name != "chance"} for one in influences
        ],
    }


def _compare(report: Report, found: Sequence[Group], by: str) -> None:
    """Each controller beside the first of its motion."""
    pairs = [(one, next(first for first in found if first.motion == one.motion)) for one in found]
    rows = []
    for one, first in pairs:
        if one is not first:
            comparison = compare(one, first, by)
            rows.append(
                [one.motion, comparison.one, comparison.other, _range(comparison.better, 100), comparison.ratio]
            )
    if rows:
        report.table(
            "compared",
            ("motion", "controller", "beside", "better on, % of machines", "median ratio of errors"),
            rows,
            f"Machine by machine, under the same load and noise: {ERRORS[by]}",
        )


def _blame(report: Report, plan: SweepPlan, found: Sequence[GroupInfluences], by: str) -> None:
    rows = [
        [
            one.motion,
            one.controller,
            influence.name,
            100 * influence.share,
            100 * influence.uncertain,
            1e6 * influence.low,
            1e6 * influence.high,
        ]
        for one, influences in found
        for influence in influences
        if influence.is_significant  # result.json has the others
    ]
    if rows:
        columns = ("motion", "controller", "quantity", "share, %", "+-", "um where low", "um where high")
        report.record("sensitivity", columns, rows)
        headings = (*columns[:4], "+-, %", "error where low, um", "error where high, um")
        report.show(
            f"What drives the spread: share of the variance of the logarithm of the {ERRORS[by]}, and its mean in the "
            "lowest and highest sixth" + (TOGETHER if plan.correlation else ""),
            *_of_groups([one for one, _ in found], headings, rows),
            of="sensitivity",
        )
    for one, influences in found if plan.varied else ():
        place = f"{one.motion}, {one.controller}"
        if not influences:
            report.say(
                f"{place}: no sensitivities: they take {MIN_MACHINES} machines that did not diverge and are not all "
                "alike."
            )
        elif not any(influence.is_significant for influence in influences):
            report.say(
                f"{place}: no quantity stands out by its share of the spread; more machines show smaller shares."
            )


def _blame_for_divergence(report: Report, plan: SweepPlan, found: Sequence[Group]) -> None:
    """Machines that diverged have no share in the errors' spread: what decides over that is a table of its own."""
    rows = []
    for one in found:
        if not one.diverged.any():
            continue
        influences = influences_on_event(list(plan.units), varied_values(plan, one), one.diverged, plan.seed)
        significant_ones = [
            influence for influence in influences if influence.is_significant or influence.chance < RARELY
        ]
        for influence in significant_ones:
            uncertain = 100 * influence.uncertain if np.isfinite(influence.uncertain) else None
            shown = [100 * influence.share, uncertain, influence.chance, 100 * influence.low, 100 * influence.high]
            rows.append([one.motion, one.controller, influence.name, *shown])
        if not significant_ones:
            why = (
                "which nothing that varies distinguishes from the others"
                if influences
                else f"and of why nothing is said: that takes {MIN_MACHINES} machines, some that stay, and what varies"
            )
            report.say(
                f"{one.motion}, {one.controller}: {np.sum(one.diverged)} machines diverged, {why} (the first ones "
                "are named below)."
            )
    if rows:
        columns = (
            "motion", "controller", "quantity", "share, %", "+-", "by chance", "% diverge where low",
            "% diverge where high",
        )  # fmt: skip
        report.table(
            "divergence",
            columns,
            rows,
            "What decides whether a machine diverges; those that do are not in the shares above"
            + (TOGETHER if plan.correlation else ""),
        )
