"""The missing force that a gap is told in: what lasts, what is sudden, and what noise makes of either."""

import numpy as np
import pytest

from tests.support.perturbed_machine import DEVIATIONS, fitter_of
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.gap.gap import force_floor, force_gap
from tuning.diagnosis.hypotheses.calibration import TOLERANCE
from tuning.diagnosis.hypotheses.model import Model
from tuning.diagnosis.selection.search import initial_trajectory

SUDDEN = 150.0  # N


def shaken(size):
    """A log in which a force of that size, new in every sample, is missing from the command, and its true fit."""
    fitter = fitter_of()
    lanes = fitter.logged.lanes
    missing = size * np.random.default_rng(2).standard_normal(lanes.command.shape)
    fitter = Fitter(fitter.logged._replace(lanes=lanes._replace(command=lanes.command - missing)))
    process_noise = np.array([1e-3, max(size, fitter.least)])
    return (
        fitter,
        fitter.fit(Model(fitter.logged), DEVIATIONS / TOLERANCE, process_noise, initial_trajectory(fitter.logged), 0),
        process_noise,
    )


@pytest.mark.long
def test_a_sudden_force_that_the_filter_may_invent_counts_as_missing():
    fitter, fit, process_noise = shaken(SUDDEN)
    gap = force_gap(fitter, fit, process_noise)
    assert gap.lost == 0.0
    # of a white force the filter sees what the noise of the scale leaves of it
    assert 0.5 * SUDDEN < gap.rms < 1.1 * SUDDEN
    assert force_floor(fitter, fit, gap.counts, process_noise) < 0.5 * gap.rms


@pytest.mark.long
def test_noise_alone_makes_no_more_of_it_than_the_floor_says():
    fitter, fit, _ = shaken(0.0)
    for process_noise in (np.array([2.0, fitter.least]), np.array([2.0, 2.0]), np.array([2.0, 50.0])):
        gap = force_gap(fitter, fit, process_noise)
        assert gap.rms == pytest.approx(force_floor(fitter, fit, gap.counts, process_noise), rel=0.25)


@pytest.mark.long
def test_what_is_not_known_of_the_command_is_in_the_floor():
    fitter, fit, process_noise = shaken(0.0)
    counts = force_gap(fitter, fit, process_noise).counts
    unsure = Fitter(fitter.logged._replace(command_std=3.0))
    known, told = (force_floor(one, fit, counts, process_noise) for one in (fitter, unsure))
    assert told**2 == pytest.approx(known**2 + 3.0**2)
