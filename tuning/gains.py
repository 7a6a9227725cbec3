"""Gradient tuning of a controller's gains on the residuals of an ensemble of scenarios."""

from dataclasses import dataclass

import jax
import numpy as np

from diffdrive.controllers import DOBVSC, Cascade, Controller, FrictionCompensation, PDFeedforwardDOB
from diffdrive.load_estimator import InnovationLoad
from diffdrive.observer import LoadStateObserver
from diffdrive.parameters import as_arrays, check, require_double_precision
from diffdrive.smooth import smooth
from tuning.least_squares import Progress, Search, levenberg_marquardt, silent
from tuning.objective import Ensemble
from tuning.space import Space, around

FEEDBACK_FACTOR = 1.3  # kp and kd stay near the commissioned loop: no stability margin holds them back here
FILTER_FACTOR = 1e3


def default_space(controller: Controller) -> Space:
    """The gains that this kind of controller is tuned by, and how far each may move from where it is."""
    near, far = FEEDBACK_FACTOR, FILTER_FACTOR
    if isinstance(controller, Cascade):
        return around(controller, {"kp": near, "kv": near, "ki": near})
    factors = {"tracking.gains.kp": near, "tracking.gains.kd": near}
    if isinstance(controller, DOBVSC | PDFeedforwardDOB):
        factors["observer.cutoff"] = 3.0
    if isinstance(controller, DOBVSC):
        factors |= {"reach": 10.0, "layer": 10.0, "slope": 10.0}
    if isinstance(controller, FrictionCompensation):
        noises = ["position", "velocity", "bristle", "measurement"]
        if isinstance(controller.observer, LoadStateObserver):
            noises.append("load")
        factors |= {f"observer.tuning.{name}": far for name in noises}
        estimator = getattr(controller.observer, "load_estimator", None)
        if isinstance(estimator, InnovationLoad):
            factors["observer.load_estimator.gain"] = far
    return around(controller, factors)


@dataclass(frozen=True)
class Tuned:
    """The tuned controller, each gain before and after, those that ended at a bound, and the search behind them."""

    controller: Controller
    names: list[str]
    before: np.ndarray
    after: np.ndarray
    at_bound: list[str]
    search: Search


def tune(
    controller: Controller,
    scenarios: Ensemble,
    space: Space | None = None,
    *,
    max_steps: int = 20,
    tolerance: float = 1e-3,
    progress: Progress = silent,
) -> Tuned:
    """Tune `controller` on its smooth variant over `scenarios`; verify the result on the exact simulator.

    The search's cost is the root of the mean squared cost over the loads, in units of `Scales`.
    """
    require_double_precision()
    check(controller)
    space = default_space(controller) if space is None else space
    search = levenberg_marquardt(
        lambda y, args: args[1].residuals(space.insert(args[0], y)),
        np.zeros(len(space.free)),
        (as_arrays(smooth(controller)), scenarios),
        max_steps=max_steps,
        tolerance=tolerance,
        progress=progress,
    )
    return Tuned(
        controller=jax.tree.map(float, space.insert(as_arrays(controller), search.y)),
        names=space.names,
        before=np.asarray(space.values(np.zeros_like(search.y))),
        after=np.asarray(space.values(search.y)),
        at_bound=space.at_bound(search.y),
        search=search,
    )
