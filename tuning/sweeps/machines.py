"""From shares of the probability to machines side by side."""

from collections.abc import Sequence
from types import EllipsisType

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.model.parameters import Drive, check_drive
from diffdrive.model.quantity import Directional, node_at, with_nodes
from diffdrive.motion.load import Ramp
from diffdrive.numerics.arrays import as_arrays
from tuning.sweeps.varied import LOAD, VariedQuantity, with_effects

Values = dict[str, Float[np.ndarray, " n"]]


def _varied_value(value: PyTree, quantity: VariedQuantity, drawn: Float[np.ndarray, " n"]) -> Array | Directional:
    """A value of the drive file, or a pair, under what was drawn."""
    if isinstance(value, Directional):
        return Directional(*(jnp.asarray(quantity.apply(side, drawn)) for side in (value.positive, value.negative)))
    return jnp.asarray(quantity.apply(value, drawn))


def machines(
    drive: Drive, varied: Sequence[VariedQuantity], shares: Float[np.ndarray, "n d"], sheet: DataSheet = NO_SHEET
) -> tuple[Drive, Ramp, Values]:
    """A drive whose varied leaves are arrays over the machines, their loads, and the values of what varies.

    A quantity per direction is reported by its value in positive direction. Raises `ParameterError` for values that no
    drive may have.
    """
    names = {quantity.name.split(".")[1] for quantity in varied if quantity.name.startswith("effects.")}
    machine = as_arrays(with_effects(drive, names, sheet))
    values: Values = {}
    ends: dict[str, float | Float[np.ndarray, " n"]] = {**dict.fromkeys(LOAD, 0.0), "load.change.end": 1.0}
    for k, quantity in enumerate(varied):
        drawn = quantity.quantile(shares[:, k])
        if quantity.name in LOAD:
            ends[quantity.name] = values[quantity.name] = drawn
            continue
        varied_value = _varied_value(node_at(machine, quantity.name), quantity, drawn)
        machine = with_nodes(machine, {quantity.name: varied_value})
        values[quantity.name] = np.asarray(
            varied_value.positive if isinstance(varied_value, Directional) else varied_value
        )
    check_drive(machine)
    count = len(shares)
    return machine, Ramp(*(jnp.broadcast_to(jnp.asarray(end, float), (count,)) for end in ends.values())), values


def lane(drive: Drive, number: int | np.ndarray | EllipsisType) -> Drive:
    """One of the machines, or some of them."""
    return jax.tree.map(lambda leaf: leaf[number] if np.ndim(leaf) else leaf, drive)
