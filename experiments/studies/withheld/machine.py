"""A machine with effects, in numerics of its own: continuous time, adaptive steps, tight tolerances.

Nothing of the simulator that the diagnosis fits is used: the equations are written out again as one set of ordinary
differential equations, and diffrax's Tsit5 integrates each control period to `TOLERANCE`. A period begins with the
measurement (noise, then the scale's resolution); the PD's command follows from it without delay and is held.

    table   M (a + a_b) = S - r F(v) + pushes            motor   s M (a + a_q) = f - (1 - r) F(v + v_q) - S
    base    a_b + 2 zeta w v_b + w^2 x_b = -ratio (reaction) / M      lag     tau df/dt = u - f
"""

from functools import partial
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from diffdrive.model.parameters import Drive, Scalar, as_arrays

TOLERANCE = 1e-8
ELEMENTS = 10  # Maxwell elements, their slip distances evenly spread up to the longest
MAX_DELAY = 8
MAX_STEPS = 20_000  # of a control period
DIVERGED = 5e-3  # m off the reference
DEAD_TIME_ROUNDING = 5.0  # N, about which an inverter's dead time takes its full toll


class FaultParameters(NamedTuple):
    """Everything that may be wrong, neutral by default; SI units."""

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


class MachineStructure(NamedTuple):
    """What changes the equations' form; hashable."""

    elastic: bool = False
    maxwell: bool = False
    lagging: bool = False


class MachineState(NamedTuple):
    """All that moves."""

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


class MachineInputs(NamedTuple):
    """What the machine is told and what happens to it, [n] each."""

    reference: Float[Array, " n"]  # m
    load: Float[Array, " n"]  # N
    noise: Float[Array, " n"]  # m
    push: Float[Array, " n"]  # N, outside the catalogue
    rub: Float[Array, " n"]  # share of Coulomb friction, outside the catalogue


def _window(t: Scalar, start: Scalar, end: Scalar, edge: float) -> Scalar:
    return jnp.clip((t - start) / edge, 0.0, 1.0) * jnp.clip((end - t) / edge, 0.0, 1.0)


def _friction(
    drive: Drive,
    f: FaultParameters,
    kind: MachineStructure,
    s: MachineState,
    v: Scalar,
    z: Scalar,
    x: Scalar,
    load: Scalar,
    rub: Scalar,
    t: Scalar,
) -> tuple[Scalar, Scalar, Scalar]:
    """Friction with damping (N), the bristle's rate (m/s), and the level (N)."""
    own, speed = drive.friction, jnp.abs(v)
    put_on = f.extra_load * _window(t, f.load_start, f.load_end, 0.05)
    place = 1.0 + f.slope * (x - f.middle) + f.wave * jnp.sin(2 * jnp.pi * x / f.wave_period + f.wave_phase) + rub
    warm = jnp.exp(-t / f.drift_time)
    spot = jnp.exp(-0.5 * ((x - f.chip_place) / f.chip_width) ** 2) * jnp.where(t > f.chip_start, 1.0, 0.0)

    def level_of(way: Scalar) -> Scalar:
        level = own.coulomb_screw.towards(way) + own.load_coefficient.towards(way) * (own.initial_load + load + put_on)
        level = level * place * (1.0 + f.drift_coulomb * warm) + f.chip * spot
        gap = own.breakaway_gap.towards(way) * (1.0 + f.growth * jnp.log1p(s.age / f.onset))
        fast, exponent = speed / own.stribeck_velocity.towards(way), own.stribeck_exponent
        return level + gap * jnp.exp(-(fast if exponent is None else fast**exponent))

    level = level_of(v)
    stiff = own.bristle_stiffness.towards(z)
    rate = v - stiff * z * speed / level
    viscous = (own.viscous.towards(v) + drive.plant.damping.towards(v)) * (1.0 + f.drift_viscous * warm) * v
    bend = stiff * z + own.bristle_damping.towards(v) * rate
    if kind.maxwell:  # each holds with the level of its own direction: a level of the table's would jump where it turns
        bend = jnp.mean(s.elements * jnp.where(s.elements >= 0.0, level_of(1.0), level_of(-1.0)))
    return bend + viscous, rate, level


