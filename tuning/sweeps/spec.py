"""A sweep as it was asked for, in plain text: what its folder keeps, and any machine can be run again from."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from diffdrive.axis_file.drive_file import axis_tables, parse_axis, read_axis
from diffdrive.errors import ParameterError
from diffdrive.motion.file import parse_motion_table, read_motion
from diffdrive.motion.motion import Motion
from diffdrive.motion.text import MOTIONS, Recipe, motion_recipe, parse_motion, require_same_rate
from diffdrive.support.atomic_write import write_text
from tuning.sweeps.engine import LEAST_IN_A_PART, Precision, most_in_a_part
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.samples import Method

FILE = "asked.json"


@dataclass(frozen=True)
class SweepSpec:
    """Drives as the tables of their files, motions as their texts or the whole text of their files."""

    name: str
    drive: Mapping[str, object]  # what the first controller believes
    motions: dict[str, str]
    vary: tuple[str, ...]
    samples: int
    method: Method = "sobol"
    seed: int = 0
    load: str = "0"
    settle: float = 0.0
    machine: Mapping[str, object] | None = None  # what the machines vary about, where it is not the drive
    against: Mapping[str, Mapping[str, object]] = field(
        default_factory=dict
    )  # further controllers, by the name of their file
    correlation: dict[str, dict[str, float]] = field(default_factory=dict)
    most_in_a_part: int = LEAST_IN_A_PART
    precision: Precision = "double"

    @classmethod
    def of(
        cls, drive: Path, motions: Sequence[str], vary: Sequence[str], samples: int, *,
        machine: Path | None = None, against: Sequence[Path] = (), **more: Any,
    ) -> "SweepSpec":  # fmt: skip
        """From files and texts, which are read here; raises what reading them does."""
        names = [path.stem for path in (drive, *against)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ParameterError(f"--against: two files are called {', '.join(twice)}: give them names of their own")
        return cls(
            drive.stem,
            axis_tables(read_axis(drive)),
            dict(_motion(text) for text in motions),
            tuple(vary),
            samples,
            machine=None if machine is None else axis_tables(read_axis(machine)),
            against={path.stem: axis_tables(read_axis(path)) for path in against},
            **{"most_in_a_part": most_in_a_part()} | more,
        )

    def plan(self) -> SweepPlan:
        """What is to be run. Raises `ParameterError` or `MotionError` for a sweep that cannot be."""
        believed = parse_axis(self.drive, self.name)
        axis = believed if self.machine is None else parse_axis(self.machine, "the machine")
        sampling = believed.sampling
        require_same_rate("--machine", axis, believed)
        axis = dataclasses.replace(axis, sampling=sampling, limits=believed.limits)
        controllers = {self.name: believed.controller}
        for name, tables in self.against.items():
            other = parse_axis(tables, name)
            require_same_rate(f"--against {name}", other, believed)
            controllers[name] = other.controller
        origins = self.origins(sampling.rate)
        motions = {name: self._motion(origin, sampling.rate) for name, origin in origins.items()}
        return SweepPlan.of(
            axis, controllers, motions, self.vary, self.samples, recipes=self._recipes(origins),
            method=self.method, seed=self.seed, load=self.load, settle=self.settle, correlation=self.correlation,
            most_in_a_part=self.most_in_a_part, precision=self.precision,
        )  # fmt: skip

    def origins(self, rate: float) -> dict[str, str]:
        """What was asked for, by the name of each motion in the sweep: a second one of a name by its number, too."""
        found: dict[str, str] = {}
        for origin in self.motions:
            name = self._motion(origin, rate).name
            number = 1 + sum(other.split(" #")[0] == name for other in found)
            found[name if number == 1 else f"{name} #{number}"] = origin
        return found

    def _motion(self, origin: str, rate: float) -> Motion:
        text = self.motions[origin]
        return parse_motion(text, rate) if text == origin else parse_motion_table(text, origin)

    def _recipes(self, origins: dict[str, str]) -> dict[str, Recipe[Motion] | None]:
        """How those motions are made that are not of a file."""
        return {name: motion_recipe(text) if self.motions[text] == text else None for name, text in origins.items()}


def to_text(spec: SweepSpec) -> str:
    """As JSON."""
    return json.dumps(dataclasses.asdict(spec), indent=1) + "\n"


def from_text(text: str) -> SweepSpec:
    """From JSON."""
    fields = json.loads(text)
    return SweepSpec(**fields | {"vary": tuple(fields["vary"])})


def _motion(text: str) -> tuple[str, str]:
    """Where it is from, and what it says: a motion by its text is from there itself."""
    if text.partition(":")[0] in MOTIONS or not Path(text).is_file():
        return text, text
    return text, read_motion(Path(text))


def write_spec(spec: SweepSpec, folder: Path) -> None:
    """Write it into the folder of the sweep."""
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / FILE, to_text(spec))


def read_spec(folder: Path) -> SweepSpec:
    """What the sweep in `folder` was asked for; raises `ParameterError` where there is none."""
    path = folder / FILE
    try:
        return from_text(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise ParameterError(f"{folder}: holds no sweep ({FILE} is not there)") from None
    except (ValueError, TypeError, KeyError) as problem:
        raise ParameterError(f"{path}: is damaged: {problem}; run the sweep again") from None
