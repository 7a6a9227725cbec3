"""C99: a header, the controller, and a bench that replays a simulated run and compares."""

import re
from collections.abc import Mapping
from typing import NamedTuple

from experiments.exports.c_language import C99
from experiments.exports.layout import Access, Layout, layout_of
from experiments.exports.program import Program
from experiments.exports.replay import Replay
from experiments.exports.templates import rendered
from experiments.reports.report import version_of

ACCESS = Access(parameter="p->", input="in->", start="", coefficient="k->", state="s->")


class CCode(NamedTuple):
    """What templates of C write."""

    program: Program
    language: C99
    layout: Layout

    @property
    def real(self) -> str:
        """The type of a real number."""
        return self.language.real

    @property
    def set_parameters(self) -> list[str]:
        """The lines that compute the coefficients."""
        return self.language.lines(*self.layout.parameters)

    @property
    def reset(self) -> list[str]:
        """The lines that start at a position."""
        return self.language.lines(*self.layout.start)

    @property
    def step(self) -> list[str]:
        """The lines of one period."""
        outputs = [one._replace(name=f"out->{one.name}") for one in self.layout.outputs]
        return self.language.lines(self.layout.step.statements, [*outputs, *self.layout.step.assignments])

    def reads(self, lines: list[str], what: str) -> bool:
        """Whether a name, or what begins with it, stands in some lines."""
        return any(re.search(rf"\b{re.escape(what)}", line) for line in lines)

    def calls(self, helper: str) -> bool:
        """Whether a helper is called anywhere."""
        return self.reads(self.set_parameters + self.reset + self.step, f"{self.program.name}_{helper}(")


def c_code(program: Program) -> CCode:
    """A program in C."""
    language = C99(program.name, program.single)
    return CCode(program, language, layout_of(program, language, ACCESS))


def c_files(program: Program, title: str, replay: Replay, tolerances: Mapping[str, float]) -> Mapping[str, str]:
    """The files by their names: header, controller, bench, and the run that this replays."""
    values = {"code": c_code(program), "program": program, "title": title, "tolerances": tolerances}
    values["version"] = version_of("diffdrive")
    names = {"c99.h.jinja": ".h", "c99.c.jinja": ".c", "c99_bench.c.jinja": "_bench.c"}
    files = {f"{program.name}{ending}": rendered(template, **values) for template, ending in names.items()}
    return files | {f"{program.name}_run.csv": replay.as_csv()}
