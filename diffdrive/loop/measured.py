"""The loop with a measured frequency response in the place of the model's plant.

    L'(f) = L(f) P'(f) / P(f)

L is the loop of the model, P its plant from the force on the table to the reading of an encoder, P' the measured one.
P stands in L as a factor, so that with one encoder nothing of the model's plant is in L': what is left of L is the
controller with amplifier and dead time. With two encoders the way from one reading to the other is the model's.

P' follows from the acceleration per force a that was measured, since a force is held over each period T:

    P' = -a H / w^2 ,   H = (1 - exp(-j w T)) / (j w T) ,

Between the measured frequencies a is a cubic in the logarithm of frequency, of its complex values: for a free mass it
is constant. What the sampling folds down from above the control rate is left out, a share of w T to the fourth power.
"""

from dataclasses import fields, replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Complex, Float, PyTree

from diffdrive.controllers import Controller
from diffdrive.errors import ParameterError
from diffdrive.frequency.response import FEWEST
from diffdrive.loop.linearise import (
    OpenLoop,
    OperatingPoint,
    Response,
    StepInputs,
    StepOutputs,
    balanced,
    growth_rate,
    response,
    steady_step,
)
from diffdrive.loop.margins import Margins, frequency_grid, margins_of_response
from diffdrive.loop.step import LoopState
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar

HIGHEST = 0.4999  # of the control rate, beyond which a sampled loop has no response of its own


class MeasuredPlant(eqx.Module):
    """A measured plant beside the model's, at one operating point: what takes the one out of a loop, the other in."""

    model: OpenLoop  # from the force on the table to minus the reading
    log_frequency: Float[Array, " f"]
    acceleration: Complex[Array, " f"]  # per force, m/s^2/N
    slope: Complex[Array, " f"]  # of it, by the logarithm of frequency
    grid: Float[Array, " g"]  # Hz, where margins are looked for: within the band, the measured frequencies among them

    @property
    def band(self) -> Float[Array, "2"]:
        """The lowest and the highest frequency (Hz) at which it is known."""
        return self.grid[jnp.array([0, -1])]

    def reading(self, frequency: Float[Array, " f"]) -> Response:
        """P', per force that is held over each period, and its slope; at the nearest end beyond the band."""
        log = jnp.clip(jnp.log(frequency), self.log_frequency[0], self.log_frequency[-1])
        at = jnp.clip(jnp.searchsorted(self.log_frequency, log, side="right") - 1, 0, len(self.log_frequency) - 2)
        step = self.log_frequency[at + 1] - self.log_frequency[at]
        share = (log - self.log_frequency[at]) / step
        first, last = self.slope[at] * step, self.slope[at + 1] * step
        rise = self.acceleration[at + 1] - self.acceleration[at]
        second, third = 3.0 * rise - 2.0 * first - last, first + last - 2.0 * rise
        value = self.acceleration[at] + share * (first + share * (second + share * third))
        slope = (first + share * (2.0 * second + 3.0 * share * third)) / step
        turn = 1j * 2.0 * jnp.pi * frequency * self.model.period
        held = -hold(frequency, self.model.period) / (2.0 * jnp.pi * frequency) ** 2
        # d log(H / w^2) = (j w T exp(-j w T) / (1 - exp(-j w T)) - 3) d log f
        bend = turn * jnp.exp(-turn) / (1.0 - jnp.exp(-turn)) - 3.0
        return Response(frequency, value * held, (slope + value * bend) * held)


def hold(frequency: Float[Array, " f"], period: float) -> Complex[Array, " f"]:
    """H: a force held over each period, per force that is not; half a period of delay, and a little of gain."""
    turn = 1j * 2.0 * jnp.pi * frequency * period
    return (1.0 - jnp.exp(-turn)) / turn


def measured_response(
    loop: OpenLoop, plant: MeasuredPlant, frequency: Float[Array, " f"] | Float[np.ndarray, " f"]
) -> Response:
    """L' within the band, negative feedback understood; differentiable once, in the loop."""
    frequency = jnp.clip(jnp.asarray(frequency), *plant.band)
    of_loop, of_model, measured = (
        response(loop, frequency),
        response(lax.stop_gradient(plant.model), frequency),
        plant.reading(frequency),
    )
    ratio = -measured.loop / of_model.loop
    # d log L' = d log L + d log P' - d log P
    slope = of_loop.slope * ratio - of_loop.loop * (
        measured.slope / of_model.loop + ratio / of_model.loop * of_model.slope
    )
    return Response(frequency, of_loop.loop * ratio, slope)


