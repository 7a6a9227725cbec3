"""C99: how it writes operations, in double or single precision."""

import math

import numpy as np

from experiments.exports.program import ExportError, Kind, Value
from experiments.exports.statements import ATOM, Language, Statement, Text

OR, AND, EQUAL, LESS, SUM, PRODUCT, UNARY = 1, 2, 3, 4, 5, 6, 7
BINARY = {
    "add": ("+", SUM), "sub": ("-", SUM), "mul": ("*", PRODUCT), "div": ("/", PRODUCT),
    "lt": ("<", LESS), "le": ("<=", LESS), "gt": (">", LESS), "ge": (">=", LESS),
    "eq": ("==", EQUAL), "ne": ("!=", EQUAL), "xor": ("!=", EQUAL), "and": ("&&", AND), "or": ("||", OR),
}  # fmt: skip
MATH = {
    "sqrt": "sqrt", "exp": "exp", "exp2": "exp2", "log": "log", "sin": "sin", "cos": "cos", "tan": "tan",
    "asin": "asin", "acos": "acos", "atan": "atan", "atan2": "atan2", "tanh": "tanh", "pow": "pow",
    "floor": "floor", "ceil": "ceil", "abs": "fabs", "rem": "fmod", "round": "rint",
}  # fmt: skip
HELPERS = {"min": "smaller", "max": "larger", "sign": "sign_of", "halved": "halved"}  # of the template


class C99(Language):
    """Expressions of C99 that no compiler warns of."""

    def __init__(self, prefix: str, single: bool) -> None:
        """Of helpers with this prefix."""
        self.prefix, self.single = prefix, single
        self.real = "float" if single else "double"

    def type_of(self, kind: Kind) -> str:
        """The type of a value."""
        return {Kind.REAL: self.real, Kind.WHOLE: "int32_t", Kind.TRUTH: "bool"}[kind]

    def number(self, number: float) -> str:
        """A real literal, exact to the last bit."""
        if not math.isfinite(number):
            return "NAN" if math.isnan(number) else "INFINITY" if number > 0 else "-INFINITY"
        text = str(np.float32(number)) if self.single else repr(float(number))
        if "e" not in text and "." not in text:
            text += ".0"
        return f"{text}f" if self.single else text

    def literal(self, value: Value) -> Text:
        if value.kind is Kind.TRUTH:
            return Text("true" if value.number else "false", ATOM)
        if value.kind is Kind.WHOLE:
            whole = int(value.number or 0)
            return Text(str(whole), UNARY if whole < 0 else ATOM)
        text = self.number(float(value.number or 0.0))
        return Text(text, UNARY if text.startswith("-") else ATOM)

    def operation(self, value: Value, operands: list[Text]) -> Text:
        name = value.operation
        if name in BINARY:
            operator, binds = BINARY[name]
            left, right = operands
            # compilers warn of comparisons beside comparisons, and of && within ||
            least = binds if name in ("add", "sub", "mul", "div") else SUM
            return Text(f"{left.within(least)} {operator} {right.within(least + 1)}", binds)
        if name == "neg":
            return Text(f"-{operands[0].within(UNARY + 1)}", UNARY)
        if name == "not":
            return Text(f"!{operands[0].within(UNARY + 1)}", UNARY)
        if name == "select":
            which, then, otherwise = operands
            return Text(f"{which.within(SUM)} ? {then.within(SUM)} : {otherwise.within(SUM)}", 0)
        if name == "convert":
            return self._converted(value, operands[0])
        arguments = ", ".join(operand.text for operand in operands)
        if name in HELPERS and value.kind is Kind.REAL:
            return Text(f"{self.prefix}_{HELPERS[name]}({arguments})", ATOM)
        if name in MATH and value.kind is Kind.REAL:
            return Text(f"{MATH[name]}{'f' if self.single else ''}({arguments})", ATOM)
        raise ExportError(f"the controller's step uses '{name}' of {value.kind} numbers, which is not written in C")

    def _converted(self, value: Value, operand: Text) -> Text:
        if value.operands[0].kind is Kind.TRUTH:
            one, zero = (self.number(1.0), self.number(0.0)) if value.kind is Kind.REAL else ("1", "0")
            return Text(f"{operand.within(SUM)} ? {one} : {zero}", 0)
        if value.kind is Kind.TRUTH:
            zero = self.number(0.0) if value.operands[0].kind is Kind.REAL else "0"
            return Text(f"{operand.within(SUM)} != {zero}", EQUAL)
        return Text(f"({self.type_of(value.kind)}){operand.within(UNARY + 1)}", UNARY)

    def statement(self, statement: Statement) -> list[str]:
        """A declaration with its value."""
        kind, name = self.type_of(statement.kind), statement.name
        if statement.summed is not None:
            count, entry = statement.summed
            return [f"{kind} {name} = {self.number(0.0)};", *self.loop(0, count, f"{name} += {entry};")]
        if statement.size is None:
            return [f"const {kind} {name} = {statement.text};"]
        return [f"{kind} {name}[{statement.size}];", *self.pieces(statement)]

    def assigned(self, name: str, text: str) -> str:
        return f"{name} = {text};"

    def looped(self, first: int, last: int, body: str) -> list[str]:
        return [f"for (int i = {first}; i < {last + 1}; ++i) {{", f"    {body}", "}"]
