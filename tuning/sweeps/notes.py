"""What to expect of a sweep before it runs."""

import numpy as np

from diffdrive.axis import Axis
from diffdrive.loop.convergence import convergence_warnings
from tuning.sweeps.duty_cycles import DutyCycle
from tuning.sweeps.identified import Distributions, about_nominal
from tuning.sweeps.plan import SweepPlan


def convergence_notes(plan: SweepPlan) -> tuple[str, ...]:
    """Where a controller's load estimator does not converge; of settings that vary, the first warning of each kind."""
    notes = []
    for motion in plan.motions:
        extremes = extreme_cycles(plan, motion)
        for name, controller in plan.controllers.items():
            first: dict[str, str] = {}
            for cycle in extremes:
                for text in convergence_warnings(controller, *cycle, plan.axis.sampling.period):
                    first.setdefault(text.partition(" at ")[0], text)
            notes += [f"{motion}, {name}: {text}" for text in first.values()]
    return tuple(notes)


def uncertainty_notes(axis: Axis, varied: Distributions) -> tuple[str, ...]:
    """Which parameters vary since the axis says how well it knows them."""
    left_open = {} if axis.uncertainty is None else about_nominal(axis.uncertainty).vary
    own = [name for name, text in left_open.items() if varied.vary.get(name) == text]
    if not own:
        return ()
    return (f"{axis.name}: varies by the [uncertainty] of its drive file: {', '.join(own)}.",)


def extreme_cycles(plan: SweepPlan, motion: str) -> list[DutyCycle]:
    """What comes at worst: the ends of the settings, with the least and the most of the load that varies."""
    cycles = plan.cycles(plan.corner_numbers(), motion) if plan.has_own_cycles else [plan.nominal_cycle(motion)]
    ends = {quantity.name: quantity.quantile(np.array([0.0, 1.0])) for quantity in plan.varied}
    behind = np.append(ends.get("load.change", []), 0.0)
    more = [load + change for load in ends.get("load", [0.0]) for change in behind]
    return [DutyCycle(motion, np.concatenate([load + each for each in more])) for motion, load in cycles]
