"""Structured Text of IEC 61131-3: a function block, and a program that replays a simulated run."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from experiments.exports.layout import Access, Layout, layout_of
from experiments.exports.program import Program
from experiments.exports.replay import Replay
from experiments.exports.st_language import StructuredText
from experiments.exports.statements import Statement
from experiments.exports.templates import rendered
from experiments.reports.report import version_of

ROWS, PER_LINE = 500, 5  # of the replay, which the memory of a controller must hold
SMALLEST = 1e-37  # below it a signal in SI units is nothing
ACCESS = Access(parameter="", input="", start="", coefficient="k_", state="s_")


class STCode(NamedTuple):
    """What the template of a function block writes."""

    program: Program
    language: StructuredText
    layout: Layout

    @property
    def real(self) -> str:
        """The type of a real number."""
        return self.language.real

    @property
    def declared(self) -> list[Statement]:
        """What is computed on the way, and is no output."""
        parts = (self.layout.parameters, self.layout.start, self.layout.step)
        outputs = {one.name for one in self.layout.outputs}
        return [one for part in parts for one in part.statements if one.name not in outputs]

    @property
    def parameters(self) -> list[str]:
        """The lines that read the parameters."""
        return self.language.lines(*self.layout.parameters)

    @property
    def start(self) -> list[str]:
        """The lines that start at a position."""
        return self.language.lines(*self.layout.start)

    @property
    def step(self) -> list[str]:
        """The lines of each call."""
        return self.language.lines(self.layout.step.statements, [*self.layout.outputs, *self.layout.step.assignments])

    @property
    def has_arrays(self) -> bool:
        """Whether there are loops."""
        return any("FOR i" in line for line in self.start + self.step)


def st_code(program: Program) -> STCode:
    """A program in Structured Text."""
    language = StructuredText(program.single)
    return STCode(program, language, layout_of(program, language, ACCESS))


def st_files(program: Program, title: str, replay: Replay, tolerances: Mapping[str, float]) -> Mapping[str, str]:
    """The files by their names: the function block, and a program that replays the start of a run."""
    code = st_code(program)
    replayed = replay.inputs | {"expected_force": replay.outputs["force"]}
    values = {
        "code": code,
        "program": program,
        "title": title,
        "version": version_of("diffdrive"),
        "tolerances": tolerances,
        "rows": min(ROWS, len(replay.outputs["force"])),
        "columns": {name: _lines(code.language, column[:ROWS]) for name, column in replayed.items()},
    }
    templates = {f"{program.name}.st": "block.st.jinja", f"{program.name}_bench.st": "bench.st.jinja"}
    return {file: rendered(template, **values) for file, template in templates.items()}


def _lines(language: StructuredText, numbers: np.ndarray) -> list[str]:
    """Numbers as lines of literals."""
    texts = [language.number(float(number) if abs(number) > SMALLEST else 0.0) for number in numbers]
    return [", ".join(texts[first : first + PER_LINE]) for first in range(0, len(texts), PER_LINE)]
