"""The error per turn of the screw: a wave along the stroke, at the stated lead or at a period that stands out."""

import numpy as np
from jaxtyping import Float

from diffdrive.axis import Axis
from diffdrive.effects.scale import LeadError

_BINS = 8192  # along the stroke, at most
_PADDED = 4  # finer grid of frequencies
FEWEST_TURNS = 3  # on the stroke: fewer are a bend of the scale
AROUND = 2.0  # a line stands out of the spectrum within this factor of its frequency
LEVEL = 0.05  # probability that any frequency stands out so by chance


def stated_lead(axis: Axis | None) -> float | None:
    """The screw's lead (m) where the axis's data sheet states it, or its lead error; None otherwise."""
    if axis is None:
        return None
    if axis.sheet.lead is not None:
        return axis.sheet.lead
    return next((float(effect.lead) for effect in axis.drive.effects if isinstance(effect, LeadError)), None)


def wave(position: Float[np.ndarray, " n"], period: float) -> dict[str, Float[np.ndarray, " n"]]:
    """Its two columns."""
    phase = 2.0 * np.pi * position / period
    return {"cosine": np.cos(phase), "sine": np.sin(phase)}


def find_period(position: Float[np.ndarray, " n"], residual: Float[np.ndarray, " n"]) -> float | None:
    """The period (m) of a line that stands out of the residual's spectrum along the stroke; None if there is none.

    The power at a frequency without a line is exponentially distributed about what its neighbours have.
    """
    low, travel = float(np.min(position)), float(np.ptp(position))
    bins = int(min(_BINS, len(position) // 4))
    if travel == 0.0 or bins < 32:
        return None
    place = np.minimum(((position - low) / travel * bins).astype(int), bins - 1)
    limit = 3.0 * float(np.median(np.abs(residual))) + np.finfo(float).tiny
    sums = np.bincount(place, np.clip(residual, -4.0 * limit, 4.0 * limit), minlength=bins)
    power = np.abs(np.fft.rfft(sums, _PADDED * bins)) ** 2
    turns = np.arange(len(power)) / _PADDED
    first, last = FEWEST_TURNS * _PADDED, len(power) // 2
    if last <= first:
        return None
    order = np.argsort(power[first:last])[::-1][:50] + first
    best = None
    for k in order:
        if power[k] < power[k - 1] or power[k] < power[min(k + 1, len(power) - 1)]:
            continue
        around = (turns > turns[k] / AROUND) & (turns < turns[k] * AROUND) & (np.abs(turns - turns[k]) > 1.5)
        mean = float(np.median(power[around])) / np.log(2.0)
        chance = (last - first) / _PADDED * float(np.exp(-power[k] / max(mean, np.finfo(float).tiny)))
        if chance < LEVEL:
            best = k
            break
    if best is None:
        return None
    # the vertex of the parabola through the three powers about it
    left, middle, right = power[best - 1], power[best], power[best + 1]
    shift = 0.5 * (left - right) / (left - 2.0 * middle + right)
    return travel / ((best + float(shift)) / _PADDED)