def measured_margins(loop: OpenLoop, plant: MeasuredPlant) -> Margins:
    """Margins of L' within the band; pure, differentiable once. `growth` is that of the model, infinite where L' turns
    about -1 as L does not: with the measured plant the loop is unstable then, and with gains by which it is not it need
    not be.
    """
    found = margins_of_response(
        lambda frequency: measured_response(loop, plant, frequency), plant.grid, growth_rate(loop), ends_real=False
    )
    return found._replace(growth=jnp.where(extra_turns(loop, plant) != 0, jnp.inf, found.growth))


def extra_turns(loop: OpenLoop, plant: MeasuredPlant) -> Scalar:
    """How often L' turns about -1 within the band beyond what L does (Nyquist's criterion); differentiable nowhere.

    (1 + L') / (1 + L) begins and ends near one where the plants agree at the ends of the band, or the loop's gain is
    small there. What it turns in between is what L' turns about -1 more than L.
    """
    with_model = response(lax.stop_gradient(loop), plant.grid).loop
    with_measured = measured_response(lax.stop_gradient(loop), plant, plant.grid).loop
    ratio = (1.0 + with_measured) / (1.0 + with_model)
    turned = jnp.angle(ratio[0]) + jnp.sum(jnp.angle(ratio[1:] / ratio[:-1])) - jnp.angle(ratio[-1])
    return jnp.round(turned / (2.0 * jnp.pi))


def measured_plant(
    drive: Drive,
    controller: Controller,
    sampling: Sampling,
    point: OperatingPoint,
    of: str,
    frequency: Float[np.ndarray, " f"],
    value: Complex[np.ndarray, " f"],
) -> MeasuredPlant:
    """The measured plant beside that of the `drive`; `of` is a key of `RESPONSES`, `value` [f] in units of the table.

    What is measured of a closed loop, or behind amplifier and dead time, is led back to the plant by the model of
    controller and amplifier, the gains being those at which it was measured. Drive and controller are smooth variants.
    Raises `ParameterError` where the band holds too little below half the control rate, or there is no such loop.
    """
    within = frequency <= HIGHEST * sampling.rate
    if np.sum(within) < FEWEST:
        raise ParameterError(
            f"the measured response has {np.sum(within)} values below half the control rate of {sampling.rate:g} Hz; "
            f"{FEWEST} are needed"
        )
    low, high = float(frequency[0]), float(frequency[within][-1])
    usual = frequency_grid(sampling.rate)
    grid = np.unique(np.concatenate([frequency[within], usual[(usual > low) & (usual < high)]]))
    measured_with = _with_open_position_loop(controller) if of == "speed-loop" else controller
    at, values = jnp.asarray(frequency[within]), jnp.asarray(value[within])
    found = _acceleration(drive, measured_with, sampling, point, of, at, values)
    model = _model_plant(drive, controller, sampling, point, _encoder(drive, controller, of))
    log = jnp.log(at)
    return MeasuredPlant(model, log, found, _slopes(log, found), jnp.asarray(grid))


@eqx.filter_jit
def _model_plant(
    drive: Drive, controller: Controller, sampling: Sampling, point: OperatingPoint, encoder: str
) -> OpenLoop:
    """From the force on the table to minus the reading."""

    def of_machine(state: LoopState) -> PyTree:
        still = jax.tree.map(lambda _: False, state)
        moving = _every_number(state)
        return still._replace(plant=moving.plant, effects=moving.effects)

    vector, inputs, step = steady_step(drive, controller, sampling, point, of_machine)

    def reading(vector: Array, force: Scalar) -> tuple[Array, Scalar]:
        ahead, outputs = step(vector, inputs._replace(force=force))
        return ahead, outputs.encoders.at(encoder)

    (a, b), (c, _) = jax.jacfwd(reading, argnums=(0, 1))(vector, inputs.force)
    return balanced(a, b, c, sampling.period)


