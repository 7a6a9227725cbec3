"""A loop that differences its reference backwards, half a sample late: no other controller, and no less of one."""

from dataclasses import replace

import numpy as np
import pytest

import diffdrive as dd
from diffdrive.logs.checks.examine import examine
from diffdrive.logs.checks.relation import controller_relation
from diffdrive.logs.checks.replay import backward, central
from diffdrive.model.parameters import Sampling
from experiments.studies.controller_study import NaiveCascade

LOOP = NaiveCascade(velocity_feedforward=1.0, ratio=1, backward=True)


def axis_of(loop):
    """The loop as a drive file states it."""
    axis = replace(dd.paper_axis("cascade"), sampling=Sampling(loop.rate)).replace({"plant.mass": loop.mass})
    axis = axis.with_gains(kp=loop.kp, kv=loop.kv, ki=loop.kv / loop.reset_time)
    controller = replace(
        axis.controller, velocity_feedforward=loop.velocity_feedforward, velocity_samples=loop.velocity_samples
    )
    return replace(axis, controller=controller)


def of_controller(findings):
    return [one.message for one in findings if "controller" in one.message]


@pytest.mark.parametrize(("is_backward", "difference"), [(True, backward), (False, central)])
def test_the_controller_that_ran_is_recognised_however_it_takes_the_speed(is_backward, difference):
    log = replace(LOOP, backward=is_backward).log(2.0, seed=2)
    axis = axis_of(LOOP)
    relation = controller_relation(log, axis)
    assert relation.difference is difference
    assert relation.replay_as_logged()[1].error < 1e-5  # the log is rounded to 0.01 N
    assert of_controller(examine(log, axis)) == []


def test_gains_that_changed_are_still_found():
    log = replace(LOOP, kv=1.3 * LOOP.kv).log(2.0, seed=2)
    assert of_controller(examine(log, axis_of(LOOP)))


def test_differences_of_a_line_are_its_slope():
    line = 3.0 * np.arange(6)[None] * 0.1
    np.testing.assert_allclose(central(line, 0.1), 3.0)
    np.testing.assert_allclose(backward(line, 0.1)[:, 1:], 3.0)
