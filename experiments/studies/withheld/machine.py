"""A machine with effects, in numerics of its own: continuous time, adaptive steps, tight tolerances.

Nothing of the simulator that the diagnosis fits is used: the `equations` are written out again, and diffrax's Tsit5
integrates each control period to `TOLERANCE`. A period begins with the
measurement (noise, then the scale's resolution); the controller's command follows from it without delay and is held. A
motor's encoder reads the motor and, where that is fixed to the table, how far the force winds its screw up.
"""

from functools import partial
from typing import NamedTuple, cast

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from scipy.interpolate import CubicSpline

from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import Scalar, as_arrays
from experiments.studies.control import Control, Loop, command
from experiments.studies.withheld.equations import ELEMENTS, FaultParameters, MachineState, MachineStructure, rates

TOLERANCE = 1e-8
MAX_DELAY = 8
MAX_STEPS = 20_000  # of a control period
DIVERGED = 5e-3  # m off the reference, beyond what a cascade is behind it anyway
MOTOR_SHARE = 0.1  # of the scale's resolution, that a motor's encoder has, and scatters by
DEAD_TIME_ROUNDING = 5.0  # N, about which an inverter's dead time takes its full toll


Signal = Float[Array, " n"] | Float[np.ndarray, " n"]


class MachineInputs(NamedTuple):
    """Reference, load, noise and disturbances of one log, [n] each."""

    reference: Signal  # m
    load: Signal  # N
    noise: Signal  # m
    disturbance: Signal  # N, outside the catalogue
    friction_share: Signal  # share of Coulomb friction, outside the catalogue
    motor_noise: Signal | None = None  # 1, of unit variance; of an axis with a motor's encoder
    lateness: Signal | None = None  # s, by which a sample is taken late, outside the catalogue
    cut: Signal | None = None  # share of the force that is lost, outside the catalogue


_Carry = tuple[MachineState, Array, Loop, Array]  # state, forces newest first, of the controller, count


class MachineSignals(NamedTuple):
    """What the machine shows at each control sample, [n] each."""

    position: Float[np.ndarray, " n"]  # m, of the scale
    command: Float[np.ndarray, " n"]  # N
    motor: Float[np.ndarray, " n"] | None  # m, of the motor's encoder


