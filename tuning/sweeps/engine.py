"""The costs of many machines: lanes side by side in blocks that stay in cache, shared out among the devices."""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Float, PyTree

from diffdrive.controllers import Controller, Reference
from diffdrive.loop.costs import Costs, running_costs
from diffdrive.loop.step import Inputs
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.motion.load import Ramp
from diffdrive.numerics.arrays import as_arrays, in_precision_of

Precision = Literal["double", "single"]  # as numpy calls them, too

# Lanes at a time (docs/evidence/performance.md): as a processor's first cache holds; as keep a GPU busy, and as its
# memory holds if each has a cycle of its own.
CPU_BLOCK, GPU_BLOCK, GPU_BLOCK_OWN_CYCLES = 64, 65_536, 1024
LEAST_IN_A_PART = 1024  # machines: a second or two of work, blocks for sixteen cores


class LaneCycle(NamedTuple):
    """What a machine goes through, [t] over time; [n, t] where machines differ in it."""

    reference: Reference
    load: Float[Array, "*n t"]  # N on the guides, beside the lane's ramp
    mask: Float[Array, "*n t"]  # 1 at the samples that count
    max_error: Float[Array, "*n"]  # m, the tracking error beyond which the loop has diverged


class SweepLanes(NamedTuple):
    """What differs between machines, [n] each: the leaves of the drive that vary, its load, its noise; its cycle, or
    None where all have the same.
    """

    drive: PyTree  # a drive whose other leaves are None
    ramp: Ramp
    key: Array | None
    cycle: LaneCycle | None = None


@eqx.filter_jit
def _costs(
    lanes: SweepLanes, fixed: Drive, controller: Controller, cycle: LaneCycle | None, sampling: Sampling, devices: int
) -> Costs:
    def share(lanes: SweepLanes, fixed: Drive, controller: Controller, cycle: LaneCycle | None) -> Costs:
        def simulate_lane(lane: SweepLanes) -> Costs:
            drive = eqx.combine(lane.drive, fixed)
            own = cycle if lane.cycle is None else lane.cycle
            assert own is not None  # all have one, or each has its own
            inputs = Inputs(own.reference, own.load, jnp.zeros_like(own.load))
            return running_costs(
                drive, controller, inputs, own.mask, sampling, lane.key, lane.ramp, divergence_bound=own.max_error
            )

        return jax.lax.map(simulate_lane, lanes, batch_size=block_size(lanes.cycle is not None))

    apart, everywhere = PartitionSpec("lanes"), PartitionSpec()  # type: ignore[no-untyped-call]
    return jax.shard_map(
        share,
        mesh=Mesh(np.array(jax.devices()[:devices]), ("lanes",)),
        in_specs=(apart, everywhere, everywhere, everywhere),
        out_specs=apart,
        check_vma=False,
    )(lanes, fixed, controller, cycle)


def block_size(own_cycles: bool = False) -> int:
    """How many lanes run side by side on a device; `own_cycles`: each with one of its own."""
    if jax.default_backend() == "cpu":
        return CPU_BLOCK
    return GPU_BLOCK_OWN_CYCLES if own_cycles else GPU_BLOCK


def most_in_a_part() -> int:
    """How many machines a part should have on this kind of device, a power of two."""
    return max(LEAST_IN_A_PART, block_size())


def lane_costs(
    machine: Drive, ramp: Ramp, keys: Array | None, controller: Controller, cycle: LaneCycle, sampling: Sampling,
    precision: Precision = "double",
) -> Costs:  # fmt: skip
    """Costs of machines whose varied leaves, loads and keys are [n], along one cycle or [n] of them; [n] each.

    A lane's costs are the same to the last bit however many lanes or devices there are: every block is of one size.
    """
    count, of_each = np.shape(ramp.load)[0], block_size(np.ndim(cycle.load) == 2)
    devices = min(len(jax.devices()), -(-count // of_each))
    total = -(-count // (of_each * devices)) * of_each * devices
    varied, fixed = eqx.partition(as_arrays(machine), lambda leaf: np.ndim(leaf) == 1)
    own, common = (None, cycle) if np.ndim(cycle.load) == 1 else (cycle, None)
    lanes = SweepLanes(varied, ramp, keys, own)
    if total > count:  # whole blocks on every device
        lanes = jax.tree.map(lambda leaf: leaf[np.arange(total) % count], lanes)
    models = (lanes, fixed, as_arrays(controller), common)
    found = _costs(*in_precision_of(jnp.zeros((), precision), models), sampling, devices)
    return jax.tree.map(lambda cost: np.asarray(cost)[:count], found)
