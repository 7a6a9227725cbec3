"""A trace that is slower than its loop: read as snapshots, and its mass found."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from diffdrive.model.parameters import Actuator, Sampling
from experiments.studies.recovery.excitation import identification_motion
from experiments.studies.recovery.truth import truth_log
from tests.support.known_machine import BELIEVED, GAINS, MACHINE
from tests.support.slow_trace import every
from tuning.identification import snapshots
from tuning.identification.identify import identify
from tuning.identification.prediction import Lanes
from tuning.identification.problem import IdentificationProblem, Innovations
from tuning.identification.refinement import RefinedFit
from tuning.identification.row_force import BetweenRows
from tuning.optimisation.least_squares import LeastSquaresResult, Outcome, no_progress
from tuning.optimisation.space import Coordinate

RATE, RATIO = 4_000.0, 4


@pytest.fixture(scope="module")
def log():
    return truth_log(MACHINE, GAINS, identification_motion(RATE), 0.0, seed=3)


@pytest.mark.slow
def test_a_slow_trace_is_read_as_snapshots_and_its_mass_is_the_machines(log):
    found = identify([every(log, RATIO)], BELIEVED, starts=2)
    assert found.between is BetweenRows.SMOOTH
    assert found.loop_samples == RATIO
    assert any("snapshots" in note for note in found.notes)
    mass, delay = (next(one for one in found.estimates if one.name == name) for name in ("mass", "delay"))
    assert mass.value == pytest.approx(float(MACHINE.plant.mass), rel=2e-3)
    assert mass.low <= float(MACHINE.plant.mass) <= mass.high
    assert delay.value == pytest.approx(0.5 / RATIO - 0.5, abs=0.05)  # the loop holds a command for one of its periods


@pytest.mark.slow
def test_a_trace_of_every_sample_is_read_as_held(log):
    found = identify([log], BELIEVED, starts=2)
    assert found.between is BetweenRows.HELD
    assert not any("snapshots" in note for note in found.notes)


@pytest.mark.slow
def test_a_command_that_is_logged_a_row_late_and_acts_half_a_row_late_has_its_mass_all_the_same():
    """Its delay is that of snapshots, -1/2, and it changes within a row as theirs does; its noise is the machine's."""
    late = dataclasses.replace(MACHINE, actuator=Actuator(delay_samples=1, delay_fraction=0.5))
    delayed = truth_log(late, GAINS, identification_motion(RATE), 0.0, seed=4)
    rows = delayed.replace(command=np.r_[np.zeros(2), delayed.command[:-2]])  # two rows late: 1.5 - 2
    found = identify([rows], BELIEVED, starts=2)
    mass, delay = (next(one for one in found.estimates if one.name == name) for name in ("mass", "delay"))
    assert delay.value == pytest.approx(-0.5, abs=0.05)
    assert mass.value == pytest.approx(float(MACHINE.plant.mass), rel=1e-3)
    assert mass.low <= float(MACHINE.plant.mass) <= mass.high


# --- which reading is taken, by the deviances of the fits

SAMPLING = Sampling(RATE)


def fit(deviance, between=BetweenRows.HELD, gain=1e4, outcome=Outcome.CONVERGED, steps=3):
    search = LeastSquaresResult(np.zeros(1), outcome, str(outcome), 1.0, 1.0, steps, 0.0, [1.0])
    residuals = Innovations((Coordinate("delay", False),), SAMPLING, between=between)
    return RefinedFit(
        residuals, None, search, None, np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)), 1.0, deviance, gain, steps
    )


def shown(monkeypatch, deviances, acts_early=False, held=None, between=None, smooth_early=True):
    """The reading that is taken where the fits of (reading, is noisy) have these deviances; their order.

    `acts_early` says it of a held command, `smooth_early` of a smooth one.
    """
    quiet, tried = np.zeros((1, 500)), []
    lanes = Lanes(quiet, quiet + NOISE.normal(size=quiet.shape), quiet, quiet, quiet + 1.0, np.zeros(1))
    problem = IdentificationProblem(None, None, None, lanes, None, np.zeros(1), np.zeros((2, 1)), np.zeros(1))

    def refined(residuals, theta, read, *_):
        key = residuals.between, read is problem
        tried.append(key)
        found = deviances[key]
        return found if isinstance(found, RefinedFit) else fit(found, residuals.between)

    def there(residuals, *_):
        return SimpleNamespace(deviance=deviances["there"])

    monkeypatch.setattr(snapshots, "refine", refined)
    monkeypatch.setattr(snapshots, "most_likely_at", there)
    early = {HELD: acts_early, SMOOTH: smooth_early}
    monkeypatch.setattr(snapshots, "_acts_early", lambda fitted: early[fitted.residuals.between])
    return snapshots.as_rows_show(held or fit(100.0), problem, 1e-8, no_progress, None, between), tried


