"""What is tuned on and what is held out share nothing; the random starts of the study stay in their two decades."""

import json
from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.library import PAPER_DRIVE
from diffdrive.model.quantity import node_at
from diffdrive.model.uncertainty import Deviation, Uncertainty
from experiments.reports.report import Report
from experiments.studies.tuning_study.study import (
    DECADES,
    _cost_to_reach,
    _evaluation_history,
    _random_shift,
    benchmark,
    tuning_study,
)
from tuning.gains.plan import (
    HELD_OUT_SEED,
    OFF_GRID_FACTOR,
    TuningPlan,
    held_out_scenarios,
    machines,
    perturbed,
    reversal,
    training_scenarios,
)
from tuning.gains.requirements import Requirements, operating_points
from tuning.gains.sequential import FEASIBILITY_TOLERANCE
from tuning.gains.setup import set_up
from tuning.gains.tune import default_space
from tuning.gains.uncertain_machine import uncertain_values

PLAN = TuningPlan(loads=(0.0, 12_600.0))


@pytest.fixture(scope="module")
def description():
    return read_axis(PAPER_DRIVE)


def test_held_out_scenarios_share_neither_load_nor_seed_with_those_tuned_on(description):
    on, off = training_scenarios(description, PLAN), held_out_scenarios(description, PLAN)
    assert not {one.seed for one in on} & {one.seed for one in off}
    assert len({one.seed for one in on + off}) == len(on + off)
    assert not {one.name for one in on} & {one.name for one in off}
    for one in off:
        for other in on:
            same_load = np.array_equal(np.asarray(one.load), np.asarray(other.load))
            same_motion = np.array_equal(one.motion.position, other.motion.position)
            assert not (same_load and same_motion and one.drive == other.drive)


@pytest.mark.parametrize("load", [0.0, 8_000.0])
def test_under_a_single_load_another_machine_is_held_out_and_nothing_comes_twice(description, load):
    plan = TuningPlan(loads=(load, load))
    on, off = training_scenarios(description, plan), held_out_scenarios(description, plan)
    assert [one.name for one in on] == [f"{name}, {load / 1e3:g} kN" for name in ("nominal", "machine 1")]
    (stranger,) = (one for one in off if one.name.startswith("other machine"))
    assert stranger.drive not in [one.drive for one in on]
    tried = [
        (one.motion.position.tobytes(), np.broadcast_to(one.load, one.motion.time.shape).tobytes(), one.drive)
        for one in on + off
    ]
    assert all(one not in tried[:k] for k, one in enumerate(tried))
    assert list(operating_points([description.drive], (0.0, 0.01), plan.loads).velocity) == [-0.01, 0.0, 0.01]


def test_the_held_out_machine_was_not_tuned_on(description):
    plan = replace(PLAN, machines=4)
    on = {tuple(jax.tree.leaves(one.drive)) for one in training_scenarios(description, plan)}
    strangers = {
        tuple(jax.tree.leaves(one.drive)) for one in held_out_scenarios(description, plan) if "other" in one.name
    }
    assert len(on) == 4
    assert not on & strangers


def test_machines_lie_within_a_few_spreads_and_begin_with_the_drive_itself(description):
    drawn = machines(description.drive, 6, 0.03, 1)
    assert drawn[0] == description.drive
    masses = np.array([one.plant.mass for one in drawn[1:]])
    assert np.all(np.abs(masses / drawn[0].plant.mass - 1.0) < 0.15)
    assert len(set(masses)) == 5


KNOWN = Uncertainty.of(
    {
        "plant.mass": Deviation(0.01),
        "plant.constant_force": Deviation(2.0, is_relative=False),
        "friction.viscous.positive": Deviation(0.2),
    },
    {"plant.mass": {"plant.constant_force": -0.8}},
)


def test_what_is_known_is_drawn_with_its_deviations_and_correlations(description):
    count = 2000
    drawn = uncertain_values(description.drive, KNOWN, [np.random.default_rng((1, k)) for k in range(count)])
    mass, force, viscous = (np.array([one[name] for one in drawn]) for name in KNOWN.names)
    mass, viscous = np.log(mass / description.value("plant.mass")), np.log(viscous / viscous_of(description))
    # four standard errors of each
    assert [np.std(mass), np.std(force), np.std(viscous)] == pytest.approx(
        [0.01, 2.0, 0.2], rel=4.0 / np.sqrt(2 * count)
    )
    assert [np.mean(mass) / 0.01, np.mean(force) / 2.0, np.mean(viscous) / 0.2] == pytest.approx(
        [0.0, description.value("plant.constant_force"), 0.0], abs=4.0 / np.sqrt(count)
    )
    assert np.corrcoef(mass, force)[0, 1] == pytest.approx(-0.8, abs=4.0 * (1.0 - 0.8**2) / np.sqrt(count))
    assert abs(np.corrcoef(mass, viscous)[0, 1]) < 4.0 / np.sqrt(count)


