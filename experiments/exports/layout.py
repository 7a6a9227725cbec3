"""The layout of a program in a language: names of its coefficients, and the statements of its three parts."""

from typing import NamedTuple

from experiments.exports.program import Kind, Program, Value
from experiments.exports.statements import Assignment, Language, Statement, Statements


class Access(NamedTuple):
    """What a language writes before the name of a parameter, an input, a coefficient or a state."""

    parameter: str
    input: str
    start: str
    coefficient: str
    state: str


class Coefficient(NamedTuple):
    """What is computed from the parameters once: its name, and the expression that it is given."""

    name: str
    kind: Kind
    size: int | None
    text: str


class Part(NamedTuple):
    """Statements, and then what is kept of them."""

    statements: tuple[Statement, ...]
    assignments: tuple[Assignment, ...]


class Layout(NamedTuple):
    """Coefficients, and the parts: from parameters, at the start, and in each step with its outputs."""

    coefficients: tuple[Coefficient, ...]
    parameters: Part
    start: Part
    step: Part
    outputs: tuple[Assignment, ...]


def layout_of(program: Program, language: Language, access: Access) -> Layout:
    """The program in a language."""
    names: dict[Value, str] = {}
    for value in program.coefficients:
        names[value] = f"{access.coefficient}{value.name or f'c{1 + sum(not one.name for one in names)}'}"
    set_up = Statements(language, _leaves(program, "parameter", access.parameter), prefix="p")
    set_up.compute(names)
    start = Statements(language, names | _leaves(program, "input", access.start), prefix="b")
    start.compute((), {f"first_{one.name}": one.initial for one in program.states})
    step = Statements(
        language, names | _leaves(program, "input", access.input) | _leaves(program, "state", access.state)
    )
    outputs = {signal.name: value for signal, value in program.outputs}
    step.compute((), outputs | {f"next_{one.name}": one.following for one in program.states})
    for one in program.states:
        if one.following.operation == "state" and one.following.name != one.name:
            step.copy(f"next_{one.name}", one.following)  # which may have its own next value by then
    prefix = len(access.coefficient)
    return Layout(
        tuple(Coefficient(names[value][prefix:], value.kind, value.size, set_up.text(value).text) for value in names),
        Part(tuple(set_up.written), tuple(_assignment(names[value], value, set_up) for value in names)),
        Part(
            tuple(start.written),
            tuple(_assignment(f"{access.state}{one.name}", one.initial, start) for one in program.states),
        ),
        Part(
            tuple(step.written),
            tuple(_assignment(f"{access.state}{one.name}", one.following, step) for one in program.states),
        ),
        tuple(_assignment(name, value, step) for name, value in outputs.items()),
    )


def _assignment(name: str, value: Value, statements: Statements) -> Assignment:
    return Assignment(name, value.size, statements.text(value).text)


def _leaves(program: Program, operation: str, prefix: str) -> dict[Value, str]:
    """The leaves of one sort that the program reads, by what they are called."""
    return {value: f"{prefix}{value.name}" for value in program.leaves if value.operation == operation}
