"""What each primitive operation of a traced program becomes.

The package's own exponentials are polynomials and 2^-n, and stay so. A library's would differ by its rounding, which
the friction observer makes a hundred thousand times larger. Only general powers and waves, of which the package reads
the bits, become the target's own functions. What no target has (a loop, a matrix) is an `ExportError` that names it.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.extend import core

from diffdrive.numerics import exponential
from experiments.exports.program import Arithmetic, ExportError, Kind, Value

Operands = list[Value]
Rule = Callable[[Arithmetic, Operands, Mapping[str, Any]], list[Value]]


def kind_of(dtype: Any) -> Kind:
    """What a number of this type is to a target."""
    if jnp.issubdtype(dtype, jnp.floating):
        return Kind.REAL
    return Kind.TRUTH if dtype.kind == "b" else Kind.WHOLE


def size_of(shape: tuple[int, ...], what: str) -> int | None:
    """The length of an array, None of a scalar; raises `ExportError` for more dimensions."""
    if len(shape) > 1:
        raise ExportError(f"{what} is an array of shape {shape}: write the controller in scalars, or in rows of them")
    return shape[0] if shape else None


def evaluated(arithmetic: Arithmetic, closed: Any, operands: Operands) -> list[Value]:
    """The results of a traced program on these values."""
    return _run(arithmetic, closed.jaxpr, closed.consts, operands)


def _run(arithmetic: Arithmetic, jaxpr: Any, constants: Sequence[Any], operands: Operands) -> list[Value]:
    known: dict[Any, Value] = dict(zip(jaxpr.invars, operands, strict=True))
    known |= {variable: _constant(arithmetic, one) for variable, one in zip(jaxpr.constvars, constants, strict=True)}

    def read(variable: Any) -> Value:
        return _constant(arithmetic, variable.val) if isinstance(variable, core.Literal) else known[variable]

    for equation in jaxpr.eqns:
        name, given = equation.primitive.name, [read(one) for one in equation.invars]
        rule = RULES.get(name)
        if rule is None:
            raise ExportError(f"the controller's step uses '{name}', which no target has: write it in other operations")
        for variable in equation.outvars:
            size_of(variable.aval.shape, f"a result of '{name}'")
        shapes = {"shape": equation.outvars[0].aval.shape, "dtype": equation.outvars[0].aval.dtype}
        known |= dict(zip(equation.outvars, rule(arithmetic, given, dict(equation.params) | shapes), strict=True))
    return [read(one) for one in jaxpr.outvars]


def _constant(arithmetic: Arithmetic, number: Any) -> Value:
    array = np.asarray(number)
    if array.ndim == 0:
        return arithmetic.literal(array)
    size = size_of(array.shape, "a constant")
    if len(set(array.tolist())) > 1:
        entries = [_broadcast(arithmetic, arithmetic.literal(one), 1) for one in array]
        return arithmetic.value("join", *entries, size=size or 0)
    return _broadcast(arithmetic, arithmetic.literal(array[0]), len(array))


def _broadcast(arithmetic: Arithmetic, scalar: Value, size: int) -> Value:
    return arithmetic.value("fill", scalar, size=size)


# what each primitive becomes


def _plain(operation: str, kind: Kind | None = None) -> Rule:
    """The operation of another name."""

    def rule(arithmetic: Arithmetic, operands: Operands, _: Mapping[str, Any]) -> list[Value]:
        return [arithmetic.value(operation, *operands, kind=kind)]

    return rule


def _same(_: Arithmetic, operands: Operands, __: Mapping[str, Any]) -> list[Value]:
    return operands


def _inner(name: str) -> Rule:
    """The program inside, such as that of a function that is compiled by itself."""

    def rule(arithmetic: Arithmetic, operands: Operands, params: Mapping[str, Any]) -> list[Value]:
        program = params[name]
        jaxpr = getattr(program, "jaxpr", program)
        function = FUNCTIONS.get(_function_name(jaxpr))
        if function is not None:
            return function(arithmetic, *operands)
        return _run(arithmetic, jaxpr, getattr(program, "consts", ()), operands)

    return rule


def _function_name(jaxpr: Any) -> str:
    """The name of a traced function of `diffdrive.numerics`; "" for any other."""
    information = getattr(jaxpr, "debug_info", None)
    name, _, file = str(getattr(information, "func_src_info", "") or "").partition(" at ")
    return name if "diffdrive/numerics/" in file.replace("\\", "/") else ""


def _select(arithmetic: Arithmetic, operands: Operands, _: Mapping[str, Any]) -> list[Value]:
    which, *cases = operands
    if which.kind is not Kind.TRUTH or len(cases) != 2:
        raise ExportError(f"the controller's step chooses between {len(cases)} values at once: choose between two")
    return [arithmetic.value("select", which, cases[1], cases[0], kind=cases[0].kind)]


def _convert(arithmetic: Arithmetic, operands: Operands, params: Mapping[str, Any]) -> list[Value]:
    kind = kind_of(params["dtype"])
    (value,) = operands
    return [value if value.kind is kind else arithmetic.value("convert", value, kind=kind)]


def _power(arithmetic: Arithmetic, operands: Operands, params: Mapping[str, Any]) -> list[Value]:
    """A whole power by squares, as the compiler does it."""
    exponent, (base,) = params["y"], operands
    result: Value | None = None
    for bit in reversed(f"{abs(exponent):b}"):
        if bit == "1":
            result = base if result is None else arithmetic.value("mul", result, base)
        base = arithmetic.value("mul", base, base)
    if result is None:
        result = arithmetic.literal(1.0)
    return [result if exponent >= 0 else arithmetic.value("div", arithmetic.literal(1.0), result)]


def _square(arithmetic: Arithmetic, operands: Operands, _: Mapping[str, Any]) -> list[Value]:
    return [arithmetic.value("mul", operands[0], operands[0])]


def _round(arithmetic: Arithmetic, operands: Operands, params: Mapping[str, Any]) -> list[Value]:
    if int(params["rounding_method"]) != 1:
        raise ExportError(
            "the controller's step rounds halves away from zero: use jnp.round, which rounds them to even"
        )
    return [arithmetic.value("round", *operands)]


def _bits(arithmetic: Arithmetic, operands: Operands, params: Mapping[str, Any]) -> list[Value]:
    """The bits of a whole number beside a large one, and 2^-n of them: all that the package's exponentials read."""
    (value,) = operands
    if params["dtype"] in (np.int32, np.int64):
        return [arithmetic.value("bits", value, kind=Kind.WHOLE)]
    if value.operation == "shift_left" and value.operands[0].operation == "sub":
        bias, bits = value.operands[0].operands
        if bias.number in EXPONENT_BIASES and bits.operation == "bits" and bits.operands[0].operation == "add":
            return [arithmetic.value("halved", bits.operands[0].operands[0], kind=Kind.REAL)]
    raise ExportError("the controller's step makes a number of bits: write it in other operations")


