"""A machine with effects, in numerics of its own: continuous time, adaptive steps, tight tolerances.

Nothing of the simulator that the diagnosis fits is used: the equations are written out again as one set of ordinary
differential equations, and diffrax's Tsit5 integrates each control period to `TOLERANCE`. A period begins with the
measurement (noise, then the scale's resolution); the controller's command follows from it without delay and is held. A
motor's encoder reads the motor and, where that is fixed to the table, how far the force winds its screw up.

    table   M (a + a_b) = S - r F(v) + pushes            motor   s M (a + a_q) = f - (1 - r) F(v + v_q) - S
    base    a_b + 2 zeta w v_b + w^2 x_b = -ratio (reaction) / M      lag     tau df/dt = u - f
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

from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import Scalar, as_arrays
from experiments.studies.control import Control, Loop, command

TOLERANCE = 1e-8
ELEMENTS = 10  # Maxwell elements, their slip distances evenly spread up to the longest
MAX_DELAY = 8
MAX_STEPS = 20_000  # of a control period
DIVERGED = 5e-3  # m off the reference, beyond what a cascade is behind it anyway
MOTOR_SHARE = 0.1  # of the resolution and noise of the scale, that a motor's encoder has
DEAD_TIME_ROUNDING = 5.0  # N, about which an inverter's dead time takes its full toll


class FaultParameters(NamedTuple):
    """The parameters of all faults, neutral by default; SI units."""

    extra_load: Scalar = 0.0  # N
    load_start: Scalar = -1.0  # s
    load_end: Scalar = 1e9  # s
    slope: Scalar = 0.0  # 1/m, of Coulomb friction
    wave: Scalar = 0.0  # share of it
    wave_period: Scalar = 0.1  # m
    wave_phase: Scalar = 0.0
    middle: Scalar = 0.0  # m
    drift_viscous: Scalar = 0.0
    drift_coulomb: Scalar = 0.0
    drift_time: Scalar = 5.0  # s
    growth: Scalar = 0.0
    onset: Scalar = 0.1  # s
    slip: Scalar = 1e-5  # m
    rested: Scalar = 1.0  # s
    longest: Scalar = 5e-6  # m
    constant: Scalar = 0.0  # N
    spring: Scalar = 0.0  # N/m
    neutral: Scalar = 0.0  # m
    cogging: Scalar = 0.0  # N
    cogging_period: Scalar = 1e-3  # m
    cogging_phase: Scalar = 0.0
    second: Scalar = 0.0  # share
    sixth: Scalar = 0.0  # share
    process: Scalar = 0.0  # N
    process_mean: Scalar = 0.0  # N
    process_frequency: Scalar = 100.0  # Hz
    process_phase: Scalar = 0.0
    process_start: Scalar = 0.0  # s
    process_end: Scalar = 0.0  # s
    base_ratio: Scalar = 0.0
    base_frequency: Scalar = 20.0  # Hz
    base_damping: Scalar = 0.03
    gap: Scalar = 0.0  # m
    stiffness: Scalar = 1e8  # N/m
    screw_damping: Scalar = 0.05
    motor_share: Scalar = 0.4
    table_friction: Scalar = 0.5
    gain: Scalar = 0.0
    limit: Scalar = 1e9  # N
    lag: Scalar = 1e-9  # s
    delay: Scalar = 0.0  # control periods
    lead_error: Scalar = 0.0  # m
    lead: Scalar = 5e-3  # m
    lead_phase: Scalar = 0.0
    linear: Scalar = 0.0
    interpolation: Scalar = 0.0  # m
    interpolation_period: Scalar = 2e-5  # m
    interpolation_phase: Scalar = 0.0
    chip: Scalar = 0.0  # N, outside the catalogue: friction at one spot, from some time on
    chip_place: Scalar = 0.0  # m
    chip_width: Scalar = 1e-3  # m
    chip_start: Scalar = 0.0  # s
    droop: Scalar = 0.0  # outside the catalogue: share of the force that is lacking at `droop_force`
    droop_force: Scalar = 300.0  # N
    dead: Scalar = 0.0  # N, outside the catalogue: what an inverter's dead time takes from the force, either way
    fading: Scalar = 0.0  # outside the catalogue: share of the force that is lost as magnets grow warm
    fading_time: Scalar = 5.0  # s
    bumper: Scalar = 0.0  # N/m, outside the catalogue: a spring that is met beyond some place
    bumper_place: Scalar = 1.0  # m
    # outside the catalogue, too, and in no study before the second design of the diagnosis
    spin: Scalar = 0.0  # N, of a spindle's unbalance while it runs up
    spin_start: Scalar = 0.0  # s
    spin_rise: Scalar = 20.0  # Hz/s
    spin_fastest: Scalar = 150.0  # Hz
    step: Scalar = 0.0  # N, of the command's counts
    play: Scalar = 0.0  # m, of the scale's reading head
    film_time: Scalar = 0.0  # s, by which the film of oil, and with it the friction, lags behind the speed
    commutation: Scalar = 0.0  # share of the force, that comes and goes along the motor
    commutation_period: Scalar = 1e-3  # m
    commutation_phase: Scalar = 0.0
    chain: Scalar = 0.0  # N, of a cable chain that is bent to and fro
    chain_length: Scalar = 5e-3  # m, in which it is
    windage: Scalar = 0.0  # N s^2/m^2


class MachineStructure(NamedTuple):
    """Which equations the machine has; hashable, so that each structure is compiled once."""

    elastic: bool = False
    maxwell: bool = False
    lagging: bool = False


class MachineState(NamedTuple):
    """The state of the machine's differential equations."""

    x: Scalar  # m, table against base
    v: Scalar
    z: Scalar  # m, bristle
    q: Scalar  # m, motor against table
    w: Scalar
    y: Scalar  # m, motor's bristle
    base: Scalar  # m
    swing: Scalar  # m/s
    force: Scalar  # N, behind the lag
    age: Scalar  # s
    elements: Float[Array, " e"]
    film: Scalar  # m/s, speed that the film of oil has got used to
    chain: Scalar  # 1, how far a cable chain is bent


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


