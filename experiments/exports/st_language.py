"""Structured Text of IEC 61131-3: how it writes operations, with LREAL or REAL."""

import math

import numpy as np

from experiments.exports.program import ExportError, Kind, Value
from experiments.exports.statements import ATOM, Language, Statement, Text

OR, XOR, AND, EQUAL, LESS, SUM, PRODUCT, UNARY = 1, 2, 3, 4, 5, 6, 7, 8
BINARY = {
    "add": ("+", SUM), "sub": ("-", SUM), "mul": ("*", PRODUCT), "div": ("/", PRODUCT),
    "lt": ("<", LESS), "le": ("<=", LESS), "gt": (">", LESS), "ge": (">=", LESS),
    "eq": ("=", EQUAL), "ne": ("<>", EQUAL), "xor": ("XOR", XOR), "and": ("AND", AND), "or": ("OR", OR),
}  # fmt: skip
RANGE = 1.2e-38, 3.4e38  # of a REAL
FUNCTIONS = {
    "sqrt": "SQRT", "exp": "EXP", "log": "LN", "sin": "SIN", "cos": "COS", "tan": "TAN", "asin": "ASIN",
    "acos": "ACOS", "atan": "ATAN", "pow": "EXPT", "abs": "ABS",
}  # fmt: skip


class StructuredText(Language):
    """Expressions of the second edition, which every controller's compiler reads."""

    def __init__(self, single: bool) -> None:
        """With REAL, or with LREAL."""
        self.single = single
        self.real, self.whole = ("REAL", "DINT") if single else ("LREAL", "LINT")

    def type_of(self, kind: Kind, size: int | None = None) -> str:
        """The type of a value."""
        name = {Kind.REAL: self.real, Kind.WHOLE: "DINT", Kind.TRUTH: "BOOL"}[kind]
        return name if size is None else f"ARRAY[0..{size - 1}] OF {name}"

    def number(self, number: float) -> str:
        """A real literal, exact to the last bit; some compilers take no LREAL that is beyond a REAL."""
        if number and not RANGE[0] < abs(number) < RANGE[1]:  # NaN, too
            raise ExportError(f"Structured Text cannot write the number {number:g}: its literals end at {RANGE[1]:g}")
        mantissa, exponent, power = self._text(number).partition("E")
        return f"{mantissa}{'' if '.' in mantissa else '.0'}{exponent}{power}"

    def constant(self, number: float) -> str:
        """A literal within an expression: without its type CODESYS and TwinCAT take it for an LREAL."""
        text = self.number(number)
        if not self.single:
            return text
        return f"-REAL#{text[1:]}" if text.startswith("-") else f"REAL#{text}"

    def _text(self, number: float) -> str:
        return (str(np.float32(number)) if self.single else repr(float(number))).upper()

    def literal(self, value: Value) -> Text:
        if value.kind is Kind.TRUTH:
            return Text("TRUE" if value.number else "FALSE", ATOM)
        if value.kind is Kind.WHOLE:
            text = str(int(value.number or 0))
            return Text(text, UNARY if text.startswith("-") else ATOM)
        number = float(value.number or 0.0)
        if number and math.isfinite(number) and not RANGE[0] < abs(number) < RANGE[1]:
            mantissa, _, power = f"{number:.16E}".partition("E")
            return Text(f"{mantissa} * EXPT({self.real}#10.0, {int(power)}.0)", PRODUCT)
        text = self.constant(number)
        return Text(text, UNARY if text.startswith("-") else ATOM)

    def operation(self, value: Value, operands: list[Text]) -> Text:
        name = value.operation
        if name in BINARY:
            operator, binds = BINARY[name]
            left, right = operands
            least = binds if name in ("add", "sub", "mul", "div") else SUM
            return Text(f"{left.within(least)} {operator} {right.within(least + 1)}", binds)
        if name in ("neg", "not"):
            return Text(f"{'-' if name == 'neg' else 'NOT '}{operands[0].within(UNARY + 1)}", UNARY)
        if name == "select":
            which, then, otherwise = operands
            return _call("SEL", which, otherwise, then)
        if name == "convert":
            return self._converted(value, operands[0])
        if name == "sign":
            (x,) = operands
            zero, one = self.constant(0.0), self.constant(1.0)
            below = f"SEL({x.within(SUM)} < {zero}, {x.text}, -{one})"
            return Text(f"SEL({x.within(SUM)} > {zero}, {below}, {one})", ATOM)
        if name in ("min", "max") and value.kind is Kind.REAL:
            return _extreme("<" if name == "min" else ">", value, operands)
        if name == "round":
            return Text(f"{self.whole}_TO_{self.real}({self.real}_TO_{self.whole}({operands[0].text}))", ATOM)
        if name in ("halved", "exp2"):
            exponent = f"-{operands[0].within(UNARY + 1)}" if name == "halved" else operands[0].text
            return Text(f"EXPT({self.real}#2.0, {exponent})", ATOM)
        if name in FUNCTIONS and value.kind is Kind.REAL:
            return _call(FUNCTIONS[name], *operands)
        raise ExportError(
            f"the controller's step uses '{name}' of {value.kind} numbers, which is not written in Structured Text: "
            "export it as c99"
        )

    def _converted(self, value: Value, operand: Text) -> Text:
        given, kind = value.operands[0].kind, value.kind
        if given is Kind.TRUTH:
            zero, one = ("0", "1") if kind is Kind.WHOLE else (self.constant(0.0), self.constant(1.0))
            return Text(f"SEL({operand.text}, {zero}, {one})", ATOM)
        if kind is Kind.TRUTH:
            return Text(f"{operand.within(SUM)} <> {'0' if given is Kind.WHOLE else self.constant(0.0)}", EQUAL)
        return Text(f"{self.type_of(given)}_TO_{self.type_of(kind)}({operand.text})", ATOM)

    def statement(self, statement: Statement) -> list[str]:
        """The lines that give a declared name its value."""
        name = statement.name
        if statement.summed is not None:
            count, entry = statement.summed
            return [f"{name} := {self.constant(0.0)};", *self.loop(0, count, f"{name} := {name} + {entry};")]
        if statement.size is None:
            return [self.assigned(name, statement.text)]
        return self.pieces(statement)

    def assigned(self, name: str, text: str) -> str:
        return f"{name} := {text};"

    def looped(self, first: int, last: int, body: str) -> list[str]:
        return [f"FOR i := {first} TO {last} DO", f"    {body}", "END_FOR;"]


def _extreme(before: str, value: Value, operands: list[Text]) -> Text:
    """The smaller or larger of two numbers; where one is none, that one: MIN and MAX may give the other, a limit."""
    pairs = sorted(zip(value.operands, operands, strict=True), key=lambda pair: _doubt(pair[0]))
    (doubted, first), (_, second) = pairs
    comes_first = f"{first.within(SUM)} {before} {second.within(SUM)}"
    if _doubt(doubted) == 2:
        comes_first = f"({comes_first}) OR ({first.within(SUM)} <> {first.within(SUM)})"
    return Text(f"SEL({comes_first}, {second.text}, {first.text})", ATOM)


def _doubt(value: Value) -> int:
    """Whether a value may be no number: 0 for a literal, 1 where only the parameters say, 2 where inputs do."""
    return 0 if value.operation == "literal" else 1 + value.in_step


def _call(function: str, *operands: Text) -> Text:
    return Text(f"{function}({', '.join(operand.text for operand in operands)})", ATOM)
