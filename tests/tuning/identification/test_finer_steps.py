"""The fit at finer steps of the integrator: by chords it ends where a search with its own Jacobian does."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from diffdrive import motion
from diffdrive.model.parameters import Sampling
from experiments.studies.recovery.truth import truth_log
from tests.support.known_machine import BELIEVED, GAINS, MACHINE, RATE
from tuning.identification.problem import Innovations
from tuning.identification.refinement import FINE_GAIN, SETTLED, _by_chords, fit_at, search_once
from tuning.identification.setup import build_problem
from tuning.optimisation.least_squares import Outcome, no_progress
from tuning.optimisation.space import coordinates

HELD = ("breakaway_gap", "stribeck_velocity", "bristle_stiffness", "bristle_damping", "constant_force", "delay")


@cache
def coarse_fit():
    """A fit with steps so long that finer ones move it."""
    lap = motion.sine(amplitude=4e-3, frequency=2.0, duration=1.0, rate=RATE)
    setup = build_problem([truth_log(MACHINE, GAINS, lap, 0.0, seed=5)], BELIEVED, HELD, {})
    residuals = Innovations(coordinates(setup.free), Sampling(RATE, 2))
    search = search_once(residuals, np.zeros(len(setup.free)), setup.problem, no_progress, FINE_GAIN)
    return fit_at(residuals, setup.problem, search)


@pytest.mark.long
def test_chords_end_where_a_search_with_its_own_jacobian_ends():
    fit = coarse_fit()
    finest = dataclasses.replace(fit.residuals, sampling=Sampling(RATE, 8))
    found = _by_chords(finest, fit, no_progress)
    search = search_once(finest, fit.search.theta, fit.problem, no_progress, FINE_GAIN)
    searched = fit_at(finest, fit.problem, search)
    assert found is not None
    errors = np.sqrt(np.diag(fit.covariance.matrix))
    moved = np.max(np.abs(searched.search.theta - fit.search.theta) / errors)
    off = np.max(np.abs(found.search.theta - searched.search.theta) / errors)
    assert off < max(2.0 * SETTLED, 0.05 * moved)
    assert found.search.cost == pytest.approx(searched.search.cost, rel=1e-6)
    widths = [np.sqrt(np.diag(one.covariance.matrix)) for one in (found, searched)]
    np.testing.assert_allclose(*widths, rtol=0.02)
    np.testing.assert_allclose(found.innovation, searched.innovation, atol=0.02 * np.std(searched.innovation))


@pytest.mark.long
def test_chords_that_are_interrupted_say_so_and_those_that_do_not_settle_are_none():
    fit = coarse_fit()
    finest = dataclasses.replace(fit.residuals, sampling=Sampling(RATE, 8))

    def stop(*_):
        raise KeyboardInterrupt

    assert _by_chords(finest, fit, stop).search.outcome is Outcome.INTERRUPTED
    far = dataclasses.replace(fit.search, theta=fit.search.theta + 3.0)
    assert _by_chords(finest, fit._replace(search=far), no_progress) is None