_RateArguments = tuple[Drive, FaultParameters, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]
_Carry = tuple[MachineState, Array, Loop, Array, Array]  # state, forces newest first, controller, head (m), count


class MachineSignals(NamedTuple):
    """What the machine shows at each control sample, [n] each."""

    position: Float[np.ndarray, " n"]  # m, of the scale
    command: Float[np.ndarray, " n"]  # N
    motor: Float[np.ndarray, " n"] | None  # m, of the motor's encoder


def _window(t: Scalar, start: Scalar, end: Scalar, edge: float) -> Scalar:
    return jnp.clip((t - start) / edge, 0.0, 1.0) * jnp.clip((end - t) / edge, 0.0, 1.0)


def _friction(
    drive: Drive,
    f: FaultParameters,
    structure: MachineStructure,
    s: MachineState,
    v: Scalar,
    z: Scalar,
    x: Scalar,
    load: Scalar,
    friction_share: Scalar,
    t: Scalar,
) -> tuple[Scalar, Scalar, Scalar]:
    """Friction with damping (N), the bristle's rate (m/s), and the level (N)."""
    friction, speed = drive.friction, jnp.abs(v)
    shown = jnp.where(jnp.asarray(f.film_time) > 0.0, jnp.abs(s.film), speed)
    extra_load = f.extra_load * _window(t, f.load_start, f.load_end, 0.05)
    wave = f.wave * jnp.sin(2 * jnp.pi * x / f.wave_period + f.wave_phase)
    position_factor = 1.0 + f.slope * (x - f.middle) + wave + friction_share
    warm = jnp.exp(-t / f.drift_time)
    spot = jnp.exp(-0.5 * ((x - f.chip_place) / f.chip_width) ** 2) * jnp.where(t > f.chip_start, 1.0, 0.0)

    def level_of(direction: Scalar) -> Scalar:
        level = friction.coulomb_screw.towards(direction) + friction.load_coefficient.towards(direction) * (
            friction.initial_load + load + extra_load
        )
        level = level * position_factor * (1.0 + f.drift_coulomb * warm) + f.chip * spot
        gap = friction.breakaway_gap.towards(direction) * (1.0 + f.growth * jnp.log1p(s.age / f.onset))
        fast, exponent = shown / friction.stribeck_velocity.towards(direction), friction.stribeck_exponent
        return level + gap * jnp.exp(-(fast if exponent is None else fast**exponent))

    level = level_of(v)
    stiffness = friction.bristle_stiffness.towards(z)
    rate = v - stiffness * z * speed / level
    viscous = (friction.viscous.towards(v) + drive.plant.damping.towards(v)) * (1.0 + f.drift_viscous * warm) * v
    bristle_force = stiffness * z + friction.bristle_damping.towards(v) * rate
    if structure.maxwell:
        # each element yields at the level of its own direction: the table's level would jump where it reverses
        bristle_force = jnp.mean(s.elements * jnp.where(s.elements >= 0.0, level_of(1.0), level_of(-1.0)))
    return bristle_force + viscous, rate, level