NOISE = np.random.default_rng(0)
HELD, SMOOTH = BetweenRows


def test_a_smooth_command_is_taken_where_it_is_likelier_than_a_held_one_at_its_own_point(monkeypatch):
    found, _ = shown(monkeypatch, {"there": 99.0, (SMOOTH, False): 95.0})
    assert found.residuals.between is SMOOTH
    assert (found.deviance, found.steps) == (95.0, 6)


@pytest.mark.parametrize(("again", "reading"), [(40.0, HELD), (95.5, SMOOTH)])
def test_a_held_fit_that_was_stuck_goes_on_from_where_the_smooth_one_ended(monkeypatch, again, reading):
    deviances = {"there": 99.0, (SMOOTH, False): 95.0, (HELD, True): again}
    found, tried = shown(monkeypatch, deviances, smooth_early=False)
    assert found.residuals.between is reading
    assert tried == [(SMOOTH, False), (HELD, True)]
    assert found.steps == 9


def test_what_the_rows_are_known_to_be_is_not_asked_again(monkeypatch):
    deviances = {"there": 99.0, (SMOOTH, False): 95.0}
    found, tried = shown(monkeypatch, deviances, between=SMOOTH, smooth_early=False)
    assert found.residuals.between is SMOOTH
    assert tried == [(SMOOTH, False)]


def test_a_held_command_is_kept_where_it_is_likelier(monkeypatch):
    held = fit(100.0)
    found, tried = shown(monkeypatch, {"there": 101.0}, held=held)
    assert (found, tried) == (held, [])


def test_where_a_held_command_acts_early_a_smooth_one_that_is_likelier_once_fitted_is_taken(monkeypatch):
    deviances = {(SMOOTH, True): 99.0, (SMOOTH, False): 120.0, (HELD, False): 110.0}
    assert shown(monkeypatch, deviances, acts_early=True)[0].residuals.between is SMOOTH


@pytest.mark.parametrize(("without_noise", "reading"), [(80.0, HELD), (99.0, SMOOTH)])
def test_where_a_held_command_acts_early_its_noise_does_not_decide(without_noise, reading, monkeypatch):
    deviances = {(SMOOTH, True): 110.0, (SMOOTH, False): 98.0, (HELD, False): without_noise}
    assert shown(monkeypatch, deviances, acts_early=True)[0].residuals.between is reading


def test_where_nothing_is_missing_and_where_the_reading_is_known_nothing_is_compared(monkeypatch):
    sound = fit(100.0, gain=1.0)
    assert shown(monkeypatch, {}, held=sound) == (sound, [])
    found, tried = shown(monkeypatch, {(SMOOTH, False): 500.0}, held=sound, between=SMOOTH)
    assert (found.residuals.between, tried) == (SMOOTH, [(SMOOTH, False)])


@pytest.mark.parametrize("stopped", [(SMOOTH, True), (SMOOTH, False), (HELD, False)])
def test_a_trial_that_is_interrupted_leaves_the_finished_fit(stopped, monkeypatch):
    deviances = {(SMOOTH, True): 110.0, (SMOOTH, False): 98.0, (HELD, False): 99.0}
    deviances[stopped] = fit(1.0, stopped[0], outcome=Outcome.INTERRUPTED)
    found, tried = shown(monkeypatch, deviances, acts_early=True)
    assert tried[-1] == stopped
    assert found.residuals.between is HELD
    assert found.deviance == 100.0
    assert found.search.outcome is Outcome.INTERRUPTED
    assert found.steps == 3 + 3 * len(tried)
