"""LuGre friction (paper, eqs. (4) to (6)), and the bristle's motion at constant velocity.

    F     = s0 z + s1 dz/dt + mu_v v
    dz/dt = v - r z ,   r = s0 |v| / g(v)
    g(v)  = F_C + (F_S - F_C) exp(-(|v| / v_s)^d) ,   F_C = F_BC + mu_LC (W_LI + W_LA)

The paper's d is 1, for which the curve costs one exponential and nothing else; textbooks have 2, measurements 0.5 to 2.
Where a machine has no Coulomb friction (an air bearing, a linear motor), only mu_v v is left: the limit F_C, F_S -> 0,
in which the bristle relaxes at once. It is computed with the least level that leaves all derivatives numbers.

Sliding parameters are taken for the direction of the velocity, the bristle's stiffness for the direction of its
deflection: then force and bristle rate stay continuous through v = 0 and z = 0 also where the two sides differ.
"""

import dataclasses
import math
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from diffdrive.model.parameters import Friction
from diffdrive.model.quantity import Directional
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.exponential import LOG2_E, bounded_power, exp2_neg
from diffdrive.numerics.once import once
from diffdrive.numerics.polynomial import reciprocal
from diffdrive.numerics.relaxation import decay, relaxation

Tree = TypeVar("Tree")

# N: the level of a machine without Coulomb friction. Derivatives of the bristle's relaxation have level^-5, which must
# be a number, and the force that is too much must not show: on 10 kg it is 0.1 pm/s^2, in single precision 1 um/s^2
LEAST_LEVEL, LEAST_LEVEL_SINGLE = 1e-12, 1e-5


class LuGreCoefficients(NamedTuple):
    """The LuGre coefficients at one velocity, load and direction."""

    stiffness: Scalar  # s0, N/m
    damping: Scalar  # s1, N s/m
    viscous: Scalar  # mu_v, N s/m
    level: Scalar  # g(v), N
    rate: Scalar  # r = s0 |v| / g, 1/s


def coulomb(friction: Friction, velocity: Scalar, load: Scalar) -> Scalar:
    """Coulomb friction F_C, N, in the direction of `velocity` under the applied load (eq. (6))."""
    return friction.coulomb_at(load).towards(velocity)


def stribeck_level(friction: Friction, velocity: Scalar, load: Scalar) -> Scalar:
    """Friction level g(v), N, without the viscous part (eq. (5))."""
    return friction_under_load(friction, load).level(velocity)


def lugre_coefficients(friction: Friction, velocity: Scalar, deflection: Scalar, load: Scalar) -> LuGreCoefficients:
    """The coefficients of eq. (4) at this velocity, bristle deflection and load."""
    return friction_under_load(friction, load).at(velocity, deflection)


class LoadedFriction(NamedTuple):
    """Friction under one load: what does not depend on the velocity is computed once."""

    coulomb: Directional  # F_C, N
    gap: Directional  # F_S - F_C, N
    halvings: Directional  # 1 / (v_s ln 2), s/m: how often the gap halves for each m/s; with an exponent 1 / v_s
    stiffness: Directional
    damping: Directional
    viscous: Directional
    exponent: Scalar | None  # d, of the Stribeck curve; None: 1

    def at(self, velocity: Scalar, deflection: Scalar) -> LuGreCoefficients:
        """The coefficients of eq. (4) at this velocity and bristle deflection."""
        return self.coefficients_at_level(self.level(velocity), velocity, deflection)

    def coefficients_at_level(self, level: Scalar, velocity: Scalar, deflection: Scalar) -> LuGreCoefficients:
        """`coefficients` with a friction level (N) that is computed already."""
        stiffness = self.stiffness.towards(deflection)
        return LuGreCoefficients(
            stiffness=stiffness,
            damping=self.damping.towards(velocity),
            viscous=self.viscous.towards(velocity),
            level=level,
            rate=stiffness * jnp.abs(velocity) / level,
        )

    def level(self, velocity: Scalar) -> Scalar:
        """Friction level g(v), N."""
        stribeck = self.gap.towards(velocity) * self.remaining_gap(jnp.abs(velocity) * self.halvings.towards(velocity))
        return self.coulomb.towards(velocity) + stribeck

    def levels(self, velocity: Scalar) -> Directional:
        """Friction level g, N, at this speed in either direction."""
        speed = jnp.abs(velocity)

        def level(coulomb: Scalar, gap: Scalar, halvings: Scalar) -> Scalar:
            return coulomb + gap * self.remaining_gap(speed * halvings)

        return self.coulomb.map(level, self.gap, self.halvings)

    def remaining_gap(self, speeds: Scalar) -> Scalar:
        """The share of the gap that is left at a speed times `halvings`."""
        return exp2_neg(speeds if self.exponent is None else LOG2_E * bounded_power(speeds, self.exponent))


