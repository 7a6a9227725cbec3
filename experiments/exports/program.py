"""A control step as arithmetic: what is computed from parameters once, and what from inputs and state in each step.

A `Value` is one result: of an operation on others, or a parameter, an input, a state, a literal. Equal values are one
object (`Arithmetic.value`), so that nothing is computed twice. Arrays have one dimension; all else is a scalar.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from diffdrive.errors import ParameterError


class ExportError(ParameterError):
    """A controller cannot be exported: it names what stands in the way."""


class Kind(StrEnum):
    """What a value is, in every language that is written."""

    REAL = "real"
    WHOLE = "whole"
    TRUTH = "truth"


LEAVES = ("literal", "parameter", "input", "state")


@dataclass(frozen=True, eq=False)
class Value:
    """A result: `operation` on `operands`; of a leaf the `name`, or the number."""

    operation: str
    operands: tuple["Value", ...]
    kind: Kind
    size: int | None  # of an array
    name: str = ""
    number: float | int | bool | None = None
    place: int = 0  # the first entry that a slice or an entry takes
    in_step: bool = False  # whether it depends on inputs or states

    @property
    def is_leaf(self) -> bool:
        """Whether nothing is computed."""
        return self.operation in LEAVES


class Parameter(NamedTuple):
    """A number that the controller's behaviour depends on: how a target names it, and what a drive file says of it."""

    name: str
    path: str
    unit: str
    meaning: str
    value: float


class Signal(NamedTuple):
    """An input or an output."""

    name: str
    unit: str
    meaning: str


ENCODERS = "scale_position", "motor_position"  # names of the inputs that measure a position
AT_START = Signal("start_position", "m", "measured position at the start")


class State(NamedTuple):
    """What is kept from step to step: the part of the controller's state that it holds, and its first value.

    Unit and meaning are "" where the controller does not state them.
    """

    name: str
    path: str
    unit: str
    meaning: str
    kind: Kind
    size: int | None
    initial: Value  # from parameters and the measured position
    following: Value

    @property
    def comment(self) -> str:
        """What is known of it, for a comment."""
        return f"{self.unit}: {self.meaning}" if self.unit and self.meaning else self.meaning or self.path


