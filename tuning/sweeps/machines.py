"""From shares of the probability to machines side by side."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from diffdrive.model.parameters import Directional, Drive, as_arrays, check_drive
from diffdrive.motion.load import Ramp
from tuning.sweeps.varied import LOAD, VariedQuantity, with_effects

Values = dict[str, Float[np.ndarray, " n"]]


def _node_at(drive: Drive, name: str) -> Any:
    """The number or pair of that name."""
    at: Any = drive
    for part in name.split("."):
        at = next(one for one in at if one.name == part) if isinstance(at, tuple) else getattr(at, part)
    return at


def _varied_value(value: Any, one: VariedQuantity, drawn: Float[np.ndarray, " n"]) -> Any:
    """A value of the drive file, or a pair, under what was drawn."""
    if isinstance(value, Directional):
        return Directional(_varied_value(value.positive, one, drawn), _varied_value(value.negative, one, drawn))
    return jnp.asarray(one.met(value, drawn))


def machines(
    drive: Drive, varied: Sequence[VariedQuantity], shares: Float[np.ndarray, "n d"]
) -> tuple[Drive, Ramp, Values]:
    """A drive whose varied leaves are arrays over the machines, their loads, and the values of what varies.

    A quantity per direction is told by its value in positive direction. Raises `ParameterError` for values that no
    drive may have.
    """
    names = {one.name.split(".")[1] for one in varied if one.name.startswith("effects.")}
    machine = as_arrays(with_effects(drive, names))
    values: Values = {}
    ends = dict.fromkeys(LOAD, 0.0) | {"load.to": 1.0}
    for k, one in enumerate(varied):
        drawn = one.of(shares[:, k])
        if one.name in LOAD:
            ends[one.name] = values[one.name] = drawn
            continue
        met = _varied_value(_node_at(machine, one.name), one, drawn)
        machine = eqx.tree_at(
            lambda tree, n=one.name: _node_at(tree, n), machine, met, is_leaf=lambda leaf: leaf is None
        )
        values[one.name] = np.asarray(met.positive if isinstance(met, Directional) else met)
    check_drive(machine)
    count = len(shares)
    return machine, Ramp(*(jnp.broadcast_to(jnp.asarray(end, float), (count,)) for end in ends.values())), values


def lane(drive: Drive, number: int | np.ndarray) -> Drive:
    """One of the machines, or some of them."""
    return jax.tree.map(lambda leaf: leaf[number] if np.ndim(leaf) else leaf, drive)
