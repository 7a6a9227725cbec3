"""Why an answer that a search converged to is not to be believed, and what of it holds all the same."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.stats

from diffdrive.errors import DiffdriveError
from diffdrive.logs import Log
from diffdrive.model.parameters import Drive
from tuning.identification import inverse_dynamics
from tuning.identification.estimates import NORMAL, EstimateStatus
from tuning.identification.gaps import delay_of, mean_square_force
from tuning.identification.identify import Identification
from tuning.identification.inverse_dynamics import MIN_SPEED, InverseDynamics
from tuning.identification.regressors import DIRECTIONAL

# Friction less than half, or more than twice, of what the command shows while the table slides that way: the rest of
# the command is then a force of another kind, as large as the friction itself.
FACTOR = 2.0
HARDLY = 0.1  # half of an interval over the value, from which a parameter is hardly determined
CHANCE = 0.01  # that the disturbance of a held-out log seems to rise


class DeterminedSum(NamedTuple):
    """A sum (or difference) of two parameters that the logs determine better than either: N, or its unit."""

    first: str
    second: str
    sign: int  # of the second
    value: float
    half_width: float  # of the 95 % interval
    unit: str

    @property
    def message(self) -> str:
        """In one sentence."""
        sign = "+" if self.sign > 0 else "-"
        return (
            f"{self.first} {sign} {self.second} is {self.value:.4g} ± {self.half_width:.2g} {self.unit}; these logs "
            "hardly say how much of it is either"
        )


def determined_sums(found: Identification) -> list[DeterminedSum]:
    """Of each pair of parameters that the logs hardly tell apart, what they determine: their sum, or their difference.

    Of pairs of one unit; the sum of others means nothing to a reader. And where a part is hardly determined, measured
    by the larger of the two: a constant force of 0 ± 2 N beside 250 N of friction is known as well as it need be.
    """
    order = {one.path: k for k, one in enumerate(found.estimates) if one.status is EstimateStatus.FITTED}
    sums = []
    for first, second, correlation in found.correlated:
        if first not in order or second not in order:
            continue
        one, other = (found.estimates[order[path]] for path in (first, second))
        if one.unit != other.unit:
            continue
        largest = max(found.estimate_covariance[order[path], order[path]] for path in (first, second))
        widest = NORMAL * float(np.sqrt(largest))
        if widest <= HARDLY * max(abs(one.value), abs(other.value)):
            continue
        sign = -1 if correlation > 0 else 1
        weights = np.zeros(len(found.estimates))
        weights[order[first]], weights[order[second]] = 1.0, sign
        variance = float(weights @ found.estimate_covariance @ weights)
        half_width = NORMAL * float(np.sqrt(max(variance, 0.0)))
        sums.append(DeterminedSum(one.name, other.name, sign, one.value + sign * other.value, half_width, one.unit))
    return sums


def doubts(found: Identification, believed: Drive, logs: Sequence[Log], held_out: Sequence[Log]) -> list[str]:
    """What speaks against the answer, one sentence each; none where nothing does."""
    against = [*_starts_disagree(found), *_leaves_inverse_dynamics(found, believed, logs)]
    return [*against, *_rises(found, believed, held_out)]


def _starts_disagree(found: Identification) -> list[str]:
    """Another start that explains the logs as well, elsewhere."""
    if not found.rival:
        return []
    values = ", ".join(one.words for one in found.rival)
    return [
        f"the starts disagree: another search explains the logs as well with {values}; these logs do not decide, so "
        "add a motion that does, or fix what you know"
    ]


def _leaves_inverse_dynamics(found: Identification, believed: Drive, logs: Sequence[Log]) -> list[str]:
    """Friction that is far from the command that it takes to slide that way."""
    try:
        shown = inverse_dynamics.identify(list(logs), DIRECTIONAL, min_speed=MIN_SPEED)
    except DiffdriveError:
        return []
    friction, stated = found.drive.friction, float(believed.plant.constant_force)
    messages = []
    for side, way, sign in (("positive", "forwards", 1.0), ("negative", "backwards", -1.0)):
        level = _level(shown, side) + sign * stated  # the command has to overcome both
        fitted = float(getattr(friction.coulomb_at(shown.load), side))
        if level > 0 and not 1.0 / FACTOR < fitted / level < FACTOR:
            messages.append(
                f"the Coulomb friction {way} is {fitted:.4g} N, while inverse dynamics shows {level:.4g} N: the rest "
                f"is a constant force of {float(found.drive.plant.constant_force):.4g} N or depends on speed; if the "
                "axis lies flat, hold it: fix constant_force"
            )
    return messages


def _level(shown: InverseDynamics, side: str) -> float:
    """Coulomb friction (N) under the logs' load as inverse dynamics shows it; NaN where it does not."""
    slope = shown.load_coefficient
    level = float(getattr(shown.coulomb, side))
    return level if slope is None else level + float(getattr(slope, side)) * shown.load


def _rises(found: Identification, believed: Drive, held_out: Sequence[Log]) -> list[str]:
    """Logs that were held out and are further from the identified drive than from the believed one."""
    if not held_out:
        return []
    delay = next(one.value for one in found.estimates if one.name == "delay")
    before = np.concatenate([mean_square_force(believed, delay_of(believed), log, found.between) for log in held_out])
    after = np.concatenate([mean_square_force(found.drive, delay, log, found.between) for log in held_out])
    rise = after - before
    if len(rise) < 2 or not np.mean(rise) > 0.0:
        return []
    if scipy.stats.ttest_1samp(rise, 0.0, alternative="greater").pvalue >= CHANCE:
        return []
    was, now = (float(np.sqrt(np.mean(blocks))) for blocks in (before, after))
    return [
        f"on the held-out logs the disturbance force rose from {was:.3g} to {now:.3g} N RMS: what was identified does "
        "not hold there; do all logs show one state of the machine?"
    ]
