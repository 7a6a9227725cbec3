"""A truth machine for identification studies: the same physics as the simulator that is fitted, other numerics.

Were a fit judged on logs of the very simulator that it fits, errors of the integrator would cancel and the fit look
better than it is. So the paper's equations are written out again here, and integrated by the classical Runge-Kutta
method of fourth order in fixed steps of at most 2 us; `diffdrive.model.plant` and `diffdrive.model.friction` are not
used.

    (4)  F = s0 z + s1 dz/dt + mu_v v ,   dz/dt = v - s0 |v| z / g(v)
    (5)  g(v) = F_C + gap exp(-(|v| / v_s)^d)
    (6)  F_C = F_BC + mu_LC (W_LI + W_LA)
    (7)  M dv/dt = u + constant force - B v - F

Parameters of sliding are those of the velocity's direction, the bristle's stiffness that of its deflection's. A period
begins with the measurement (noise, then the scale's resolution); the PD's command follows from it without delay and is
held. Under a delay of w + f periods the force is the command of w + 1 periods ago for the first f of the period, then
that of w periods ago: the step in which the switch falls is divided there. The load is constant in a period.

Steps of 2 us are stable to |v| s0 / g < 1.4e6 1/s, 3 m/s on the paper's drive. Over the identification motion they are
within 0.0002 nm of steps of 0.25 us; Radau agrees as well through a reversal.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from diffdrive.controllers import PDGains
from diffdrive.errors import DivergenceError, ParameterError
from diffdrive.logs import Log
from diffdrive.model.parameters import Drive, Sensor, check_drive
from diffdrive.model.quantity import check
from diffdrive.motion.load import validated_load
from diffdrive.motion.motion import Motion
from diffdrive.numerics.arrays import Scalar, as_arrays, require_double_precision

LONGEST_STEP = 2e-6  # s
SCALE = Sensor(resolution=1e-7, noise=3e-8)


class TruthTable(NamedTuple):
    """Position (m), velocity (m/s) and bristle deflection (m)."""

    position: Scalar
    velocity: Scalar
    bristle: Scalar


class TruthSignals(NamedTuple):
    """What happened at each sample, [n]."""

    position: Float[Array, " n"] | Scalar  # m, as logged: noisy, quantised
    command: Float[Array, " n"] | Scalar  # N, before limit and delay
    table: Float[Array, " n"] | Scalar  # m, where the table truly was


class _Loop(NamedTuple):
    table: TruthTable
    forces: tuple[Scalar, ...]  # commands after the limit, newest first
    error: Scalar
    sample: Scalar  # its number


def _rates(drive: Drive, table: TruthTable, force: Scalar, load: Scalar) -> TruthTable:
    """The time derivatives of eqs. (4) to (7); the position's is the velocity."""
    plant, friction, velocity, deflection = drive.plant, drive.friction, table.velocity, table.bristle
    speed = jnp.abs(velocity)
    coulomb = friction.coulomb_screw.towards(velocity) + friction.load_coefficient.towards(velocity) * (
        friction.initial_load + load
    )
    gap = friction.breakaway_gap.towards(velocity)
    speed_ratio, exponent = speed / friction.stribeck_velocity.towards(velocity), friction.stribeck_exponent
    level = coulomb + gap * jnp.exp(-(speed_ratio if exponent is None else speed_ratio**exponent))
    spring = friction.bristle_stiffness.towards(deflection) * deflection
    slip = velocity - spring * speed / level
    viscous = (friction.viscous.towards(velocity) + plant.damping.towards(velocity)) * velocity
    resistance = spring + friction.bristle_damping.towards(velocity) * slip + viscous
    return TruthTable(velocity, (force + plant.constant_force - resistance) / plant.mass, slip)


def _euler_step(table: TruthTable, rates: TruthTable, step: Scalar) -> TruthTable:
    return TruthTable(*(x + step * dx for x, dx in zip(table, rates, strict=True)))


