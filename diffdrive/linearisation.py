"""An axis linearised about a steady motion: its open loop's frequency response, and stability margins."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from diffdrive.axis import Axis, require_axis
from diffdrive.controllers.base import require_rate
from diffdrive.errors import ParameterError
from diffdrive.loop import linearise as loop
from diffdrive.loop import margins as loop_margins
from diffdrive.numerics.arrays import Scalar, as_arrays, require_double_precision
from diffdrive.simulation import checked_machine


class StabilityMargins(eqx.Module):
    """How far a loop is from instability; a margin that does not exist is infinite, its derivative zero."""

    gain_margin_up: Scalar  # dB, by which the loop's gain may rise
    gain_margin_down: Scalar  # dB, by which it may fall
    phase_margin: Scalar  # deg
    peak_sensitivity: Scalar  # largest |1 / (1 + L)|, Ms
    crossover: Scalar  # Hz, the highest frequency with |L| = 1; 0 where there is none
    growth: Scalar  # 1/s, of the closed loop's dominant mode

    @property
    def gain_margin(self) -> Scalar:
        """The smaller of the gain margins up and down (dB)."""
        return jnp.minimum(self.gain_margin_up, self.gain_margin_down)

    @property
    def stable(self) -> Bool[Array, ""]:
        """Whether no mode of the closed loop grows; where one does, the margins are void."""
        return jnp.asarray(self.growth) < loop_margins.NEUTRAL_GROWTH

    def __repr__(self) -> str:
        if any(isinstance(leaf, jax.core.Tracer) or np.ndim(leaf) for leaf in jax.tree.leaves(self)):
            return f"StabilityMargins of {jax.tree.leaves(self)[0]!r}"
        grows = "" if np.isinf(float(self.growth)) else f": a mode grows by {float(self.growth):.3g} 1/s"
        verdict = "stable" if self.stable else f"UNSTABLE{grows}"
        return (
            f"{verdict}; gain margins {float(self.gain_margin_up):z.3g} dB up, {float(self.gain_margin_down):z.3g} dB "
            f"down, phase margin {float(self.phase_margin):z.3g} deg at {float(self.crossover):.3g} Hz, peak "
            f"sensitivity {float(self.peak_sensitivity):.3g}"
        )


class LinearLoop(eqx.Module):
    """The loop of an axis about a steady motion, opened where the amplifier's force reaches the table.

    One from `jax.vmap` is a loop for each lane, and so are its margins and its response.
    """

    open_loop: loop.OpenLoop  # x' = a x + b force, requested = c x, per control period
    velocity: Scalar  # m/s
    load: Scalar  # N

    def margins(self) -> StabilityMargins:
        """Gain and phase margins and peak sensitivity; differentiable once."""
        if self._has_lanes:
            return jax.vmap(LinearLoop.margins)(self)
        return stability_margins(_margins(self.open_loop))

    def response(self, frequencies: Float[Array, " f"] | Float[np.ndarray, " f"]) -> Complex[Array, "*lanes f"]:
        """The open loop L at `frequencies` (Hz, up to half the control rate): requested force over force on the table.

        Negative feedback is understood: the closed loop is unstable where L reaches -1. L is a ratio of forces, so it
        has no unit: `20 log10 |L|` is its gain in dB, `angle(L)` its phase in rad. Differentiable once.

        Raises:
            ParameterError: A frequency is not above 0, or beyond half the control rate.

        """
        frequencies = jnp.asarray(frequencies, jnp.float64)
        highest = 0.5 / self.open_loop.period
        if frequencies.ndim != 1 or not frequencies.size:
            raise ParameterError("frequencies: must be an array of one or more, in Hz")
        if not isinstance(frequencies, jax.core.Tracer):
            outside = ~((frequencies > 0.0) & (frequencies <= highest * (1.0 + 1e-9)))
            if bool(jnp.any(outside)):
                bad = float(frequencies[jnp.argmax(outside)])
                raise ParameterError(f"frequencies: {bad:g} Hz is not above 0 and up to {highest:g} Hz, half the rate")
        if self._has_lanes:
            return jax.vmap(lambda loop: loop.response(frequencies))(self)
        return _response(self.open_loop, frequencies).loop

    @property
    def _has_lanes(self) -> bool:
        return self.open_loop.b.ndim > 1

    def __repr__(self) -> str:
        return f"LinearLoop of {self.open_loop.b.shape[-1]} states at {self.velocity} m/s under {self.load} N"


def linearise(axis: Axis, *, velocity: Scalar, load: Scalar = 0.0, machine: Axis | None = None) -> LinearLoop:
    """Linearise an axis about a steady motion: controller, observers, delay, friction and table, as they are stepped.

    Of the axis's smooth variant (`Axis.smooth`), since the exact one rounds and switches. Pure: for `jit`, `grad` and
    `vmap`, over gains, parameters, velocity and load.

    Args:
        axis: The drive and its controller; its leaves may be traced.
        velocity: At which the table slides (m/s); 0 for a table at rest, where friction acts as a spring.
        load: Force on the guides (N).
        machine: An axis whose drive replaces the axis's own, as in `simulate`.

    Raises:
        ParameterError: The velocity or the load is not finite, the load is negative, or the machine has another rate.

    Examples:
        >>> loop = linearise(axis, velocity=0.010, load=8e3)
        >>> print(loop.margins())
        >>> gain = 20.0 * np.log10(np.abs(loop.response(np.geomspace(1.0, 1e3, 300))))

    """
    require_double_precision()
    require_axis(axis)
    for name, value, unit, least in (("velocity", velocity, "m/s", -np.inf), ("load", load, "N", 0.0)):
        if np.ndim(value):
            raise ParameterError(f"{name}: must be one number; take `jax.vmap` for several")
        if not isinstance(value, jax.core.Tracer) and not (np.isfinite(float(value)) and float(value) >= least):
            floor = "" if np.isinf(least) else f", {least:g} or more"
            raise ParameterError(f"{name}: must be a finite number in {unit}{floor}, got {float(value):g}")
    require_rate(axis.controller, axis.rate)
    drive, controller = checked_machine(axis, machine).smooth().drive, axis.smooth().controller
    point = loop.OperatingPoint(velocity, load)
    return LinearLoop(_open_loop(*as_arrays((drive, controller)), axis.sampling, as_arrays(point)), velocity, load)


def stability_margins(found: loop_margins.Margins) -> StabilityMargins:
    """Margins in dB and degrees."""
    up, down = (20.0 * jnp.log10(gain) for gain in (found.gain_up, found.gain_down))
    return StabilityMargins(up, down, jnp.degrees(found.phase), found.sensitivity, found.crossover, found.growth)


_open_loop = eqx.filter_jit(loop.open_loop)
_margins = eqx.filter_jit(loop_margins.margins)
_response = eqx.filter_jit(loop.response)
