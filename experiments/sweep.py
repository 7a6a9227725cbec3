"""Monte Carlo: many machines, loads and noise seeds at once, to see how a controller bears what it does not know."""

from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Float

from diffdrive.controllers import Controller
from diffdrive.errors import ParameterError
from diffdrive.motion import Motion
from diffdrive.parameters import Drive, Sampling, as_arrays, check, check_drive, quantities, require_double_precision
from diffdrive.simulate import Costs, Inputs, inputs_of, running_costs

BLOCK = 64  # lanes at a time: they stay in cache (docs/numerics.md)


@dataclass(frozen=True)
class Sweep:
    """Loads (N) and costs of every lane, [lanes]; `ok` is False where a lane diverged or sat at its limit."""

    load: np.ndarray
    rms: np.ndarray  # m
    peak: np.ndarray  # m
    command_noise: np.ndarray  # N
    load_error: np.ndarray | None  # N
    saturated: np.ndarray  # share of the samples at the force limit
    ok: np.ndarray


def perturbed(drive: Drive, spread: float, lanes: int, rng: np.random.Generator) -> Drive:
    """`lanes` machines whose plant and friction parameters differ from nominal by the relative deviation `spread`.

    Log-normal, so that no parameter changes sign; the leaves that vary have shape [lanes].
    """
    machine = as_arrays(drive)
    names = [
        name for name, _, value in quantities(machine) if name.startswith(("plant.", "friction.")) and value is not None
    ]

    def varied(leaf: Array) -> Array:
        return leaf * jnp.exp(spread * jnp.asarray(rng.standard_normal(lanes)))

    def parts(tree: Drive) -> list[Any]:
        return [attrgetter(name)(tree) for name in names]

    return eqx.tree_at(parts, machine, [jax.tree.map(varied, part) for part in parts(machine)])


@eqx.filter_jit
def _costs(
    drives: Drive, controller: Controller, inputs: Inputs, loads: Array, counts: Array, keys: Array, sampling: Sampling
) -> Costs:
    """Costs of all lanes: shared out among the devices, on each in blocks, one block after the other."""

    def one(drive: Drive, controller: Controller, inputs: Inputs, load: Array, counts: Array, key: Array) -> Costs:
        return running_costs(drive, controller, inputs._replace(load=load + inputs.load), counts, sampling, key)

    def share(drives: Drive, controller: Controller, inputs: Inputs, loads: Array, counts: Array, keys: Array) -> Costs:
        def block(lane: tuple[Drive, Array, Array]) -> Costs:
            return one(lane[0], controller, inputs, lane[1], counts, lane[2])

        return jax.lax.map(block, (drives, loads, keys), batch_size=BLOCK)

    lanes, everywhere = PartitionSpec("lanes"), PartitionSpec()
    return jax.shard_map(
        share,
        mesh=Mesh(np.array(jax.devices()), ("lanes",)),
        in_specs=(lanes, everywhere, everywhere, lanes, everywhere, lanes),
        out_specs=lanes,
        check_vma=False,
    )(drives, controller, inputs, loads, counts, keys)


def sweep(
    drive: Drive,
    controller: Controller,
    motion: Motion,
    *,
    sampling: Sampling,
    lanes: int = 256,
    load: tuple[float, float] = (0.0, 12_600.0),
    spread: float = 0.0,
    settle: float = 0.0,
    seed: int = 0,
) -> Sweep:
    """Simulate `lanes` machines over `motion`, each with its own load (uniform in `load`, N), parameters and noise.

    The machine differs from what the controller believes by `spread`; costs count from `settle` (s) on. Reproducible
    for a given `seed`. Runs on all of the program's devices.
    """
    require_double_precision()
    check_drive(drive)
    check(controller)
    low, high = load
    if not -float(drive.friction.initial_load) < low <= high:
        raise ParameterError(
            f"load range {low:g} to {high:g} N: the lowest must exceed minus the initial load, the highest follow"
        )
    if lanes < 1 or spread < 0 or not 0 <= settle < motion.duration:
        raise ParameterError("sweep: lanes must be at least 1, spread at least 0, settle within the motion")
    rng = np.random.default_rng(seed)
    share = BLOCK * len(jax.devices()) if lanes > BLOCK else len(jax.devices())
    total = -(-lanes // share) * share  # whole blocks on every device
    # drawn for the lanes asked for, so that the same seed gives the same machines on any number of devices
    lane = np.arange(total) % lanes
    loads = rng.uniform(low, high, lanes)[lane]
    varied = perturbed(drive, spread, lanes, rng)
    machines = jax.tree.map(lambda leaf: leaf[lane] if leaf.ndim else jnp.broadcast_to(leaf, (total,)), varied)
    costs = _costs(
        machines,
        as_arrays(controller),
        inputs_of(motion, np.zeros(len(motion.time))),
        jnp.asarray(loads),
        jnp.asarray(motion.time >= settle, jnp.float64),
        jax.random.split(jax.random.key(seed), lanes)[lane],
        sampling,
    )
    rms, peak, noise, missed, saturated, steps = (None if c is None else np.asarray(c)[:lanes] for c in costs)
    return Sweep(loads[:lanes], rms, peak, noise, missed, saturated, (steps == len(motion.time)) & (saturated < 0.5))


def percentiles(values: Float[np.ndarray, " n"]) -> tuple[float, float, float]:
    """Median, 95 % and worst."""
    return float(np.median(values)), float(np.quantile(values, 0.95)), float(np.max(values))
