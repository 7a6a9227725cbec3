"""How small an effect logs would have shown: against logs of machines that have it, and by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from diffdrive.effects.actuator import ForceGain
from diffdrive.effects.forces import Cogging, ConstantForce
from diffdrive.effects.scale import LeadError
from tests.support.perturbed_machine import catalogue, fitter_of, recalibrated_of
from tuning.diagnosis.filter.second_encoder import Twist, seen_by, twist_deviance
from tuning.diagnosis.fits.reduced import reduced
from tuning.diagnosis.hypotheses.calibration import TOLERANCE
from tuning.diagnosis.hypotheses.priors import Parameter
from tuning.diagnosis.levels import LACKING
from tuning.diagnosis.limits.detection import (
    AMPLITUDE,
    DetectionLimit,
    allowed,
    amplitude_groups,
    detection_limits,
    gain_of,
    gain_per_deviation,
    small_amounts,
)
from tuning.diagnosis.limits.limit_words import limit_says, limits_say
from tuning.diagnosis.selection.screening import DEARNESS, joined, screen
from tuning.diagnosis.selection.search import recalibrated

PERIOD = 1.5e-3  # m, usual for cogging
LEAD = 6e-3  # m


@pytest.fixture(scope="module")
def sound():
    return recalibrated_of()


@pytest.fixture(scope="module")
def limits(sound):
    fitter, base = sound
    found = limits_of(fitter, base, catalogue(fitter, base))
    return {(one.effect, one.parameter): one for one in found}


def limits_of(fitter, fitted, several, needed=LACKING):
    fitted = allowed(fitter, fitted)
    return detection_limits(fitter, fitted, several, small_amounts(fitter, fitted, several), needed)


def evidence_of(name, *effects):
    """What screening makes of an effect of the catalogue in a log of a machine with these, less the price of its other
    parameters, of which it takes the best of a grid.
    """
    fitter = fitter_of(*effects, seed=2)
    base = allowed(fitter, recalibrated(fitter, TOLERANCE))
    several = [one for one in catalogue(fitter, base) if one.name == name]
    others = [sum(not parameter.amplitude for parameter in one.parameters) for one in several]
    return max(screen(base, one).evidence - DEARNESS * count for one, count in zip(several, others, strict=True))


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
    candidate = candidate_of(sound, name)
    first = candidate.parameters[0]
    size = limits[name, first.name].size
    sizes = [first.standard(by * size) for by in (1.0, 2.0, 0.5)]
    at, above, below = map(gain_of(fitter, allowed(fitter, base), candidate), sizes)
    needed = LACKING + DEARNESS * len(candidate.parameters)
    assert below < needed <= at < above
    if name == "actuator_lag":
        assert at == pytest.approx(needed, rel=0.3)
        assert below == pytest.approx(0.25 * at, rel=0.1)


@pytest.mark.long
def test_play_that_is_none_is_no_change(sound):
    fitter, base = sound
    candidate = candidate_of(sound, "backlash")
    bare = candidate.parameters[0].standard(candidate.bare)
    assert gain_of(fitter, allowed(fitter, base), candidate)(bare) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.long
def test_elastic_and_limited_drives_are_seen_up_to_a_size(limits):
    assert limits["compliance", "frequency"].weakens
    assert limits["force_limit", "limit"].weakens
    assert sum(one.weakens for one in limits.values()) == 2


@pytest.mark.long
def test_a_constant_force_hides_behind_friction_that_differs_by_direction(limits):
    """One that is on for part of the log only does not: the drive file's tolerance cannot make up for it."""
    assert limits["process_force", "mean"].size < 0.5 * limits["constant_force", "force"].size


@pytest.mark.long
def test_a_load_that_comes_and_goes_shows_where_one_throughout_hides_in_recalibration(limits):
    throughout, stepped = limits["applied_load", "load"].size, limits["applied_load", "more"].size
    assert throughout is None or stepped < 0.5 * throughout


@pytest.mark.long
def test_a_lead_error_without_its_wave_is_none(limits):
    """A scale that is long by a constant share is none: no limit is given that nothing would be named for."""
    assert ("lead_error", AMPLITUDE) in limits
    assert ("lead_error", "linear") not in limits


@pytest.mark.long
def test_a_scale_s_wave_is_not_claimed_below_what_its_counts_pass_for(sound, limits):
    least = candidate_of(sound, "interpolation_error").least
    assert limits["interpolation_error", AMPLITUDE].size >= least


@pytest.mark.long
def test_more_evidence_needed_is_a_larger_size_by_its_root(sound):
    fitter, base = sound
    few = [one for one in catalogue(fitter, base) if one.name in ("constant_force", "viscous_drift")]
    small, large = (limits_of(fitter, base, few, needed) for needed in (1e4, 4e4))
    for one, other in zip(small, large, strict=True):
        if other.size is not None:
            assert other.size == pytest.approx(2.0 * one.size, rel=0.01)


@pytest.mark.long
def test_neither_what_a_fit_has_nor_what_has_nothing_to_tell_has_a_limit(sound):
    fitter, base = sound
    force = candidate_of(sound, "constant_force")
    model = joined(base.model, force)
    fit = fitter.fit(model, np.r_[base.theta, 0.1], base.process_noise, base.filtered.trajectory, most=0)
    assert limits_of(fitter, fit, [force, force._replace(parameters=(), effect=ForceGain)]) == []
    assert limits_of(fitter, base, []) == []


