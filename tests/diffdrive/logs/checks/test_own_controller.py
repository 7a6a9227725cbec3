"""A controller of one's own, without any part of those in the catalogue, against the logs that it should explain."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import diffdrive as dd
from diffdrive.controllers import Command, Controller, Keys, Kind, Tunable
from diffdrive.logs.checks.examine import examine
from diffdrive.model.quantity import quantity

AXIS = dd.paper_axis("pd+fc")
MOTION = dd.motion.triangular(speed=0.010, stroke=0.001, rounding=0.05, duration=0.8, rate=AXIS.rate)
LOG = dd.simulate(AXIS, MOTION).log("lap")


class PI(Controller):
    """u = kp e + ki int e."""

    kp: float = quantity("N/m", "proportional gain", at_least=0.0)
    ki: float = quantity("N/(m*s)", "integral gain", at_least=0.0)

    @property
    def kind(self):
        return "pi"

    @property
    def tunables(self):
        return {name: Tunable(name, 30.0, enters_linearly=True) for name in ("kp", "ki")}

    def table(self):
        return {"kp": float(self.kp), "ki": float(self.ki)}

    def init(self, position):
        return jnp.zeros_like(position)

    def step(self, state, reference, position, applied, period):
        error = reference.position - position
        integral = state + self.ki * period * error
        return integral, Command(self.kp * error + integral)


@pytest.fixture
def registered():
    dd.controllers.register(Kind("pi", "PI", lambda section, drive: section.build(PI), (Keys("controller", PI),)))
    yield
    dd.controllers.KINDS.remove("pi")


def log_of(kp, ki):
    error = LOG.reference - LOG.position
    return dataclasses.replace(LOG, command=kp * error + ki * np.cumsum(error) / AXIS.rate)


@pytest.mark.usefixtures("registered")
def test_the_command_of_another_law_is_a_finding():
    assert "other controller" in [finding.cause for finding in examine(LOG, AXIS.with_controller(PI(1e6, 5e6)))]


@pytest.mark.usefixtures("registered")
def test_its_own_command_is_none_and_one_with_other_gains_is():
    log = log_of(1e6, 5e6)
    causes = [finding.cause for finding in examine(log, AXIS.with_controller(PI(1e6, 5e6)))]
    assert "other controller" not in causes
    causes = [finding.cause for finding in examine(log, AXIS.with_controller(PI(2e6, 2e6)))]
    assert "other controller" in causes
