"""How a filter's innovations answer small changes of the machine and of the effects' signals.

They answer linearly,

    e = e0 + d e / d b  b + d e / d (signals)  d signals ,

and that answer is a linear recursion along the log (`innovations_of_forcings`), cheap enough for a hundred directions
at once.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree

from diffdrive.effects import stages
from diffdrive.model import plant
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar
from tuning.diagnosis.filter.effect_signals import EffectSignals
from tuning.diagnosis.filter.ekf import DISTURBANCE_TIME, EkfResult, in_substeps
from tuning.identification.prediction import Lanes

BATCH = 64  # samples that are differentiated at once: what they keep on the way stays in cache


class StepJacobians(NamedTuple):
    """Derivatives of the table after one period: [lanes, n, 3, directions]."""

    state: Float[Array, "lanes n 3 2"]  # with respect to velocity and bristle
    machine: Float[Array, "lanes n 3 p"]  # to the numbers of plant and friction, in the order of `numbers`
    signals: Float[Array, "lanes n 3 4"]  # to force, Coulomb friction, gap and viscous friction


def numbers(drive: Drive) -> Float[Array, " p"]:
    """Plant and friction as one vector."""
    return ravel_pytree((drive.plant, drive.friction))[0]


def with_numbers(drive: Drive, values: Float[Array, " p"]) -> Drive:
    """The drive with plant and friction from such a vector."""
    plant, friction = ravel_pytree((drive.plant, drive.friction))[1](values)
    return dataclasses.replace(drive, plant=plant, friction=friction)


def step_jacobians_along(
    drive: Drive, under: EffectSignals, filtered: EkfResult, lanes: Lanes, sampling: Sampling
) -> StepJacobians:
    """Derivatives of every period along what was filtered, by the state, the machine and the effects' signals."""

    def period(args: PyTree, load: Scalar, ripple: Float[Array, " substeps"] | None) -> Float[Array, " 3"]:
        v, z, machine, force, coulomb, gap, viscous = args
        acts = EffectSignals(force, coulomb, gap, viscous, *(jnp.zeros(()) for _ in range(3)))
        table = plant.PlantState(jnp.zeros_like(v), v, z)
        bent = stages.with_friction_offset(with_numbers(drive, machine), acts)
        return jnp.stack(plant.advance(bent, table, force, load, sampling.period, sampling.plant_steps, ripple))

    def at(sample: PyTree) -> Float[Array, "3 directions"]:
        v, z, force, coulomb, gap, viscous, load, ripple = sample
        flat, again = ravel_pytree((v, z, numbers(drive), force, coulomb, gap, viscous))
        return jax.jacrev(lambda args: period(again(args), load, ripple))(flat)  # three ways back, some twenty ahead

    force = under.force + filtered.disturbance
    table = (filtered.trajectory.velocity, filtered.trajectory.bristle)
    samples = (*table, force, under.coulomb, under.gap, under.viscous, lanes.load, in_substeps(under, sampling))
    shape = filtered.disturbance.shape
    flat = jax.tree.map(lambda one: one.reshape(-1, *one.shape[2:]), samples)
    jac = lax.map(at, flat, batch_size=BATCH)
    jac = jac.reshape(*shape, 3, -1)
    return StepJacobians(jac[..., :2], jac[..., 2:-4], jac[..., -4:])


def innovations_of_forcings(
    filtered: EkfResult,
    step_jacobians: StepJacobians,
    forcing: Float[Array, "lanes n 3 m"],
    scale: Float[Array, "lanes n m"],
    period: float,
) -> Float[Array, "lanes n m"]:
    """Change of the innovations over their scatter, [lanes, n, m], for forcings of the table ([lanes, n, 3, m] after
    each period) and errors of the scale ([lanes, n, m]).
    """
    ar1_coeff = float(np.exp(-period / DISTURBANCE_TIME))

    def one(args: PyTree) -> Float[Array, "n m"]:
        gain, innovation_std, state, push, forced, off = args

        def body(carry: PyTree, at: PyTree) -> tuple[PyTree, Float[Array, " m"]]:
            x, v, z, f = carry
            (kx, kv, kz, kf), s, a, p, d, shift = at
            e = -(x + shift)
            x, v, z, f = x + kx * e, v + kv * e, z + kz * e, f + kf * e
            ahead = [(x if row == 0 else 0.0) + a[row, 0] * v + a[row, 1] * z + p[row] * f + d[row] for row in range(3)]
            return (*ahead, ar1_coeff * f), e / s

        m = forced.shape[-1]
        # the filter begins where the first sample was measured
        begin = (-off[0], *(jnp.zeros(m) for _ in range(3)))
        return lax.scan(body, begin, (gain, innovation_std, state, push, forced, off))[1]

    given = (filtered.kalman_gain, filtered.innovation_std, step_jacobians.state, step_jacobians.signals[..., 0])
    return lax.map(one, (*given, forcing, scale))
