"""Rows that are snapshots of a faster loop: the commands between them, and that a sound machine lacks nothing then."""

import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.controllers import UnknownController
from experiments.studies.recovery.excitation import identification_motion
from experiments.studies.recovery.truth import truth_log
from tests.support.known_machine import GAINS, MACHINE
from tests.support.slow_trace import every
from tuning.diagnosis.diagnose import diagnose, logged_of
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.goodness_of_fit import (
    is_complete,
    max_prior_deviation,
    missing_evidence,
    sudden_force_evidence,
)
from tuning.diagnosis.hypotheses.calibration import DELAY, NAMES, TOLERANCE
from tuning.diagnosis.levels import LACKING, STRAINED
from tuning.diagnosis.selection.search import recalibrated
from tuning.diagnosis.selection.snapshots import as_snapshots, within_rows

RATE, SAMPLES = 4_000.0, 4


@pytest.fixture(scope="module")
def log():
    return truth_log(MACHINE, GAINS, identification_motion(RATE), 0.0, seed=3)


@pytest.mark.parametrize("samples", [1, 2, 4, 5])
def test_a_command_that_is_a_cubic_is_met_at_every_instant_of_the_loop(samples):
    time = np.arange(12 * samples) / samples  # rows
    command = 3.0 - 2.0 * time + 0.7 * time**2 - 0.05 * time**3
    found = within_rows(jnp.asarray(command[::samples]), samples)
    np.testing.assert_allclose(found[1:-2].ravel(), command[samples : -2 * samples], rtol=1e-12)


def test_the_command_of_a_row_is_the_one_that_is_read_and_substeps_fit_its_samples(log):
    rows = every(log, SAMPLES)
    held = logged_of(MACHINE, [rows])
    for samples in (3, SAMPLES):
        read = as_snapshots(held, samples, held.lanes.command)
        np.testing.assert_allclose(read.lanes.period_commands[:, 1:-2, 0], held.lanes.command[:, 1:-2], atol=1e-9)
        assert read.lanes.period_commands.shape[2] == read.loop_samples == samples
        assert read.sampling.plant_steps % samples == 0
        assert read.sampling.plant_steps >= held.sampling.plant_steps


def test_a_log_of_every_sample_is_not_read_as_snapshots(log):
    """Nor one that is thinned: what acts over each of its samples is known."""
    assert logged_of(MACHINE, [log]).loop_samples == 1
    assert logged_of(MACHINE, [log], SAMPLES).loop_samples == 1


@pytest.mark.long
def test_a_sound_machine_lacks_nothing_but_in_rows_that_are_read_as_held(log):
    """Its own drive moves as the log does, with no number moved, where the commands between the rows are read."""
    fitters = [Fitter(logged_of(MACHINE, [every(log, SAMPLES)], samples)) for samples in (1, SAMPLES)]
    held, read = ((fitter, recalibrated(fitter, TOLERANCE)) for fitter in fitters)
    assert missing_evidence(*held) > 100.0 * LACKING
    assert is_complete(*read)
    assert sudden_force_evidence(*read) > LACKING  # of the commands between
    assert sudden_force_evidence(*held) == 0.0
    assert max_prior_deviation(read[1]) < STRAINED


@pytest.mark.long
def test_no_force_within_what_is_not_known_of_the_command_is_any_effects(log):
    """The filter may always lack so much, and a sound machine is told to lack nothing: no force is looked for."""
    rows = [every(one, SAMPLES) for one in (log, truth_log(MACHINE, GAINS, identification_motion(RATE), 0.0, seed=4))]
    logged = logged_of(MACHINE, rows, SAMPLES)
    assert logged.command_std > 0.01  # N
    told = diagnose(MACHINE, UnknownController(), rows, loop_samples=SAMPLES).verdict
    assert told.verdict == "none"
    assert not [one for one in told.beliefs if one.found]


@pytest.mark.long
def test_the_instant_of_the_rows_is_recalibrated(log):
    """Of a loop that is told wrong, five samples to a row in the place of four, it is a fortieth of a row late."""
    base = recalibrated(Fitter(logged_of(MACHINE, [every(log, SAMPLES)], SAMPLES + 1)), TOLERANCE)
    late = base.model.calibration(base.theta)[NAMES.index(DELAY)]
    assert late == pytest.approx(0.5 / SAMPLES - 0.5 / (SAMPLES + 1), abs=0.005)