def friction_under_load(friction: Friction, load: Scalar) -> LoadedFriction:
    """The friction under an applied load (N)."""
    exponent = friction.stribeck_exponent
    per_velocity = LOG2_E if exponent is None else 1.0
    return LoadedFriction(
        friction.coulomb_at(load),
        friction.breakaway_gap,
        friction.stribeck_velocity.map(lambda velocity: per_velocity / velocity),
        friction.bristle_stiffness,
        friction.bristle_damping,
        friction.viscous,
        exponent,
    )


def resolvable(tree: Tree) -> Tree:
    """The same drive, controller or tree of them, each friction such that it can be computed.

    Where there is no Coulomb friction, it has `LEAST_LEVEL`, and its bristle no damping, which in the limit it has not
    either. The level is raised, not replaced: the derivative by it is that of the friction force, but for what the
    bristle's damping adds while it turns. All other friction stays as it is, to the last bit. To be called before a
    loop over samples, so that no sample pays for it.
    """

    def is_friction(node: object) -> bool:
        return isinstance(node, Friction)

    resolved: Tree = jax.tree.map(
        lambda node: _with_least_level(node) if is_friction(node) else node, tree, is_leaf=is_friction
    )
    return resolved


def _with_least_level(friction: Friction) -> Friction:
    level, gap, slope = friction.coulomb_at(0.0), friction.breakaway_gap, friction.load_coefficient
    least = LEAST_LEVEL_SINGLE if jnp.result_type(level.positive) == jnp.float32 else LEAST_LEVEL

    def screw(stated: Scalar, level: Scalar) -> Scalar:
        return jnp.where(level > least, stated, stated + least)

    def damping(stated: Scalar, level: Scalar, gap: Scalar, slope: Scalar) -> Scalar:
        return jnp.where((level + gap > least) | (slope > 0.0), stated, 0.0)

    return dataclasses.replace(
        friction,
        coulomb_screw=friction.coulomb_screw.map(screw, level),
        bristle_damping=friction.bristle_damping.map(damping, level, gap, slope),
    )


def friction_force(bristle: LuGreCoefficients, velocity: Scalar, deflection: Scalar) -> Scalar:
    """Friction force F, N (eq. (4))."""
    bristle_velocity = velocity - bristle.rate * deflection
    return bristle.stiffness * deflection + bristle.damping * bristle_velocity + bristle.viscous * velocity


def steady_friction(friction: Friction, velocity: Scalar, load: Scalar = 0.0) -> Scalar:
    """Friction force, N, after a long time at constant velocity: the Stribeck curve (paper, Fig. 5(a))."""
    level = stribeck_level(friction, velocity, load)
    return jnp.sign(velocity) * level + friction.viscous.towards(velocity) * velocity


def steepest_stribeck_slope(friction: Friction, side: str) -> float:
    """The steepest fall of the Stribeck curve in one direction ("positive" or "negative"), N s/m, by its magnitude.

    For d >= 1 it is that of the curve itself, at rest for d = 1. For d < 1, where the curve is vertical at rest, it is
    that of the chord from rest to where the gap has fallen by a factor e.
    """
    gap, width = (float(getattr(pair, side)) for pair in (friction.breakaway_gap, friction.stribeck_velocity))
    d = float(friction.exponent)
    share = (d - 1.0) / d
    steepest = d * share**share * math.exp(-share) if d > 1.0 else 1.0 if d == 1.0 else 1.0 - math.exp(-1.0)
    return gap / width * steepest


