"""The costs of many machines: lanes side by side in blocks that stay in cache, shared out among the devices."""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Float

from diffdrive.controllers import Controller
from diffdrive.load import Ramp
from diffdrive.parameters import Drive, Sampling, as_arrays, in_precision_of
from diffdrive.simulate import Costs, Inputs, running_costs

Precision = Literal["double", "single"]  # as numpy calls them, too

BLOCK = 64  # lanes at a time (docs/performance.md)


class Lanes(NamedTuple):
    """What differs between machines, [n] each: the leaves of the drive that vary, its load, its noise."""

    drive: Any
    ramp: Ramp
    key: Array | None


@eqx.filter_jit
def _costs(
    lanes: Lanes, fixed: Drive, controller: Controller, inputs: Inputs, counts: Float[Array, " t"], reach: Array,
    sampling: Sampling, devices: int,
) -> Costs:  # fmt: skip
    def share(lanes: Lanes, fixed: Drive, controller: Controller, inputs: Inputs, counts: Array, reach: Array) -> Costs:
        def one(lane: Lanes) -> Costs:
            drive = eqx.combine(lane.drive, fixed)
            return running_costs(drive, controller, inputs, counts, sampling, lane.key, lane.ramp, reach=reach)

        return jax.lax.map(one, lanes, batch_size=BLOCK)

    apart, everywhere = PartitionSpec("lanes"), PartitionSpec()
    return jax.shard_map(
        share,
        mesh=Mesh(np.array(jax.devices()[:devices]), ("lanes",)),
        in_specs=(apart, everywhere, everywhere, everywhere, everywhere, everywhere),
        out_specs=apart,
        check_vma=False,
    )(lanes, fixed, controller, inputs, counts, reach)


def costs_of(
    machine: Drive, ramp: Ramp, keys: Array | None, controller: Controller, inputs: Inputs,
    counts: Float[np.ndarray, " t"], sampling: Sampling, precision: Precision = "double", reach: float = 1.0,
) -> Costs:  # fmt: skip
    """Costs of machines whose varied leaves, loads and keys are [n], over one motion; [n] each, as numpy arrays.

    A machine has diverged whose tracking error is beyond `reach` (m).

    A lane's costs are the same to the last bit however many lanes or devices there are: every block is of one size.
    """
    count = len(ramp.load)
    devices = min(len(jax.devices()), -(-count // BLOCK))
    total = -(-count // (BLOCK * devices)) * BLOCK * devices
    again = np.arange(total) % count  # whole blocks on every device
    varied, fixed = eqx.partition(as_arrays(machine), lambda leaf: np.ndim(leaf) == 1)
    lanes = jax.tree.map(lambda leaf: leaf[again], Lanes(varied, ramp, keys))
    models = (lanes, fixed, as_arrays(controller), inputs, jnp.asarray(counts, float), jnp.asarray(reach))
    found = _costs(*in_precision_of(jnp.zeros((), precision), models), sampling, devices)
    return Costs(*(None if one is None else np.asarray(one)[:count] for one in found))
