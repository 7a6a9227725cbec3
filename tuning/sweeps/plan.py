"""A sweep as it is planned: its machines by their numbers, and what each goes through."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from diffdrive.axis import Axis
from diffdrive.controllers import Controller
from diffdrive.errors import MotionError, ParameterError
from diffdrive.model.parameters import Drive
from diffdrive.motion.load import Ramp
from diffdrive.motion.motion import Motion, require_within
from diffdrive.motion.text import Recipe, load_recipe, parse_load, require_choice, require_longer_than
from diffdrive.numerics.arrays import require_double_precision
from diffdrive.support.rates import require_same_rate
from tuning.sweeps.duty_cycles import (
    DutyCycle,
    DutyCycles,
    at_corners,
    is_cycle_setting,
    variable_settings,
)
from tuning.sweeps.engine import LEAST_IN_A_PART, Precision
from tuning.sweeps.machines import Values, machines
from tuning.sweeps.samples import Method, correlate, correlation_root, unit_samples
from tuning.sweeps.varied import VariedQuantity, parse_varied


@dataclass(frozen=True)
class SweepPlan:
    """The machines of a sweep, and what each goes through.

    Every controller follows every motion on the same machines under the same loads and noise (common random numbers).
    """

    axis: Axis
    controllers: Mapping[str, Controller]
    motions: Mapping[str, Motion]
    varied: tuple[VariedQuantity, ...]
    samples: int
    method: Method = "sobol"
    seed: int = 0
    recipes: Mapping[str, Recipe[Motion] | None] = field(default_factory=dict)  # of the motions whose settings may vary
    load: str = "0"  # over time, as `motion.text.parse_load` takes it; a load that varies is added to it
    settle: float = 0.0  # s at the start that do not count
    correlation: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    most_in_a_part: int = LEAST_IN_A_PART  # a power of two
    precision: Precision = "double"

    @classmethod
    def of(
        cls, axis: Axis, controllers: Mapping[str, Controller], motions: Mapping[str, Motion],
        vary: tuple[str, ...], samples: int, **more: Any,
    ) -> "SweepPlan":  # fmt: skip
        """From the texts of `varied.parse_varied`. Raises `ParameterError` or `MotionError` for one that cannot be."""
        require_double_precision()
        require_choice("method", "method", more.get("method", "sobol"), get_args(Method))
        require_choice("precision", "precision", more.get("precision", "double"), get_args(Precision))
        recipes = more.get("recipes", {})
        known = variable_settings(
            {name: recipes.get(name) for name in motions}, load_recipe(more.get("load", "0"), axis.sheet)
        )
        varied = tuple(parse_varied(text, axis.drive, known, axis.sheet) for text in vary)
        names = [quantity.name for quantity in varied]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ParameterError(f"vary: {', '.join(twice)} is given more than once")
        both = [name for name in names if {f"{name}.positive", f"{name}.negative"} & set(names)]
        if both:
            raise ParameterError(f"vary {both[0]}: stands for both directions, one of which is varied beside it")
        plan = cls(axis, controllers, motions, varied, samples, **more)
        if samples < 1:
            raise ParameterError(f"samples: at least one machine is needed, got {samples}")
        if set(names) & {"load.change.begin", "load.change.end"} and "load.change" not in names:
            raise ParameterError("vary load.change.begin, load.change.end: load.change does not vary: give it, too")
        for name, motion in motions.items():
            if not plan.varies("motion"):  # else none of the machines may run that one
                require_within(motion, axis.limits)
                require_longer_than(plan.settle, name, motion)
            require_same_rate(name, motion.rate, "the axis", axis.rate)
        if not 0 <= plan.seed < 2**63:
            raise ParameterError(f"seed: must be from 0 to 2^63 - 1, got {plan.seed}")
        correlation_root(plan.correlation, names)
        return plan

    @cached_property
    def _setting_indices(self) -> list[int]:
        """Which of the quantities that vary are settings of the motions and of the load over time."""
        return [k for k, quantity in enumerate(self.varied) if is_cycle_setting(quantity.name)]

    @cached_property
    def duty_cycles(self) -> DutyCycles:
        """Motions and load over time."""
        varied = tuple(self.varied[k] for k in self._setting_indices)
        return DutyCycles(self.motions, self.recipes, self.load, self.axis.sampling.rate, varied, self.axis.sheet)

    @property
    def has_own_cycles(self) -> bool:
        """Whether each machine goes through a duty cycle of its own."""
        return bool(self._setting_indices)

    def varies(self, of: str) -> bool:
        """Whether settings of the motions, or of the load, vary."""
        return any(quantity.name.startswith(f"{of}.") for quantity in self.duty_cycles.varied)

    def cycles(self, numbers: np.ndarray, motion: str) -> list[DutyCycle]:
        """What machines of one part go through. Raises `ParameterError` that names one whose motion cannot be."""
        values = self.duty_cycles.values(motion, self._unit_samples(numbers)[:, self._setting_indices])
        found = []
        for k, number in enumerate(numbers):
            try:
                cycle = self.duty_cycles.cycle(motion, {name: value[k] for name, value in values.items()})
                require_within(cycle.motion, self.axis.limits)
                require_longer_than(self.settle, motion, cycle.motion)
            except (MotionError, ParameterError) as problem:
                raise ParameterError(f"sweep: machine {number} cannot be: {problem}") from None
            found.append(cycle)
        return found

    def nominal_cycle(self, motion: str) -> DutyCycle:
        """What all machines go through but for settings that vary."""
        planned = self.motions[motion]
        return DutyCycle(planned, parse_load(self.load, planned.time, self.axis.sheet))

    def corner_numbers(self, part: int = 0) -> np.ndarray:
        """The machines of a part that are nearest to the ends of settings."""
        return self.numbers(part)[at_corners(self.unit_samples(part)[:, self._setting_indices])]

    @cached_property
    def _correlation_root(self) -> np.ndarray | None:
        return correlation_root(self.correlation, [quantity.name for quantity in self.varied])

    @property
    def part_size(self) -> int:
        """Machines in a part, a power of two."""
        return min(self.most_in_a_part, 1 << (self.samples - 1).bit_length())

    @property
    def parts(self) -> int:
        """How many parts."""
        return -(-self.samples // self.part_size)

    def unit_samples(self, part: int) -> np.ndarray:
        """Shares of the probability of the machines of a part, [n, d]."""
        count = len(self.numbers(part))
        drawn = unit_samples(self.method, len(self.varied), self.seed, part, self.part_size, count)
        return drawn if self._correlation_root is None else correlate(drawn, self._correlation_root)

    def numbers(self, part: int) -> np.ndarray:
        """Numbers of the machines of a part."""
        return np.arange(part * self.part_size, min(self.samples, (part + 1) * self.part_size))

    def keys(self, numbers: np.ndarray) -> Array | None:
        """Keys of the measuring noise of these machines; None where no encoder has any."""
        varied = {quantity.name for quantity in self.varied}
        if not self.axis.drive.has_noise and not varied & {"sensor.noise", "motor_encoder.noise"}:
            return None
        base = jax.random.key(self.seed)
        return jax.vmap(lambda number: jax.random.fold_in(base, number))(jnp.asarray(numbers))

    def _unit_samples(self, numbers: np.ndarray) -> np.ndarray:
        """Those of some machines of one part."""
        part = int(numbers[0]) // self.part_size
        return self.unit_samples(part)[numbers - part * self.part_size]

    def machines(self, numbers: np.ndarray) -> tuple[Drive, Ramp, Values, Array | None]:
        """Machines of one part by their numbers: drives, loads, the values of what varies, the keys of their noise."""
        own = [k for k in range(len(self.varied)) if k not in self._setting_indices]
        varied = [self.varied[k] for k in own]
        shares = self._unit_samples(numbers)[:, own]
        return *machines(self.axis.drive, varied, shares, self.axis.sheet), self.keys(numbers)

    def values(self, numbers: np.ndarray, motion: str) -> Values:
        """The values of what varies of some machines of one part, [n] each, in the order in which it was given."""
        drawn, (_, _, found, _) = self._unit_samples(numbers)[:, self._setting_indices], self.machines(numbers)
        found |= self.duty_cycles.values(motion, drawn)
        return {quantity.name: found[quantity.name] for quantity in self.varied}

    def axis_of(self, drive: Drive) -> Axis:
        """The axis with another drive in it: what a machine's drive file says. Of one machine nothing is uncertain."""
        return replace(self.axis, drive=drive, uncertainty=None)

    @property
    def units(self) -> dict[str, str]:
        """What varies, with its unit."""
        return {quantity.name: quantity.unit for quantity in self.varied}
