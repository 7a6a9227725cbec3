"""A controller that no drive file can state, and the command of any controller replayed on a log."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, PyTree

from diffdrive.controllers import PD, Cascade, Command, Controller, Feedforward, Reference
from diffdrive.numerics.arrays import Scalar

WEIGHTS = (0.3, 0.1, -0.1, -0.3)  # of the least-squares slope, the newest sample first


class FittedVelocityState(NamedTuple):
    """The last three samples, newest first, whether there were any, and the integral (N)."""

    samples: tuple[Scalar, Scalar, Scalar]
    started: Scalar
    integral: Scalar


class FittedVelocity(Controller):
    """A controller whose velocity is the slope of a line through the last four samples.

    PD: kp e + kd slope(e) + feed-forward. Cascade: kv (kp e + ff v_ref - slope(y)) + its integral + feed-forward.
    """

    gains: dict[str, Scalar]
    feedforward: Feedforward | None
    cascade: bool = eqx.field(static=True)

    @classmethod
    def of(cls, controller: PD | Cascade) -> "FittedVelocity":
        """The same gains with the other velocity."""
        if isinstance(controller, PD):
            gains = controller.tracking.gains
            return cls({"kp": gains.kp, "kd": gains.kd}, controller.tracking.feedforward, False)
        names = ("kp", "kv", "ki", "velocity_feedforward")
        return cls({name: getattr(controller, name) for name in names}, controller.feedforward, True)

    def init(self, position: Scalar) -> FittedVelocityState:
        zero = jnp.zeros_like(position)
        return FittedVelocityState((zero, zero, zero), zero, zero)

    def step(
        self, state: FittedVelocityState, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[FittedVelocityState, Command]:
        error = reference.position - position
        newest = position if self.cascade else error
        previous = tuple(state.started * sample + (1.0 - state.started) * newest for sample in state.samples)
        slope = sum(weight * sample for weight, sample in zip(WEIGHTS, (newest, *previous), strict=True)) / period
        integral, gains = state.integral, self.gains
        if self.cascade:
            velocity_error = gains["kp"] * error + gains["velocity_feedforward"] * reference.velocity - slope
            integral = integral + gains["ki"] * period * velocity_error
            force = gains["kv"] * velocity_error + integral
        else:
            force = gains["kp"] * error + gains["kd"] * slope
        state = FittedVelocityState((newest, previous[0], previous[1]), jnp.ones_like(position), integral)
        if self.feedforward is not None:
            force = force + self.feedforward.force(reference)
        return state, Command(force)


@eqx.filter_jit
def replayed_command(
    controller: Controller,
    reference: Reference,
    position: Float[Array, " n"],
    command: Float[Array, " n"],
    period: float,
) -> Float[Array, " n"]:
    """The command (N, [n]) of a controller from rest on a log's reference, position (m) and applied command (N)."""

    def body(carry: tuple[PyTree, Array], sample: tuple[Reference, Array, Array]) -> tuple[tuple[PyTree, Array], Array]:
        state, applied = carry
        reference_sample, measured, logged = sample
        state, replayed = controller.step(state, reference_sample, measured, applied, period)
        return (state, logged), jnp.asarray(replayed.force)

    initial = controller.init(position[0]), jnp.zeros_like(position[0])
    return lax.scan(body, initial, (reference, position, command))[1]
