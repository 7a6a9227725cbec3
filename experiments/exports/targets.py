"""The targets by name, and `register` for further ones."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from diffdrive.support.registry import Registry
from experiments.exports.c99 import c_files
from experiments.exports.fmu import fmu_files
from experiments.exports.hal import hal_files
from experiments.exports.program import Program
from experiments.exports.replay import Replay
from experiments.exports.structured_text import st_files

Files = Mapping[str, str | bytes]


@dataclass(frozen=True)
class Target:
    """A language or format: its name, what it is, and the function that writes its files.

    `write` takes the program, a title, the run to replay, and the relative difference of each output that is borne.
    `readme` is the template of the readme, beside what all targets have in theirs.
    """

    name: str
    meaning: str
    write: Callable[[Program, str, Replay, Mapping[str, float]], Files]
    next_command: Callable[[str], str]  # of the program's name
    has_c_bench: bool = False
    readme: str = "readme.txt.jinja"


_BUILT_IN = (
    Target(
        "c99", "C without allocation: a structure of state, and a step function", c_files,
        lambda name: f"cc -std=c99 -O2 -o {name}_bench {name}.c {name}_bench.c -lm && ./{name}_bench {name}_run.csv",
        has_c_bench=True, readme="readme_c99.txt.jinja",
    ),
    Target(
        "structured-text", "a function block of IEC 61131-3, for TwinCAT, CODESYS and others", st_files,
        lambda name: f"import {name}.st and {name}_bench.st, and call {name}_bench until it is done",
        readme="readme_structured_text.txt.jinja",
    ),
    Target(
        "fmu", "a co-simulation FMU of FMI 3.0, with its sources", fmu_files,
        lambda name: f"pip install fmpy && python {name}_fmu_bench.py",
        readme="readme_fmu.txt.jinja",
    ),
    Target(
        "hal", "a component of LinuxCNC, for halcompile", hal_files,
        lambda name: f"sudo halcompile --install {name}.comp && python3 {name}_hal_bench.py",
        readme="readme_hal.txt.jinja",
    ),
)  # fmt: skip
TARGETS: Registry[Target] = Registry("target", {target.name: target for target in _BUILT_IN})
"""Every known target by its name."""


def register(target: Target) -> Target:
    """Make a target known to `export` and to the command line.

    Raises `ParameterError` for the name of a target that the package has.
    """
    TARGETS.add(target.name, target)
    return target
