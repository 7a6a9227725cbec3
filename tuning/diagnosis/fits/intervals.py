"""How sure the numbers of a fit are: 95 % intervals of what was fitted.

The curvature of the cost is the inverse covariance where the residuals are white and the model is right. Neither is
quite so: the scores of pieces of the logs scatter by more than it says, and give the covariance anew (Huber 1967, White
1982); of the two the wider is told. The details of some effects differ from machine to machine: their numbers are those
of the nearest machine of the kind, and are trusted to some per cent, however sharp the fit; so are the amounts of what
acts beside them. The times of a load or of a process are trusted to the time that these take to come and go; one that
comes while the table rests is not seen before it slides.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from diffdrive.effects.actuator import LoopDelay
from diffdrive.effects.forces import EDGE_TIME, FrameVibration, ProcessForce
from diffdrive.effects.friction import AppliedLoad, FrictionDwell, PreslidingHysteresis
from diffdrive.effects.transmission import Backlash, Compliance
from tuning.diagnosis.blocks import block_sums
from tuning.diagnosis.fits.curvature import solved
from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.priors import Parameter
from tuning.identification.estimates import NORMAL

DETAILS = {  # of a number: standard deviation of what another machine of its kind would call the same
    Compliance: 0.1,
    Backlash: 0.1,
    PreslidingHysteresis: 0.1,
    FrameVibration: 0.03,
    FrictionDwell: 0.03,
}
SLOW = 1e-3  # m/s, below which the table does not tell what load it bears

Number = float | list[float]
Interval = tuple[Number, Number]


def deviations(fitted: Fitted) -> Float[np.ndarray, " k"]:
    """Standard deviations of what was fitted, the nominal parameters as `NAMES` has them and the others in units of
    the prior: the curvature's, or the scores' where wider.
    """
    model, jacobian = fitted.model, fitted.jacobian
    lanes, samples = model.logged.lanes.position.shape
    curved = solved(fitted.hessian, np.eye(jacobian.shape[1]))
    scores = (jacobian * fitted.residual[:, None]).reshape(lanes, samples, -1)
    pieces = block_sums(scores, model.logged.sampling.rate).reshape(-1, jacobian.shape[1])
    scattered = curved @ (pieces.T @ pieces + np.eye(jacobian.shape[1])) @ curved  # the prior is a score of its own
    units = np.eye(len(curved))
    units[: len(NAMES), : len(NAMES)] = model.prior
    return np.sqrt(np.maximum(*(np.sum((units @ one) * units, axis=1) for one in (curved, scattered))))


def parameters(fitted: Fitted, member: int) -> dict[str, tuple[Number, Interval]]:
    """Value and 95 % interval of each parameter of an effect; lists where they differ from log to log."""
    candidate = fitted.model.members[member].candidate
    details = [DETAILS.get(one.candidate.effect, 0.0) for one in fitted.model.members]
    known, spread = candidate.by_name, deviations(fitted)
    values_of, intervals = fitted.model.values(fitted.theta)[member], dict[str, Any]()
    for k, (index, name, log) in enumerate(fitted.model.slots, start=len(NAMES)):
        if index != member:
            continue
        one, theta = known[name], float(fitted.theta[k])
        trusted = max(details) if one.amplitude else details[member]
        wide = NORMAL * np.hypot(spread[k], trusted * _whole(one, theta))
        value, low, high = one.value(theta), one.value(theta - wide), one.value(theta + wide)
        if candidate.effect in (AppliedLoad, ProcessForce) and name in ("start", "end") and log is not None:
            edge = float(values_of.get("edge", np.full(log + 1, EDGE_TIME))[log])
            low, high = _through_rests(fitted, log, low - 0.5 * edge, high + 0.5 * edge)
        if candidate.effect is LoopDelay:
            value, low, high = (fitted.model.logged.control_periods * number for number in (value, low, high))
        if log is None:
            intervals[name] = (value, (low, high))
        else:
            values, (lows, highs) = intervals.get(name, ([], ([], [])))
            intervals[name] = ([*values, value], ([*lows, low], [*highs, high]))
    return intervals


def _whole(parameter: Parameter, theta: float) -> float:
    """A value's magnitude in units of its prior."""
    return abs(parameter.value(theta) / parameter.slope(theta)) if parameter.slope(theta) else 0.0


def _through_rests(fitted: Fitted, log: int, low: float, high: float) -> tuple[float, float]:
    """An interval of times (s) with the rests of the table that it touches."""
    logged = fitted.model.logged
    ends = [low, high]
    for lane in (k for k, owner in enumerate(logged.owner) if owner == log):
        rests = (np.abs(np.asarray(fitted.filtered.trajectory.velocity)[lane]) < SLOW) & (logged.lanes.counts[lane] > 0)
        edges = np.flatnonzero(np.diff(np.r_[0, rests.astype(int), 0]))
        for begin, end in float(logged.starts[lane]) + edges.reshape(-1, 2) / logged.sampling.rate:
            if begin <= high and end >= low:
                ends += [float(begin), float(end)]
    return min(ends), max(ends)
