"""Controllers by themselves: one that no drive file can state, and what any would have commanded in a log."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from diffdrive.controllers import PD, Cascade, Command, Controller, Feedforward, Reference
from diffdrive.model.parameters import Scalar

WEIGHTS = (0.3, 0.1, -0.1, -0.3)  # of the least-squares slope, the newest sample first


class FittedVelocityState(NamedTuple):
    """The last three samples whose slope is taken, newest first, whether there were any, and the integral (N)."""

    samples: tuple[Scalar, Scalar, Scalar]
    started: Scalar
    integral: Scalar


class FittedVelocity(Controller):
    """A controller whose velocity is the slope of a line through the last four samples.

    PD: kp e + kd slope(e) + feed-forward. Cascade: kv (kp e + ff v_ref - slope(y)) + its integral + feed-forward.
    """

    gains: dict[str, Scalar]
    feedforward: Feedforward
    cascade: bool = eqx.field(static=True)

    @classmethod
    def of(cls, controller: PD | Cascade) -> "FittedVelocity":
        """The same gains with the other velocity."""
        if isinstance(controller, PD):
            own = controller.tracking.gains
            return cls({"kp": own.kp, "kd": own.kd}, controller.tracking.feedforward, False)
        names = ("kp", "kv", "ki", "velocity_feedforward")
        return cls({name: getattr(controller, name) for name in names}, controller.feedforward, True)

    def init(self, position: Scalar) -> FittedVelocityState:
        zero = jnp.zeros_like(position)
        return FittedVelocityState((zero, zero, zero), zero, zero)

    def step(
        self, state: FittedVelocityState, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[FittedVelocityState, Command]:
        error = reference.position - position
        now = position if self.cascade else error
        past = tuple(state.started * one + (1.0 - state.started) * now for one in state.samples)
        slope = sum(weight * one for weight, one in zip(WEIGHTS, (now, *past), strict=True)) / period
        integral, own = state.integral, self.gains
        if self.cascade:
            wanted = own["kp"] * error + own["velocity_feedforward"] * reference.velocity - slope
            integral = integral + own["ki"] * period * wanted
            force = own["kv"] * wanted + integral
        else:
            force = own["kp"] * error + own["kd"] * slope
        state = FittedVelocityState((now, *past[:2]), jnp.ones_like(position), integral)
        return state, Command(force + self.feedforward.force(reference))


@eqx.filter_jit
def replayed_command(controller: Controller, reference: Reference, position: Any, command: Any, period: float) -> Any:
    """What this controller would have commanded (N), from rest, in a log ([n] each) that holds another's command."""

    def body(carry: Any, at: Any) -> Any:
        state, applied = carry
        now, measured, given = at
        state, own = controller.step(state, now, measured, applied, period)
        return (state, given), own.force

    begin = controller.init(position[0]), jnp.zeros_like(position[0])
    return lax.scan(body, begin, (reference, position, command))[1]
