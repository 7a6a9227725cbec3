"""What a missing force depends on: against dense algebra, and on logs of machines whose fault is known."""

import numpy as np
import pytest

from diffdrive.effects.forces import Cogging
from diffdrive.effects.friction import AppliedLoad
from tests.support.perturbed_machine import recalibrated_of
from tests.support.sound_log import RATE
from tuning.diagnosis.gap.dependence import Dependence, _at_scale, _shortest, dependences, hats
from tuning.diagnosis.gap.dependence_words import NAMES, dependence_says, dependences_say
from tuning.diagnosis.hypotheses.setting import setting

LOAD, START, END = 9e3, 1.0, 2.2  # N, s


def left_of(*effects):
    fitter, base = recalibrated_of(*effects)
    return dependences(fitter, base, setting(base.recalibrated_drive, fitter.logged.lanes, 1.0 / RATE))


def test_hats_add_up_to_one_and_make_any_polygon():
    values, knots = np.linspace(-1.5, 1.5, 40)[None], np.linspace(-1.0, 1.0, 7)
    basis = hats(values, knots)
    np.testing.assert_allclose(basis.sum(axis=-1), 1.0)
    np.testing.assert_allclose(basis @ np.abs(knots), np.interp(values, knots, np.abs(knots)))


def test_the_evidence_of_a_function_is_that_of_its_gaussian_process():
    """Residuals of white noise, and a function that is free beside it: the likelihoods of both, written out."""
    rng = np.random.default_rng(2)
    columns, residual, scale = rng.normal(size=(30, 4)), rng.normal(size=30), 0.7
    evidence, corners = _at_scale(columns.T @ columns, columns.T @ residual, scale)
    covariance = np.eye(30) + scale**2 * columns @ columns.T
    without = residual @ residual
    with_it = residual @ np.linalg.solve(covariance, residual) + np.linalg.slogdet(covariance)[1]
    assert evidence == pytest.approx(without - with_it, rel=1e-10)
    expected = -(scale**2) * columns.T @ np.linalg.solve(covariance, residual)
    np.testing.assert_allclose(corners, expected, rtol=1e-9)


def test_the_range_in_which_most_of_it_lies_is_the_shortest():
    """Two heaps: the denser one, and not the range that has both."""
    where = np.linspace(0.0, 1.0, 1001)
    energy = np.exp(-(((where - 0.6) / 0.01) ** 2)) + 0.05 * np.exp(-(((where - 0.1) / 0.01) ** 2))
    low, high = _shortest(where, energy, 0.9 * energy.sum())
    assert low == pytest.approx(0.6 - 0.0136, abs=2e-3)
    assert high == pytest.approx(0.6 + 0.0136, abs=2e-3)


@pytest.mark.long
def test_a_sound_machine_leaves_nothing_that_depends_on_anything():
    assert left_of() == []


@pytest.mark.long
def test_a_load_that_comes_and_goes_is_a_friction_that_changes_with_time():
    found = left_of(AppliedLoad(more=LOAD, start=START, end=END))[0]
    assert (found.of, found.kind) == ("time", "friction")
    assert found.evidence > 100.0
    more = 3.66e-4 * LOAD * np.sqrt((END - START) / 3.0)  # N, RMS over the log; recalibration takes some of it
    assert 0.3 * more < found.rms < 1.5 * more


@pytest.mark.long
def test_what_pushes_by_place_is_a_force_that_depends_on_position():
    found = left_of(Cogging(period=0.02, cosine=4.0))[0]
    assert (found.of, found.kind) == ("position", "force")


def test_every_kind_is_told_in_words():
    for of, kind in NAMES:
        one = Dependence(of, kind, 50.0, 2.13e-6 if kind == "scale" else 2.13, 0.01, 0.0234, None)
        assert ("2.1 um RMS" if kind == "scale" else "2.1 N RMS") in dependence_says(one)
    rests = Dependence("time", "friction", 50.0, 2.13, 1.0, 2.0, 2)
    other = Dependence("speed", "friction", 45.0, 1.0, 0.0, 0.01, None)
    both = dependences_say([rests, other], "What is left")
    assert both.startswith(
        "What is left looks most like a friction that changes with time, 2.1 N RMS, most of it between"
    )
    assert "between 1 and 2 s of log 2" in both
    assert ", or a friction that depends on speed" in both
    assert "speed" not in dependences_say([rests, other._replace(evidence=20.0)], "What is left")
    assert "nothing in particular" in dependences_say([], "What is left")
