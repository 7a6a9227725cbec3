"""The main job: simulate the paper's drive, differentiate it, tune it over loads; identify and replay a real axis."""

from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.controllers import Controller, FrictionCompensation
from diffdrive.errors import ParameterError
from diffdrive.library import PAPER_DRIVE
from diffdrive.loop import metrics
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import quantities
from diffdrive.numerics.arrays import Scalar, as_arrays
from experiments.reports.report import Report
from experiments.reports.tuning import tune_and_report
from experiments.studies.emps import axis as emps
from experiments.studies.emps import study as emps_study
from experiments.studies.paper import scenario as paper
from experiments.studies.paper.reproduce import table_1
from tuning.gains.plan import SPREAD, reversal
from tuning.gains.tune import STARTS


def sensitivities(axis: Axis) -> list[tuple[str, float]]:
    """d(RMS tracking error) / d(log parameter), um per doubling / ln 2, for every parameter of drive and controller."""
    motion = reversal(0.010, axis.sampling.rate, 0.6)
    inputs = loop_inputs(motion, np.linspace(0.0, 5_000.0, len(motion.time)))
    models = as_arrays(smooth((axis.drive, axis.controller)))

    @eqx.filter_jit
    def gradient(models: tuple[Drive, Controller]) -> tuple[Drive, Controller]:
        def rms(models: tuple[Drive, Controller]) -> Scalar:
            drive, controller = models
            position = rollout_loop(drive, controller, inputs, axis.sampling).table_position
            return metrics.rms(jnp.asarray(inputs.reference.position) - position)

        return jax.grad(rms)(models)

    slopes = gradient(models)
    results = []
    for part, name in ((0, "machine"), (1, "controller")):
        for (path, _, value), (_, _, slope) in zip(quantities(models[part]), quantities(slopes[part]), strict=True):
            for side, number, slope_value in _directions(value, slope):
                if number is not None and float(number) != 0:
                    results.append((f"{name}: {path}{side}", 1e6 * float(number) * float(slope_value)))
    return sorted(results, key=lambda item: -abs(item[1]))


def _directions(value: Any, slope: Any) -> list[tuple[str, Any, Any]]:
    if hasattr(value, "positive"):
        return [(" +", value.positive, slope.positive), (" -", value.negative, slope.negative)]
    return [("", value, slope)]


def demo(out: Path | None, *, emps_folder: Path | None = None, quick: bool = False) -> Report:
    """The main job; `quick` searches from fewer starts. Returns the report, written to `out` if given."""
    if emps_folder is not None and not (emps_folder / emps.FILES["estimation"]).is_file():
        raise ParameterError(f"--emps {emps_folder}: no {emps.FILES['estimation']} in it")
    with Report("diffdrive: the paper's drive, and a real axis", out) as report:
        axis = read_axis(PAPER_DRIVE)
        _simulate(report, axis)
        _differentiate(report, axis)
        report.say("Tuning Kp, Kd, Q, R and K_w over loads from 0 to 12.6 kN, within stability margins.")
        # the paper leaves more of the friction open than its load estimator bears: docs/reference/axes.md
        tune_and_report(axis, report, loads=(0.0, 12_600.0), starts=1 if quick else STARTS, spread=SPREAD)
        folder = emps_folder or emps.find_folder()
        if folder is None:
            report.say(
                "The EMPS log is not here (looked for shared/data/emps beside this folder): the real axis is left out. "
                "Name its folder with --emps."
            )
        else:
            _real_axis(report, folder, quick)
    return report


def _simulate(report: Report, axis: Axis) -> None:
    with report.working("simulating six controllers on the paper's drive"):
        runs = table_1(axis.drive, paper.canonical())
    rows = []
    for name, run in runs.items():
        published = paper.TABLE_1.get(name, (None, None))
        rows.append([name, *published, 1e6 * run.peak_error(*paper.AFTER_LOAD), 1e6 * run.rms_error(*paper.AFTER_LOAD)])
    report.table(
        "table_1",
        ("controller", "paper peak", "paper RMS", "peak", "RMS"),
        rows,
        "Tracking error in um at a reversal under 10 kN (paper, Table 1), 0.1 um scale",
    )


def _differentiate(report: Report, axis: Axis) -> None:
    assert isinstance(axis.controller, FrictionCompensation)
    with report.working("differentiating the closed loop with respect to every parameter"):
        slopes = sensitivities(axis)
    report.table(
        "sensitivities",
        ("parameter", "um per 100 %"),
        slopes[:12],
        f"What moves the tracking error most, of {len(slopes)} parameters (reverse-mode gradient of its RMS)",
    )


def _real_axis(report: Report, folder: Path, quick: bool) -> None:
    """The EMPS axis before and after identification; `diffdrive emps` says more."""
    records = emps.read_all(folder)
    identified = emps_study.identify_axis(report, records, starts=2 if quick else 6)
    drives = {emps_study.PUBLISHED: emps.reference_drive(), emps_study.IDENTIFIED: identified.drive}
    replays = emps_study.force_table(report, drives, records)
    emps_study.parameter_table(report, identified.estimates, {})
    report.say(identified.adequacy.says)
    estimation = {name: replays[name]["estimation"] for name in drives}
    emps_study.force_figure(report, records["estimation"], estimation)
