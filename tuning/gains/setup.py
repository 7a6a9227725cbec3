"""A tuning before its search: scenarios, limits, what is free, and the speeds at which margins are looked at."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from diffdrive.axis import Axis
from diffdrive.controllers import Controller, FrictionCompensation
from diffdrive.errors import ParameterError
from diffdrive.frequency.response import FrequencyResponse
from diffdrive.loop.convergence import innovation_load_observer
from diffdrive.loop.linearise import OperatingPoint
from diffdrive.loop.measured import measured_plant
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Sampling
from diffdrive.numerics.arrays import as_arrays
from tuning.gains.measured import MeasuredMachine
from tuning.gains.objective import Objective
from tuning.gains.plan import TuningPlan, held_out_scenarios, run_scenario, training_scenarios
from tuning.gains.requirements import AsGiven, Constraints, LoopLimits, Requirements, operating_points
from tuning.gains.scenarios import Ensemble, EnsembleSignals, Scenario, ensemble
from tuning.gains.tune import default_space, gain_factors
from tuning.optimisation.space import SearchSpace

# where margins are looked at
LOW_SPEEDS = (0.0, 1e-3, 3e-3)  # m/s
SPEED_FACTORS = (1.0, 2.0)  # times the speed tuned at
DIVERGES = "The loop diverges with the gains as given, and nothing is relative to that"


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
    measured: tuple[FrequencyResponse, ...] = ()  # in whose loops the margins are kept, too


def set_up(
    axis: Axis,
    plan: TuningPlan,
    requirements: Requirements = Requirements(),
    objective: Objective = Objective(),
    *,
    friction: bool = False,
    measured: Sequence[FrequencyResponse] = (),
) -> TuningSetup:
    """Scenarios, constraints and search space of a tuning as planned. Raises `ParameterError` and `MotionError`."""
    if friction and not isinstance(axis.controller, FrictionCompensation):
        raise ParameterError("friction: this controller observes no friction that could be tuned along")
    training, held_out_runs = training_scenarios(axis, plan), held_out_scenarios(axis, plan)
    coarse = Sampling(axis.rate, max(2, -(-axis.sampling.plant_steps // 2)))
    lanes = ensemble(training, coarse, settle=plan.settle)
    signals = eqx.filter_eval_shape(lanes.signals, as_arrays(smooth(axis.controller)))  # nothing is simulated
    _require_shown(axis.controller, signals, requirements, objective)
    limits, notes = _limits(axis, requirements, signals, training, plan.settle)
    speeds = margin_speeds(plan)
    grid = operating_points([axis.drive], speeds, plan.loads)
    space = default_space(axis.controller, friction=friction)
    if left := sorted(
        gain_factors(axis.controller, friction=friction).keys() - {parameter.path for parameter in space.free}
    ):
        notes.append(f"0 in the drive file, and so not tuned, since no factor leads away from it: {', '.join(left)}.")
    notes += [
        f"{one.name}: measured from {one.frequency[0]:.3g} to {one.frequency[-1]:.4g} Hz; its margins hold within."
        for one in measured
    ]
    if plan.uncertainty is not None:
        notes.append(
            f"Other machines are drawn by the [uncertainty] of the drive file ({', '.join(plan.uncertainty.names)}), "
            f"and by {100.0 * plan.spread:.3g} % in all other parameters of plant and friction."
        )
    constraints = Constraints(limits, grid, coarse, _measured_machines(axis, plan, coarse, measured))
    return TuningSetup(
        training, held_out_runs, lanes, limits, constraints, space, speeds, friction, tuple(notes), tuple(measured)
    )


def _measured_machines(
    axis: Axis, plan: TuningPlan, sampling: Sampling, measured: Sequence[FrequencyResponse]
) -> tuple[MeasuredMachine, ...]:
    """The measured plants, about the speed that is tuned at and under the lowest load."""
    drive, controller = as_arrays((smooth(axis.drive), smooth(axis.controller)))
    point = as_arrays(OperatingPoint(plan.top_speed, plan.loads[0]))
    return tuple(
        MeasuredMachine(
            drive,
            point,
            measured_plant(drive, controller, sampling, point, one.of, one.frequency, one.at_table(axis.sheet)),
        )
        for one in measured
    )


def _require_shown(
    controller: Controller, signals: EnsembleSignals, requirements: Requirements, objective: Objective
) -> None:
    """Raise `ParameterError` for a requirement that cannot be judged of this controller: it would count as kept."""
    if requirements.states("load_error"):
        signals.require_load_error("requirements")
    if objective.load_error:
        signals.require_load_error("objective")
    if requirements.states("load_settling") and innovation_load_observer(controller) is None:
        raise ParameterError(
            "requirements: load_settling: this controller has no load estimator as eq. (20) that could be kept to it"
        )


def _limits(
    axis: Axis, requirements: Requirements, signals: EnsembleSignals, training: Sequence[Scenario], settle: float
) -> tuple[LoopLimits, list[str]]:
    """The requirements as limits, those relative to the gains as given from what these do; and what to say of them."""
    noise, load_error = requirements.command_noise, requirements.load_error
    if signals.load_error is None:
        load_error = None
    is_relative = isinstance(noise, AsGiven) or isinstance(load_error, AsGiven)
    scenarios = training if is_relative else ()
    before = [run_scenario(axis.controller, scenario, axis.sampling, settle) for scenario in scenarios]
    notes: list[str] = []
    if any(result.run.status.code == "diverged" for result in before):
        _require_unstated(requirements)
        noise, load_error = (None if isinstance(limit, AsGiven) else limit for limit in (noise, load_error))
        notes.append(f"{DIVERGES}, so that the default limits of command noise and load error do not apply.")
    if isinstance(noise, AsGiven):
        factor, noise = noise.factor, noise.factor * max(result.command_noise for result in before)
        notes.append(f"Command noise is limited to {factor:g} times that of the gains as given: {noise:.3g} N.")
    if not isinstance(load_error, AsGiven):
        return requirements.limits(noise, load_error), notes
    factor = load_error.factor
    errors = np.array([factor * result.load_error for result in before if result.load_error is not None])
    notes.append(f"The load error in each scenario is limited to {factor:g} times that of the gains as given.")
    return requirements.limits(noise, errors), notes


def _require_unstated(requirements: Requirements) -> None:
    """Raise `ParameterError` for a limit that somebody wants relative to gains with which the loop diverges."""
    for name in ("command_noise", "load_error"):
        if isinstance(getattr(requirements, name), AsGiven) and requirements.states(name):
            raise ParameterError(f"requirements: {name}: {DIVERGES}: state it in N, or None for no limit")


def margin_speeds(plan: TuningPlan) -> tuple[float, ...]:
    """The speeds (m/s) at which margins are looked at."""
    return (*LOW_SPEEDS, *(factor * plan.top_speed for factor in SPEED_FACTORS))