def _clamp(arithmetic: Arithmetic, operands: Operands, _: Mapping[str, Any]) -> list[Value]:
    low, value, high = operands
    return [arithmetic.value("min", arithmetic.value("max", value, low), high)]


def _fill(arithmetic: Arithmetic, operands: Operands, params: Mapping[str, Any]) -> list[Value]:
    (value,) = operands
    size = size_of(params["shape"], "a result")
    if value.size is not None and value.size == 1 and size is not None and size > 1:
        value = arithmetic.value("entry", value)
    if size is None and value.size is not None:
        return [arithmetic.value("entry", value)]
    return [value if value.size == size else _broadcast(arithmetic, value, size or 0)]


def _slice(arithmetic: Arithmetic, operands: Operands, params: Mapping[str, Any]) -> list[Value]:
    (first,), strides = params["start_indices"], params["strides"] or (1,)
    if strides != (1,):
        raise ExportError("the controller's step takes each n-th entry of an array: write it in scalars")
    return [arithmetic.value("slice", *operands, place=first, size=params["shape"][0])]


def _join(arithmetic: Arithmetic, operands: Operands, params: Mapping[str, Any]) -> list[Value]:
    return [arithmetic.value("join", *operands, size=params["shape"][0])]


def _logistic(arithmetic: Arithmetic, operands: Operands, _: Mapping[str, Any]) -> list[Value]:
    one, (value,) = arithmetic.literal(1.0), operands
    tail = arithmetic.value("exp", arithmetic.value("neg", value))
    return [arithmetic.value("div", one, arithmetic.value("add", one, tail))]


