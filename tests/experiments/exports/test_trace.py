"""What a controller's step becomes, and what cannot be written elsewhere is refused by its name."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import pytest

from diffdrive.controllers import UnknownController
from diffdrive.controllers.base import Command, Controller
from diffdrive.model.data_sheet import DataSheet
from diffdrive.model.motor_units import axis_unit
from diffdrive.model.quantity import quantities, quantity
from experiments.exports.program import ExportError
from experiments.exports.trace import program_of
from tests.support.exported import VARIANTS

PERIOD = 1e-4


class Custom(Controller):
    """Any law of reference minus position."""

    law: object = None
    gain: float = quantity("N/m", "gain", default=2.0)

    def init(self, position):
        return jnp.zeros(2)

    def step(self, state, reference, position, applied, period):
        return state, Command(self.law(self.gain * (reference.position - position)))


class Inner(NamedTuple):
    x: jax.Array


class Outer(NamedTuple):
    inner: Inner


class Nested(Controller):
    """A state within a state, of which nothing is stated."""

    gain: float = quantity("N/m", "gain", default=2.0)

    def init(self, position):
        return Outer(Inner(position))

    def step(self, state, reference, position, applied, period):
        return Outer(Inner(position)), Command(self.gain * (state.inner.x - position))


@pytest.mark.parametrize("name", VARIANTS)
def test_every_number_that_the_law_depends_on_is_a_parameter_and_no_other(name):
    """One that changes nothing would be set in vain: `ki` has no effect beside a reset time."""
    axis = VARIANTS[name]
    program = program_of(axis.controller, PERIOD, "axis")
    paths = {one.path.removesuffix(".positive").removesuffix(".negative") for one in program.parameters}
    stated = {path for path, _, value in quantities(axis.controller) if value is not None}
    assert paths == stated - ({"ki"} if "reset_time" in stated else set())
    assert {one.name for one in program.parameters} <= {value.name for value in program.leaves}
    assert len({one.name for one in program.parameters}) == len(program.parameters)


def test_what_no_parameter_changes_is_no_coefficient_and_what_one_does_is():
    program = program_of(VARIANTS["cascade"].controller, PERIOD, "axis")
    assert {value.name for value in program.coefficients if value.is_leaf} == {"kp", "kv", "velocity_feedforward"}
    (integral,) = (value for value in program.coefficients if not value.is_leaf)
    assert [operand.name or operand.number for operand in integral.operands] == ["ki", PERIOD]  # once, not each step


def test_an_input_that_is_not_read_says_so():
    program = program_of(VARIANTS["cascade"].controller, PERIOD, "axis")
    unread = [one.name for one in program.inputs if one.meaning.endswith("not read by this controller")]
    assert unread == ["reference_acceleration", "applied_force"]
    observed = program_of(VARIANTS["pd+fc"].controller, PERIOD, "axis")
    assert not any("not read" in one.meaning for one in observed.inputs)


def test_what_is_kept_says_what_it_is_also_on_a_rotary_axis():
    program = program_of(VARIANTS["pd+fc+ls"].controller, PERIOD, "axis")
    rotary = program.in_units(lambda unit: axis_unit(unit, DataSheet(kind="rotary")))
    comments = {
        one.path: (one.comment, turned.comment) for one, turned in zip(program.states, rotary.states, strict=True)
    }
    assert comments["last_error.known"] == ("whether there was one",) * 2
    assert comments["observer.x[1]"] == ("m/s: estimated velocity", "rad/s: estimated velocity")
    assert comments["observer.covariance[1][0]"][1] == "rad^2/s^2: variance of the estimated velocity"
    assert comments["observer.covariance[3][0]"][1].startswith("(N*m)^2: ")


def test_of_a_state_that_says_nothing_its_place_is_told():
    program = program_of(Custom(lambda error: error), PERIOD, "axis")
    assert {one.comment for one in program.states} == {""}  # an array, the whole state
    nested = program_of(Nested(), PERIOD, "axis")
    assert [one.comment for one in nested.states] == ["inner.x"]


def test_a_controller_whose_law_is_unknown_is_refused():
    with pytest.raises(ExportError, match="unknown"):
        program_of(UnknownController(), PERIOD, "axis")


REFUSED = {
    "while": lambda error: jax.lax.while_loop(lambda x: x > 1.0, lambda x: 0.5 * x, error),
    "scan": lambda error: jax.lax.scan(lambda x, _: (0.5 * x, None), error, None, length=3)[0],
    "dot_general": lambda error: jnp.dot(jnp.ones(2), jnp.array([error, error])),
    "shape": lambda error: jnp.sum(jnp.broadcast_to(error, (2, 2))),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_no_target_has_is_refused_by_its_name(what):
    with pytest.raises(ExportError, match=what):
        program_of(Custom(REFUSED[what]), PERIOD, "axis")


def test_a_filter_that_the_controller_drops_leaves_no_input_behind():
    motor = program_of(VARIANTS["cascade, motor alone"].controller, PERIOD, "axis")
    names = [one.name for one in motor.inputs]
    assert "motor_position" in names
    assert "scale_position" not in names
    plain = program_of(replace(VARIANTS["cascade"].controller), PERIOD, "axis")
    assert "motor_position" not in [one.name for one in plain.inputs]