def _runge_kutta(drive: Drive, table: TruthTable, force: Scalar, load: Scalar, step: Scalar) -> TruthTable:
    k1 = _rates(drive, table, force, load)
    k2 = _rates(drive, _euler_step(table, k1, step / 2), force, load)
    k3 = _rates(drive, _euler_step(table, k2, step / 2), force, load)
    k4 = _rates(drive, _euler_step(table, k3, step), force, load)
    mean = TruthTable(*((a + 2.0 * (b + c) + d) / 6.0 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)))
    return _euler_step(table, mean, step)


def advance(
    drive: Drive, table: TruthTable, before: Scalar, after: Scalar, load: Scalar, period: float, steps: int
) -> TruthTable:
    """One control period (s) on: force `before` for the share `delay_fraction` of it, then `after` (N)."""
    share = 0.0 if drive.actuator.delay_fraction is None else drive.actuator.delay_fraction
    switch = jnp.asarray(share * steps)  # counted in steps
    divided = jnp.floor(switch)  # the step that becomes two, one on each side of the switch

    def step(index: Array, table: TruthTable) -> TruthTable:
        first, second = index == divided, index == divided + 1
        width = jnp.where(first, switch - divided, jnp.where(second, 1.0 - (switch - divided), 1.0))
        force = jnp.where(index <= divided, before, after)
        return lax.optimization_barrier(_runge_kutta(drive, table, force, load, width * (period / steps)))  # type: ignore[no-untyped-call]  # jax declares no types of it

    return lax.fori_loop(0, steps + 1, step, table)


def run(
    drive: Drive,
    gains: PDGains,
    reference: Float[Array, " n"],
    load: Float[Array, " n"],
    deflection: Scalar,
    key: Array,
    rate: float,
    steps: int | None = None,
) -> TruthSignals:
    """Follow `reference` (m) under `load` (N) at `rate` (Hz); pure, for use under `jit` and `vmap`.

    The table begins at rest, held by the controller against the bristle's `deflection` (m). `key` seeds the scale's
    noise. `steps` a period: as many as keep one within 2 us, unless given.
    """
    require_double_precision()
    sensor, actuator, period = drive.sensor, drive.actuator, 1.0 / rate
    steps = int(np.ceil(round(period / LONGEST_STEP, 6))) if steps is None else steps

    def body(loop: _Loop, inputs: tuple[Scalar, Scalar]) -> tuple[_Loop, TruthSignals]:
        target, applied_load = inputs
        table = loop.table.position
        measured = table + sensor.noise * jax.random.normal(jax.random.fold_in(key, loop.sample), dtype=jnp.float64)
        if sensor.resolution is not None:
            measured = sensor.resolution * jnp.round(measured / sensor.resolution)
        error = target - measured
        last = jnp.where(loop.sample == 0, error, loop.error)
        command = gains.kp * error + gains.kd * (error - last) * rate
        limit = jnp.inf if actuator.force_limit is None else actuator.force_limit
        forces = (jnp.clip(command, -limit, limit), *loop.forces)
        next_table = advance(drive, loop.table, forces[-1], forces[-2], applied_load, period, steps)
        return _Loop(next_table, forces[:-1], error, loop.sample + 1), TruthSignals(measured, command, table)

    holding = drive.friction.bristle_stiffness.towards(deflection) * deflection - drive.plant.constant_force
    rest_position = reference[0] - holding / gains.kp
    rest = TruthTable(rest_position, jnp.zeros_like(rest_position), jnp.zeros_like(rest_position) + deflection)
    initial = _Loop(
        rest, (holding,) * (actuator.delay_samples + 1), jnp.zeros_like(rest_position), jnp.zeros((), jnp.uint32)
    )
    return lax.scan(body, initial, (reference, load))[1]