def candidate_of(sound, name):
    return next(one for one in catalogue(*sound) if one.name == name)


def test_what_is_free_makes_way_as_in_a_joint_fit():
    """Against the same quadratic cost, minimised by all at once."""
    rng = np.random.default_rng(3)
    jacobian, columns, residual, theta = (rng.normal(size=size) for size in ((60, 4), (60, 3), 60, 4))
    fit = SimpleNamespace(jacobian=jacobian, hessian=jacobian.T @ jacobian + np.eye(4), residual=residual, theta=theta)
    found = reduced(fit, columns)
    both = np.hstack([jacobian, columns])
    prior = np.diag(np.r_[np.ones(4), np.zeros(3)])
    joint = -np.linalg.solve(both.T @ both + prior, both.T @ residual + np.r_[theta, np.zeros(3)])
    np.testing.assert_allclose(-np.linalg.solve(found.curvature, found.slope), joint[4:], rtol=1e-9)
    np.testing.assert_allclose(-found.wanted - found.way @ joint[4:], joint[:4], rtol=1e-9)


def test_a_wave_is_told_at_the_phases_that_show_least_of_it_and_what_is_alike_in_all_logs_by_its_sum():
    amplitude = Parameter("mean", 0.0, 1.0, session=True, amplitude=True)
    waves = [amplitude._replace(name=name) for name in ("cosine", "sine", "cosine2")]
    labels = [(one, log) for one in waves for log in (0, 1)]
    assert amplitude_groups(labels) == {"cosine": [[0, 2], [1, 3]]}
    assert amplitude_groups([(amplitude, 0), (amplitude, 1)]) == {"mean": [[0], [1]]}
    curvature = 1e6 * np.array([[1.0, -0.9], [-0.9, 1.0]])
    assert gain_per_deviation(curvature, [[0], [1]]) == pytest.approx(
        0.2e6, rel=1e-3
    )  # alike in both: they take from each other
    both = 1e6 * np.diag([4.0, 4.0, 9.0, 9.0])
    assert gain_per_deviation(both, [[0, 2], [1, 3]]) == pytest.approx(2 * 4e6, rel=1e-3)
    for phase in np.linspace(0.0, np.pi, 7):
        way = np.array([np.cos(phase), np.cos(phase), np.sin(phase), np.sin(phase)])
        assert way @ both @ way >= 0.999 * gain_per_deviation(both, [[0, 2], [1, 3]])


def test_what_a_second_encoder_would_see_is_what_its_likelihood_falls_by():
    rng = np.random.default_rng(5)
    counts = np.ones((2, 4000))
    rest, added = 3e-7 * rng.normal(size=counts.shape), 1e-8 * np.sin(0.01 * np.arange(4000)) * counts
    twist = Twist(rest + added, counts, 1e-7)
    nothing = np.zeros_like(added)
    seen = seen_by(twist, added, added, period=1e-3)
    falls = twist_deviance(twist, nothing, 1e-3) - twist_deviance(twist, added, 1e-3)
    cross = 2.0 * float(np.sum((rest - rest.mean(axis=1, keepdims=True)) * added))  # by chance of this noise
    share = cross / float(np.sum((added - added.mean(axis=1, keepdims=True)) ** 2))
    assert falls == pytest.approx(float(seen @ seen) * (1.0 + share), rel=0.02)


LIMIT = DetectionLimit("backlash", "gap", "m", 4.6e-7, False)


@pytest.mark.parametrize(
    ("limit", "says"),
    [
        (LIMIT, "gap from 0.46 um"),
        (LIMIT._replace(size=None), "gap: at no usual size"),
        (DetectionLimit("compliance", "frequency", "Hz", 520.0, True), "frequency up to 520 Hz"),
        (DetectionLimit("friction_shape", "breakaway_gap", "1", 0.1, False), "breakaway_gap from 11 %"),
        (DetectionLimit("force_gain", "gain", "1", 0.034, False), "gain from 3.4 %"),
        (DetectionLimit("loop_delay", "delay", "1", 0.02, False), "delay from 0.02 control periods"),
    ],
)
def test_a_limit_in_words(limit, says):
    assert limit_says(limit) == says


def test_one_sentence_has_each_effect_once_and_what_would_not_show_apart():
    hidden = LIMIT._replace(effect="applied_load", parameter="load", size=None)
    both = [LIMIT, LIMIT._replace(parameter="other"), hidden]
    assert limits_say(both) == "These logs would show backlash (gap from 0.46 um); at no usual size applied_load"
    assert limits_say([hidden, hidden._replace(parameter="more", size=100.0, unit="N")]).endswith("(more from 100 N)")
    assert limits_say([]) == ""


def test_there_are_no_limits_behind_a_screw_nor_where_no_filter_follows(sound):
    fitter, base = sound
    assert allowed(None, SimpleNamespace(model=SimpleNamespace(coupled=True))) is None

    class Astray(type(fitter)):
        def under(self, fitted, process_noise):
            return fitted._replace(hessian=np.full_like(fitted.hessian, np.nan))

    assert allowed(Astray(fitter.logged), base) is None
