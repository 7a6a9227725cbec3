"""How small an effect logs would have shown: against logs of machines that have it, and by hand."""

import numpy as np
import pytest

from diffdrive.effects.actuator import ForceGain
from diffdrive.effects.forces import Cogging, ConstantForce
from diffdrive.effects.scale import LeadError
from tests.support.perturbed_machine import catalogue, fitter_of, recalibrated_of
from tuning.diagnosis.calibration import TOLERANCE
from tuning.diagnosis.detection import AMPLITUDE, DetectionLimit, Table, detection_limits
from tuning.diagnosis.leftover import LACKING, relevant_forces
from tuning.diagnosis.limit_words import limit_says, limits_say
from tuning.diagnosis.screening import DEARNESS, screen
from tuning.diagnosis.search import recalibrated
from tuning.diagnosis.shown import made_way, possible_sizes, sized, unusual_values, usual_values

PERIOD = 1.5e-3  # m, usual for cogging
LEAD = 6e-3  # m


@pytest.fixture(scope="module")
def sound():
    return recalibrated_of()


@pytest.fixture(scope="module")
def limits(sound):
    fitter, base = sound
    found = detection_limits(fitter, base, catalogue(fitter, base), LACKING)
    return {(one.effect, one.parameter): one for one in found}


def evidence_of(name, *effects):
    """What screening makes of an effect of the catalogue in a log of a machine with these."""
    fitter = fitter_of(*effects, seed=2)
    base = recalibrated(fitter, TOLERANCE)
    usual = fitter.under(base, np.maximum(base.process, relevant_forces(fitter, base)))
    return max(screen(usual, one).evidence for one in catalogue(fitter, base) if one.name == name)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "parameter", "machine"),
    [
        ("constant_force", "force", ConstantForce),
        ("force_gain", "gain", ForceGain),
        ("cogging", AMPLITUDE, lambda size: Cogging(PERIOD, size)),
        ("lead_error", AMPLITUDE, lambda size: LeadError(cosine=size, lead=LEAD)),
    ],
)
def test_twice_its_limit_brings_the_evidence_and_half_of_it_does_not(limits, name, parameter, machine):
    size = limits[name, parameter].size
    assert evidence_of(name, machine(2.0 * size)) > LACKING
    assert evidence_of(name, machine(0.5 * size)) < LACKING


@pytest.mark.long
@pytest.mark.parametrize("name", ["actuator_lag", "backlash"])
def test_an_effect_that_is_not_linear_changes_the_innovations_by_its_evidence_at_its_limit(sound, limits, name):
    """A lag by its square; play by its impacts, one by one, and beyond what the elastic screw does without it."""
    fitter, base = sound
    candidate = next(one for one in catalogue(fitter, base) if one.name == name)
    first = candidate.parameters[0]
    size = limits[name, first.name].size
    usual = fitter.under(base, np.maximum(base.process, relevant_forces(fitter, base)))
    sizes = [first.standard(by * size) for by in (1.0, 2.0, 0.5)]
    at, above, below = sized(fitter, usual, candidate, sizes).gains
    needed = LACKING + DEARNESS * len(candidate.parameters)
    assert below < needed <= at < above
    if name == "actuator_lag":
        assert at == pytest.approx(needed, rel=0.3)
        assert below == pytest.approx(0.25 * at, rel=0.1)


@pytest.mark.long
def test_each_effect_has_a_limit_that_is_no_larger_than_where_it_is_told_from_its_rival(limits):
    for one in limits.values():
        assert one.size is not None, one
        assert one.size > 0.0, one
        if one.rival is None:
            assert one.apart == one.size
        elif one.apart is not None and one.weakens:
            assert one.apart < one.size
        elif one.apart is not None:
            assert one.apart > one.size


@pytest.mark.long
def test_a_constant_force_hides_behind_friction_that_differs_by_direction(limits):
    """One that is on for part of the log only does not: the drive file's tolerance cannot make up for it."""
    assert limits["process_force", "mean"].size < 0.5 * limits["constant_force", "force"].size


@pytest.mark.long
def test_a_scale_s_wave_is_not_claimed_below_what_its_counts_pass_for(sound, limits):
    least = next(one.least for one in catalogue(*sound) if one.name == "interpolation_error")
    assert limits["interpolation_error", AMPLITUDE].size >= least


@pytest.mark.long
def test_sizes_are_tried_inside_of_what_the_effect_is_called_so(sound):
    fitter, base = sound
    for one in catalogue(fitter, base):
        if any(parameter.amplitude for parameter in one.parameters):
            assert len(unusual_values(one, 1)) <= 2 * len(one.parameters)
            assert {parameter.name for parameter in one.parameters if not parameter.amplitude} <= set(
                usual_values(one, 1)
            )
        else:
            values = [one.parameters[0].value(size) for size in possible_sizes(one)]
            assert len(values) >= 4
            assert all(low < value < high for name, low, high in one.bounds[:1] for value in values)


def test_what_is_free_makes_way_as_in_the_schur_complement():
    rng = np.random.default_rng(3)
    jacobian, columns = rng.normal(size=(60, 4)), rng.normal(size=(60, 3))

    class Fit:
        pass

    fit = Fit()
    fit.jacobian, fit.hessian = jacobian, jacobian.T @ jacobian + np.eye(4)
    left = made_way(fit, columns)
    cross = jacobian.T @ columns
    np.testing.assert_allclose(
        left.T @ left, columns.T @ columns - cross.T @ np.linalg.solve(fit.hessian, cross), rtol=1e-10
    )


def test_beside_a_rival_that_does_the_same_next_to_nothing_is_left():
    rng = np.random.default_rng(4)
    one, other = 30.0 * rng.normal(size=(80, 2)), 30.0 * rng.normal(size=(80, 1))
    every = np.concatenate([one, one @ [[1.0], [2.0]], other], axis=1)
    table = Table(every.T @ every, {"a": slice(0, 2), "same": slice(2, 3), "other": slice(3, 4)}, {}, {})
    assert table.beside("same", "a")[0, 0] < 10.0  # what the prior of the rival costs
    assert table.beside("other", "a")[0, 0] == pytest.approx(table.of("other")[0, 0], rel=0.2)


LIMIT = DetectionLimit("backlash", "gap", "m", 4.6e-7, False, "compliance", 9.2e-7)


@pytest.mark.parametrize(
    ("limit", "says"),
    [
        (LIMIT, "gap from 0.46 um, told from compliance from 0.92 um"),
        (LIMIT._replace(rival=None), "gap from 0.46 um"),
        (LIMIT._replace(apart=None), "gap from 0.46 um, never told from compliance"),
        (LIMIT._replace(size=None, apart=None), "gap at no usual size"),
        (DetectionLimit("compliance", "frequency", "Hz", 520.0, True, None, 520.0), "frequency up to 520 Hz"),
        (DetectionLimit("friction_shape", "breakaway_gap", "1", 0.1, False, None, 0.1), "breakaway_gap from 11 %"),
    ],
)
def test_a_limit_in_words(limit, says):
    assert limit_says(limit) == says


def test_one_sentence_has_each_effect_once():
    assert (
        limits_say([LIMIT, LIMIT._replace(parameter="other")])
        == "These logs would have shown backlash (gap from 0.46 um)"
    )
    assert limits_say([]) == ""