def _rates(t: Scalar, s: MachineState, args: Any, *, kind: MachineStructure) -> MachineState:
    drive, f, now, later, switch, load, push, rub = args
    asked = jnp.where(t < switch, now, later)
    force = s.force if kind.lagging else asked
    mass = drive.plant.mass
    pushes = push + f.constant + drive.plant.constant_force - f.spring * (s.x - f.neutral)
    pushes = pushes - f.bumper * jnp.maximum(s.x - f.bumper_place, 0.0)
    angle = 2 * jnp.pi * s.x / f.cogging_period + f.cogging_phase
    pushes = pushes + f.cogging * (jnp.sin(angle) + f.second * jnp.sin(2 * angle) + f.sixth * jnp.sin(6 * angle))
    beat = 2 * jnp.pi * f.process_frequency * t + f.process_phase
    cut = f.process * (jnp.sin(beat) + 0.3 * jnp.sin(2 * beat)) + f.process_mean
    pushes = pushes + cut * _window(t, f.process_start, f.process_end, 0.01)
    friction, rate, _ = _friction(drive, f, kind, s, s.v, s.z, s.x, load, rub, t)
    zero = jnp.zeros_like(s.x)
    turn, motor_rate = zero, zero
    if kind.elastic:
        motor, motor_rate, _ = _friction(drive, f, kind, s, s.v + s.w, s.y, s.x, load, rub, t)
        table_mass, motor_mass = (1.0 - f.motor_share) * mass, f.motor_share * mass
        damping = 2.0 * f.screw_damping * jnp.sqrt(f.stiffness * table_mass * motor_mass / mass)
        beyond = s.q - jnp.clip(s.q, -0.5 * f.gap, 0.5 * f.gap)
        pull = f.stiffness * beyond + jnp.where((beyond != 0.0) | (f.gap <= 0.0), damping * s.w, 0.0)
        # contact pushes, it does not stick
        pull = jnp.where(f.gap > 0.0, jnp.where(pull * beyond > 0.0, pull, 0.0), pull)
        net = pull - f.table_friction * friction + pushes
        a = net / table_mass
        turn = (force - (1.0 - f.table_friction) * motor - pull) / motor_mass - a
        reaction = force - friction
    else:
        net = force - friction + pushes
        a, reaction = net / mass, force - friction
    angular = 2 * jnp.pi * f.base_frequency
    lift = -f.base_ratio * reaction / mass - 2 * f.base_damping * angular * s.swing - angular**2 * s.base
    a = a - lift
    elements = zero * s.elements
    if kind.maxwell:
        distance = f.longest * jnp.arange(1, ELEMENTS + 1) / ELEMENTS
        stop = (s.elements * jnp.sign(s.v) >= 1.0) & (s.v != 0.0)
        elements = jnp.where(stop, 0.0, s.v / distance)
    return MachineState(
        x=s.v,
        v=a,
        z=rate,
        q=s.w,
        w=turn,
        y=motor_rate,
        base=s.swing,
        swing=lift,
        force=(asked - s.force) / f.lag if kind.lagging else zero,
        age=1.0 - jnp.abs(s.v) * s.age / f.slip,
        elements=elements,
    )


