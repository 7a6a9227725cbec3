"""Tracking error against command noise: what quietness costs."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tuning.gains.plan import run_scenario
from tuning.gains.requirements import Constraints
from tuning.gains.result import TuningResult
from tuning.gains.tune import default_space
from tuning.gains.tune import tune as search_gains
from tuning.progress import Progress, reporting


class ParetoPoint(NamedTuple):
    """Gains tuned under one limit of the command noise, and what they do in scenarios that were not tuned on."""

    noise_limit: float  # N
    objective: float
    feasible: bool  # every requirement is kept
    command_noise: float  # N, mean over the held-out scenarios
    rms: float  # m, mean tracking error over them


def pareto_front(
    result: TuningResult, noise_limits: Sequence[float], *, progress: Progress | None = None
) -> list[ParetoPoint]:
    """Tune a result's axis again under each limit of the command noise (N), and judge the gains held out.

    Args:
        result: Of `tune`: its requirements, scenarios and objective are kept.
        noise_limits: Limits of the RMS command noise (N), each above 0.
        progress: Called with (stage, done, of how many).

    Returns:
        A point for each limit, the lowest first.

    Examples:
        >>> front = pareto_front(tune(axis), [5.0, 10.0, 20.0])
        >>> [(point.command_noise, point.rms) for point in front]

    """
    axis, setup, settle = result.initial_axis, result.setup, result.plan.settle
    space, front = default_space(axis.controller), []
    with reporting(progress) as tell:
        for k, noise in enumerate(sorted(noise_limits)):
            tell("Pareto front", k, len(noise_limits))
            limits = setup.constraints.limits._replace(command_noise=noise)
            limited = Constraints(limits, setup.constraints.points, setup.lanes.sampling)
            found = search_gains(axis.controller, setup.lanes, limited, space, objective=result.objective)
            runs = [run_scenario(found.controller, scenario, axis.sampling, settle) for scenario in setup.held_out]
            front.append(
                ParetoPoint(
                    float(noise), float(found.point.objective), bool(found.feasible),
                    float(np.mean([run.command_noise for run in runs])),
                    float(np.mean([run.rms for run in runs])),
                )
            )  # fmt: skip
        tell("Pareto front", len(noise_limits), len(noise_limits))
    return front
