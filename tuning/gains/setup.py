"""A tuning before its search: scenarios, limits, what is free, and the speeds at which margins are looked at."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diffdrive.axis import Axis
from diffdrive.controllers import FrictionCompensation
from diffdrive.errors import ParameterError
from diffdrive.model.parameters import Sampling
from tuning.gains.plan import TuningPlan, held_out_scenarios, run_scenario, training_scenarios
from tuning.gains.requirements import Constraints, LoopLimits, check_limits, operating_points
from tuning.gains.scenarios import Ensemble, Scenario, ensemble
from tuning.gains.tune import default_space, gain_factors
from tuning.optimisation.space import SearchSpace

SPEEDS = (0.0, 1e-3, 3e-3, 1.0, 2.0)  # m/s, where margins are looked at; from 1 on, times the speed tuned at
# times the command noise, and the load error, of the gains as given: where no limit is stated
DEFAULT_NOISE_FACTOR, DEFAULT_LOAD_ERROR_FACTOR = 2.0, 1.1


class TuningSetup(NamedTuple):
    """A tuning before its search: what it is tuned on and verified on, what is free, and what is required."""

    training: list[Scenario]
    held_out: list[Scenario]
    lanes: Ensemble
    limits: LoopLimits
    constraints: Constraints
    space: SearchSpace
    speeds: tuple[float, ...]  # m/s, at which margins are looked at
    friction: bool  # tuned along
    notes: tuple[str, ...]


def set_up(axis: Axis, plan: TuningPlan, required: LoopLimits, *, friction: bool = False) -> TuningSetup:
    """Scenarios, constraints and search space of a tuning as planned. Raises `ParameterError` and `MotionError`."""
    check_limits(required)
    if friction and not isinstance(axis.controller, FrictionCompensation):
        raise ParameterError("friction: this controller observes no friction that could be tuned along")
    training, held_out_runs = training_scenarios(axis, plan), held_out_scenarios(axis, plan)
    coarse = Sampling(axis.rate, max(2, -(-axis.sampling.plant_steps // 2)))
    lanes = ensemble(training, coarse, settle=plan.settle)
    required, notes = _with_default_limits(axis, required, training, plan.settle)
    speeds = margin_speeds(plan)
    grid = operating_points([axis.drive], speeds, plan.loads)
    space = default_space(axis.controller, friction=friction)
    if left := sorted(
        gain_factors(axis.controller, friction=friction).keys() - {parameter.path for parameter in space.free}
    ):
        notes.append(f"0 in the drive file, and so not tuned, since no factor leads away from it: {', '.join(left)}.")
    return TuningSetup(
        training, held_out_runs, lanes, required, Constraints(required, grid, coarse), space, speeds, friction,
        tuple(notes),
    )  # fmt: skip


def _with_default_limits(
    axis: Axis, required: LoopLimits, training: Sequence[Scenario], settle: float
) -> tuple[LoopLimits, list[str]]:
    """Limits that were not given, from what the gains as given do; and what to say of them."""
    notes = []
    before = [run_scenario(axis.controller, scenario, axis.sampling, settle) for scenario in training]
    if required.command_noise is None:
        noise = DEFAULT_NOISE_FACTOR * max(result.command_noise for result in before)
        required = required._replace(command_noise=noise)
        notes.append(
            f"Command noise is limited to {DEFAULT_NOISE_FACTOR:g} times that of the gains as given: {noise:.3g} N."
        )
    if required.load_error is None and before[0].load_error is not None:
        errors = np.array(
            [DEFAULT_LOAD_ERROR_FACTOR * result.load_error for result in before if result.load_error is not None]
        )
        required = required._replace(load_error=errors)
        notes.append(
            f"The load error in each scenario is limited to {DEFAULT_LOAD_ERROR_FACTOR:g} times that of the gains as "
            "given."
        )
    return required, notes


def margin_speeds(plan: TuningPlan) -> tuple[float, ...]:
    """The speeds (m/s) at which margins are looked at."""
    return tuple(speed if speed < 1.0 else speed * plan.top_speed for speed in SPEEDS)
