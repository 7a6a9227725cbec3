"""The figures of `diffdrive diagnose`: the ladder, the missing force, where it lies, and the causes."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from diffdrive.logs import Log
from experiments.report import Report, new_figure
from tuning.diagnosis.diagnose import Diagnosis
from tuning.diagnosis.ladder import Rung
from tuning.diagnosis.where import SIGNIFICANT

MOST_POINTS = 6000  # of a signal in a figure
REGIONS, CAUSES = 12, 8
BEFORE, AFTER = "0.6", "C0"


def draw(report: Report, found: Diagnosis, logs: Sequence[Log]) -> None:
    """Save every figure."""
    report.figure("ladder", _ladder(found))
    report.figure("missing_force", _missing(found, logs))
    report.figure("where", _where(found))
    if found.verdict.beliefs:
        report.figure("causes", _causes(found))


def _ladder(found: Diagnosis) -> Any:
    """The missing force of each model on held-out data, against the floor."""
    with_loop = all(rung.loop is not None and not rung.loop.says for rung in found.rungs)
    figure, axes = new_figure(1, 3 if with_loop else 1, width=11.0 if with_loop else 6.0, height=3.4, share_x=False)
    axes = np.atleast_1d(axes)
    names = [rung.name for rung in found.rungs]
    at = np.arange(len(names))
    rms = np.array([rung.force.rms for rung in found.rungs])
    spread = np.abs(np.array([rung.interval for rung in found.rungs]).T - rms)
    axes[0].errorbar(at, rms, yerr=spread, fmt="o-", color=AFTER, linewidth=0.8, capsize=4)
    axes[0].axhline(found.floor, color="k", linestyle="--", label="noise floor")
    axes[0].set_ylabel("missing force, N RMS")
    axes[0].legend()
    if with_loop:
        for axis, scale, signal, label in (
            (axes[1], 1e6, "position", "position, um RMS"),
            (axes[2], 1.0, "command", "command, N RMS"),
        ):
            of_rungs = [scale * getattr(rung.loop, f"{signal}_rms") for rung in found.rungs]
            axis.plot(at, of_rungs, "o-", color=AFTER, linewidth=0.8)
            floor = scale * getattr(found.rungs[-1].loop, f"{signal}_floor")
            axis.axhline(floor, color="k", linestyle="--")
            axis.set_ylabel(f"{label}, closed loop")
    for axis in axes:
        axis.set_xticks(at, names, rotation=20, ha="right")
        axis.set_xlim(-0.5, len(names) - 0.5)
        axis.set_yscale("log")
    figure.suptitle(f"The gap, {found.split.says}")
    return figure


def _missing(found: Diagnosis, logs: Sequence[Log]) -> Any:
    """The force that is missing over time and over position, recalibrated and with what was found."""
    figure, axes = new_figure(2, 1, width=11.0, height=2.8, share_x=False)
    lane = found.logged.owner.index(found.split.logs[-1])
    rate = found.logged.sampling.rate
    for rung, color in _first_and_last(found.rungs, BEFORE, AFTER):
        counts = rung.force.counts[lane] > 0
        every = max(1, counts.size // MOST_POINTS)
        force = np.where(counts, rung.force.force[lane], np.nan)[::every]
        position = 1e3 * np.asarray(rung.force.course.position[lane])[::every]
        axes[0].plot(np.arange(counts.size)[::every] / rate, force, color=color, linewidth=0.8, label=rung.name)
        axes[1].plot(position, force, ".", color=color, markersize=1.5)
    axes[0].set_xlabel("time, s")
    axes[1].set_xlabel("position, mm")
    for axis in axes:
        axis.set_ylabel("missing force, N")
    axes[0].legend(loc="upper right")
    figure.suptitle(f"Force that the model lacks while the table slides, {logs[found.split.logs[-1]].name}")
    return figure


def _first_and_last(rungs: Sequence[Rung], before: str, after: str) -> list[tuple[Rung, str]]:
    return [(rungs[1], before)] + ([(rungs[-1], after)] if len(rungs) > 2 else [])


def _where(found: Diagnosis) -> Any:
    """Shares of the gap beside the shares of the time."""
    telling = [one for one in found.where if one.dimension not in ("subsystem", "signal")]
    telling = [one for one in telling if one.p_value < SIGNIFICANT][:REGIONS] or telling[:REGIONS]
    figure, axis = new_figure(width=9.0, height=0.6 + 0.34 * max(len(telling), 3))
    at = np.arange(len(telling))[::-1]
    axis.barh(at + 0.2, [100 * one.share for one in telling], 0.4, color=AFTER, label="of the gap")
    axis.barh(at - 0.2, [100 * one.expected for one in telling], 0.4, color=BEFORE, label="expected by chance")
    axis.set_yticks(at, [f"{one.dimension}: {one.region}" for one in telling])
    axis.set_xlabel("share, %")
    axis.legend()
    return figure


def _causes(found: Diagnosis) -> Any:
    """How sure each cause is."""
    beliefs = found.verdict.beliefs[:CAUSES]
    figure, axis = new_figure(width=7.0, height=0.6 + 0.34 * max(len(beliefs), 3))
    at = np.arange(len(beliefs))[::-1]
    axis.barh(at, [one.confidence for one in beliefs], color=[AFTER if one.found else BEFORE for one in beliefs])
    axis.set_yticks(at, [one.effect for one in beliefs])
    axis.set_xlim(0, 1)
    axis.set_xlabel("confidence (blue: part of the explanation)")
    return figure
