"""What `diffdrive identify` draws and looks along, piece by piece."""

import dataclasses
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.library import PAPER_DRIVE
from diffdrive.loop.simulate import simulate_loop
from experiments.reports.identification.forest import forest
from experiments.reports.identification.identification import _hardly_determined, judged
from experiments.studies.emps import axis as emps
from experiments.studies.recovery.excitation import concatenate, resting, strokes
from tests.support.sound_log import RATE, axis_of, simulate_log
from tuning.identification.estimates import EstimateStatus, ParameterEstimate
from tuning.identification.modelled_friction import gap_free_pieces, modelled_friction
from tuning.identification.problem import lanes_of

TRUE = axis_of()
# distance m, speed m/s, acceleration m/s^2, jerk m/s^3
STROKES = ((2e-4, 1.5e-3, 0.05, 20.0), (1e-3, 3e-3, 0.3, 30.0), (2e-3, 2e-2, 0.5, 50.0), (4e-3, 0.08, 2.0, 200.0))
MOTION = concatenate([resting(0.05, RATE), *strokes(STROKES, RATE), resting(0.05, RATE)], "reversals")


@pytest.mark.parametrize(
    ("ok", "incomplete", "good"), [(True, False, True), (True, True, None), (False, False, False), (False, True, False)]
)
def test_a_page_is_green_only_where_the_model_is_complete(ok, incomplete, good):
    fit = SimpleNamespace(adequacy=SimpleNamespace(has_structure=incomplete))
    assert judged(SimpleNamespace(status=SimpleNamespace(ok=ok), fit=fit)) is good


def test_friction_along_a_motion_is_that_of_the_simulation():
    drive = TRUE.drive
    run = simulate_loop(drive, TRUE.controller, MOTION, sampling=TRUE.sampling, seed=None)
    found = modelled_friction(drive, run.log(), run.velocity)
    damping = np.where(run.velocity >= 0, drive.plant.damping.positive, drive.plant.damping.negative) * run.velocity
    assert np.sqrt(np.mean((found - run.friction - damping) ** 2)) < 0.5  # of 100 N


def test_stretches_are_those_of_the_lanes():
    log = dataclasses.replace(simulate_log(TRUE, MOTION), gaps=(1000, 1100, 3000))
    lanes, pieces = lanes_of([log]), gap_free_pieces([log])
    assert [len(one.time) for one in pieces] == np.asarray(lanes.counts).sum(axis=1).tolist()
    assert [one.position[0] for one in pieces] == np.asarray(lanes.position)[:, 0].tolist()


def test_a_forest_plot_draws_every_kind_of_row():
    rows = [
        ParameterEstimate("plant.fitted", "kg", 100.0, 90.0, 80.0, 110.0, 3.0, 3e3, EstimateStatus.FITTED),
        ParameterEstimate("plant.far", "N", 1e-3, 5.0, 4.0, 6.0, 1e-4, 5.0, EstimateStatus.AT_BOUND),
        ParameterEstimate("plant.other sign", "N", 1e-3, -5.0, -6.0, -4.0, -9.0, 9.0, EstimateStatus.FITTED),
        ParameterEstimate("plant.none believed", "N", 0.0, 3.0, 2.0, 4.0, -9.0, 9.0, EstimateStatus.FITTED),
        ParameterEstimate("plant.left", "N", 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, EstimateStatus.UNDETERMINED),
    ]
    figure = forest(rows)
    low, high = figure.axes[0].get_xlim()
    assert low < 0.8
    assert 30.0 < high < 100.0
    figure.draw_without_rendering()


def test_the_emps_drive_file_holds_the_published_parameters():
    held = read_axis(PAPER_DRIVE.parent / "emps.toml")
    published = emps.reference_drive()
    assert jax.tree.leaves((held.drive.plant, held.drive.friction)) == jax.tree.leaves(
        (published.plant, published.friction)
    )
    assert held.sampling.rate == emps.SAMPLING.rate


def test_a_wide_interval_gets_a_note_unless_the_file_says_zero():
    rows = [
        ParameterEstimate(
            "friction.bristle_damping", "N*s/m", 100.0, 90.0, -300.0, 500.0, 3.0, 3e3, EstimateStatus.FITTED
        ),
        ParameterEstimate("plant.constant_force", "N", 0.0, 0.1, -0.3, 0.5, -9.0, 9.0, EstimateStatus.FITTED),
        ParameterEstimate("plant.mass", "kg", 100.0, 90.0, 70.0, 110.0, 3.0, 3e3, EstimateStatus.FITTED),
    ]
    (alone,) = _hardly_determined(SimpleNamespace(estimates=rows, correlated=[]))
    assert "bristle_damping (not distinguished from 0), mass (± 22 %)" in alone
    assert "constant_force" not in alone
    tied, alone = _hardly_determined(
        SimpleNamespace(estimates=rows, correlated=[("plant.mass", "plant.constant_force", -0.97)])
    )
    assert "mass: hardly determined (± 22 %): the logs hardly distinguish it from constant_force" in tied
    assert "mass" not in alone