@partial(jax.jit, static_argnums=6)
def _run_lanes(
    drives: Drive, gains: PDGains, reference: Array, load: Array, deflection: Array, keys: Array, rate: float
) -> TruthSignals:
    lanes = jax.vmap(partial(run, rate=rate), in_axes=(0, 0, None, 0, 0, 0))
    return lanes(drives, gains, reference, load, deflection, keys)


def truth_logs(
    drives: Sequence[Drive],
    gains: PDGains | Sequence[PDGains],
    motion: Motion,
    loads: float | np.ndarray | Sequence[float | np.ndarray] = 0.0,
    seeds: Sequence[int] | None = None,
) -> list[Log]:
    """One log for each of `drives`, all on the same motion, in one vectorised run.

    `gains` and `loads` (N, a number or an array [n]) are one for all, or a list of one for each; `seeds` (by default
    0, 1, ...) draw the noise and the bristle's initial deflection, up to half of the Coulomb friction either way.
    Raises `ParameterError` unless the drives agree in whole samples of delay, and in which optional parameters they
    have, and `DivergenceError` if a table runs off by 1 m.
    """
    lanes, samples = len(drives), len(motion.time)
    seeds = range(lanes) if seeds is None else seeds
    gains = [gains] * lanes if isinstance(gains, PDGains) else gains
    lane_loads = loads if isinstance(loads, Sequence) else [loads] * lanes
    if not lanes == len(seeds) == len(gains) == len(lane_loads):
        raise ParameterError(
            f"{lanes} drives, {len(gains)} gains, {len(lane_loads)} loads, {len(seeds)} seeds: give as many"
        )
    for drive, gain in zip(drives, gains, strict=True):
        check_drive(drive)
        check(gain)
    if len({jax.tree.structure(drive) for drive in as_arrays(list(drives))}) > 1:
        raise ParameterError("drives with different delay_samples or optional parameters: run each kind on its own")
    load = np.stack(
        [
            validated_load(drive, lane_load * np.ones(samples), motion.time)
            for drive, lane_load in zip(drives, lane_loads, strict=True)
        ]
    )
    draws = [np.random.default_rng(seed) for seed in seeds]
    deflection = [
        _resting_deflection(drive, draw, start) for drive, draw, start in zip(drives, draws, load[:, 0], strict=True)
    ]
    # not key(seed): `simulate` with the same seed would meet the same noise
    keys = jnp.stack([jax.random.key(int(draw.integers(2**32))) for draw in draws])
    stacked = partial(jax.tree.map, lambda *leaves: jnp.stack(leaves))
    machines = stacked(*as_arrays(list(drives))), stacked(*as_arrays(list(gains)))
    signals = _run_lanes(*machines, jnp.asarray(motion.position), load, jnp.asarray(deflection), keys, motion.rate)
    position, command = np.asarray(signals.position), np.asarray(signals.command)
    stable = np.all(np.abs(position - motion.position) < 1.0, axis=1)
    if not stable.all():
        raise DivergenceError(f"the loops of drives {np.flatnonzero(~stable).tolist()} diverge: lower their gains")
    return [
        Log(f"truth {seed}", motion.time, position[i], command[i], reference=motion.position, load=load[i])
        for i, seed in enumerate(seeds)
    ]


def _resting_deflection(drive: Drive, draw: np.random.Generator, load: float) -> float:
    """A bristle deflection (m) at which the table may have come to rest."""
    friction, share = drive.friction, draw.uniform(-0.5, 0.5)
    side = "positive" if share > 0 else "negative"
    screw, guide, stiffness = (
        float(getattr(pair, side))
        for pair in (friction.coulomb_screw, friction.load_coefficient, friction.bristle_stiffness)
    )
    return share * (screw + guide * (float(friction.initial_load) + load)) / stiffness


def truth_log(drive: Drive, gains: PDGains, motion: Motion, load: float | np.ndarray = 0.0, seed: int = 0) -> Log:
    """The log of one machine: `truth_logs` of one."""
    return truth_logs([drive], gains, motion, [load], [seed])[0]
