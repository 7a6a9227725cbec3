"""Tuned gains as they are handed over: each by its name, in volts where it is a force; the machine stays as it was."""

from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import diffdrive as dd
from diffdrive.controllers import Command, Controller, Tunable
from diffdrive.logs.mapping import ColumnMapping
from diffdrive.loop.margins import Margins
from diffdrive.model.quantity import quantity
from tuning.gains.handover import handover, worst_margins
from tuning.gains.result import tuned_axis
from tuning.gains.tune import default_space, gain_names, gain_units

MARGINS = Margins(*(jnp.ones(1) for _ in Margins._fields))


class Spring(Controller):
    """u = stiffness (r - y) + push, its gains with names of its own."""

    stiffness: float = quantity("N/m", "stiffness", at_least=0.0)
    push: float = quantity("N", "push", at_least=0.0)
    corner: float = quantity("Hz", "corner", at_least=0.0)
    variance: float = quantity("N^2", "variance", at_least=0.0)

    kind = "spring"
    tunables: ClassVar = {name: Tunable(name, 10.0) for name in ("stiffness", "push", "corner", "variance")}

    def init(self, position):
        return position

    def step(self, state, reference, position, applied, period):
        return state, Command(self.stiffness * (reference.position - position) + self.push)


def handed(axis, *, friction=False):
    """The tables of gains that stay as they are."""
    space = default_space(axis.controller, friction=friction)
    tuned = SimpleNamespace(
        names=list(gain_names(axis.controller, space).values()),
        units=gain_units(axis.controller, space),
        after=np.asarray(space.values(np.zeros(len(space.free)))),
    )
    volts = replace(axis, mapping=replace(ColumnMapping(), force_per_volt=2.0))
    return handover(volts, tuned, MARGINS, {})


def test_every_gain_that_is_a_force_is_handed_over_in_volts():
    spring = dd.paper_axis().with_controller(Spring(100.0, 10.0, 5.0, 4.0))
    tables = handed(spring)
    assert tables["gains_si"] == pytest.approx({"stiffness": 100.0, "push": 10.0, "corner": 5.0, "variance": 4.0})
    assert tables["gains_in_command_volts"] == pytest.approx({"force_per_volt": 2.0, "stiffness": 50.0, "push": 5.0})


def test_the_friction_that_an_observer_is_tuned_to_is_no_gain_in_volts():
    tables = handed(dd.paper_axis("pd+fc+ls"), friction=True)
    assert {"kp", "Q_position", "R", "viscous.positive"} <= tables["gains_si"].keys()
    assert tables["gains_in_command_volts"].keys() == {"force_per_volt", "kp", "kd"}


def test_a_machine_keeps_its_friction_unless_that_is_tuned_along():
    axis = dd.paper_axis("pd+fc")
    other = axis.replace({"friction.coulomb_screw": 1.0})
    apart = axis.with_controller(other.controller)  # its observer believes in another friction
    assert tuned_axis(apart, apart.controller, friction=False).drive.friction == axis.drive.friction
    assert tuned_axis(apart, apart.controller, friction=True).drive.friction == other.drive.friction


def test_a_margin_that_rounds_to_zero_has_no_sign():
    """As of the growth of a load that is not observable at rest: some 1e-12 1/s of rounding."""
    found = worst_margins(MARGINS._replace(growth=-1e-12 * jnp.ones(1)))
    assert {str(found[name]) for name in ("gain_up_dB", "growth_per_s")} == {"0.0"}