def _root_reciprocal(arithmetic: Arithmetic, operands: Operands, _: Mapping[str, Any]) -> list[Value]:
    return [arithmetic.value("div", arithmetic.literal(1.0), arithmetic.value("sqrt", *operands))]


def _branches(arithmetic: Arithmetic, operands: Operands, params: Mapping[str, Any]) -> list[Value]:
    which, *given = operands
    if len(params["branches"]) != 2:
        raise ExportError("the controller's step has a switch of more than two cases: choose between two")
    otherwise, then = (evaluated(arithmetic, branch, given) for branch in params["branches"])
    if which.kind is not Kind.TRUTH:
        which = arithmetic.value("ne", which, arithmetic.literal(0), kind=Kind.TRUTH)
    pairs = zip(then, otherwise, strict=True)
    return [arithmetic.value("select", which, first, second, kind=first.kind) for first, second in pairs]


EXPONENT_BIASES = (127, 1023)  # of single and double precision
RULES: Mapping[str, Rule] = (
    {name: _plain(name) for name in ("add", "sub", "mul", "div", "neg", "abs", "sign", "min", "max", "sqrt")}
    | {name: _plain(name) for name in ("exp", "exp2", "log", "sin", "cos", "tan", "asin", "acos", "atan", "tanh")}
    | {name: _plain(name) for name in ("floor", "ceil", "pow", "atan2", "rem")}
    | {name: _plain(name, Kind.TRUTH) for name in ("lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not", "xor")}
    | dict.fromkeys(("optimization_barrier", "copy", "stop_gradient"), _same)
    | {name: _inner("jaxpr") for name in ("jit", "pjit", "closed_call", "checkpoint", "remat", "remat2")}
    | {name: _inner("call_jaxpr") for name in ("custom_jvp_call", "custom_vjp_call", "core_call")}
    | {
        "add_any": _plain("add"),
        "reduce_sum": _plain("sum"),
        "select_n": _select,
        "convert_element_type": _convert,
        "integer_pow": _power,
        "square": _square,
        "round": _round,
        "bitcast_convert_type": _bits,
        "shift_left": _plain("shift_left"),
        "clamp": _clamp,
        "broadcast_in_dim": _fill,
        "reshape": _fill,
        "squeeze": _fill,
        "slice": _slice,
        "concatenate": _join,
        "logistic": _logistic,
        "rsqrt": _root_reciprocal,
        "cond": _branches,
    }
)


# functions of the package that read bits, by those of the target


def _bounded_power(arithmetic: Arithmetic, y: Value, power: Value) -> list[Value]:
    one, least = arithmetic.literal(1.0), arithmetic.literal(exponential.MIN_BASE)
    representable = arithmetic.value("ge", y, least, kind=Kind.TRUTH)
    base = arithmetic.value("select", representable, y, one, kind=Kind.REAL)
    largest = arithmetic.literal(2.0**exponential.MAX_LOG2_POWER)
    raised = arithmetic.value("min", arithmetic.value("pow", base, power), largest)
    nothing = arithmetic.value("mul", arithmetic.literal(0.0), y)
    return [arithmetic.value("select", representable, raised, nothing, kind=Kind.REAL)]


def _cosine_sine(arithmetic: Arithmetic, angle: Value) -> list[Value]:
    return [arithmetic.value("cos", angle), arithmetic.value("sin", angle)]


FUNCTIONS: Mapping[str, Callable[..., list[Value]]] = {
    "bounded_power": _bounded_power,
    "cosine_sine": _cosine_sine,
}
