"""The gains of a cascade as they are reported: by name and unit, each with its interval."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from diffdrive.controllers.cascade import Cascade
from tuning.identification.controller.fit import Alternative, LawFit
from tuning.identification.controller.law import Law, Reading
from tuning.identification.controller.search import TINY

LEVEL = 0.95
# what is compared and reported: K_v, velocity gain, inverse reset time, feed-forwards, following error per speed
PARTS = ("log kp", "log kv", "rate", "velocity feed-forward", "acceleration feed-forward", "following time")


class Gain(NamedTuple):
    """One gain, between `low` and `high` with 95 % confidence; `determined` where the log tells it from zero."""

    name: str
    unit: str
    value: float
    low: float
    high: float
    determined: bool


@dataclass(frozen=True)
class Parts:
    """`PARTS` of a controller with their covariance, in SI units; `freedom` is that of the covariance."""

    values: np.ndarray
    covariance: np.ndarray
    freedom: float


def parts_of(fit: LawFit, control_period: float | None) -> Parts:
    """The parts of a fitted law: their mean over what it may be.

    The velocity gain is K less half a period of the integral. If no period is stated, that of the rows is taken where
    each is a sample; as a velocity over whole rows of a faster loop looks the same, anything shorter counts as its
    spread. Of snapshots it is anything up to half a row, or the window of the velocity where that is shorter, whose
    middle is taken.
    """
    deviation = 0.0
    if control_period is None and fit.reading is Reading.EVERY_SAMPLE:
        control_period, deviation = fit.period, fit.period / np.sqrt(3.0)
    elif control_period is None:
        longest = fit.period * float(np.clip(fit.law.window.real, TINY, 0.5))
        control_period, deviation = 0.5 * longest, longest / np.sqrt(12.0)
    each = [_parts_with_covariance(one, control_period, deviation) for one in fit.mixture]
    share = np.array([one.share for one in fit.mixture])
    values, own = (np.stack(some) for some in zip(*each, strict=True))
    mean = share @ values
    apart = values - mean
    covariance = np.einsum("m,mij->ij", share, own) + np.einsum("m,mi,mj->ij", share, apart, apart)
    return Parts(mean, covariance, fit.freedom)


def _parts_with_covariance(one: Alternative, period: float, deviation: float) -> tuple[np.ndarray, np.ndarray]:
    """Those of one law, whose control period has a standard deviation."""
    values = _parts(one.parameters, period).real
    steps = 1j * TINY * np.eye(len(one.parameters))
    jacobian = np.stack([_parts(one.parameters + step, period).imag / TINY for step in steps], axis=1)
    by_period = _parts(one.parameters.astype(complex), period + 1j * TINY).imag / TINY * deviation
    return values, jacobian @ one.covariance @ jacobian.T + np.outer(by_period, by_period)


def _parts(parameters: np.ndarray, period: complex) -> np.ndarray:
    law = Law(*parameters)
    kp, total = np.exp(law.log_kp), np.exp(law.log_gain)
    proportional = 1.0 - 0.5 * period * law.rate
    return np.array(
        [
            law.log_kp,
            law.log_gain + np.log(proportional + 0j),
            law.rate / proportional,
            1.0 - kp * law.kappa,
            total * law.mass,
            law.kappa,
        ]
    )


def parts_of_cascade(cascade: Cascade) -> Parts | None:
    """Those of a controller that is known, without uncertainty; None for one that has more than the law."""
    if not _is_plain(cascade):
        return None
    share = 1.0 if cascade.force_feedforward is None else float(cascade.force_feedforward)
    mass = 0.0 if cascade.feedforward is None else share * float(cascade.feedforward.mass)
    kp, kv, forward = float(cascade.kp), float(cascade.kv), float(cascade.velocity_feedforward)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = float(cascade.ki) / kv if cascade.reset_time is None else 1.0 / float(cascade.reset_time)
        values = np.array([np.log(kp), np.log(kv), rate, forward, mass, (1.0 - forward) / kp])
    return Parts(values, np.zeros((len(PARTS), len(PARTS))), np.inf) if np.all(np.isfinite(values)) else None


def _is_plain(cascade: Cascade) -> bool:
    """Whether it is the law alone: no filter, no slower position loop, no second encoder, no force of its own."""
    filtered = cascade.filters or cascade.velocity_filter_time is not None or cascade.reference_filter_time is not None
    slower = cascade.position_every != 1 or cascade.reference_delay_samples != 0
    damping = None if cascade.feedforward is None else cascade.feedforward.damping
    pushes = damping is not None and (float(damping.positive) != 0 or float(damping.negative) != 0)
    return not (filtered or slower or pushes or "motor" in cascade.feedback_encoders)


def pooled(several: list[Parts]) -> Parts:
    """One controller from several logs, each weighted by the inverse of its covariance.

    Where they scatter more than these explain, the covariance is widened by as much (the factor of Birge).
    """
    if len(several) == 1:
        return several[0]
    independent = [0, 1, 2, 4, 5]  # the velocity feed-forward follows from K_v and the following time
    scale = np.sqrt(np.mean([np.diag(one.covariance)[independent] for one in several], axis=0))
    chosen = np.ix_(independent, independent)
    weights = [np.linalg.pinv(one.covariance[chosen] / np.outer(scale, scale), hermitian=True) for one in several]
    covariance = np.linalg.pinv(np.sum(weights, axis=0), hermitian=True)
    weighted = [weight @ (one.values[independent] / scale) for weight, one in zip(weights, several, strict=True)]
    mean = covariance @ np.sum(weighted, axis=0)
    apart = [one.values[independent] / scale - mean for one in several]
    scatter = sum(float(off @ weight @ off) for weight, off in zip(weights, apart, strict=True))
    log_kp, log_kv, rate, mass, following = scale * mean
    covariance = covariance * np.outer(scale, scale) * max(1.0, scatter / (len(independent) * (len(several) - 1)))
    kp = np.exp(log_kp)
    spread = np.zeros((len(PARTS), len(independent)))
    spread[independent, range(len(independent))] = 1.0
    spread[3] = [-kp * following, 0.0, 0.0, 0.0, -kp]
    values = np.array([log_kp, log_kv, rate, 1.0 - kp * following, mass, following])
    freedom = float(sum(one.freedom for one in several))
    return Parts(values, spread @ covariance @ spread.T, freedom)


def gains_of(parts: Parts) -> tuple[Gain, ...]:
    """The gains that a reader knows, from the parts."""
    quantile = float(student.ppf(0.5 + 0.5 * LEVEL, parts.freedom))
    half = quantile * np.sqrt(np.diag(parts.covariance))
    low, high = parts.values - half, parts.values + half
    ki, ki_half = _integral_gain(parts, quantile)

    def logarithmic(name: str, unit: str, k: int) -> Gain:
        # a standard deviation of half the value or less tells it from zero
        with np.errstate(over="ignore"):  # an interval without end
            value, lowest, highest = np.exp([parts.values[k], low[k], high[k]]).tolist()
        return Gain(name, unit, value, lowest, highest, bool(half[k] < 1.0))

    def linear(name: str, unit: str, k: int) -> Gain:
        return Gain(name, unit, float(parts.values[k]), float(low[k]), float(high[k]), not low[k] <= 0 <= high[k])

    rate = linear("rate", "1/s", 2)
    return (
        logarithmic("kp", "1/s", 0),
        logarithmic("kv", "N*s/m", 1),
        Gain("reset_time", "s", _inverse(rate.value), _inverse(rate.high), _inverse(rate.low), rate.determined),
        Gain("ki", "N/m", ki, ki - ki_half, ki + ki_half, ki > ki_half),
        linear("velocity_feedforward", "1", 3),
        linear("acceleration_feedforward", "kg", 4),
        linear("following_time", "s", 5),
    )


def _integral_gain(parts: Parts, quantile: float) -> tuple[float, float]:
    kv, rate = float(np.exp(parts.values[1])), float(parts.values[2])
    slope = np.array([kv * rate, kv])
    return kv * rate, quantile * float(np.sqrt(slope @ parts.covariance[1:3, 1:3] @ slope))


def _inverse(rate: float) -> float:
    return 1.0 / rate if rate > 0 else np.inf