def viscous_of(axis):
    return axis.drive.friction.viscous.positive


def test_what_is_not_known_keeps_the_spread_and_its_draws(description):
    known, spread = (machines(description.drive, 3, 0.03, 1, uncertainty) for uncertainty in (KNOWN, None))
    assert known[0] == description.drive
    for k, (one, other) in enumerate(zip(known[1:], spread[1:], strict=True), 1):
        rng = np.random.default_rng((1, k))
        perturbed(description.drive, 0.03, rng)
        (drawn,) = uncertain_values(description.drive, KNOWN, [rng])  # whatever the number of machines
        assert {name: node_at(one, name) for name in KNOWN.names} == drawn
        assert one.plant.mass != other.plant.mass
        assert one.friction.viscous.positive != other.friction.viscous.positive
        assert one.friction.viscous.negative == other.friction.viscous.negative
        assert one.friction.coulomb_screw == other.friction.coulomb_screw
        assert one.actuator == other.actuator


def test_the_plan_draws_by_what_is_known_and_says_so(description):
    plan = TuningPlan(loads=(0.0, 0.0), uncertainty=KNOWN)
    on, off = training_scenarios(description, plan), held_out_scenarios(description, plan)
    drives = [one.drive for one in on + off if "machine" in one.name]
    expected = [machines(description.drive, 2, plan.spread, seed, KNOWN)[1] for seed in (0, HELD_OUT_SEED)]
    assert drives == expected
    prepared = set_up(description, plan, Requirements(command_noise=None, load_error=None))  # runs nothing
    assert f"({', '.join(KNOWN.names)}), and by 3 %" in prepared.notes[-1]


def test_a_reversal_turns_once_and_cruises_at_its_speed():
    motion = reversal(0.010 * OFF_GRID_FACTOR, 10_000.0)
    speed = np.gradient(motion.position, motion.time)
    assert np.max(np.abs(speed)) == pytest.approx(0.010 * OFF_GRID_FACTOR, rel=1e-3)
    moving = np.sign(speed[np.abs(speed) > 1e-3])
    assert np.count_nonzero(np.diff(moving)) == 1


def test_random_starts_of_the_study_span_two_decades_and_stay_inside():
    space = default_space(benchmark().controller)
    rng = np.random.default_rng(3)
    drawn = np.array([np.asarray(space.values(_random_shift(space, rng))) for _ in range(200)])
    given = np.asarray(space.values(np.zeros(len(space.free))))
    decades = np.log10(drawn / given)
    assert np.all(np.abs(decades) <= DECADES / 2 + 1e-9)
    assert np.all(decades.max(axis=0) - decades.min(axis=0) > 0.9 * DECADES)
    for k, free in enumerate(space.free):
        assert np.all((drawn[:, k] > free.low) & (drawn[:, k] < free.high))


def test_the_trail_of_a_tuning_counts_every_start_and_every_derivative():
    def found(*history):
        return SimpleNamespace(state=SimpleNamespace(history=history))

    # evaluations, linearisations, s, objective, missed: of two searches, after a look at both starts in 0.5 s
    first = found((1, 1, 1.0, 5.0, 0.0), (2, 2, 2.0, 3.0, 0.2))
    second = found((1, 1, 0.7, 2.0, 0.0))
    tuned = SimpleNamespace(start_objectives=np.zeros(2), screening_seconds=0.5, searches=[first, second])
    trail = _evaluation_history(tuned)
    assert trail == [(5, 2, 1.5, 5.0), (7, 3, 2.5, np.inf), (10, 5, 3.2, 2.0)]
    # to within 20 %, 5 % and 1 % of 2: the third alone
    assert _cost_to_reach(trail, 2.0) == [10, 3.2] * 3
    assert _cost_to_reach(trail, 4.5) == [5, 1.5, 10, 3.2, 10, 3.2]
    assert _cost_to_reach(trail, 1.0) == [None] * 6


@pytest.mark.slow
def test_the_study_compares_all_searches_and_writes_what_it_found(tmp_path):
    """Few evaluations and starts, all of its parts: eight minutes, most of them compilation."""
    with Report("study", tmp_path) as report:
        tuning_study(report, evaluations=50, runs=1, starts=1)
    written = json.loads((tmp_path / "result.json").read_text())
    assert {"race", "held_out", "starts", "parameters"} <= set(written["tables"])
    objectives = {row[0]: row[1] for row in written["tables"]["race"]["rows"]}
    assert objectives["gradient"] == min(objectives.values())
    assert objectives["gradient"] <= 0.018
    assert all(row[2] <= 0.07 for row in written["tables"]["held_out"]["rows"])
    assert written["true_load"]["objective_um"] <= 0.022
    assert written["true_load"]["worst_nominal_load_error_N"] <= 300.0 * (1 + FEASIBILITY_TOLERANCE)
    assert written["random_starts"]["unstable_results"] == 0
