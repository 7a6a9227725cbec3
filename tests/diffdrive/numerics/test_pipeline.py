"""Delays and differences over many samples: the same numbers in either form, and none as long as the motion."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive import motion as motions
from diffdrive.controllers import PD, Cascade
from diffdrive.controllers.base import paper_tracking
from diffdrive.errors import ParameterError
from diffdrive.loop.linearise import OperatingPoint, open_loop
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model import actuator
from diffdrive.model.parameters import Actuator, Sampling
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.numerics import pipeline
from diffdrive.numerics.arrays import as_arrays

DRIVE = paper_drive(quantised=False)
TRACKING = PD(paper_tracking(DRIVE, PAPER_KP, PAPER_KD))
MOVE = motions.jerk_limited(distance=2e-4, speed=0.01, acceleration=1.0, jerk=100.0, rate=10_000.0, dwell=0.01)
LATE = dataclasses.replace(DRIVE, actuator=Actuator(delay_samples=3))


@pytest.mark.parametrize("controller", [TRACKING, Cascade(kp=50.0, kv=1e4, ki=1e5, velocity_samples=4)])
def test_a_long_pipeline_gives_the_numbers_of_a_short_one(controller, monkeypatch):
    def position():
        inputs = loop_inputs(MOVE, np.zeros(len(MOVE.time)))
        return np.asarray(
            jax.jit(lambda: rollout_loop(*as_arrays((LATE, controller)), inputs, Sampling()).table_position)()
        )

    short = position()
    monkeypatch.setattr(pipeline, "LONGEST_TUPLE", 0)
    # to rounding: the compiler fuses the products of the one otherwise than those of the other
    np.testing.assert_allclose(position(), short, rtol=1e-13, atol=1e-18)


@pytest.mark.parametrize("count", [0, 1, 32, 33, 400])
def test_a_force_arrives_after_as_many_samples(count):
    late = Actuator(delay_samples=count)
    asked = jnp.arange(1.0, 1001.0)

    def step(state, force):
        ahead = actuator.step(late, state, force, 1e-4)
        return ahead, ahead.applied

    applied = np.asarray(jax.lax.scan(step, actuator.init(late), asked)[1])
    np.testing.assert_array_equal(applied, np.r_[np.zeros(count), asked[: 1000 - count]])


@pytest.mark.parametrize("count", [len(MOVE.time), 10**9, 10**30])
def test_what_is_as_long_as_the_motion_is_refused(count):
    with pytest.raises(ParameterError, match=r"actuator\.delay_samples of .* samples is as long as the motion"):
        simulate_loop(dataclasses.replace(DRIVE, actuator=Actuator(delay_samples=count)), TRACKING, MOVE)
    with pytest.raises(ParameterError, match=r"controller\.velocity_samples of .* nothing comes out of it"):
        simulate_loop(DRIVE, Cascade(kp=50.0, kv=1e4, velocity_samples=count), MOVE)


def test_a_loop_of_too_many_states_is_refused_before_its_matrix_is_made():
    late = dataclasses.replace(DRIVE, actuator=Actuator(delay_samples=10**6))
    with pytest.raises(ParameterError, match=r"linearised loop of 1000\d+ states would take about 64 TB of memory"):
        open_loop(*as_arrays((late, TRACKING)), Sampling(), OperatingPoint(0.01, 0.0))


def test_a_run_that_does_not_fit_is_refused_before_it_begins(monkeypatch):
    monkeypatch.setattr("diffdrive.support.resources.memory_available", lambda: 1e5)
    with pytest.raises(ParameterError, match=r"a run of .* samples would take about 194 kB of memory, and 100 kB"):
        simulate_loop(DRIVE, TRACKING, MOVE)
    assert simulate_loop(DRIVE, TRACKING, MOVE, every=100).status.ok


@pytest.mark.parametrize("seed", [10**22, -(10**22), 2**63])
def test_a_seed_of_more_than_64_bits_is_refused(seed):
    with pytest.raises(ParameterError, match="seed must be a whole number of 64 bits"):
        simulate_loop(DRIVE, TRACKING, MOVE, seed=seed)
