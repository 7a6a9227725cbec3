"""What a diagnosis says on its way: words of made-up gaps and searches, and the order of a real one."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.fake_fits import fake_fit
from tests.support.perturbed_machine import DRIVE
from tests.support.sound_log import simulate_log, two_sines
from tuning.diagnosis.diagnose import diagnose
from tuning.diagnosis.gap.where import Region
from tuning.diagnosis.selection.search import Round
from tuning.diagnosis.selection.stages import Stage, of_gap, of_round


def gap(rms, is_known=True):
    return SimpleNamespace(rms=rms, is_known=is_known)


def region(p_value, says="61 % at reversals, in 8 % of the time"):
    return Region("phase", "reversal", 0.61, 0.08, p_value, says)


def test_the_gap_is_given_with_its_floor_and_its_first_surely_telling_place():
    regions = [region(0.4, "most at rest"), region(1e-4)]
    assert of_gap(gap(12.34), 1.5, False, regions) == Stage(
        "gap",
        "the recalibrated drive lacks a force of 12.3 N RMS, 8.2 times the noise floor; 61 % at reversals, in 8 % of "
        "the time",
    )
    assert of_gap(gap(12.34), np.inf, False, [region(0.4)]).says.endswith("of 12.3 N RMS")


@pytest.mark.parametrize(
    ("one", "is_complete", "says"), [(gap(1.0), True, "to the noise"), (gap(1.0, is_known=False), False, "loses track")]
)
def test_no_force_is_named_where_there_is_none_or_none_can_be_told(one, is_complete, says):
    assert says in of_gap(one, 1.0, is_complete, [region(1e-4)]).says


def test_of_a_search_the_likeliest_effects_are_named_and_none_that_is_not_worth_it():
    base = fake_fit(evidence=0.0)
    fits = [fake_fit(name, evidence=-gain) for name, gain in (("backlash", 5400.0), ("cogging", 80.0), ("lag", 3.0))]
    assert of_round(Round(base, [], fits, 3, 0.0)) == Stage(
        "search", "best candidates: backlash (evidence 5400), cogging (evidence 80)"
    )
    beside = Round(fits[0], [], [fake_fit("backlash", "lag", evidence=-5401.0)], 1, 0.0)
    assert of_round(beside) == Stage("search beside backlash", "no effect explains enough more")
    resolving = beside._replace(allowance=100.0)  # it may lack some, since it brings an impossible number back
    assert of_round(resolving).says == "best candidate: lag (evidence 1)"


@pytest.mark.long
def test_a_diagnosis_tells_its_gap_before_it_searches():
    told = []
    logs = [simulate_log(DRIVE, two_sines(), seed=3)]
    diagnose(DRIVE.drive, DRIVE.controller, logs, most_effects=1, tell=told.append)
    assert [one.name for one in told][:2] == ["gap", "search"]
