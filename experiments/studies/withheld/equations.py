"""The equations of a machine with effects, written out again as one set of ordinary differential equations.

table   M (a + a_b) = S - r F(v) + pushes            motor   s M (a + a_q) = f - (1 - r) F(v + v_q) - S
base    a_b + 2 zeta w v_b + w^2 x_b = -ratio (reaction) / M      lag     tau df/dt = u - f
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import Scalar

ELEMENTS = 10  # Maxwell elements, their slip distances evenly spread up to the longest


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


RateArguments = tuple[Drive, FaultParameters, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]


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


def rates(t: Scalar, s: MachineState, args: RateArguments, *, structure: MachineStructure) -> MachineState:
    """Time derivatives of the state at `t` (s); the command is `now` until `switch` (s), and `later` from then on."""
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
    bends = (jnp.asarray(f.chain) > 0.0) & ((s.chain * jnp.sign(s.v) < 1.0) | (s.v == 0.0))
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
        chain=jnp.where(bends, s.v / f.chain_length, 0.0),
    )
