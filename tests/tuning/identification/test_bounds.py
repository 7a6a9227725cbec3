"""Identification of a short log: what is held, bounded, stopped and refused."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from diffdrive.errors import LogError, ParameterError
from diffdrive.logs import Log
from diffdrive.model.parameters import Sampling, check_drive
from diffdrive.model.quantity import Directional
from experiments.studies.recovery.excitation import FAST, MEDIUM, SLOW, concatenate, resting, strokes
from experiments.studies.recovery.truth import truth_log
from tests.support.known_machine import BELIEVED, GAINS, MACHINE, RATE, by_name
from tuning.identification.estimates import EstimateStatus, estimates
from tuning.identification.identify import COARSE_STEPS, identify
from tuning.identification.problem import Innovations
from tuning.identification.refinement import MAX_ROUGH_STEPS, MAX_STEPS
from tuning.identification.setup import build_problem
from tuning.identification.uncertainty import Covariance
from tuning.optimisation.space import coordinates


@cache
def short_log():
    rows = (*SLOW[3:5], MEDIUM[2], FAST[0])
    reference = concatenate([resting(0.05, RATE), *strokes(rows, RATE), resting(0.05, RATE)], "short")
    return truth_log(MACHINE, GAINS, reference, 0.0, seed=2)


TOLD = {"fixed": ("breakaway_gap",), "bounded": {"mass": (80.0, 97.0), "viscous": (1_000.0, 3_000.0)}, "starts": 2}


@pytest.fixture(scope="module")
def told():
    return identify([short_log()], BELIEVED, **TOLD)


@pytest.mark.slow
def test_what_is_fixed_stays_and_what_is_bounded_stays_inside(told):
    rows = by_name(told)
    for side, gap in (("positive", 30.0), ("negative", 22.98)):
        one = rows[f"breakaway_gap.{side}"]
        assert (one.status, one.value, one.low, one.high) == ("fixed", *[pytest.approx(gap, abs=1e-9)] * 3)
        assert getattr(told.drive.friction.breakaway_gap, side) == gap
        assert 1_000.0 < rows[f"viscous.{side}"].value < 3_000.0
    # the true mass is 101 kg
    assert 96.0 < rows["mass"].value <= 97.0
    assert rows["mass"].status == "at its bound"
    assert (rows["mass"].lowest, rows["mass"].highest) == pytest.approx((80.0, 97.0))
    assert rows["viscous.positive"].lowest == pytest.approx(1_000.0)
    assert rows["breakaway_gap.positive"].lowest == rows["breakaway_gap.positive"].highest


def bounds_of(logs, fixed=(), **bounded):
    """The question's bounds by path, and its notes."""
    question = build_problem(logs, BELIEVED, fixed, bounded)
    return {one.path: (one.low, one.high) for one in question.free}, question.notes


def two_loads():
    log = short_log()
    return [replace(log, load=np.zeros_like(log.time)), replace(log, load=np.full_like(log.time, 5e3))]


def test_bounds_are_given_in_the_names_of_the_drive_file():
    friction = BELIEVED.friction
    guide = float(friction.load_coefficient.positive * friction.initial_load)
    level = float(friction.coulomb_screw.positive) + guide
    found, _ = bounds_of(two_loads(), coulomb_at_no_load=(50.0, 150.0))
    assert found["coulomb.positive"] == pytest.approx((50.0, 150.0))
    found, _ = bounds_of([short_log()], coulomb_screw=(50.0, 150.0))  # one load: load_coefficient is held
    assert found["coulomb.positive"] == pytest.approx((50.0 + guide, 150.0 + guide))
    found, notes = bounds_of([short_log()], ("coulomb_screw",), breakaway_gap=(-1.0, 40.0))
    assert found["breakaway.positive"] == pytest.approx((1 - 1.0 / level, 1 + 40.0 / level))
    assert not any("F_S / F_C" in note for note in notes)
    assert any("F_S / F_C" in note for note in bounds_of([short_log()], breakaway_gap=(-1.0, 40.0))[1])


def test_narrow_bounds_are_no_prior_and_leave_nothing_undetermined():
    """The prior, and what counts as determined, are those of the usual bounds: a factor of 30 either way."""
    free = build_problem([short_log()], BELIEVED, (), {"mass": (94.0, 96.0)})
    prior = dict(zip((one.path for one in free.free), free.problem.prior, strict=True))
    assert prior["mass"] == pytest.approx(np.log(96 / 94) / np.log(900))
    assert prior["delay"] == prior["viscous.positive"] == 1.0


def test_a_drive_file_with_more_damping_than_the_machine_is_told():
    """Friction that grows less with speed than the file's damping leaves no viscous friction to speak of."""
    damped = replace(BELIEVED, plant=replace(BELIEVED.plant, damping=Directional(1e4, 1e4)))
    question = build_problem([short_log()], damped, (), {})
    paths = [one.path for one in question.free]
    y = np.zeros(len(paths))
    y[paths.index("viscous.positive")] = -1.0
    innovations = Innovations(coordinates(question.free), Sampling(RATE))
    covariance = Covariance(np.eye(len(y)), 100, 1.0)
    found = {row.name: row for row in estimates(y, innovations, question.problem, covariance, set())[0]}
    assert (found["viscous.positive"].value, found["viscous.positive"].status) == (0.0, "at its bound")
    assert found["viscous.negative"].status == "fitted"


