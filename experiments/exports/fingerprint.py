"""A short text by which two exports are told apart: that of the control law and of every number in it."""

import hashlib

from experiments.exports.program import Program, Value

GROUPS, LETTERS = 3, 4  # 48 bits: among a thousand exports two are alike by chance once in 500 million times


def fingerprint_of(program: Program) -> str:
    """The same for the same law with the same numbers, whatever the target and the names in its code."""
    places: dict[Value, int] = {}
    lines = [f"{program.kind} {program.period!r} {program.single}"]
    lines += [f"{one.name} = {one.value!r}" for one in program.parameters]
    for value in program.values:
        operands = [places[operand] for operand in value.operands]
        places[value] = len(places)
        lines.append(
            f"{value.operation} {operands} {value.kind} {value.size} {value.name} {value.number!r} {value.place}"
        )
    lines += [f"{signal.name}: {places[value]}" for signal, value in program.outputs]
    lines += [f"{one.path}: {places[one.initial]} {places[one.following]}" for one in program.states]
    digest = hashlib.sha256("\n".join(lines).encode("utf-8")).hexdigest()
    return "-".join(digest[LETTERS * group : LETTERS * (group + 1)] for group in range(GROUPS))
