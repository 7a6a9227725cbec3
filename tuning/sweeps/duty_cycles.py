"""What each machine of a sweep goes through: a motion and a load, with those of their settings that vary.

A setting varies under the name `motion.stroke` or `load.workpiece`. A sweep without such settings has one cycle for
all machines. With them each machine has its own, as long as it is, and rests where it ended until the longest of those
beside it ends.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from diffdrive.controllers import Reference
from diffdrive.loop.run import divergence_bound
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.motion.motion import Limits, Motion
from diffdrive.motion.text import Recipe, load_recipe, parse_load
from tuning.sweeps import engine
from tuning.sweeps.varied import LOAD, KnownQuantity, VariedQuantity

MAX_CORNER_SETTINGS = 6  # settings of which every combination of ends is looked at


class DutyCycle(NamedTuple):
    """What one machine goes through."""

    motion: Motion
    load: Float[np.ndarray, " t"]  # N, beside the ramp that varies


def is_cycle_setting(name: str) -> bool:
    """Whether what varies under this name is a setting of the motion or of the load over time."""
    return name.startswith(("motion.", "load.")) and name not in LOAD


def variable_settings(
    recipes: Mapping[str, Recipe[Motion] | None], load: Recipe[np.ndarray] | None
) -> dict[str, KnownQuantity]:
    """The settings that may vary: those that every motion has, and those of the load."""
    settings = [{} if recipe is None else recipe.numbers() for recipe in recipes.values()]
    common = [name for name in (settings[0] if settings else ()) if all(name in numbers for numbers in settings)]
    found = {
        f"motion.{name}": KnownQuantity(settings[0][name][0], tuple(numbers[name][1] for numbers in settings))
        for name in common
    }
    for name, (unit, value) in ({} if load is None else load.numbers()).items():
        if is_cycle_setting(f"load.{name}"):
            found[f"load.{name}"] = KnownQuantity(unit, (value,))
    return found


@dataclass(frozen=True)
class DutyCycles:
    """The motions of a sweep by their names, its load over time, and which of their settings vary."""

    motions: Mapping[str, Motion]
    recipes: Mapping[str, Recipe[Motion] | None]
    load: str  # as `motion.text.parse_load` takes it
    rate: float  # Hz
    varied: tuple[VariedQuantity, ...]
    sheet: DataSheet = NO_SHEET  # by which the load's units are read

    @cached_property
    def _load(self) -> Recipe[np.ndarray] | None:
        return load_recipe(self.load, self.sheet)

    def values(self, name: str, shares: Float[np.ndarray, "n d"]) -> dict[str, Float[np.ndarray, " n"]]:
        """The values of the settings, with a motion of that name, at shares of the probability of each."""
        known = variable_settings({name: self.recipes.get(name)}, self._load)
        return {
            quantity.name: np.asarray(quantity.apply(known[quantity.name].values[0], quantity.quantile(shares[:, k])))
            for k, quantity in enumerate(self.varied)
        }

    def cycle(self, name: str, values: Mapping[str, float]) -> DutyCycle:
        """The cycle with a motion of that name and such settings. Raises `MotionError` for settings that make none."""
        motion, recipe = self.motions[name], self.recipes.get(name)
        of_motion, of_load = (
            {key.removeprefix(of): float(value) for key, value in values.items() if key.startswith(of)}
            for of in ("motion.", "load.")
        )
        if recipe is not None and of_motion:
            motion = recipe.build(rate=self.rate, **of_motion)
        if self._load is None:
            return DutyCycle(motion, parse_load(self.load, motion.time, self.sheet))
        return DutyCycle(motion, self._load.build(motion.time, **of_load))


def at_corners(shares: Float[np.ndarray, "n d"]) -> list[int]:
    """The machines nearest to each combination of ends: what goes wrong between settings goes wrong there first."""
    count = shares.shape[1]
    every = (
        list(product((-1.0, 1.0), repeat=count)) if count <= MAX_CORNER_SETTINGS else [*np.eye(count), *-np.eye(count)]
    )
    return sorted({int(np.argmax(shares @ np.asarray(way))) for way in every})


def shared_cycle(cycle: DutyCycle, settle: float, limits: Limits) -> engine.LaneCycle:
    """The cycle of all machines, as the engine takes it; its first `settle` seconds do not count."""
    motion, load = cycle
    position, velocity, acceleration, loads, mask, max_error = (
        jnp.asarray(signal, float)
        for signal in (
            motion.position,
            motion.velocity,
            motion.acceleration,
            load,
            motion.time >= settle,
            divergence_bound(motion.position, limits),
        )
    )
    return engine.LaneCycle(Reference(position, velocity, acceleration), loads, mask, max_error)


def stacked_cycles(cycles: Sequence[DutyCycle], settle: float, limits: Limits) -> engine.LaneCycle:
    """The same of several machines side by side, [n, t]; where a shorter cycle rests does not count."""
    shape = len(cycles), _rounded_up(max(len(cycle.load) for cycle in cycles))
    position, velocity, acceleration, loads, counts = (np.zeros(shape) for _ in range(5))
    for k, (motion, load) in enumerate(cycles):
        end = len(load)
        position[k, :end], position[k, end:] = motion.position, motion.position[-1]
        velocity[k, :end], acceleration[k, :end] = motion.velocity, motion.acceleration
        loads[k, :end], loads[k, end:] = load, load[-1]
        counts[k, :end] = motion.time >= settle
    reach = np.array([divergence_bound(motion.position, limits) for motion, _ in cycles])
    reference = Reference(position, velocity, acceleration)  # type: ignore[arg-type]  # numpy, until a block is run
    return engine.LaneCycle(reference, loads, counts, reach)  # type: ignore[arg-type]  # the same


def _rounded_up(count: int) -> int:
    """To a number of four binary digits: few lengths to compile for, each at most an eighth too long."""
    step = 1 << max(0, count.bit_length() - 4)
    return -(-count // step) * step
