"""The step of integration is halved as long as the likelihood of the recalibrated drive depends on it."""

import dataclasses

import pytest

from diffdrive.model.parameters import LONGEST_SUBSTEP, Sampling
from tests.support.perturbed_machine import recalibrated_of
from tests.support.sound_log import RATE
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.levels import WORTH
from tuning.diagnosis.selection.step_size import with_step_short_enough

pytestmark = pytest.mark.long  # fits in other steps: programs of their own


@pytest.fixture(scope="module")
def in_long_steps():
    """A sound machine, in steps of a whole row."""
    fitter, base = recalibrated_of()
    long = Fitter(fitter.logged._replace(sampling=Sampling(RATE, 1)))
    model = dataclasses.replace(base.model, logged=long.logged)
    return long, long.fit(model, base.theta, base.process_noise, base.filtered.trajectory)


def test_steps_that_are_short_enough_stay_as_they_are():
    fitter, base = recalibrated_of()
    assert with_step_short_enough(fitter, base) == (fitter, base)


def test_steps_are_halved_until_the_likelihood_no_longer_depends_on_them(in_long_steps):
    _, base = recalibrated_of()
    long, there = in_long_steps
    assert there.cost - base.cost > WORTH  # such steps do matter
    finer, ended = with_step_short_enough(long, there)
    assert finer.logged.sampling.plant_steps > 1
    assert abs(ended.cost - base.cost) < 2.0 * WORTH  # each of the two may be off by one
    assert ended.model.logged is finer.logged


def test_no_step_is_shorter_than_the_simulator_needs(in_long_steps, monkeypatch):
    long, there = in_long_steps
    monkeypatch.setattr("tuning.diagnosis.selection.step_size.WORTH", 0.0)
    monkeypatch.setattr("tuning.diagnosis.selection.step_size.DETAILS", 0.0)
    finer, _ = with_step_short_enough(long, there)
    step = finer.logged.sampling.period / finer.logged.sampling.plant_steps
    assert LONGEST_SUBSTEP / 2 < step <= LONGEST_SUBSTEP
