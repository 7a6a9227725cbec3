"""Random axes whose truth is known: `python -m experiments.studies.random_axes FOLDER`, for `known_machines`.

Four families: a CNC's axis of which every sample is logged, the same as a slower trace whose controller is unknown, a
linear motor, a gantry with a second encoder. The numerics are their own: classical Runge-Kutta of fixed steps, a
cascade or PD written out again; nothing of the simulator is used. FOLDER/NNN has rough.toml, a data sheet up to 30 %
off, and two logs of the sound machine; FOLDER/key.json the truth.
"""

import argparse
import json
import math
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jax import lax
from jaxtyping import Array, Float

from diffdrive.numerics.arrays import Scalar
from diffdrive.runtime import configure
from diffdrive.support.atomic_write import atomic_write, write_text
from experiments.studies.control import Control, Loop, command

OFF = 0.3  # of a number of the data sheet, at most
LEAST_STEPS = 8  # of Runge-Kutta to a control period
BENT = 0.5  # of its length, that a bristle may bend back in one step


class Friction(NamedTuple):
    """LuGre friction, each number as (forwards, backwards); SI units."""

    coulomb: Float[Array, " 2"]  # N, of screw and guides together
    gap: Float[Array, " 2"]  # N, of breakaway over Coulomb
    stribeck: Float[Array, " 2"]  # m/s
    viscous: Float[Array, " 2"]  # N s/m
    stiffness: Scalar  # N/m
    damping: Scalar  # N s/m
    exponent: Scalar


class Machine(NamedTuple):
    """What is stepped."""

    mass: Scalar
    friction: Friction
    control: Control
    resolution: Scalar  # m
    noise: Scalar  # m
    screw: Scalar  # m/N, wind-up between motor and table


def _slope(machine: Machine, force: Scalar, state: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """Derivative of position, velocity and bristle."""
    _, v, z = state
    friction = machine.friction
    coulomb, gap, stribeck, viscous = (
        jnp.where(v < 0.0, pair[1], pair[0])
        for pair in (friction.coulomb, friction.gap, friction.stribeck, friction.viscous)
    )
    level = coulomb + gap * jnp.exp(-((jnp.abs(v) / stribeck) ** friction.exponent))
    bending = v - friction.stiffness * jnp.abs(v) / level * z
    resisting = friction.stiffness * z + friction.damping * bending + viscous * v
    return jnp.stack([v, (force - resisting) / machine.mass, bending])


@partial(jax.jit, static_argnames=("steps", "samples"))
def run(
    machine: Machine,
    reference: Float[Array, " n"],
    speed: Float[Array, " n"],
    noise: Float[Array, "n 2"],
    period: Scalar,
    steps: int,
    samples: int,
) -> tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """Scale, command and motor's encoder at each control sample; the speed is a difference over so many `samples`."""
    step = period / steps

    def rounded(position: Scalar, noise: Scalar, resolution: Scalar) -> Scalar:
        return jnp.round((position + machine.noise * noise) / resolution) * resolution

    def body(carry, at):  # type: ignore[no-untyped-def]  # of a scan
        state, loop, acting = carry
        wanted, wanted_speed, noises = at
        motor = rounded(state[0] + machine.screw * acting, noises[1], 0.1 * machine.resolution)
        measured = rounded(state[0], noises[0], machine.resolution)
        force, loop = command(machine.control, loop, wanted, wanted_speed, measured, period)

        def substep(state, _):  # type: ignore[no-untyped-def]
            k1 = _slope(machine, force, state)
            k2 = _slope(machine, force, state + 0.5 * step * k1)
            k3 = _slope(machine, force, state + 0.5 * step * k2)
            k4 = _slope(machine, force, state + step * k3)
            return state + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4), None

        ahead, _ = lax.scan(substep, state, None, length=steps)
        return (ahead, loop, force), (measured, force, motor)

    begin = jnp.array([0.0, 0.0, 0.0]).at[0].set(reference[0])
    carry = (begin, Loop(jnp.zeros(()), jnp.full(samples, reference[0])), jnp.zeros(()))
    return lax.scan(body, carry, (reference, speed, noise))[1]


