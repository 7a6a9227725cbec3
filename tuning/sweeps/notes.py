"""What to expect of a sweep before it runs."""

from diffdrive.loop.convergence import convergence_warnings
from tuning.sweeps.plan import SweepPlan


def convergence_notes(plan: SweepPlan) -> tuple[str, ...]:
    """Where a controller's load estimator does not converge; of settings that vary, the first warning of each kind."""
    notes = []
    for motion in plan.motions:
        extremes = plan.extreme_cycles(motion)
        for name, controller in plan.controllers.items():
            first: dict[str, str] = {}
            for cycle in extremes:
                for text in convergence_warnings(controller, *cycle, plan.axis.sampling.period):
                    first.setdefault(text.partition(" at ")[0], text)
            notes += [f"{motion}, {name}: {text}" for text in first.values()]
    return tuple(notes)
