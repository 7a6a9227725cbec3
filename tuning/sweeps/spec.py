"""A sweep as it was stated, and the same as text: its folder keeps it, workers get it, `replay` begins from it."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import faithful_tables, parse_axis
from diffdrive.errors import DriveFileError, ParameterError
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.motion.motion import Motion
from diffdrive.motion.text import Recipe, motion_recipe, parse_motion
from diffdrive.numerics.correlation import Correlation
from diffdrive.support.atomic_write import write_text
from diffdrive.support.bounds import require_a
from diffdrive.support.rates import require_same_rate
from tuning.sweeps.engine import LEAST_IN_A_PART, Precision, most_in_a_part
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.samples import Method

FILE = "spec.json"
SIGNALS = ("time", "position", "velocity", "acceleration")  # of a motion


class GivenMotion(NamedTuple):
    """A motion, and what it was given by: a line of text, the name of a file, or its own name."""

    motion: Motion
    given: str
    recipe: Recipe[Motion] | None = None  # of a line of text: its settings may vary

    @classmethod
    def of(cls, motion: Motion | str, rate: float, sheet: DataSheet = NO_SHEET) -> "GivenMotion":
        """A motion from what a user gives; raises `MotionError` for a text that is none."""
        if isinstance(motion, Motion):
            return cls(motion, motion.name)
        require_a(str, "motion", motion, "give a Motion, a line of text or a file")
        return cls(parse_motion(motion, rate, sheet), motion, motion_recipe(motion, sheet))


@dataclass(frozen=True)
class SweepSpec:
    """Axes and motions as they are in memory, and how machines are drawn."""

    axis: Axis  # under the first controller; its machine is what the others vary about, where no other is given
    motions: tuple[GivenMotion, ...]
    vary: Mapping[str, str]  # distributions by the names of quantities
    samples: int
    machine: Axis | None = None  # what the machines vary about
    against: Mapping[str, Axis] = field(default_factory=dict)  # whose controllers run on the same machines
    method: Method = "sobol"
    seed: int = 0
    load: str = "0"
    settle: float = 0.0
    correlation: Correlation = field(default_factory=dict)
    most_in_a_part: int = LEAST_IN_A_PART
    precision: Precision = "double"

    @classmethod
    def of(
        cls, axis: Axis, motions: Motion | str | Sequence[Motion | str], vary: Mapping[str, str], samples: int,
        **more: Any,
    ) -> "SweepSpec":  # fmt: skip
        """From motions and texts of motions; raises `MotionError` for one that cannot be."""
        several = motions if isinstance(motions, Sequence) and not isinstance(motions, str) else [motions]
        given = tuple(GivenMotion.of(motion, axis.rate, axis.sheet) for motion in several)
        return cls(axis, given, dict(vary), samples, **{"most_in_a_part": most_in_a_part()} | more)

    def plan(self) -> SweepPlan:
        """What is to be run. Raises `ParameterError` or `MotionError` for a sweep that cannot be."""
        if self.axis.name in self.against:
            raise ParameterError(f"against: {self.axis.name!r} is the axis itself; give it another name")
        others = {f"against {name}": other for name, other in self.against.items()}
        for name, other in (others if self.machine is None else {"machine": self.machine} | others).items():
            require_same_rate(name, other.rate, "the axis", self.axis.rate)
        axis = self.axis if self.machine is None else dataclasses.replace(self.axis, drive=self.machine.drive)
        motions = self.motions_by_name
        return SweepPlan.of(
            axis,
            {self.axis.name: self.axis.controller} | {name: other.controller for name, other in self.against.items()},
            {name: given.motion for name, given in motions.items()},
            tuple(f"{name}={text}" for name, text in self.vary.items()),
            self.samples,
            recipes={name: given.recipe for name, given in motions.items()},
            method=self.method, seed=self.seed, load=self.load, settle=self.settle, correlation=self.correlation,
            most_in_a_part=self.most_in_a_part, precision=self.precision,
        )  # fmt: skip

    @property
    def motions_by_name(self) -> dict[str, GivenMotion]:
        """The motions by their names in the sweep: a second one of a name by its number, too."""
        found: dict[str, GivenMotion] = {}
        for given in self.motions:
            number = 1 + sum(other.motion.name == given.motion.name for other in found.values())
            found[given.motion.name if number == 1 else f"{given.motion.name} #{number}"] = given
        return found


def to_text(spec: SweepSpec) -> str:
    """As JSON, axes as drive files have them; raises `ParameterError` for an axis that no file can hold."""
    fields = {field.name: getattr(spec, field.name) for field in dataclasses.fields(spec)}
    # of the machine the drive alone counts: under the axis's controller a file holds whatever drive there is
    machine = None if spec.machine is None else spec.axis.with_drive(spec.machine.drive)
    try:
        fields |= {
            "axis": _axis_to_json(spec.axis),
            "machine": None if machine is None else _axis_to_json(machine),
            "against": {name: _axis_to_json(axis) for name, axis in spec.against.items()},
        }
    except (DriveFileError, ParameterError) as problem:
        raise ParameterError(f"workers, a cluster and `replay` need drive files of all axes: {problem}") from None
    fields["motions"] = [_motion_to_json(given) for given in spec.motions]
    return json.dumps(fields, indent=1) + "\n"


def from_text(text: str) -> SweepSpec:
    """From JSON, with the numbers that it was made of."""
    fields = json.loads(text)
    axis = _axis_from_json(fields["axis"])
    return SweepSpec(
        **fields
        | {
            "axis": axis,
            "motions": tuple(_motion_from_json(given, axis) for given in fields["motions"]),
            "machine": None if fields["machine"] is None else _axis_from_json(fields["machine"]),
            "against": {name: _axis_from_json(other) for name, other in fields["against"].items()},
        }
    )


def _axis_to_json(axis: Axis) -> dict[str, object]:
    return {"name": axis.name, "drive_file": faithful_tables(axis, axis.name)}


def _axis_from_json(fields: Mapping[str, Any]) -> Axis:
    return dataclasses.replace(parse_axis(fields["drive_file"], fields["name"]), name=fields["name"])


def _motion_to_json(given: GivenMotion) -> dict[str, str]:
    """A line of text as it is; of other motions the numbers, which read back to the last bit."""
    if given.recipe is not None:
        return {"given": given.given}
    signals = {name: " ".join(map(repr, np.asarray(getattr(given.motion, name), float).tolist())) for name in SIGNALS}
    return {"given": given.given, "name": given.motion.name, **signals}


def _motion_from_json(fields: Mapping[str, str], axis: Axis) -> GivenMotion:
    if "name" not in fields:
        return GivenMotion.of(fields["given"], axis.rate, axis.sheet)
    signals = {name: np.array(fields[name].split(), float) for name in SIGNALS}
    return GivenMotion(Motion(**signals, name=fields["name"]), fields["given"])


def write_spec(spec: SweepSpec, folder: Path) -> None:
    """Write it into the folder of the sweep; where no text can hold it, why."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        text = to_text(spec)
    except ParameterError as problem:
        text = json.dumps({"unwritable": str(problem)}) + "\n"
    write_text(folder / FILE, text)


def read_spec(folder: Path) -> SweepSpec:
    """The sweep in `folder`; raises `ParameterError` where there is none, or none that a text can hold."""
    path = folder / FILE
    try:
        text = path.read_text(encoding="utf-8")
        if problem := json.loads(text).get("unwritable"):
            raise ParameterError(f"{path}: this sweep cannot be repeated: {problem}")
        return from_text(text)
    except ParameterError:
        raise
    except (FileNotFoundError, NotADirectoryError):
        raise ParameterError(f"{folder}: holds no sweep ({FILE} is not there)") from None
    except (ValueError, TypeError, KeyError, AttributeError) as problem:
        raise ParameterError(f"{path}: is damaged: {problem}; run the sweep again") from None