@eqx.filter_jit
def _run(
    drive: Drive,
    f: FaultParameters,
    control: Control,
    resolution: Scalar,
    wind_up: Scalar,
    behind: Scalar,
    speed: Float[Array, " n"],
    inputs: MachineInputs,
    rate: float,
    samples: int,
    structure: MachineStructure,
) -> tuple[Array, Array, Array | None]:
    period = 1.0 / rate
    term = diffrax.ODETerm(partial(rates, structure=structure))
    unit = jnp.ones(())
    scales = MachineState(1e-10 * unit, 1e-8 * unit, 1e-12 * unit, 1e-12 * unit, 1e-8 * unit, 1e-12 * unit,
                          1e-12 * unit, 1e-9 * unit, 1e-5 * unit, 1e-4 * unit, 1e-6 * jnp.ones(ELEMENTS),
                          1e-8 * unit, 1e-6 * unit)  # fmt: skip

    def norm(error: MachineState) -> Scalar:
        return jnp.max(jnp.stack([jnp.max(jnp.abs(leaf)) for leaf in jax.tree.leaves(error)]))

    adaptive = diffrax.PIDController(rtol=TOLERANCE, atol=1.0, norm=norm)
    scaled = diffrax.ODETerm(
        lambda t, y, args: jax.tree.map(
            lambda dy, k: dy / k, term.vf(t, jax.tree.map(jnp.multiply, y, scales), args), scales
        )
    )

    def sample(carry: _Carry, along: tuple[Array, MachineInputs]) -> tuple[_Carry, tuple[Array, Array, Array | None]]:
        state, forces, loop, k = carry
        wanted_speed, inputs = along
        reference, load, noise, disturbance, friction_share = cast(tuple[Array, ...], inputs[:5])
        motor_noise, lateness, cut = inputs[5:]
        time = k * period
        reading = state.x + f.lead_error * jnp.cos(2 * jnp.pi * state.x / f.lead + f.lead_phase) + f.linear * state.x
        angle = 2 * jnp.pi * state.x / f.interpolation_period + f.interpolation_phase
        reading = reading + f.interpolation * jnp.sin(angle) + noise
        reading = reading if lateness is None else reading + lateness * state.v
        measured = resolution * jnp.round(reading / resolution)
        motor = None
        if motor_noise is not None:
            fine = MOTOR_SHARE * resolution
            acting = state.force if structure.lagging else forces[jnp.floor(f.delay).astype(int)]
            wound = state.q if structure.elastic else wind_up * acting
            ahead = 0.0 if lateness is None else lateness * (state.v + state.w)
            motor = fine * jnp.round((state.x + wound + ahead) / fine + motor_noise)
        loop = loop._replace(past=jnp.where(k == 0, measured, loop.past))
        asked, loop = command(control, loop, reference, wanted_speed, measured, period)
        force = jnp.clip((1.0 + f.gain) * asked, -f.limit, f.limit)
        force = force * (1.0 - f.droop * jnp.abs(force) / f.droop_force)
        force = force * (1.0 - f.fading * (1.0 - jnp.exp(-time / f.fading_time)))
        # no more than there is
        force = force - f.dead * jnp.tanh(force / jnp.maximum(f.dead, DEAD_TIME_ROUNDING))
        force = force if cut is None else force * (1.0 - cut)
        count = jnp.maximum(f.step, 1e-9)
        force = jnp.where(jnp.asarray(f.step) > 0.0, count * jnp.round(force / count), force)
        forces = jnp.concatenate([force[None], forces[:-1]])
        whole_delay = jnp.floor(f.delay).astype(int)
        later, now = forces[whole_delay], forces[whole_delay + 1]
        switch = time + (f.delay - jnp.floor(f.delay)) * period
        args = (drive, f, now, later, switch, load, disturbance, friction_share)

        def advance(state: MachineState) -> MachineState:
            scaled_state = jax.tree.map(jnp.divide, state, scales)
            solution = diffrax.diffeqsolve(
                scaled, diffrax.Tsit5(), time, time + period, 0.05 * period, scaled_state, args,
                # a step across the instant at which a late command arrives would blur it by nanometres
                stepsize_controller=diffrax.ClipStepSizeController(adaptive, jump_ts=switch[None]),
                max_steps=MAX_STEPS, throw=False,
                saveat=diffrax.SaveAt(t1=True), adjoint=diffrax.ForwardMode(),
            )  # fmt: skip
            return jax.tree.map(lambda y, scale: y[-1] * scale, solution.ys, scales)

        # a machine that has diverged is not integrated any further
        follows = jnp.abs(reference - measured) < DIVERGED + behind
        next_state = lax.cond(follows, advance, lambda state: state, state)
        next_state = next_state._replace(
            elements=jnp.clip(next_state.elements, -1.0, 1.0),
            age=jnp.maximum(next_state.age, 0.0),
            chain=jnp.clip(next_state.chain, -1.0, 1.0),
        )
        return (next_state, forces, loop, k + 1.0), (measured, asked, motor)

    zero = jnp.zeros(())
    still = (zero,) * 9
    at_rest = MachineState(*still, f.rested + zero, jnp.zeros(ELEMENTS), zero, zero)
    start = at_rest._replace(x=inputs.reference[0])
    carry = (start, jnp.zeros(MAX_DELAY + 2), Loop(zero, jnp.zeros(samples)), zero)
    return lax.scan(sample, carry, (speed, inputs))[1]


def run(
    drive: Drive,
    faults: FaultParameters,
    structure: MachineStructure,
    control: Control,
    resolution: float,
    inputs: MachineInputs,
    rate: float,
    samples: int = 1,
    wind_up: float = 0.0,
) -> MachineSignals:
    """What a machine shows under a controller whose speed is a difference over so many `samples`.

    `resolution` (m) is the scale's, `wind_up` (m/N) that of the screw of a motor that is fixed to the table. A PD takes
    the speed of the reference as it takes the table's, a cascade knows it.
    """
    reference = np.asarray(inputs.reference)
    speed = rate * np.diff(reference, prepend=reference[0])
    behind = control.following_error(float(np.abs(speed).max()))
    if control.cascaded:
        speed = CubicSpline(np.arange(len(reference)) / rate, reference)(np.arange(len(reference)) / rate, 1)
    drive, faults, control, inputs = as_arrays((drive, faults, control, inputs))
    scalars = as_arrays((resolution, wind_up, behind))
    position, asked, motor = _run(
        drive, faults, control, *scalars, jnp.asarray(speed), inputs, rate, samples, structure
    )
    return MachineSignals(np.asarray(position), np.asarray(asked), None if motor is None else np.asarray(motor))