def random_motion(
    seconds: float, period: float, fastest: float, stroke: float, jerks: tuple[float, float], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Position and speed of strokes to and fro within a stroke: most fast, some slow, some rests, of limited jerk."""
    count, at = round(seconds / period), 0.0
    speed: list[np.ndarray] = []
    while sum(one.size for one in speed) < count:
        slow = rng.random() < 0.4
        wanted = fastest * (rng.uniform(0.002, 0.05) if slow else rng.uniform(0.3, 1.0))
        way = -1.0 if at > 0.0 else 1.0
        length = min(rng.uniform(0.2, 0.8), (0.5 * stroke + abs(at)) / wanted)
        at += way * wanted * length
        speed.append(np.full(round(length / period), way * wanted))
        if rng.random() < 0.3:
            speed.append(np.zeros(round(rng.uniform(0.05, 0.2) / period)))
    found = np.concatenate([np.zeros(round(0.1 / period)), *speed])[:count]
    for smoothing in jerks:
        width = max(1, round(smoothing / period))
        found = np.convolve(np.concatenate([np.zeros(width - 1), found]), np.ones(width) / width, "valid")
    return period * np.cumsum(found), found


class Axis(NamedTuple):
    """One drawn axis."""

    family: str
    machine: Machine
    truth: dict[str, float]
    rate: float  # Hz, of control
    ratio: int  # control samples to a row
    samples: int  # of the velocity's difference
    fastest: float  # m/s
    stroke: float  # m
    has_motor: bool


FAMILIES = ("cnc", "cnc-trace", "linear-motor", "gantry")


def draw(family: str, rng: np.random.Generator) -> Axis:
    """An axis of a family, its gains as machines have them: each loop several times faster than the one around it."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    linear, gantry = family == "linear-motor", family == "gantry"
    mass = between(10.0, 40.0) if linear else between(800.0, 2000.0) if gantry else between(300.0, 600.0)
    rate = float(rng.choice([8000.0, 10000.0] if linear else [1000.0, 2000.0] if gantry else [4000.0]))
    resolution = 1e-8 if linear else float(rng.choice([5e-7, 1e-6])) if gantry else 1e-7
    guide = between(0.002, 0.005)
    initial = between(400.0, 1200.0) if linear else mass * between(30.0, 60.0)
    screw = between(1.0, 5.0) if linear else mass * between(0.2, 0.6)
    sides = 1.0 + 0.08 * rng.uniform(-1.0, 1.0, size=(4, 2))
    coulomb = screw * sides[0]
    level = float(np.mean(coulomb)) + guide * initial
    gap, stribeck = level * between(0.15, 0.5) * sides[1], between(0.0015, 0.006) * sides[2]
    viscous = (between(10.0, 40.0) if linear else mass * between(1.0, 5.0)) * sides[3]
    bend = between(1e-6, 6e-6)
    stiffness = level / bend
    damping = 2.0 * between(0.2, 0.8) * math.sqrt(stiffness * mass)
    exponent = float(rng.choice([1.0, 2.0]))
    friction = Friction(
        jnp.asarray(coulomb + guide * initial), jnp.asarray(gap), jnp.asarray(stribeck), jnp.asarray(viscous),
        stiffness, damping, exponent,
    )  # fmt: skip
    bandwidth = rate * (between(0.03, 0.08) if linear else between(0.04, 0.09))  # 1/s, of the velocity loop
    if gantry:
        bandwidth = min(bandwidth, between(40.0, 100.0))
    bandwidth = min(bandwidth, between(150.0, 350.0)) if family.startswith("cnc") else bandwidth
    if linear and rng.random() < 0.4:
        control = Control(0.0, 0.25 * mass * bandwidth**2, mass * bandwidth, 0.0, 1.0)
    else:
        kv = mass * bandwidth
        control = Control(
            1.0, bandwidth / between(3.5, 8.0), kv, kv * bandwidth / between(3.0, 8.0),
            float(rng.choice([0.0, 0.9, 1.0])),
        )  # fmt: skip
    machine = Machine(
        mass, friction, control, resolution, resolution * between(0.15, 0.8), 1.0 / between(1e8, 4e8) if gantry else 0.0
    )
    truth = {"mass": mass, "load_coefficient": guide, "initial_load": initial}
    for name, pair in (
        ("coulomb_screw", coulomb),
        ("breakaway_gap", gap),
        ("stribeck_velocity", stribeck),
        ("viscous", viscous),
    ):
        truth |= {f"{name}+": float(pair[0]), f"{name}-": float(pair[1])}
    truth |= {"bristle_stiffness": stiffness, "bristle_damping": damping}
    cascaded = bool(control.cascaded)
    return Axis(
        family, machine, truth, rate,
        ratio=int(rng.choice([4, 8])) if family == "cnc-trace" else 1,
        samples=int(rng.choice([1, 2] if linear else [1, 2, 4])) if cascaded else 1,
        fastest=between(0.15, 0.4) if linear else between(0.08, 0.25),
        stroke=between(0.06, 0.3),
        has_motor=gantry,
    )  # fmt: skip


def log_columns(axis: Axis, seconds: float, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """A log of a random motion, the columns as `read_log` takes them."""
    period, friction = 1.0 / axis.rate, axis.machine.friction
    jerks = (float(rng.uniform(0.03, 0.1)), float(rng.uniform(0.01, 0.03)))
    reference, speed = random_motion(seconds, period, axis.fastest, axis.stroke, jerks, rng)
    bristle = float(friction.stiffness) / float(jnp.min(friction.coulomb))  # 1/m
    steps = max(LEAST_STEPS, 2 ** math.ceil(math.log2(1.3 * axis.fastest * bristle * period / BENT)))
    noise = jnp.asarray(rng.standard_normal((len(reference), 2)))
    found = run(axis.machine, jnp.asarray(reference), jnp.asarray(speed), noise, period, steps, axis.samples)
    position, asked, motor = map(np.asarray, found)
    columns = {
        "time": period * np.arange(len(reference)),
        "reference": reference,
        "position": position,
        "command": asked,
    }
    if axis.has_motor:
        columns["motor_position"] = motor
    return {name: column[:: axis.ratio] for name, column in columns.items()}


def rough(axis: Axis, rng: np.random.Generator) -> str:
    """A drive file whose numbers are up to `OFF` wrong; the Stribeck exponent, and a known controller, are right."""

    def off(name: str) -> str:
        pair = [axis.truth[key] for key in (name, f"{name}+", f"{name}-") if key in axis.truth]
        return f"{name} = {float(np.mean(pair)) * (1.0 + rng.uniform(-OFF, OFF)):.4g}"

    control = axis.machine.control
    names = (
        "coulomb_screw", "load_coefficient", "initial_load", "breakaway_gap", "stribeck_velocity", "viscous",
        "bristle_stiffness", "bristle_damping",
    )  # fmt: skip
    lines = [
        f"# {axis.family} axis, from the data sheets; friction guessed", "[plant]", off("mass"), "damping = 0.0", "",
        "[friction]", *map(off, names), f"stribeck_exponent = {float(axis.machine.friction.exponent)}", "",
        "[sensor]", f"resolution = {float(axis.machine.resolution)}", "",
        "[sampling]", f"rate = {axis.rate / axis.ratio}", "", "[controller]",
    ]  # fmt: skip
    if axis.ratio > 1:
        lines += ['kind = "unknown"']
    elif not control.cascaded:
        lines += ['kind = "pd"', f"kp = {float(control.kp)}", f"kd = {float(control.kv)}"]
    else:
        lines += [
            'kind = "cascade"', f"kp = {float(control.kp)}", f"kv = {float(control.kv)}", f"ki = {float(control.ki)}",
            f"velocity_feedforward = {float(control.feedforward)}", f"velocity_samples = {axis.samples}",
        ]  # fmt: skip
    return "\n".join(lines) + "\n"


def write_axes(folder: Path, count: int, seed: int, seconds: float = 10.0) -> None:
    """`count` axes, the families in turn; what is there already is not drawn again."""
    folder.mkdir(parents=True, exist_ok=True)
    key = {}
    for number in range(count):
        name, family = f"{number:03d}", FAMILIES[number % len(FAMILIES)]
        rng = np.random.default_rng([seed, number])
        axis = draw(family, rng)
        control = axis.machine.control
        key[name] = {
            "family": family,
            "healthy": axis.truth,
            "exponent": float(axis.machine.friction.exponent),
            "control_rate": axis.rate,
            "trace_rate": axis.rate / axis.ratio,
            "controller": [*map(float, control), float(axis.samples)],
        }
        (folder / name).mkdir(exist_ok=True)
        write_text(folder / name / "rough.toml", rough(axis, rng))
        for log in ("healthy-1", "healthy-2"):
            columns = log_columns(axis, seconds, rng)
            if not np.all(np.abs(columns["position"] - columns["reference"]) < 0.05):
                raise ArithmeticError(f"{name}: the loop of {axis} is not stable")
            with atomic_write(folder / name / f"{log}.parquet") as file:
                pq.write_table(pa.table(columns), file)
    write_text(folder / "key.json", json.dumps(key, indent=1))


def main() -> None:
    """Write the folder."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    configure()
    write_axes(given.folder, given.count, given.seed)


if __name__ == "__main__":
    main()
