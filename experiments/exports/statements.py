"""Statements that compute the values of a program, for a language that says how it writes an operation.

What is read once is written where it is read, as far as a line holds it; all else gets a name. Arrays are computed
entry by entry, in loops.
"""

import abc
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from experiments.exports.program import Kind, Value, in_order

LONGEST = 88  # characters of an expression
INDEX = "i"  # of a loop
ATOM = 100  # precedence of what needs no parentheses


class Text(NamedTuple):
    """An expression, and how strongly its outermost operator binds."""

    text: str
    precedence: int

    def within(self, precedence: int) -> str:
        """In parentheses, unless it binds at least so strongly."""
        return self.text if self.precedence >= precedence else f"({self.text})"


class Piece(NamedTuple):
    """Entries of an array: `length` of them from `first` on, each by an expression in the index."""

    first: int
    length: int
    text: str


class Statement(NamedTuple):
    """A named result: one expression, pieces of an array, or the sum of an array's entries."""

    name: str
    kind: Kind
    size: int | None
    text: str = ""
    pieces: tuple[Piece, ...] = ()
    summed: tuple[int, str] | None = None  # how many entries, and each of them


class Assignment(NamedTuple):
    """A name that is given a value: a scalar, or each entry of an array in the index `i`."""

    name: str
    size: int | None
    text: str


class Language(abc.ABC):
    """How a language writes literals and operations."""

    @abc.abstractmethod
    def literal(self, value: Value) -> Text:
        """A number or a truth value."""

    @abc.abstractmethod
    def operation(self, value: Value, operands: list[Text]) -> Text:
        """An operation on scalars."""

    @abc.abstractmethod
    def statement(self, statement: "Statement") -> list[str]:
        """The lines that give a named result its value."""

    @abc.abstractmethod
    def assigned(self, name: str, text: str) -> str:
        """The statement that gives a name its value."""

    @abc.abstractmethod
    def looped(self, first: int, last: int, body: str) -> list[str]:
        """A loop over the entries of an array from `first` to `last`."""

    def loop(self, first: int, length: int, body: str) -> list[str]:
        """A loop over entries of an array; of one entry the body alone."""
        return [body] if length == 1 else self.looped(first, first + length - 1, body)

    def lines(self, statements: "Iterable[Statement]", assignments: "Iterable[Assignment]" = ()) -> list[str]:
        """Statements, and then what is kept of them; what keeps its own value needs no line."""
        lines = [line for one in statements for line in self.statement(one)]
        for name, size, text in assignments:
            if name != text:
                target = name if size is None else f"{name}[{index_of(size)}]"
                lines += self.loop(0, 1 if size is None else size, self.assigned(target, text))
        return lines

    def pieces(self, statement: "Statement") -> list[str]:
        """The loops that fill an array."""
        lines = []
        for piece in statement.pieces:
            index = index_of(piece.length, piece.first if piece.length == 1 else 0)
            lines += self.loop(piece.first, piece.length, self.assigned(f"{statement.name}[{index}]", piece.text))
        return lines

    def entry(self, array: str, index: str) -> Text:
        """One entry of an array."""
        return Text(f"{array}[{index}]", ATOM)


@dataclass
class Statements:
    """Writes values one after another.

    `names` are those of leaves, and of what was computed before.
    """

    language: Language
    names: dict[Value, str]
    prefix: str = "t"
    written: list[Statement] = field(default_factory=list)
    _inline: dict[Value, Text] = field(default_factory=dict)
    _count: int = 0

    def compute(self, targets: Iterable[Value], named: Mapping[str, Value] | None = None) -> None:
        """Compute these values, and those that are `named` under their names; a leaf has its name already."""
        wanted = {value: name for name, value in reversed(list((named or {}).items()))}
        values = [value for value in (*targets, *wanted) if not value.is_leaf]
        order = in_order(values, self.names)
        readers = Counter(operand for value in order for operand in value.operands)
        readers.update(values)  # a target is read outside
        for value in order:
            text = self._text(value) if value.size is None and value.operation != "sum" else None
            if value in wanted or text is None or readers[value] > 1 or len(text.text) > LONGEST:
                self._let(value, wanted.get(value, ""))
            else:
                self._inline[value] = text

    def copy(self, name: str, value: Value) -> None:
        """Keep what a leaf is now under a name, by which it is read from here on."""
        pieces = () if value.size is None else (Piece(0, value.size, self.text(value).text),)
        self.written.append(Statement(name, value.kind, value.size, self.text(value).text, pieces))
        self.names[value] = name

    def text(self, value: Value, index: str = "") -> Text:
        """What a value is called, or the expression that it is; of an array one entry."""
        if value in self._inline:
            return self._inline[value]
        if value.operation == "literal":
            return self.language.literal(value)
        name = self.names[value]
        return Text(name, ATOM) if value.size is None else self.language.entry(name, index or index_of(value.size))

    def _let(self, value: Value, name: str = "") -> None:
        if not name:
            self._count += 1
            name = f"{self.prefix}{self._count}"
        if value.operation == "sum":
            (array,) = value.operands
            self.written.append(Statement(name, value.kind, None, summed=(array.size or 0, self.text(array).text)))
        elif value.size is not None:
            self.written.append(Statement(name, value.kind, value.size, pieces=self._pieces(value)))
        else:
            self.written.append(Statement(name, value.kind, None, self._text(value).text))
        self.names[value] = name

    def _text(self, value: Value) -> Text:
        if value.operation == "entry":
            return self.text(value.operands[0], str(value.place))
        return self.language.operation(value, [self.text(operand) for operand in value.operands])

    def _pieces(self, value: Value) -> tuple[Piece, ...]:
        size = value.size or 0
        if value.operation == "fill":
            return (Piece(0, size, self.text(value.operands[0]).text),)
        if value.operation == "slice":
            return (Piece(0, size, self.text(value.operands[0], index_of(size, value.place)).text),)
        if value.operation == "join":
            pieces, first = [], 0
            for operand in value.operands:
                length = operand.size or 1
                # in a loop the index is that of the whole; alone the entry's own
                index = index_of(length, -first) if length > 1 else "0"
                pieces.append(Piece(first, length, self.text(operand, index).text))
                first += length
            return tuple(pieces)
        return (Piece(0, size, self._text(value).text),)


def index_of(size: int, shift: int = 0) -> str:
    """The entry that a loop over so many entries is at; one entry needs no loop, and some compilers run none."""
    if size == 1:
        return str(shift)
    return INDEX if shift == 0 else f"{INDEX} {'+' if shift > 0 else '-'} {abs(shift)}"
