"""Gain and phase margins and peak sensitivity of a loop, differentiable.

    response on a grid -> cubics between -> the critical frequencies -> response there -> margins

The critical frequencies come from cubics through the grid's values and slopes in the logarithm of frequency. There the
response is computed again, with its derivative in every gain, and one Newton step follows each crossing as the gains
move it. A margin that does not exist (no crossing) is infinite, and its derivative zero.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Complex, Float

from diffdrive.loop.linearise import OpenLoop, Response, growth_rate, response
from diffdrive.numerics.arrays import Scalar

LOWEST_FREQUENCY = 0.5  # Hz
POINTS_PER_DECADE = 60
REFINEMENTS, SUBDIVISIONS = 6, 8
NEUTRAL_GROWTH = 0.2  # 1/s: slower growth (a load that is not observable at rest) does not count as unstable


class Margins(NamedTuple):
    """How far a loop is from instability. Gains are factors, not decibels."""

    growth: Scalar  # 1/s, of the dominant mode; above `NEUTRAL_GROWTH` the loop is unstable, and the rest void
    gain_up: Scalar  # factor by which the gain may rise
    gain_down: Scalar  # factor by which the gain may fall, above 1
    phase: Scalar  # rad
    sensitivity: Scalar  # peak of |1 / (1 + L)|, Ms
    crossover: Scalar  # Hz, the highest frequency with |L| = 1; 0 where there is none


def frequency_grid(rate: float) -> Float[np.ndarray, " f"]:
    """Where margins are looked for (Hz): from `LOWEST_FREQUENCY` to half the control rate, where a response is real."""
    highest = 0.4999 * rate
    grid = np.geomspace(LOWEST_FREQUENCY, highest, int(POINTS_PER_DECADE * np.log10(highest / LOWEST_FREQUENCY)))
    return np.append(grid, 0.5 * rate)


def margins(loop: OpenLoop) -> Margins:
    """Margins of an open loop; pure, differentiable once."""
    grid = frequency_grid(1.0 / loop.period)
    return margins_of_response(lambda frequency: response(loop, frequency), grid, growth_rate(loop))


def margins_of_response(
    respond: Callable[[Float[Array, " f"] | Float[np.ndarray, " f"]], Response],
    grid: Float[Array, " f"] | Float[np.ndarray, " f"],
    growth: Scalar,
    *,
    ends_real: bool = True,
) -> Margins:
    """Margins of a response, which are looked for on the `grid` (Hz); `growth` (1/s) is passed on.

    Pure, differentiable once in what `respond` depends on. `ends_real`: the grid ends where the response is real, as it
    is at half the control rate, so that it meets the real axis there as well.
    """
    critical = lax.stop_gradient(_critical_frequencies(respond(grid), ends_real))
    at_critical = respond(critical.frequency)
    value, slope = jnp.where(critical.exists, at_critical.loop, 1.0), at_critical.slope

    def newton_step(residual: Scalar, rate: Scalar) -> Scalar:
        """The Newton step to the crossing, in the logarithm of frequency: zero, with its derivative."""
        return -residual / lax.stop_gradient(jnp.where(rate == 0, 1.0, rate))

    def real_axis_crossing(k: int) -> Scalar:
        return -jnp.real(value[k] + slope[k] * newton_step(jnp.imag(value[k]), jnp.imag(slope[k])))

    def unit_circle_shift(k: int) -> Scalar:
        return newton_step(jnp.log(jnp.abs(value[k])), jnp.real(slope[k] / value[k]))

    exists = critical.exists
    phase = jnp.abs(jnp.angle(-(value[2] + slope[2] * unit_circle_shift(2))))
    return Margins(
        growth=growth,
        gain_up=jnp.where(exists[0], 1.0 / jnp.where(exists[0], real_axis_crossing(0), 1.0), jnp.inf),
        gain_down=jnp.where(exists[1], real_axis_crossing(1), jnp.inf),
        phase=jnp.where(exists[2], phase, jnp.inf),
        sensitivity=1.0 / jnp.abs(1.0 + value[3]),
        crossover=jnp.where(exists[4], critical.frequency[4] * jnp.exp(unit_circle_shift(4)), 0.0),
    )


class _Critical(NamedTuple):
    """The frequencies (Hz) of gain_up, gain_down, phase, sensitivity and crossover, and which of them exist."""

    frequency: Float[Array, "5"]
    exists: Bool[Array, "5"]


def _critical_frequencies(sampled: Response, ends_real: bool) -> _Critical:
    cubic = _Cubic.interpolate(sampled)

    def nearest(candidates: Bool[Array, " i"], distance: Array, log: Array) -> tuple[Scalar, Bool[Array, ""]]:
        chosen = jnp.argmin(jnp.where(candidates, distance, jnp.inf))
        return jnp.exp(jnp.where(candidates, log, 0.0)[chosen]), jnp.any(candidates)  # 1 Hz where there is none

    share, crosses = _crossings(cubic, jnp.imag, sampled.loop)  # of the real axis, on which the response ends as well
    log = jnp.append(cubic.start + share * cubic.step, jnp.log(sampled.frequency[-1]))
    real = -jnp.append(jnp.real(cubic.at(share)), jnp.real(sampled.loop[-1]))
    crosses = jnp.append(crosses, ends_real)
    up, down = crosses & (real > 0.0) & (real < 1.0), crosses & (real >= 1.0)
    gain_up, gain_down = nearest(up, -real, log), nearest(down, real, log)

    share, crosses = _crossings(cubic, lambda loop: jnp.log(jnp.abs(loop)), sampled.loop)
    log = cubic.start + share * cubic.step
    phase = nearest(crosses, jnp.abs(jnp.angle(-cubic.at(share))), log)
    crossover = nearest(crosses, -log, log)
    peak = jnp.exp(_nearest_to_minus_one(cubic)), jnp.array(True)
    pairs = (gain_up, gain_down, phase, peak, crossover)
    return _Critical(jnp.stack([pair[0] for pair in pairs]), jnp.stack([pair[1] for pair in pairs]))


class _Cubic(NamedTuple):
    """The response on each interval of the logarithm of frequency, as a cubic in the share 0 to 1 of the interval."""

    start: Float[Array, " i"]
    step: Float[Array, " i"]
    c0: Complex[Array, " i"]
    c1: Complex[Array, " i"]
    c2: Complex[Array, " i"]
    c3: Complex[Array, " i"]

    @classmethod
    def interpolate(cls, sampled: Response) -> "_Cubic":
        """The cubics with the response's values and slopes at the ends of each interval."""
        log = jnp.log(sampled.frequency)
        step = jnp.diff(log)
        before, after = sampled.loop[:-1], sampled.loop[1:]
        first, last = sampled.slope[:-1] * step, sampled.slope[1:] * step
        rise = after - before
        return cls(log[:-1], step, before, first, 3 * rise - 2 * first - last, first + last - 2 * rise)

    def at(self, share: Array) -> Complex[Array, "..."]:
        return self.c0 + share * (self.c1 + share * (self.c2 + share * self.c3))

    def slope(self, share: Array) -> Complex[Array, "..."]:
        return self.c1 + share * (2.0 * self.c2 + 3.0 * share * self.c3)

    def curvature(self, share: Array) -> Complex[Array, "..."]:
        return 2.0 * self.c2 + 6.0 * share * self.c3