@eqx.filter_jit
def _run(
    drive: Drive,
    f: FaultParameters,
    kp: Scalar,
    kd: Scalar,
    resolution: Scalar,
    told: MachineInputs,
    rate: float,
    kind: MachineStructure,
) -> Any:
    period = 1.0 / rate
    term = diffrax.ODETerm(partial(_rates, kind=kind))
    unit = jnp.ones(())
    scales = MachineState(1e-10 * unit, 1e-8 * unit, 1e-12 * unit, 1e-12 * unit, 1e-8 * unit, 1e-12 * unit,
                          1e-12 * unit, 1e-9 * unit, 1e-5 * unit, 1e-4 * unit, 1e-6 * jnp.ones(ELEMENTS))  # fmt: skip

    def norm(error: Any) -> Scalar:
        return jnp.max(jnp.stack([jnp.max(jnp.abs(one)) for one in jax.tree.leaves(error)]))

    control = diffrax.PIDController(rtol=TOLERANCE, atol=1.0, norm=norm)
    scaled = diffrax.ODETerm(
        lambda t, y, args: jax.tree.map(
            lambda dy, k: dy / k, term.vf(t, jax.tree.map(jnp.multiply, y, scales), args), scales
        )
    )

    def sample(carry: Any, at: Any) -> Any:
        state, forces, last, k = carry
        reference, load, noise, push, rub = at
        time = k * period
        shown = state.x + f.lead_error * jnp.cos(2 * jnp.pi * state.x / f.lead + f.lead_phase) + f.linear * state.x
        between = 2 * jnp.pi * state.x / f.interpolation_period + f.interpolation_phase
        shown = shown + f.interpolation * jnp.sin(between) + noise
        measured = resolution * jnp.round(shown / resolution)
        error = reference - measured
        command = kp * error + kd * (error - jnp.where(k == 0, error, last)) * rate
        through = jnp.clip((1.0 + f.gain) * command, -f.limit, f.limit)
        through = through * (1.0 - f.droop * jnp.abs(through) / f.droop_force)
        through = through * (1.0 - f.fading * (1.0 - jnp.exp(-time / f.fading_time)))
        # no more than there is
        through = through - f.dead * jnp.tanh(through / jnp.maximum(f.dead, DEAD_TIME_ROUNDING))
        forces = jnp.concatenate([through[None], forces[:-1]])
        whole = jnp.floor(f.delay).astype(int)
        later, now = forces[whole], forces[whole + 1]
        switch = time + (f.delay - jnp.floor(f.delay)) * period
        args = (drive, f, now, later, switch, load, push, rub)

        def onward(state: MachineState) -> MachineState:
            begin = jax.tree.map(jnp.divide, state, scales)
            found = diffrax.diffeqsolve(
                scaled, diffrax.Tsit5(), time, time + period, 0.05 * period, begin, args,
                # a step across the instant at which a late command arrives would blur it by nanometres
                stepsize_controller=diffrax.ClipStepSizeController(control, jump_ts=switch[None]),
                max_steps=MAX_STEPS, throw=False,
                saveat=diffrax.SaveAt(t1=True), adjoint=diffrax.ForwardMode(),
            )  # fmt: skip
            return jax.tree.map(lambda y, scale: y[-1] * scale, found.ys, scales)

        # a machine that has run away need not be followed any further
        ahead = lax.cond(jnp.abs(error) < DIVERGED, onward, lambda state: state, state)
        ahead = ahead._replace(elements=jnp.clip(ahead.elements, -1.0, 1.0), age=jnp.maximum(ahead.age, 0.0))
        return (ahead, forces, error, k + 1.0), (measured, command)

    zero = jnp.zeros(())
    start = MachineState(told.reference[0], *([zero] * 8), f.rested + zero, jnp.zeros(ELEMENTS))
    carry = (start, jnp.zeros(MAX_DELAY + 2), zero, zero)
    return lax.scan(sample, carry, told)[1]


def run(
    drive: Drive,
    faults: FaultParameters,
    kind: MachineStructure,
    gains: tuple[float, float],
    resolution: float,
    told: MachineInputs,
    rate: float,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Measured position (m) and command (N) of a machine under PD control; `gains` are kp (N/m) and kd (N s/m)."""
    found = _run(*as_arrays((drive, faults, *gains, resolution, told)), rate, kind)
    return np.asarray(found[0]), np.asarray(found[1])
