"""A small tuning that the tests share: a short reversal, two loads, few operating points, compiled once."""

from functools import cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Actuator, Sampling, Sensor
from diffdrive.model.presets import paper_drive
from diffdrive.motion.builders import triangular
from diffdrive.numerics.arrays import as_arrays
from experiments.studies.paper import scenario as paper
from tuning.gains.constrained import ConstrainedGains, tuning_problem
from tuning.gains.objective import Objective
from tuning.gains.requirements import Constraints, LoopLimits, operating_points
from tuning.gains.scenarios import Scenario, ensemble
from tuning.gains.tune import default_space

SAMPLING = Sampling(substeps=2)
MOTION = triangular(speed=0.010, stroke=0.0009, rounding=0.02, duration=0.15, rate=10_000.0, first_reversal=0.08)
LIMITS = LoopLimits(command_noise=15.0)


def drive():
    """The paper's, with a sample of delay and white noise in place of the scale's steps."""
    return eqx.tree_at(
        lambda d: (d.actuator, d.sensor),
        paper_drive(),
        (Actuator(delay_samples=1), Sensor(None, 2e-8)),
        is_leaf=lambda leaf: isinstance(leaf, Actuator | Sensor),
    )


def controller(name="PD+FC+LS"):
    return paper.controllers(drive())[name]


@cache
def scenarios():
    return [Scenario(f"{load:g} N", drive(), MOTION, load, seed) for seed, load in enumerate((0.0, 8_000.0))]


@cache
def lanes():
    return ensemble(scenarios(), SAMPLING, settle=0.03)


def requirements(limits=LIMITS):
    return Constraints(limits, operating_points([drive()], (0.0, 0.01), (0.0, 8_000.0)), SAMPLING)


def small_problem(limits=LIMITS, objective=Objective(), name="PD+FC+LS"):
    """Gains, problem and space."""
    space = default_space(controller(name))
    problem = tuning_problem(as_arrays(smooth(controller(name))), space, lanes(), requirements(limits))
    return ConstrainedGains(space.free, objective), problem, space


def point_of(*values):
    return jnp.asarray(np.array(values))