def _nearest_to_minus_one(cubic: _Cubic) -> Scalar:
    """The logarithm of the frequency nearest to -1: the nearest of a finer grid, and Newton's steps from there."""
    shares = jnp.linspace(0.0, 1.0, SUBDIVISIONS, endpoint=False)[:, None]
    distance = jnp.abs(1.0 + cubic.at(shares))
    best = jnp.argmin(jnp.min(distance, axis=0))
    initial = share = shares[jnp.argmin(distance[:, best]), 0]
    segment = _Cubic(*(part[best] for part in cubic))
    for _ in range(REFINEMENTS):
        difference, slope = 1.0 + segment.at(share), segment.slope(share)
        rise = jnp.real(jnp.conj(difference) * slope)  # of half the squared distance
        curvature = jnp.abs(slope) ** 2 + jnp.real(jnp.conj(difference) * segment.curvature(share))
        step = jnp.where(curvature > 0.0, -rise / jnp.where(curvature > 0.0, curvature, 1.0), 0.0)
        share = jnp.clip(share + step, initial - 1.0 / SUBDIVISIONS, initial + 1.0 / SUBDIVISIONS)
    return segment.start + share * segment.step


def _crossings(
    cubic: _Cubic, component: Callable[[Array], Array], values: Complex[Array, " f"]
) -> tuple[Float[Array, " i"], Bool[Array, " i"]]:
    """The share of each interval at which `what` of the response is zero, by bisecting its secant; whether it is."""
    values_at_knots = component(values)
    crosses = (values_at_knots[:-1] > 0) != (values_at_knots[1:] > 0)
    low, high = jnp.zeros(len(values_at_knots) - 1), jnp.ones(len(values_at_knots) - 1)
    below, above = values_at_knots[:-1], values_at_knots[1:]
    share = low
    for _ in range(REFINEMENTS):
        span = jnp.where(crosses, above - below, 1.0)
        share = jnp.clip(low - below / span * (high - low), low, high)
        value = component(cubic.at(share))
        same = (value > 0) == (below > 0)
        low, below = jnp.where(same, share, low), jnp.where(same, value, below)
        high, above = jnp.where(same, high, share), jnp.where(same, above, value)
    return share, crosses
