"""A sweep as it was asked for, and the costs of any part of it."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa

from diffdrive.controllers import Controller
from diffdrive.drive_file import DriveDescription
from diffdrive.errors import ParameterError
from diffdrive.load import Ramp
from diffdrive.motion import Motion, require_within
from diffdrive.parameters import Drive, require_double_precision
from diffdrive.run import sane_error
from diffdrive.simulate import Costs, inputs_of
from experiments.edition import edition
from experiments.runtime import arithmetic
from experiments.scenario import parse_load, require_left
from experiments.sweeps.engine import Precision, costs_of
from experiments.sweeps.machines import Values, machines
from experiments.sweeps.samples import Method, correlated, root_of, shares
from experiments.sweeps.varied import Varied, parse_varied

MOST_IN_A_PART = 1024  # machines: a second or two of work, blocks for sixteen devices


@dataclass(frozen=True)
class Plan:
    """The machines of a sweep, and what each goes through.

    Every controller follows every motion on the same machines under the same loads and noise (common random numbers).
    """

    axis: DriveDescription
    controllers: Mapping[str, Controller]
    motions: Mapping[str, Motion]
    varied: tuple[Varied, ...]
    samples: int
    method: Method = "sobol"
    seed: int = 0
    load: str = "0"  # over time, as `scenario.parse_load` takes it; a load that varies is added to it
    settle: float = 0.0  # s at the start that do not count
    correlation: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    most_in_a_part: int = MOST_IN_A_PART  # a power of two
    precision: Precision = "double"

    @classmethod
    def of(
        cls, axis: DriveDescription, controllers: Mapping[str, Controller], motions: Mapping[str, Motion],
        vary: tuple[str, ...], samples: int, **more: Any,
    ) -> "Plan":  # fmt: skip
        """From the texts of `varied.parse_varied`. Raises `ParameterError` or `MotionError` for one that cannot be."""
        require_double_precision()
        varied = tuple(parse_varied(text, axis.drive) for text in vary)
        names = [one.name for one in varied]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ParameterError(f"vary: {', '.join(twice)} is given more than once")
        both = [name for name in names if {f"{name}.positive", f"{name}.negative"} & set(names)]
        if both:
            raise ParameterError(f"vary {both[0]}: stands for both directions, one of which is varied beside it")
        plan = cls(axis, controllers, motions, varied, samples, **more)
        if samples < 1:
            raise ParameterError(f"sweep: at least one machine is needed, got {samples}")
        for name, motion in motions.items():
            require_within(motion, axis.limits)
            if abs(motion.rate / axis.sampling.rate - 1.0) > 1e-6:
                raise ParameterError(
                    f"{name}: is sampled at {motion.rate:g} Hz, the controller runs at {axis.sampling.rate:g} Hz: "
                    "make them equal"
                )
            require_left(plan.settle, name, motion)
        if not 0 <= plan.seed < 2**63:
            raise ParameterError(f"sweep: seed must be from 0 to 2^63 - 1, got {plan.seed}")
        root_of(plan.correlation, names)
        return plan

    def require_possible(self, parts: Iterable[int]) -> None:
        """Every machine of these parts can be: hours later would be late. Raises `ParameterError` that names one."""
        least = min(float(np.min(self.loads(motion))) for motion in self.motions.values())
        for part in parts:
            numbers = self.numbers(part)
            try:
                self._possible(numbers, least)
            except ParameterError as problem:
                raise ParameterError(f"sweep: machine {self._first(numbers, least)} cannot be: {problem}") from None

    def _possible(self, numbers: np.ndarray, least: float) -> None:
        machine, ramp, _, _ = self.machines(numbers)
        lowest = least + ramp.load + jnp.minimum(ramp.change, 0.0)
        if jnp.any(lowest <= -machine.friction.initial_load):
            raise ParameterError(
                f"a load of {float(jnp.min(lowest)):g} N lifts the table off its guides: it must stay above minus the "
                "initial load"
            )

    def _first(self, numbers: np.ndarray, least: float) -> int:
        """The first machine of these that cannot be, where one is."""
        while len(numbers) > 1:
            half = numbers[: len(numbers) // 2]
            try:
                self._possible(half, least)
                numbers = numbers[len(half) :]
            except ParameterError:
                numbers = half
        return int(numbers[0])

    def loads(self, motion: Motion) -> np.ndarray:
        """The load (N) that every machine has along a motion, beside what varies."""
        return parse_load(self.load, motion.time)

    def every_load(self, motion: Motion) -> np.ndarray:
        """The same with the least and the most of the load that varies, before and behind its change."""
        ends = {one.name: one.of(np.array([0.0, 1.0])) for one in self.varied}
        behind = np.append(ends.get("load.change", []), 0.0)
        return np.concatenate(
            [self.loads(motion) + more + change for more in ends.get("load", [0.0]) for change in behind]
        )

    @cached_property
    def _root(self) -> np.ndarray | None:
        return root_of(self.correlation, [one.name for one in self.varied])

    @property
    def part_size(self) -> int:
        """Machines in a part, a power of two."""
        return min(self.most_in_a_part, 1 << (self.samples - 1).bit_length())

    @property
    def parts(self) -> int:
        """How many parts."""
        return -(-self.samples // self.part_size)

    def drawn(self, part: int) -> np.ndarray:
        """Shares of the probability of the machines of a part, [n, d]."""
        count = len(self.numbers(part))
        drawn = shares(self.method, len(self.varied), self.seed, part, self.part_size, count)
        return drawn if self._root is None else correlated(drawn, self._root)

    def numbers(self, part: int) -> np.ndarray:
        """Numbers of the machines of a part."""
        return np.arange(part * self.part_size, min(self.samples, (part + 1) * self.part_size))

    def keys(self, numbers: np.ndarray) -> Any:
        """Keys of the measuring noise of these machines; None where the scale has none."""
        if not float(self.axis.drive.sensor.noise) > 0.0 and not any(one.name == "sensor.noise" for one in self.varied):
            return None
        base = jax.random.key(self.seed)
        return jax.vmap(lambda number: jax.random.fold_in(base, number))(jnp.asarray(numbers))

    def machines(self, numbers: np.ndarray) -> tuple[Drive, Ramp, Values, Any]:
        """Machines of one part by their numbers: drives, loads, the values of what varies, the keys of their noise."""
        part = int(numbers[0]) // self.part_size
        drawn = self.drawn(part)[numbers - part * self.part_size]
        return *machines(self.axis.drive, self.varied, drawn), self.keys(numbers)

    def costs_of(self, numbers: np.ndarray, controller: str, motion: str) -> Costs:
        """Costs of machines of one part; each is the same to the last bit whichever others stand beside it."""
        drives, ramps, _, keys = self.machines(numbers)
        planned = self.motions[motion]
        counts = (planned.time >= self.settle).astype(float)
        inputs = inputs_of(planned, self.loads(planned))
        control, sampling = self.controllers[controller], self.axis.sampling
        reach = sane_error(planned.position, self.axis.limits)
        return costs_of(drives, ramps, keys, control, inputs, counts, sampling, self.precision, reach)

    def costs(self, part: int) -> pa.Table:
        """The machines of a part under every controller on every motion: one row for each."""
        numbers, tables = self.numbers(part), []
        _, _, values, _ = self.machines(numbers)
        unknown = pa.nulls(len(numbers), pa.float64())
        for motion, planned in self.motions.items():
            for controller in self.controllers:
                found = self.costs_of(numbers, controller, motion)
                tables.append(
                    pa.table(
                        {
                            "machine": numbers,
                            "controller": [controller] * len(numbers),
                            "motion": [motion] * len(numbers),
                            **values,
                            "rms_m": found.rms,
                            "peak_m": found.peak,
                            "command_noise_N": found.command_noise,
                            "load_error_N": unknown if found.load_error is None else found.load_error,
                            "saturated": found.saturated,
                            "diverged": found.steps_finite < len(planned.time),
                        }
                    )
                )
        return pa.concat_tables(tables)

    def axis_of(self, drive: Drive) -> DriveDescription:
        """The axis with another drive in it: what a machine's drive file says."""
        return replace(self.axis, drive=drive)

    @property
    def units(self) -> dict[str, str]:
        """What varies, with its unit."""
        return {one.name: one.unit for one in self.varied}

    def question(self) -> str:
        """What tells this sweep from any other: everything that its numbers hang on."""
        text = hashlib.sha256(
            edition(*(one.__module__ for one in (Plan, costs_of, machines, parse_varied, shares))).encode()
        )
        asked = [
            arithmetic(),
            self.method,
            self.seed,
            self.samples,
            self.part_size,
            self.load,
            self.settle,
            self.precision,
            [one.text for one in self.varied],
        ]
        asked += [{one: dict(others) for one, others in self.correlation.items()}]
        text.update(json.dumps(asked).encode())
        models = (self.axis.drive, self.axis.sampling, dict(self.controllers))
        text.update(repr(jax.tree.map(lambda leaf: np.asarray(leaf).tolist(), models)).encode())
        for name, motion in self.motions.items():
            text.update(name.encode() + np.ascontiguousarray(motion.position).tobytes())
        return text.hexdigest()
