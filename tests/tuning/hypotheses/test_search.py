"""The search: what is fitted, what one more effect has to bring, and machines whose fault is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from diffdrive.effects.forces import Cogging
from tests.support.perturbed_machine import catalogue, recalibrated_of
from tests.support.sound_log import RATE
from tuning.diagnosis.fits.goodness_of_fit import is_complete
from tuning.diagnosis.hypotheses.setting import setting
from tuning.hypotheses.search import DETAIL, NEEDED, Judged, _first_of_each, _near, _needed, search
from tuning.hypotheses.table import Entry


def entry(name, evidence, *numbers):
    return Entry(SimpleNamespace(name=name, kind=(name, *numbers)), {}, evidence, np.zeros(0))


def judged(plain, coarse=False):
    return Judged(SimpleNamespace(model=SimpleNamespace(coarse=coarse)), plain, plain)


def test_of_each_effect_the_best_point_is_kept_and_of_these_what_may_be_as_good_as_the_best():
    found = _first_of_each(
        [entry("cogging", 40.0), entry("lead_error", 900.0), entry("cogging", 300.0), entry("backlash", -np.inf)]
    )
    assert [(one.candidate.name, one.evidence) for one in found] == [("lead_error", 900.0), ("cogging", 300.0)]
    assert [one.evidence for one in _near(found)] == [900.0, 300.0]
    assert [one.evidence for one in _near([*found, entry("backlash", 2000.0)])] == [900.0, 2000.0]
    assert _near([entry("cogging", 3.0)]) == []


def test_an_effect_throughout_and_one_that_comes_and_goes_are_both_fitted():
    """The second has more numbers to find, and may be the better only where it is linear."""
    several = [entry("applied_load", 44.0, "load", "start", "end"), entry("applied_load", 38.0, "load")]
    assert _first_of_each(several) == several


def test_beside_a_coarse_effect_more_is_needed_than_its_form_may_be_off_by():
    assert _needed(judged(0.0), judged(-1e4)) == NEEDED
    assert _needed(judged(0.0), judged(-1e4, coarse=True)) == pytest.approx(DETAIL**2 * 1e4)
    assert _needed(judged(0.0), judged(-100.0, coarse=True)) == NEEDED


@pytest.mark.long
@pytest.mark.parametrize("effects", [(), (Cogging(0.00125, 1.0, 0.5),)])
def test_a_sound_machine_has_nothing_and_one_that_cogs_has_that_alone(effects):
    fitter, base = recalibrated_of(*effects)
    at = setting(base.recalibrated_drive, fitter.logged.lanes, 1.0 / RATE)
    found = search(fitter, base, catalogue(fitter, base), at, 2)
    assert found.effects == [one.name for one in effects]
    assert is_complete(fitter, found.best.fitted)
    assert found.best.plain - found.best.free < NEEDED  # functions have nothing to explain