def _with_open_position_loop(controller: Controller) -> Controller:
    """The controller with its speed set-point from outside, through the speed feed-forward of the reference."""
    names = {field.name for field in fields(controller)}
    if not {"kp", "kv", "velocity_feedforward"} <= names:
        raise ParameterError(
            f"of: a {type(controller).__name__} has no speed loop inside a position loop; a cascade has: state it, or "
            "measure the plant"
        )
    given = {
        "kp": 0.0,
        "velocity_feedforward": 1.0,
        "feedforward": None,
        "force_feedforward": None,
        "position_every": 1,
    }
    return replace(controller, **{name: value for name, value in given.items() if name in names}).smoothed()


class _Transfer(NamedTuple):
    """Responses of the control step, [f] each: requested force, command and reading."""

    requested: Complex[Array, " f"]
    command: Complex[Array, " f"]
    reading: Complex[Array, " f"]


@eqx.filter_jit
def _acceleration(
    drive: Drive, controller: Controller, sampling: Sampling, point: OperatingPoint, of: str,
    frequency: Float[Array, " f"], value: Complex[Array, " f"],
) -> Complex[Array, " f"]:  # fmt: skip
    """The acceleration per force that was measured."""
    if of == "plant":
        return 2j * jnp.pi * frequency * value
    encoder = _encoder(drive, controller, of)
    vector, inputs, step = steady_step(drive, controller, sampling, point, _every_number)

    def outputs_of(outputs: StepOutputs) -> Array:
        return jnp.stack([outputs.requested, outputs.command, outputs.encoders.at(encoder)])

    def ahead(vector: Array, added: Array) -> tuple[Array, Array]:
        """The step with a force, a command, and position, velocity and acceleration of the reference added."""
        reference = jax.tree.map(jnp.add, inputs.reference, type(inputs.reference)(*added[2:]))
        after, outputs = step(vector, StepInputs(inputs.force + added[0], reference, added[1]))
        return after, outputs_of(outputs)

    (a, b), (c, d) = jax.jacfwd(ahead, argnums=(0, 1))(vector, jnp.zeros(5))
    angular = 2.0 * jnp.pi * frequency
    z = jnp.exp(1j * angular * sampling.period)
    inner = jnp.linalg.solve(z[:, None, None] * jnp.eye(len(vector)) - a, jnp.broadcast_to(b + 0j, (len(z), *b.shape)))
    gains = c @ inner + d

    def to(added: list[Scalar]) -> _Transfer:
        weights = jnp.stack([jnp.broadcast_to(one, angular.shape) + 0j for one in added], axis=1)
        return _Transfer(*jnp.einsum("foi,fi->of", gains, weights))

    force = to([1.0, 0.0, 0.0, 0.0, 0.0])
    square = -(angular**2) / hold(frequency, sampling.period)
    speed = 1j * angular
    if of == "plant-with-current-loop":
        command = to([0.0, 1.0, 0.0, 0.0, 0.0])
        return speed * value * command.command / command.requested
    if of == "open-loop":
        return -square * value * force.reading / force.requested
    if of == "position-loop":
        set_point = to([0.0, 0.0, 1.0, speed, -(angular**2)])
        closed = value
    else:
        set_point = to([0.0, 0.0, 0.0, 1.0, 0.0])
        closed = value / speed
    # reading = P' requested, requested = K set-point + (requested / reading of the model) reading
    return square * closed / (set_point.requested + closed * force.requested / force.reading)


def _encoder(drive: Drive, controller: Controller, of: str) -> str:
    """The encoder that shows what was measured: of a position its loop's, of a speed the motor's if there is one."""
    if of == "position-loop":
        return str(getattr(controller, "position_feedback", "scale"))
    return "scale" if drive.motor_encoder is None else "motor"


def _every_number(state: LoopState) -> PyTree:
    """Every state moves: what the set-point goes through, too."""
    return jax.tree.map(lambda leaf: jnp.issubdtype(jnp.result_type(leaf), jnp.floating), state)


def _slopes(x: Float[Array, " f"], y: Complex[Array, " f"]) -> Complex[Array, " f"]:
    """The slopes at the points of the parabola through each and its neighbours."""
    step = jnp.diff(x)
    rise = jnp.diff(y) / step
    inner = (rise[:-1] * step[1:] + rise[1:] * step[:-1]) / (step[:-1] + step[1:])
    first = rise[0] + (rise[0] - rise[1]) * step[0] / (step[0] + step[1])
    last = rise[-1] + (rise[-1] - rise[-2]) * step[-1] / (step[-1] + step[-2])
    return jnp.concatenate([first[None], inner, last[None]])
