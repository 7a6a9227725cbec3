"""Tracking error against command noise: what quietness costs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from diffdrive.errors import ParameterError
from diffdrive.results import Result, Status
from diffdrive.support.bounds import require_a, require_number
from diffdrive.support.spans import format_span
from tuning.gains.plan import run_scenario
from tuning.gains.result import TuningResult
from tuning.gains.tune import GainSearch
from tuning.gains.tune import tune as search_gains
from tuning.optimisation.least_squares import StepProgress
from tuning.progress import Progress, reporting, searching


class ParetoPoint(NamedTuple):
    """Gains tuned under one limit of the command noise, and what they do in scenarios that were not tuned on."""

    noise_limit: float  # N
    objective: float
    feasible: bool  # every requirement is kept
    command_noise: float  # N, mean over the held-out scenarios
    rms: float  # m, mean tracking error over them


@dataclass(frozen=True, repr=False, eq=False)
class ParetoFront(Result):
    """What each limit of the command noise costs: a point for each, the lowest first.

    `notes` name the limits under which a requirement is not kept or a held-out run is not ok. The status is ok where
    every limit was searched to its end, and the gains of one at least keep all requirements in runs that are ok.
    """

    points: tuple[ParetoPoint, ...]
    status: Status
    notes: tuple[str, ...]

    schema: ClassVar[str] = "pareto/1"

    def headline(self) -> str:
        verdict = "Pareto front" if self.status.ok else f"NOT OK: {self.status.message}"
        kept = [point for point in self.points if point.feasible]
        ends = (f"{1e6 * point.rms:.3g} µm RMS within {point.noise_limit:.3g} N" for point in kept[:1] + kept[1:][-1:])
        return "; held out ".join((verdict, *ends))

    def summary(self) -> str:
        rows = [f"{'limit N':>10}{'noise N':>10}{'RMS µm':>10}"]
        rows += [
            f"{point.noise_limit:>10.4g}{point.command_noise:>10.3g}{1e6 * point.rms:>10.3g}" for point in self.points
        ]
        return "\n".join([self.headline(), *rows, *(f"- {note}" for note in self.notes)])

    def as_dict(self) -> dict[str, object]:
        return {
            "points": [
                {
                    "noise_limit_N": point.noise_limit, "objective": point.objective, "feasible": point.feasible,
                    "command_noise_N": point.command_noise, "rms_m": point.rms,
                }
                for point in self.points
            ]
        }  # fmt: skip


def pareto_front(
    result: TuningResult,
    noise_limits: Sequence[float],
    *,
    resume: str | Path | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> ParetoFront:
    """Tune a result's axis again under each limit of the command noise (N), and judge the gains held out.

    Args:
        result: Of `tune`: its scenarios, other requirements, objective, free gains and search options are kept.
        noise_limits: Limits of the RMS command noise (N), each above 0.
        resume: A folder in which what is finished is kept, from which the same call continues.
        progress: Called with (stage, done, of how many).
        throw: Raise an error where the front is not ok.

    Raises:
        ParameterError: There is no limit, or one is not above 0.
        CheckpointError: What is in the folder `resume` is of another call.
        ResultError: The front is not ok, with `throw`.

    Examples:
        >>> front = pareto_front(tune(axis), [5.0, 10.0, 20.0])
        >>> [(point.command_noise, point.rms) for point in front.points]

    """
    require_a(TuningResult, "result", result, "take what tune returns")
    if not len(noise_limits):
        raise ParameterError("noise_limits: give one at least")
    for limit in noise_limits:
        require_number("noise_limits", limit, "N", above=0.0)
    points: list[ParetoPoint] = []
    notes: list[str] = []
    status = Status(False, "no gains keep every requirement under any of the limits", code="not_accepted")
    with reporting(progress) as advance:
        for k, limit in enumerate(sorted(noise_limits)):
            with searching(advance, f"tuning within {limit:g} N of command noise") as step:
                found = _tuned_under(result, limit, None if resume is None else Path(resume) / f"{limit:.17g} N", step)
            if found.interrupted:
                status = Status(False, f"interrupted after {k} of {len(noise_limits)} limits", code="interrupted")
                break
            point, problems = _judged(result, limit, found)
            points.append(point)
            notes += [f"{limit:g} N: {problem}" for problem in problems]
            if not problems:
                status = Status(True)
    front = ParetoFront(tuple(points), status, tuple(notes))
    return front.require_ok() if throw else front


def _tuned_under(result: TuningResult, limit: float, resume: Path | None, progress: StepProgress) -> GainSearch:
    """The axis as it was given, tuned as before but for this limit of the command noise (N)."""
    setup = result.setup
    limits = setup.constraints.limits._replace(command_noise=limit)
    constraints = replace(setup.constraints, limits=limits)
    return search_gains(
        result.initial_axis.controller, setup.lanes, constraints, setup.space, objective=result.objective,
        options=result.options, resume=resume, progress=progress,
    )  # fmt: skip


def _judged(result: TuningResult, limit: float, found: GainSearch) -> tuple[ParetoPoint, list[str]]:
    """What these gains do held out, and what speaks against them."""
    sampling, settle = result.initial_axis.sampling, result.plan.settle
    runs = [run_scenario(found.controller, scenario, sampling, settle) for scenario in result.setup.held_out]
    problems = [
        f"{name} is missed by {format_span((100.0 * share, None, None))[0]} %" for name, share in found.violated.items()
    ]
    problems += [
        f"{scenario.name}: {judged.run.status.message}"
        for scenario, judged in zip(result.setup.held_out, runs, strict=True)
        if not judged.run.status.ok
    ]
    point = ParetoPoint(
        float(limit), float(found.point.objective), found.feasible,
        float(np.mean([run.command_noise for run in runs])), float(np.mean([run.rms for run in runs])),
    )  # fmt: skip
    return point, problems
