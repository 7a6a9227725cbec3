"""What closing the gap pays: the gains tuned on the drive with what was found, against those tuned on the nominal one.

Both are judged on the drive with what was found, the best that is known of the machine, in scenarios that neither was
tuned on.
"""

from pathlib import Path

import numpy as np
from rich.console import Console

from diffdrive.axis import Axis
from diffdrive.controllers import Controller
from diffdrive.loop.smooth import smooth
from diffdrive.numerics.arrays import as_arrays
from experiments.reports.report import Report
from experiments.reports.tuning import tune_and_report
from tuning.gains.handover import worst_margins
from tuning.gains.plan import ScenarioResult, TuningPlan, held_out_scenarios, run_scenario
from tuning.gains.requirements import Constraints, LoopLimits, operating_points

GainFigures = dict[str, float | bool]  # of one controller, the unit in the name
STANDSTILL = 0.0  # m/s
NAMES = ("given", "tuned on nominal", "tuned on augmented")
COLUMNS = ("mean_rms_um", "worst_peak_um", "command_noise_N", "phase_deg", "gain_up_dB", "gain_down_dB")
CAPTION = "On the drive with what was found, in scenarios not tuned on"


def payoff(report: Report, nominal: Axis, augmented: Axis, plan: TuningPlan) -> dict[str, GainFigures]:
    """Tune on both drives and judge the gains as given and both results on the augmented one.

    The tunings' own figures and tables go to the folders tuned-nominal and tuned-augmented of `report`. Raises what
    `tune` raises: `ParameterError` for a drive or a controller that cannot be tuned.
    """
    gains: list[Controller] = [nominal.controller]
    accepted = [True]
    for name, description in (("nominal", nominal), ("augmented", augmented)):
        quiet = Report(f"tuned on the {name} drive", _subfolder(report, f"tuned-{name}"), Console(quiet=True))
        with report.working(f"tuning on the {name} drive"), quiet:
            result = tune_and_report(
                description, quiet, loads=plan.loads, load_steps=plan.load_steps, machines=plan.machines
            )
        if result.status.code == "interrupted":
            raise KeyboardInterrupt  # half a tuning pays nothing
        gains.append(result.search.controller)
        accepted.append(result.accepted)
    scenarios = held_out_scenarios(augmented, plan)
    rows: list[list[object]] = []
    found: dict[str, GainFigures] = {}
    for name, controller, kept in zip(NAMES, gains, accepted, strict=True):
        with report.working(f"judging the gains {name}"):
            judged = [run_scenario(controller, one, augmented.sampling) for one in scenarios]
        found[name] = _as_dict(judged, _margins(augmented, controller, plan)) | {"requirements_kept_where_tuned": kept}
        rows.append([name, *(found[name].get(key) for key in COLUMNS)])
    report.table("payoff", ("gains", *COLUMNS), rows, CAPTION)
    return found


def summarise_payoff(found: dict[str, GainFigures]) -> str:
    """What `payoff` found, in a sentence."""
    was, now = (found[name]["mean_rms_um"] for name in NAMES[1:])
    failed = [name for name in NAMES[1:] if not found[name]["runs_ok"]]
    unkept = [name for name in NAMES[1:] if not found[name]["requirements_kept_where_tuned"]]
    sentence = (
        f"On the augmented drive, tuning on it leaves {now:.3g} um of tracking error where tuning on the nominal one "
        f"leaves {was:.3g} um ({100 * (now / was - 1):+z.0f} %)."
    )
    sentence += f" Simulations fail with the gains {' and '.join(failed)}." if failed else ""
    return sentence + (f" Requirements could not be kept by the gains {' and '.join(unkept)}." if unkept else "")


def _subfolder(report: Report, name: str) -> Path | None:
    return None if report.out is None else report.out / name


def _as_dict(judged: list[ScenarioResult], margins: dict[str, float]) -> GainFigures:
    return {
        "mean_rms_um": 1e6 * float(np.mean([one.rms for one in judged])),
        "worst_peak_um": 1e6 * float(np.max([one.peak for one in judged])),
        "command_noise_N": float(np.max([one.command_noise for one in judged])),
        "runs_ok": all(one.run.status.ok for one in judged),
        **margins,
    }


def _margins(description: Axis, controller: Controller, plan: TuningPlan) -> dict[str, float]:
    """The worst at standstill and at the speed tuned at, without load and under the highest."""
    at = operating_points([description.drive], (STANDSTILL, plan.speed), plan.loads)
    return worst_margins(Constraints(LoopLimits(), at, description.sampling).margins(as_arrays(smooth(controller))))
