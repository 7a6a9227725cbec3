"""What identifies a sweep: everything that its numbers depend on."""

import numpy as np

from diffdrive.motion.motion import Motion
from diffdrive.numerics.arrays import as_arrays
from diffdrive.runtime import arithmetic_signature
from tuning.store.edition import code_digest
from tuning.store.store import digest
from tuning.sweeps.plan import SweepPlan


def identity(plan: SweepPlan) -> str:
    """A digest of a plan, of the code that runs it, and of how the processor computes."""
    limits = plan.axis.limits
    recipes = (None if recipe is None else (recipe.kind, recipe.settings) for recipe in plan.recipes.values())
    return digest(
        code_digest(),
        arithmetic_signature(),
        *(plan.method, plan.seed, plan.samples, plan.part_size, plan.load, plan.settle, plan.precision),
        [quantity.text for quantity in plan.varied],
        {name: dict(others) for name, others in plan.correlation.items()},
        list(recipes),
        # which numbers are floats, and which are arrays, is no part of them
        np.array([*limits.stroke, limits.speed, limits.acceleration], float),
        (float(plan.axis.sampling.rate), plan.axis.sampling.plant_steps),
        as_arrays((plan.axis.drive, dict(plan.controllers))),
        {name: np.array(_signals(motion), float) for name, motion in plan.motions.items()},
    )


def _signals(motion: Motion) -> tuple[np.ndarray, ...]:
    """All that a loop takes of a motion: velocity and acceleration drive the feed-forward."""
    return motion.time, motion.position, motion.velocity, motion.acceleration