def _rates(t: Scalar, s: MachineState, args: _RateArguments, *, structure: MachineStructure) -> MachineState:
    drive, f, now, later, switch, load, disturbance, friction_share = args
    command = jnp.where(t < switch, now, later)
    force = s.force if structure.lagging else command
    along_motor = 2 * jnp.pi * s.x / f.commutation_period + f.commutation_phase
    force = force * (1.0 + f.commutation * jnp.sin(along_motor))
    mass = drive.plant.mass
    external_force = disturbance + f.constant + drive.plant.constant_force - f.spring * (s.x - f.neutral)
    external_force = external_force - f.bumper * jnp.maximum(s.x - f.bumper_place, 0.0)
    angle = 2 * jnp.pi * s.x / f.cogging_period + f.cogging_phase
    external_force = external_force + f.cogging * (
        jnp.sin(angle) + f.second * jnp.sin(2 * angle) + f.sixth * jnp.sin(6 * angle)
    )
    process_phase = 2 * jnp.pi * f.process_frequency * t + f.process_phase
    process_force = f.process * (jnp.sin(process_phase) + 0.3 * jnp.sin(2 * process_phase)) + f.process_mean
    external_force = external_force + process_force * _window(t, f.process_start, f.process_end, 0.01)
    running = jnp.maximum(t - f.spin_start, 0.0)
    run_up_time = f.spin_fastest / f.spin_rise
    turns = 0.5 * f.spin_rise * jnp.minimum(running, run_up_time) ** 2
    turns = turns + f.spin_fastest * jnp.maximum(running - run_up_time, 0.0)
    speed_share = jnp.minimum(running / run_up_time, 1.0)
    external_force = external_force + f.spin * speed_share**2 * jnp.sin(2 * jnp.pi * turns)
    external_force = external_force - f.chain * s.chain - f.windage * s.v * jnp.abs(s.v)
    friction, rate, _ = _friction(drive, f, structure, s, s.v, s.z, s.x, load, friction_share, t)
    zero = jnp.zeros_like(s.x)
    motor_acceleration: Scalar = zero
    motor_rate: Scalar = zero
    if structure.elastic:
        motor_friction, motor_rate, _ = _friction(drive, f, structure, s, s.v + s.w, s.y, s.x, load, friction_share, t)
        table_mass, motor_mass = (1.0 - f.motor_share) * mass, f.motor_share * mass
        damping = 2.0 * f.screw_damping * jnp.sqrt(f.stiffness * table_mass * motor_mass / mass)
        deflection = s.q - jnp.clip(s.q, -0.5 * f.gap, 0.5 * f.gap)
        screw_force = f.stiffness * deflection + jnp.where((deflection != 0.0) | (f.gap <= 0.0), damping * s.w, 0.0)
        # contact pushes, it does not stick
        screw_force = jnp.where(f.gap > 0.0, jnp.where(screw_force * deflection > 0.0, screw_force, 0.0), screw_force)
        net_force = screw_force - f.table_friction * friction + external_force
        a = net_force / table_mass
        motor_acceleration = (force - (1.0 - f.table_friction) * motor_friction - screw_force) / motor_mass - a
        reaction = force - friction
    else:
        net_force = force - friction + external_force
        a, reaction = net_force / mass, force - friction
    angular = 2 * jnp.pi * f.base_frequency
    base_acceleration = -f.base_ratio * reaction / mass - 2 * f.base_damping * angular * s.swing - angular**2 * s.base
    a = a - base_acceleration
    elements = zero * s.elements
    if structure.maxwell:
        distance = f.longest * jnp.arange(1, ELEMENTS + 1) / ELEMENTS
        is_sliding = (s.elements * jnp.sign(s.v) >= 1.0) & (s.v != 0.0)
        elements = jnp.where(is_sliding, 0.0, s.v / distance)
    return MachineState(
        x=s.v,
        v=a,
        z=rate,
        q=s.w,
        w=motor_acceleration,
        y=motor_rate,
        base=s.swing,
        swing=base_acceleration,
        force=(command - s.force) / f.lag if structure.lagging else zero,
        age=1.0 - jnp.abs(s.v) * s.age / f.slip,
        elements=elements,
        film=jnp.where(jnp.asarray(f.film_time) > 0.0, (s.v - s.film) / jnp.maximum(f.film_time, 1e-6), 0.0),
        chain=jnp.where((s.chain * jnp.sign(s.v) >= 1.0) & (s.v != 0.0), 0.0, s.v / f.chain_length),
    )


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
    term = diffrax.ODETerm(partial(_rates, structure=structure))
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
        state, forces, loop, head, k = carry
        wanted_speed, inputs = along
        reference, load, noise, disturbance, friction_share = cast(tuple[Array, ...], inputs[:5])
        motor_noise, lateness = inputs[5:]
        time = k * period
        head = jnp.clip(head, state.x - 0.5 * f.play, state.x + 0.5 * f.play)
        reading = head + f.lead_error * jnp.cos(2 * jnp.pi * state.x / f.lead + f.lead_phase) + f.linear * state.x
        angle = 2 * jnp.pi * state.x / f.interpolation_period + f.interpolation_phase
        reading = reading + f.interpolation * jnp.sin(angle) + noise
        reading = reading if lateness is None else reading + lateness * state.v
        measured = resolution * jnp.round(reading / resolution)
        motor = None
        if motor_noise is not None:
            fine = MOTOR_SHARE * resolution
            wound = state.q if structure.elastic else wind_up * forces[0]
            motor = fine * jnp.round((state.x + wound) / fine + motor_noise)
        loop = loop._replace(past=jnp.where(k == 0, measured, loop.past))
        asked, loop = command(control, loop, reference, wanted_speed, measured, period)
        force = jnp.clip((1.0 + f.gain) * asked, -f.limit, f.limit)
        force = force * (1.0 - f.droop * jnp.abs(force) / f.droop_force)
        force = force * (1.0 - f.fading * (1.0 - jnp.exp(-time / f.fading_time)))
        # no more than there is
        force = force - f.dead * jnp.tanh(force / jnp.maximum(f.dead, DEAD_TIME_ROUNDING))
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
        return (next_state, forces, loop, head, k + 1.0), (measured, asked, motor)

    zero = jnp.zeros(())
    still = (zero,) * 9
    at_rest = MachineState(*still, f.rested + zero, jnp.zeros(ELEMENTS), zero, zero)
    start = at_rest._replace(x=inputs.reference[0])
    carry = (start, jnp.zeros(MAX_DELAY + 2), Loop(zero, jnp.zeros(samples)), jnp.asarray(start.x), zero)
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
    speed = rate * (np.gradient(reference) if control.cascaded else np.diff(reference, prepend=reference[0]))
    behind = control.following_error(float(np.abs(speed).max()))
    drive, faults, control, inputs = as_arrays((drive, faults, control, inputs))
    scalars = as_arrays((resolution, wind_up, behind))
    position, asked, motor = _run(
        drive, faults, control, *scalars, jnp.asarray(speed), inputs, rate, samples, structure
    )
    return MachineSignals(np.asarray(position), np.asarray(asked), None if motor is None else np.asarray(motor))