def deflection_after(deflection: Scalar, velocity: Scalar, rate: Scalar, duration: Scalar) -> Scalar:
    """The bristle's deflection after `duration` at constant `velocity`: the exact solution of dz/dt = v - r z."""
    decayed = decay(rate * duration)
    return decayed.remaining * deflection + duration * decayed.mean * velocity


def nan_unless_positive(level: Scalar) -> Scalar:
    """A friction level (N), or NaN where an effect made it zero or less, for which LuGre friction is not defined."""
    return jnp.where(level > 0.0, level, jnp.nan)


def relaxation_map(stiffness: Scalar, level: Scalar, velocity: Scalar, duration: float) -> tuple[Scalar, Scalar]:
    """`deflection_after` for a short `duration` (s) as a b + c of a deflection b: the share a, and c (m)."""
    level, scaled_stiffness = once((nan_unless_positive(level), duration * stiffness * jnp.abs(velocity)))
    shares = relaxation(scaled_stiffness, level)
    per_denominator = reciprocal(shares.common_denominator)
    return once((shares.remaining * per_denominator, duration * shares.mean * per_denominator * velocity))


def midpoint_friction(
    friction: LoadedFriction, damping: Directional, velocity: Scalar, bristle: Scalar, step: float
) -> tuple[Scalar, Scalar]:
    """Friction and damping (N) in the middle of a `step` (s) at one velocity (m/s), and the bristle (m) at its end."""
    shares = relaxation_map(friction.stiffness.towards(bristle), friction.level(velocity), velocity, 0.5 * step)
    return _midpoint(friction, damping, velocity, bristle, step, shares)


class FrictionSlopes(NamedTuple):
    """Derivatives of `midpoint_friction`."""

    force_by_velocity: Scalar  # N s/m
    force_by_bristle: Scalar  # N/m
    bristle_by_velocity: Scalar  # s
    bristle_by_bristle: Scalar

    def along(self, velocity: Scalar, bristle: Scalar) -> tuple[Scalar, Scalar]:
        """Force and bristle as they answer small changes."""
        return (
            self.force_by_velocity * velocity + self.force_by_bristle * bristle,
            self.bristle_by_velocity * velocity + self.bristle_by_bristle * bristle,
        )


def midpoint_friction_with_slopes(
    friction: LoadedFriction, damping: Directional, velocity: Scalar, bristle: Scalar, step: float
) -> tuple[tuple[Scalar, Scalar], FrictionSlopes]:
    """`midpoint_friction`, and its derivatives: it is linear in the bristle, whose share at the velocity is known."""
    stiffness = friction.stiffness.towards(bristle)

    def shares(velocity: Scalar) -> tuple[Scalar, Scalar]:
        return relaxation_map(stiffness, friction.level(velocity), velocity, 0.5 * step)

    (remaining, gained), slope = jax.jvp(shares, (velocity,), (jnp.ones_like(velocity),))
    half = remaining * bristle + gained
    half_slope = slope[0] * bristle + slope[1]
    end_slope = slope[0] * half + remaining * half_slope + slope[1]
    per_step = friction.damping.towards(velocity) * (1.0 / step)
    viscous = friction.viscous.towards(velocity) + damping.towards(velocity)
    slopes = FrictionSlopes(
        force_by_velocity=stiffness * half_slope + per_step * end_slope + viscous,
        force_by_bristle=stiffness * remaining + per_step * (remaining * remaining - 1.0),
        bristle_by_velocity=end_slope,
        bristle_by_bristle=remaining * remaining,
    )
    return _midpoint(friction, damping, velocity, bristle, step, (remaining, gained)), slopes


def _midpoint(
    friction: LoadedFriction,
    damping: Directional,
    velocity: Scalar,
    bristle: Scalar,
    step: float,
    shares: tuple[Scalar, Scalar],
) -> tuple[Scalar, Scalar]:
    remaining, gained = shares
    stiffness = friction.stiffness.towards(bristle)
    half = remaining * bristle + gained
    end = remaining * half + gained
    bristle_damping = friction.damping.towards(velocity) * ((end - bristle) * (1.0 / step))
    force = (
        stiffness * half + bristle_damping + (friction.viscous.towards(velocity) + damping.towards(velocity)) * velocity
    )
    return force, end
