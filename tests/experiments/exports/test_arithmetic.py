"""Values: equal ones are one object, literals are computed at once as IEEE 754 has it, and parts are told apart."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.exports.c_language import C99
from experiments.exports.program import Arithmetic, Kind
from experiments.exports.st_language import StructuredText
from experiments.exports.statements import Statements

REALS = st.floats(-1e6, 1e6, allow_nan=False).filter(lambda x: x == 0.0 or abs(x) > 1e-6)


@pytest.fixture
def arithmetic():
    return Arithmetic()


def test_an_equal_value_is_the_same_object(arithmetic):
    x, y = (arithmetic.leaf("input", name, Kind.REAL) for name in "xy")
    assert arithmetic.value("add", x, y) is arithmetic.value("add", x, y)
    assert arithmetic.value("add", x, y) is not arithmetic.value("add", y, x)  # rounding may differ in what follows
    assert arithmetic.literal(0.0) is not arithmetic.literal(-0.0)


@given(st.sampled_from(["add", "sub", "mul"]), REALS, REALS, st.booleans())
def test_literals_are_computed_as_the_target_would(operation, a, b, single):
    arithmetic = Arithmetic(single)
    kind = np.float32 if single else np.float64
    expected = {"add": np.add, "sub": np.subtract, "mul": np.multiply}[operation](kind(a), kind(b))
    assert arithmetic.value(operation, arithmetic.literal(a), arithmetic.literal(b)).number == float(expected)


def test_what_depends_on_inputs_or_states_belongs_to_the_step(arithmetic):
    gain = arithmetic.leaf("parameter", "gain", Kind.REAL)
    state = arithmetic.leaf("state", "x", Kind.REAL)
    square = arithmetic.value("mul", gain, gain)
    assert not square.in_step
    assert arithmetic.value("mul", square, state).in_step


CASES = {  # an expression, and what it must be written as: to leave brackets out may change a rounding, or the sign
    "a - (b - c)": lambda m, a, b, c: m("sub", a, m("sub", b, c)),
    "a - b - c": lambda m, a, b, c: m("sub", m("sub", a, b), c),
    "a / (b * c)": lambda m, a, b, c: m("div", a, m("mul", b, c)),
    "a * (b / c)": lambda m, a, b, c: m("mul", a, m("div", b, c)),
    "-(a + b) * c": lambda m, a, b, c: m("mul", m("neg", m("add", a, b)), c),
    "a * -b": lambda m, a, b, c: m("mul", a, m("neg", b)),
    "-(-a)": lambda m, a, b, c: m("neg", m("neg", a)),
}


@pytest.mark.parametrize("language", [C99("x", single=False), StructuredText(single=False)], ids=["C", "ST"])
@pytest.mark.parametrize("expected", CASES)
def test_brackets_stand_where_they_matter(arithmetic, language, expected):
    a, b, c = leaves = [arithmetic.leaf("input", name, Kind.REAL) for name in "abc"]
    value = CASES[expected](arithmetic.value, a, b, c)
    statements = Statements(language, {leaf: leaf.name for leaf in leaves})
    statements.compute((), {"result": value})
    assert statements.written[-1].text == expected


@given(REALS.filter(lambda x: x == 0.0 or 1e-37 < abs(x) < 1e37))
def test_a_literal_is_exact_to_its_last_bit(number):
    for language in (C99("x", single=False), StructuredText(single=False)):
        assert float(language.number(number)) == number
    for language in (C99("x", single=True), StructuredText(single=True)):
        assert np.float32(language.number(number).rstrip("f")) == np.float32(number)


def test_what_is_read_twice_is_computed_once(arithmetic):
    x = arithmetic.leaf("input", "x", Kind.REAL)
    root = arithmetic.value("sqrt", x)
    statements = Statements(C99("x", single=False), {x: "x"})
    statements.compute((), {"y": arithmetic.value("mul", root, root)})
    assert [one.text for one in statements.written] == ["sqrt(x)", "t1 * t1"]


def test_the_smaller_of_two_is_no_limit_where_an_input_is_no_number(arithmetic):
    """In MIN(force, limit) a controller may take NaN for the limit; a comparison with NaN is false."""
    force, limit = arithmetic.leaf("input", "force", Kind.REAL), arithmetic.leaf("parameter", "limit", Kind.REAL)
    statements = Statements(StructuredText(single=False), {force: "force", limit: "limit"})
    values = [arithmetic.value("min", force, limit), arithmetic.value("max", limit, force)]
    values += [arithmetic.value("min", force, arithmetic.value("neg", force)), arithmetic.value("sign", force)]
    statements.compute((), dict(zip("abcd", values, strict=True)))
    assert [one.text for one in sorted(statements.written)] == [
        "SEL(limit < force, force, limit)",
        "SEL(limit > force, force, limit)",
        "SEL((force < -force) OR (force <> force), -force, force)",
        "SEL(force > 0.0, SEL(force < 0.0, force, -1.0), 1.0)",
    ]


def test_a_single_literal_in_an_expression_has_its_type(arithmetic):
    """CODESYS and TwinCAT compute with an LREAL where a literal has none (their manuals, "Typed Literals")."""
    x = arithmetic.leaf("input", "x", Kind.REAL)
    statements = Statements(StructuredText(single=True), {x: "x"})
    value = arithmetic.value("mul", arithmetic.value("add", x, arithmetic.literal(0.5)), arithmetic.literal(-2.0))
    statements.compute((), {"y": value})
    assert statements.written[-1].text == "(x + REAL#0.5) * -REAL#2.0"