def test_bounds_that_make_no_sense_are_refused_with_the_mend():
    with pytest.raises(ParameterError, match=r"while load_coefficient is free.* bound coulomb_at_no_load"):
        bounds_of(two_loads(), coulomb_screw=(50.0, 150.0))
    with pytest.raises(ParameterError, match="mass is both bounded and held"):
        bounds_of([short_log()], ("mass",), mass=(50.0, 150.0))
    with pytest.raises(ParameterError, match="coulomb_screw is bounded twice, under two names"):
        bounds_of([short_log()], coulomb_at_no_load=(50.0, 150.0), coulomb_screw=(50.0, 150.0))
    for limits in ((-5.0, 150.0), (150.0, 50.0), (50.0, np.inf)):
        with pytest.raises(ParameterError, match=r"cannot bound plant.mass within .*: not a range of its values"):
            bounds_of([short_log()], mass=limits)


class Stops:
    """Raises at the first step of the first search that is this long."""

    def __init__(self, most):
        self.most = most
        self.steps = []

    def __call__(self, step, most, cost):
        self.steps.append((step, most))
        if most == self.most:
            raise KeyboardInterrupt


SEARCHES = {"the starts": COARSE_STEPS, "the first search": MAX_ROUGH_STEPS, "a search under the filter": MAX_STEPS}


@pytest.mark.slow
@pytest.mark.parametrize("most", SEARCHES.values(), ids=SEARCHES.keys())
def test_an_interrupted_identification_returns_the_best_so_far_and_says_so(told, most):
    stops = Stops(most)
    found = identify([short_log()], BELIEVED, **TOLD, progress=stops)
    assert found.status.startswith("interrupted")
    assert stops.steps[-1] == (1, most)  # nothing was begun afterwards
    assert sum(length == most for _, length in stops.steps) == 1
    check_drive(found.drive)
    rows = by_name(found)
    assert rows.keys() == by_name(told).keys()
    for one in found.estimates:
        assert np.isfinite(one.value)
        assert np.isfinite([one.low, one.high]).all() == (one.status != "at its bound")
    assert 80.0 <= rows["mass"].value <= 97.0
    assert found.drive.friction.breakaway_gap.positive == 30.0


def test_names_that_are_no_parameters_are_refused_with_those_that_are():
    with pytest.raises(ParameterError, match=r"cannot fix 'weight'; known: mass, .*delay"):
        identify([short_log()], BELIEVED, fixed=("weight",))
    with pytest.raises(ParameterError, match=r"cannot bound 'masss'; did you mean 'mass'"):
        identify([short_log()], BELIEVED, bounded={"masss": (1.0, 2.0)})


def test_logs_that_cannot_be_used_are_refused_with_the_mend():
    log = short_log()
    twice = Log("twice as slow", 2.0 * log.time, log.position, log.command)
    brief = Log("brief", log.time[:150], log.position[:150], log.command[:150])
    with pytest.raises(LogError, match="no log to identify from"):
        identify([], BELIEVED)
    with pytest.raises(LogError, match=r"twice as slow is sampled at 1000 Hz, .* at 2000 Hz: .* one rate"):
        identify([log, twice], BELIEVED)
    with pytest.raises(LogError, match=r"no stretch of 200 samples without a gap in brief"):
        identify([brief], BELIEVED)
    torn = replace(log, name="torn", gaps=tuple(range(150, len(log.time), 150)))
    with pytest.raises(LogError, match=r"no stretch of 200 samples without a gap in torn"):
        identify([torn], BELIEVED)


def statuses(logs, fixed=(), drive=BELIEVED):
    """Of the start, as if every parameter were known to a hundredth: by path."""
    question = build_problem(logs, drive, fixed, {})
    count = len(question.free)
    known = Covariance(1e-4 * np.eye(count), 80, 1.0)
    innovations = Innovations(coordinates(question.free), Sampling(RATE))
    table, _ = estimates(np.zeros(count), innovations, question.problem, known, set(question.unexcited))
    return {one.path: one for one in table}


def test_under_one_load_the_friction_at_no_load_is_known_and_its_parts_are_not():
    found = statuses([short_log()])
    for side in ("positive", "negative"):
        assert found[f"friction.coulomb_at_no_load.{side}"].status is EstimateStatus.FITTED
        assert found[f"friction.load_coefficient.{side}"].status is EstimateStatus.UNDETERMINED
        screw = found[f"friction.coulomb_screw.{side}"]
        assert screw.status is EstimateStatus.IN_A_SUM
        assert np.isnan([screw.low, screw.high]).all()
    assert any("the sum that they determine" in note for note in build_problem([short_log()], BELIEVED, (), {}).notes)


def test_the_screws_share_is_known_where_the_slope_is_or_is_stated_or_where_nothing_presses():
    friction = replace(BELIEVED.friction, initial_load=0.0)
    cases = (
        statuses(two_loads()),
        statuses([short_log()], fixed=("load_coefficient",)),
        statuses([short_log()], drive=replace(BELIEVED, friction=friction)),
    )
    for found in cases:
        assert found["friction.coulomb_screw.positive"].status is EstimateStatus.FITTED
