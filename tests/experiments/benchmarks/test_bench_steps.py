"""The hand-written steps that the benchmark compares with are the project's own step: else a ratio means nothing."""

import shutil

import equinox as eqx
import numpy as np
import pytest

from diffdrive.controllers import PD
from diffdrive.controllers.base import paper_tracking
from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.model.parameters import Actuator, Drive
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.model.quantity import Directional
from diffdrive.numerics.arrays import as_arrays
from experiments.benchmarks import in_c
from experiments.benchmarks.parameters import lane_parameters
from experiments.studies.paper import scenario as paper

SCENARIO = paper.canonical()
REFERENCE = np.stack([SCENARIO.motion.position, SCENARIO.motion.velocity, SCENARIO.motion.acceleration])
ROLLOUT = eqx.filter_jit(rollout_loop)


def asymmetric_drive(quantised):
    """The paper's drive with different sides throughout, so that no pair can be taken for the other."""
    drive = paper_drive(quantised=quantised)
    plant = eqx.tree_at(lambda p: p.constant_force, drive.plant, -7.0)
    sides = {"coulomb_screw": (50.0, 75.0), "load_coefficient": (3e-4, 4e-4), "bristle_stiffness": (3e7, 3.6e7),
             "bristle_damping": (4e3, 5e3)}  # fmt: skip
    friction = eqx.tree_at(
        lambda f: [getattr(f, name) for name in sides], drive.friction, [Directional(*pair) for pair in sides.values()]
    )
    return Drive(plant, friction, drive.actuator, drive.sensor)


def by_c(numbers, load, sampling):
    with in_c.compiled() as library:
        one = library.roll(numbers, REFERENCE, load, sampling.period, sampling.plant_steps)
        both = library.sweep(np.stack([numbers, numbers]), REFERENCE, load, sampling.period, sampling.plant_steps)
    return *one, both


def by_numba(numbers, load, sampling):
    in_numba = pytest.importorskip(
        "experiments.benchmarks.in_numba", reason="numba is not installed", exc_type=ImportError
    )
    one = in_numba.roll(numbers, REFERENCE, load, sampling.period, sampling.plant_steps)
    both = [
        in_numba.sweep(np.stack([numbers, numbers]), REFERENCE, load, sampling.period, sampling.plant_steps, threads)
        for threads in (1, 2)
    ]
    assert np.array_equal(*both)
    return *one, both[0]


@pytest.mark.long
@pytest.mark.parametrize("quantised", [True, False])
@pytest.mark.parametrize("hand_written", [by_c, by_numba])
def test_a_hand_written_step_is_the_projects_own(hand_written, quantised):
    if hand_written is by_c and shutil.which("gcc") is None:
        pytest.skip("no gcc")
    drive, machine = paper_drive(quantised=quantised), asymmetric_drive(quantised)
    controller = paper.controllers(drive)["PD+FC+LE"]
    inputs = loop_inputs(SCENARIO.motion, 0.7 * SCENARIO.load)
    frame = ROLLOUT(*as_arrays((machine, controller)), inputs, paper.SAMPLING)
    costs, position, both = hand_written(lane_parameters(machine, controller, 0.7), SCENARIO.load, paper.SAMPLING)
    # a quantised loop magnifies rounding: where two roll-outs fall to either side of half a quantum, they part
    until = 3_000 if quantised else len(position)
    assert np.max(np.abs(position - np.asarray(frame.table_position))[:until]) < 1e-10
    error = REFERENCE[0] - np.asarray(frame.table_position)
    load_error = np.asarray(frame.estimate.load) - 0.7 * SCENARIO.load
    expected = [np.sqrt(np.mean(error**2)), np.max(np.abs(error)), np.sqrt(np.mean(load_error**2))]
    assert costs == pytest.approx(expected, rel=0.02 if quantised else 1e-6)
    assert np.array_equal(both, np.stack([costs, costs]))


def test_what_the_hand_written_steps_have_not_is_refused():
    drive = paper_drive()
    estimating = paper.controllers(drive)["PD+FC+LE"]
    for machine, controller in (
        (drive, PD(paper_tracking(drive, PAPER_KP, PAPER_KD))),
        (drive, paper.controllers(drive)["PD+FC+LS"]),
        (Drive(drive.plant, drive.friction, Actuator(500.0)), estimating),
    ):
        with pytest.raises(ParameterError, match="hand-written"):
            lane_parameters(machine, controller)


def test_a_missing_compiler_is_said():
    with pytest.raises(DiffdriveError, match="no nocc on this machine"), in_c.compiled("nocc"):
        pass