@dataclass(frozen=True)
class Program:
    """A controller's step, its initial state, and what both need."""

    name: str
    kind: str  # of the controller
    period: float  # s
    single: bool
    parameters: tuple[Parameter, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[tuple[Signal, Value], ...]
    states: tuple[State, ...]
    at_start: Signal = AT_START

    @property
    def coefficients(self) -> tuple[Value, ...]:
        """What step and initial state read of the parameters, in the order in which it is computed."""
        order = _depth_first(self._targets, through=lambda value: value.in_step)
        return tuple(value for value in order if not value.in_step and value.operation != "literal")

    @property
    def values(self) -> tuple[Value, ...]:
        """All that is read or computed, each after its operands."""
        return tuple(_depth_first(self._targets, through=lambda _: True))

    @property
    def leaves(self) -> tuple[Value, ...]:
        """Parameters, inputs and states that are read."""
        return tuple(value for value in self.values if value.is_leaf)

    def in_units(self, unit_of: Callable[[str], str]) -> "Program":
        """With other units of the same numbers, such as those of a rotary axis; `unit_of` gives each its own."""

        def restated(one: Signal) -> Signal:
            return one._replace(unit=unit_of(one.unit))

        def state(one: State) -> State:  # some have no unit
            return one._replace(unit=unit_of(one.unit) if one.unit else "")

        return replace(
            self,
            parameters=tuple(one._replace(unit=unit_of(one.unit)) for one in self.parameters),
            inputs=tuple(map(restated, self.inputs)),
            outputs=tuple((restated(one), value) for one, value in self.outputs),
            states=tuple(map(state, self.states)),
            at_start=restated(self.at_start),
        )

    @property
    def measured(self) -> str:
        """The encoder at which it starts: the scale, or the motor's where it has no scale."""
        names = [one.name for one in self.inputs]
        return next(name for name in ENCODERS if name in names)

    def reads(self, signal: Signal) -> bool:
        """Whether the controller depends on an input."""
        return any(value.operation == "input" and value.name == signal.name for value in self.leaves)

    @property
    def _targets(self) -> list[Value]:
        values = [value for _, value in self.outputs]
        return values + [value for state in self.states for value in (state.initial, state.following)]


def _depth_first(targets: Iterable[Value], through: Callable[[Value], bool]) -> Iterator[Value]:
    """Targets and operands, each once and after its own operands; those of what is not gone `through` are left out."""
    seen: set[Value] = set()
    for target in targets:
        stack = [(target, False)]
        while stack:
            value, entered = stack.pop()
            if entered:
                yield value
            elif value not in seen:
                seen.add(value)
                stack.append((value, True))
                if through(value):
                    stack += [(operand, False) for operand in reversed(value.operands)]


def in_order(targets: Iterable[Value], known: Iterable[Value] = ()) -> list[Value]:
    """What must be computed for the targets beside leaves and what is `known`, each after what it is made of."""
    given = set(known)
    order = _depth_first(targets, through=lambda value: value not in given)
    return [value for value in order if value not in given and not value.is_leaf]


@dataclass
class Arithmetic:
    """Makes values: equal ones are one, and what is made of literals alone is computed at once."""

    single: bool = False
    _known: dict[object, Value] = field(default_factory=dict)

    def literal(self, number: object) -> Value:
        """A number, or a truth value."""
        array = np.asarray(number)
        if array.dtype == bool:
            return self._leaf("literal", Kind.TRUTH, None, number=bool(array))
        if np.issubdtype(array.dtype, np.integer):
            return self._leaf("literal", Kind.WHOLE, None, number=int(array))
        return self._leaf("literal", Kind.REAL, None, number=float(self._real(float(array))))

    def leaf(self, operation: str, name: str, kind: Kind, size: int | None = None) -> Value:
        """A parameter, an input or a state."""
        return self._leaf(operation, kind, size, name=name, in_step=operation != "parameter")

    def value(self, operation: str, *operands: Value, kind: Kind | None = None, place: int = 0, size: int = 0) -> Value:
        """The result of an operation; `size` that of an array which it makes."""
        kind = operands[0].kind if kind is None else kind
        lengths = {operand.size for operand in operands if operand.size is not None}
        length = size or (lengths.pop() if lengths and operation not in ("entry", "sum") else None)
        folded = self._folded(operation, operands, kind) if length is None else None
        if folded is not None:
            return folded
        if operation == "div" and kind is Kind.REAL and (divisor := operands[1].number):
            # as the simulator's compiler does it, and faster
            return self.value("mul", operands[0], self.literal(self._real(1.0) / self._real(float(divisor))))
        in_step = any(operand.in_step for operand in operands)
        made = Value(operation, operands, kind, length, place=place, in_step=in_step)
        return self._known.setdefault((operation, operands, kind, length, place), made)

    def _leaf(self, operation: str, kind: Kind, size: int | None, **rest: object) -> Value:
        sign = str(rest.get("number"))  # -0.0 is not 0.0
        key = (operation, kind, size, *rest.values(), sign)
        return self._known.setdefault(key, Value(operation, (), kind, size, **rest))  # type: ignore[arg-type]

    def _real(self, number: float) -> np.floating:
        return np.float32(number) if self.single else np.float64(number)

    def _folded(self, operation: str, operands: tuple[Value, ...], kind: Kind) -> Value | None:
        """The four operations, and conversions, on literals: what IEEE 754 fixes to the last bit."""
        numbers = [operand.number for operand in operands if operand.operation == "literal"]
        if len(numbers) < len(operands) or None in numbers:
            return None
        if operation == "convert":
            (number,) = numbers
            of = {Kind.REAL: float, Kind.WHOLE: int, Kind.TRUTH: bool}[kind]
            return self.literal(of(number))
        if kind is not Kind.REAL or operation not in ("add", "sub", "mul", "div", "neg"):
            return None
        with np.errstate(all="ignore"):
            reals = [self._real(float(number)) for number in numbers]  # type: ignore[arg-type]
            if operation == "neg":
                return self.literal(-reals[0])
            left, right = reals
            results = {"add": left + right, "sub": left - right, "mul": left * right}
            return self.literal(left / right if operation == "div" else results[operation])
