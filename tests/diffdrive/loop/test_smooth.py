"""The smooth variant of a drive and of its controller: what it rounds, what it leaves, and how near it stays."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.controllers import DOBVSC, PD, Cascade, Controller, DisturbanceObserver, FrictionCompensation
from diffdrive.effects import ForceLimit, ScaleEffect
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Actuator, Sensor
from diffdrive.observers.friction_observer import KalmanObserver, LoadStateObserver
from diffdrive.observers.load_estimator import InnovationLoad
from tests.support.paper_move import IDEAL, MOVE, SETTLED, TRACKING, run_of

LIMITED = dataclasses.replace(IDEAL, actuator=Actuator(force_limit=500.0, delay_samples=1), sensor=Sensor(noise=2e-8))
LOAD_ESTIMATOR = FrictionCompensation(
    TRACKING,
    KalmanObserver(IDEAL.plant, IDEAL.friction, load_estimator=InnovationLoad(min_speed=5e-3)),
)
LOAD_STATE = FrictionCompensation(TRACKING, LoadStateObserver(IDEAL.plant, IDEAL.friction))


def test_smooth_leaves_what_is_smooth_already():
    dob = DisturbanceObserver.of(IDEAL.plant, 240.0)
    compensation = FrictionCompensation(TRACKING, KalmanObserver(IDEAL.plant, IDEAL.friction))
    for part in (IDEAL, PD(TRACKING), DOBVSC(TRACKING, dob), compensation, Cascade(kp=1.0, kv=1.0)):
        assert bool(eqx.tree_equal(smooth(part), part))
    assert bool(eqx.tree_equal(smooth(smooth(LOAD_ESTIMATOR)), smooth(LOAD_ESTIMATOR)))


def test_smooth_changes_quantiser_limit_gate_and_floor_and_nothing_else():
    rounded = smooth(dataclasses.replace(LIMITED, sensor=Sensor(1e-7, 2e-8)))
    assert rounded.sensor == LIMITED.sensor
    assert (rounded.actuator.force_limit, rounded.actuator.delay_samples) == (500.0, 1)
    assert 0 < rounded.actuator.limit_rounding < 0.05 * 500.0
    assert rounded.plant == LIMITED.plant
    assert rounded.friction == LIMITED.friction
    estimator, before = smooth(LOAD_ESTIMATOR).observer.load_estimator, LOAD_ESTIMATOR.observer.load_estimator
    assert (estimator.gain, estimator.min_speed, estimator.initial_load) == (before.gain, before.min_speed, 0.0)
    assert estimator.floor is None
    assert estimator.rounding > 0
    assert smooth(LOAD_STATE).observer.floor is None
    assert smooth(LOAD_STATE).observer.tuning == LOAD_STATE.observer.tuning


class Rounded(ScaleEffect):
    """A reading in whole steps, which are gone where it is smooth."""

    name = "rounded"
    resolution: float | None = 1e-6

    def error(self, position):
        return 0.0 * position if self.resolution is None else self.resolution * jnp.round(position / self.resolution)

    def smoothed(self):
        return Rounded(None)


class Switched(Controller):
    """A controller that switches, around another."""

    inner: Controller
    width: float = 0.0

    def init(self, position):
        return self.inner.init(position)

    def step(self, state, *inputs):
        return self.inner.step(state, *inputs)

    def smoothed(self):
        return dataclasses.replace(self, width=0.1)


def test_what_somebody_else_wrote_is_smoothed_by_its_own_method():
    effects = smooth(dataclasses.replace(IDEAL, effects=(ForceLimit(50.0), Rounded()))).effects
    assert effects == (ForceLimit(50.0), Rounded(None))
    assert smooth(Switched(LOAD_ESTIMATOR)) == Switched(smooth(LOAD_ESTIMATOR), 0.1)


def test_smooth_needs_no_speed_gate():
    estimator = smooth(InnovationLoad(min_speed=0.0))
    moved = jax.value_and_grad(lambda v: estimator.step(10.0, v, 1.0, 2.0))
    assert [float(x) for x in moved(1e-3)] == [pytest.approx(110.0), 0.0]
    assert [float(x) for x in moved(0.0)] == [10.0, 0.0]


@pytest.mark.long
@pytest.mark.parametrize("controller", [PD(TRACKING), LOAD_STATE], ids=["pd", "pd+fc+ls"])
def test_smooth_keeps_the_result_where_there_is_no_quantiser(controller):
    load = np.where(MOVE.time < 0.2, 2e3, 6e3)
    exact = run_of(controller, LIMITED, load=load)
    near = run_of(smooth(controller), smooth(LIMITED), load=load)
    assert np.max(np.abs(near.table_position - exact.table_position)) < 0.02 * exact.peak_error()
    assert near.rms_error() == pytest.approx(exact.rms_error(), rel=0.01)
    if exact.load_estimate is not None:
        assert near.load_estimate[SETTLED] == pytest.approx(exact.load_estimate[SETTLED], abs=100.0)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::diffdrive.errors.LoadEstimatorWarning")
def test_smooth_keeps_the_printed_load_estimator_near():
    slow = {"load": 5e3}
    exact, near = run_of(LOAD_ESTIMATOR, **slow), run_of(smooth(LOAD_ESTIMATOR), **slow)
    assert near.load_estimate[SETTLED] == pytest.approx(exact.load_estimate[SETTLED], rel=0.05)
    assert near.rms_error() == pytest.approx(exact.rms_error(), rel=0.1)
