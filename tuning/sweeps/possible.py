"""What keeps a machine of a sweep from being, found before any of them runs: hours later would be late."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import jax
import numpy as np
from jaxtyping import Float, Int

from diffdrive.errors import ParameterError
from diffdrive.model.parameters import Drive
from diffdrive.motion.load import Ramp
from tuning.sweeps.duty_cycles import DutyCycle

Made = TypeVar("Made")
Numbers = Int[np.ndarray, " n"]


def require_buildable(numbers: Numbers, make: Callable[[Numbers], Made]) -> Made:
    """What `make` makes of these machines. Raises `ParameterError` that names the first that it cannot make."""
    try:
        return make(numbers)
    except ParameterError as found:
        problem = found
    while len(numbers) > 1:
        half = len(numbers) // 2
        try:
            make(numbers[:half])
            numbers = numbers[half:]
        except ParameterError as found:
            numbers, problem = numbers[:half], found
    raise ParameterError(f"sweep: machine {numbers[0]} cannot be: {problem}") from None


def require_ordered(ramp: Ramp) -> None:
    """Raises `ParameterError` where a load's change ends before it begins."""
    if np.any((ramp.begin > ramp.end) & (ramp.change != 0.0)):
        raise ParameterError(
            "its load.change.begin comes after its load.change.end: let them vary in ranges that do not overlap"
        )


def require_on_guides(
    numbers: Numbers,
    drives: Drive,
    ramps: Ramp,
    least: Float[np.ndarray, " n"],
    cycles: Callable[[int], Sequence[DutyCycle]],
) -> None:
    """Raises `ParameterError` that names the first machine whose load lifts its table off the guides.

    `least` are the loads (N) over time at their least, `cycles` those of the k-th machine: where the least of all
    loads at once would be too little, it is looked when each acts.
    """
    bounds = -np.broadcast_to(np.asarray(drives.friction.initial_load), len(numbers))
    for k in np.flatnonzero(np.asarray(least + ramps.load + np.minimum(ramps.change, 0.0)) <= bounds):
        ramp = jax.tree.map(lambda leaf, k=k: leaf[k], ramps)
        least_loads = [
            np.min(load + np.asarray(ramp.at(motion.time - motion.time[0]))) for motion, load in cycles(int(k))
        ]
        if least_loads and min(least_loads) <= bounds[k]:
            raise ParameterError(
                f"sweep: machine {numbers[k]} cannot be: a load of {min(least_loads):g} N lifts the table off its "
                f"guides: it must stay above minus the initial load, {bounds[k]:g} N"
            )
