"""A resonance that was measured, and that the model does not have, lowers the gains that `tune` finds."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffdrive as dd
import tuning
from diffdrive.controllers import Cascade
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Actuator, Sampling, Sensor
from diffdrive.model.presets import paper_drive
from diffdrive.model.quantity import Directional
from diffdrive.numerics.arrays import as_arrays
from tests.support.second_order import two_mass_speed
from tuning.gains.measured import NAME
from tuning.gains.plan import TuningPlan
from tuning.gains.setup import set_up

RATE = 2_000.0  # its programs compile in seconds
FREQUENCY = np.geomspace(1.0, 900.0, 200)
HIDDEN = dd.FrequencyResponse(
    FREQUENCY, two_mass_speed(FREQUENCY, 100.0, 150.0, 0.02), "plant", "(m/s)/N", name="plant"
)
SHORT = dd.motion.triangular(speed=0.010, stroke=0.0009, rounding=0.02, duration=0.2, rate=RATE, first_reversal=0.1)


@pytest.fixture(scope="module")
def axis():
    drive = paper_drive()
    drive = dataclasses.replace(
        drive,
        actuator=Actuator(delay_samples=1),
        sensor=Sensor(None, 2e-8),
        friction=dataclasses.replace(drive.friction, breakaway_gap=Directional(2.0, 2.0)),
    )
    return dd.Axis(drive, Cascade(kp=20.0, kv=3_000.0, velocity_feedforward=1.0), Sampling(RATE, 2))


def prepared(axis, measured):
    plan = TuningPlan(motion=SHORT, settle=0.05, machines=1)
    return set_up(axis, plan, tuning.Requirements(command_noise=None), measured=measured)


@pytest.mark.long
def test_the_measured_requirements_are_the_margins_of_the_measured_loop(axis):
    setup = prepared(axis, [HIDDEN, HIDDEN])
    found = setup.constraints.loop_constraints(as_arrays(smooth(axis.controller)))
    margins = dd.measured_loop(axis.with_controller(axis.controller), HIDDEN).margins()
    limit = 10.0 ** (6.0 / 20.0)
    excess = limit / 10.0 ** (float(margins.gain_margin_up) / 20.0) - 1.0
    np.testing.assert_allclose(found[NAME + "gain margin up"], [excess, excess], rtol=1e-6)
    assert float(found[NAME + "phase margin"][0]) == pytest.approx(1.0 - float(margins.phase_margin) / 30.0, rel=1e-6)
    assert not any(name.startswith(NAME) for name in prepared(axis, []).constraints.loop_constraints(
        as_arrays(smooth(axis.controller))
    ))  # fmt: skip


@pytest.mark.long
def test_what_is_missed_goes_on_smoothly_where_the_measured_loop_becomes_unstable(axis):
    """Its derivative by the gain against differences, on both sides of the brink, and no jump there."""
    constraints = prepared(axis, [HIDDEN]).constraints
    controller = as_arrays(smooth(axis.controller))

    @jax.jit
    def missed(gain):
        scaled = dataclasses.replace(controller, kv=gain)
        return constraints.loop_constraints(scaled)[NAME + "gain margin up"][0]

    gains = np.geomspace(1e3, 1.2e5, 60)  # unstable from 8e4 on, the model alone from 1.6e5
    values = np.array([missed(jnp.asarray(gain)) for gain in gains])
    assert values[0] < 0.0 < values[-1]
    brink = 10.0 ** (6.0 / 20.0) - 1.0  # the gain margin is 0 dB
    assert np.any(values < brink)
    assert np.any(values > brink)
    for gain in (gains[5], gains[-5]):
        slope = jax.jit(jax.grad(missed))(jnp.asarray(gain))
        up, down = (float(missed(jnp.asarray(factor * gain))) for factor in (1.0 + 1e-5, 1.0 - 1e-5))
        assert float(slope) * gain == pytest.approx((up - down) / 2e-5, rel=1e-5)
    near = np.flatnonzero(np.diff(np.sign(values - brink)))
    assert np.max(np.abs(np.diff(values)[near])) < 0.2 * (values[-1] - values[0])


@pytest.mark.long
def test_a_hidden_resonance_lowers_the_gain(axis):
    common = {"requirements": tuning.Requirements(command_noise=None), "machines": 1, "starts": 1, "max_steps": 12}
    blind = tuning.tune(axis, SHORT, **common)
    seeing = tuning.tune(axis, SHORT, measured=HIDDEN, **common)
    assert blind.measured_margins == ()
    (margins,) = seeing.measured_margins
    assert seeing.accepted, seeing.status
    assert float(margins.after.gain_margin) > 5.9
    assert float(margins.after.phase_margin) > 29.0
    assert seeing.gains["kv"][1] < 0.8 * blind.gains["kv"][1]
    assert not bool(dd.measured_loop(blind.axis, HIDDEN).margins().gain_margin > 5.9)
    assert "measured_margins" in seeing.as_dict()
    assert any("measured from 1 to 900 Hz" in note for note in seeing.notes)
