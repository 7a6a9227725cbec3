"""The genetic baseline on functions with known minima, the two-stage route on a known drive, and their study."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.errors import ParameterError
from diffdrive.model.quantity import Directional
from experiments.reports.report import Report
from experiments.studies.emps import axis as emps
from experiments.studies.evolution.study import (
    LevelCost,
    _median_visit,
    emps_case,
    evolution_study,
    first_visit_below,
    in_words,
    synthetic_case,
    with_delay,
)
from experiments.studies.evolution.two_stage import two_stage
from tuning.optimisation.evolution import EDGE, Budget, HistoryEntry, evolve, norm_costs, origin_fractions, theta_at
from tuning.optimisation.space import FreeParameter, search_space

PLENTY = Budget(simulations=20_000, seconds=60.0)
VALLEY = np.array([0.3, 0.7, 0.55])


def valley(shares):
    return np.sqrt(1.0 + np.sum((shares - VALLEY) ** 2 * [1.0, 10.0, 100.0], axis=1))


def test_evolution_finds_a_minimum():
    found = evolve(valley, np.full(3, 0.5), PLENTY, population=10)
    assert found.cost == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(found.share, VALLEY, atol=1e-2)
    assert found.status.startswith("converged")
    assert [visit.cost for visit in found.history] == sorted((v.cost for v in found.history), reverse=True)
    again = evolve(valley, np.full(3, 0.5), PLENTY, population=10)
    np.testing.assert_array_equal(found.share, again.share)


def test_evolution_stops_when_it_should_and_counts():
    asked = []

    def counted(shares):
        asked.append(len(shares))
        assert np.all((shares >= EDGE) & (shares <= 1 - EDGE))
        return valley(shares)

    found = evolve(counted, np.full(3, 0.5), Budget(100, 60.0), population=10)
    assert found.simulations == sum(asked) == 120  # the generation that passes the budget is the last
    assert found.status == "stopped after 120 simulations"
    assert evolve(valley, np.full(3, 0.5), Budget(10**6, 60.0, 1.1), population=10).status == "good enough"
    assert evolve(valley, np.full(3, 0.5), Budget(10**6, 0.0), population=10).status == "stopped after 0 s"


def test_evolution_begins_with_the_given_member_and_survives_what_diverges():
    def broken(shares):
        return np.where(shares[:, 0] > 0.5, np.nan, valley(shares))

    assert evolve(valley, VALLEY, Budget(1, 60.0)).history[0].cost == pytest.approx(1.0)
    assert evolve(broken, np.full(3, 0.9), PLENTY, population=10).cost == pytest.approx(1.0, abs=1e-6)


def residuals(y, args):
    return jnp.concatenate([y - args, jnp.ones(2)])


def test_costs_are_those_of_the_gradient_search():
    drive = emps.reference_drive()
    space = search_space(
        drive, [FreeParameter("plant.mass", 50.0, 200.0), FreeParameter("plant.constant_force", -20.0, 20.0)]
    )
    shares = np.array([[0.2, 0.9], [0.6, 0.4], [0.5, 0.5]])
    points = theta_at(space, shares)
    np.testing.assert_allclose(theta_at(space, origin_fractions(space)), 0.0, atol=1e-12)
    np.testing.assert_allclose(space.values(points[0])[1], -20.0 + 0.9 * 40.0)
    expected = np.sqrt(np.sum((points - 0.3) ** 2, axis=1) + 2.0)
    np.testing.assert_allclose(norm_costs(residuals, space, jnp.asarray(0.3), 2)(shares), expected)


@pytest.mark.long
def test_the_two_stage_route_finds_the_sliding_friction_of_a_drive_that_cruises():
    case = synthetic_case()
    found = two_stage([case.log], emps.reference_drive())
    ours, truth = found.drive.friction, case.truth.friction
    for side in ("positive", "negative"):
        for name in ("coulomb_screw", "breakaway_gap", "viscous", "stribeck_velocity"):
            expected = getattr(getattr(truth, name), side)
            assert getattr(getattr(ours, name), side) == pytest.approx(expected, rel=0.01), (name, side)
    assert found.stribeck_rms < 0.01
    # of the bristle it sees little: the table reverses at 4 m/s^2, and the filter blurs the first 0.2 mm
    assert found.hysteresis_rms < found.evolution.history[0].cost


@pytest.mark.long
def test_the_two_stage_route_says_what_it_cannot_tell():
    case = synthetic_case(speeds=(0.02, 0.1))
    found = two_stage([case.log], emps.reference_drive(), budget=Budget(60, 5.0))
    assert any("speeds of cruising in the negative direction: its Stribeck curve is left" in n for n in found.notes)
    assert found.drive.friction.breakaway_gap.positive == pytest.approx(1e-3)
    assert any("bristle: stopped after" in note for note in found.notes)


def test_levels_and_medians_count_those_that_never_got_there():
    history = [HistoryEntry(10, 1.0, 5.0), HistoryEntry(20, 2.0, 3.0), HistoryEntry(30, 3.0, 2.0)]
    assert first_visit_below(history, 3.0).simulations == 20
    assert first_visit_below(history, 1.0) is None
    assert _median_visit([history[0], None, history[2]]) == (30.0, 3.0)
    assert _median_visit([history[0], None, None]) is None


def test_the_result_is_of_the_closest_level_that_both_reach_else_of_the_gradient_search():
    budget = Budget(2000, 60.0)
    coarse, fine = LevelCost(0.1, (100, 1.0), (900, 9.0)), LevelCost(0.001, (200, 2.5), None)
    assert in_words([coarse, fine], budget, 3) == (
        "To come within 10 % of the best cost (median of 3 runs), the gradient search takes 100 simulations and 1 s, "
        "differential evolution 900 simulations and 9 s."
    )
    assert in_words([fine], budget, 1) == (
        "To come within 0.1 % of the best cost (1 run), the gradient search takes 200 simulations and 2.5 s; "
        "differential evolution is not there after 2000 simulations or 60 s."
    )
    assert "half of the gradient searches or more do not" in in_words([LevelCost(0.1, None, None)], budget, 1)


@pytest.mark.parametrize(
    ("delay", "whole", "fraction"), [(-0.4, 0, None), (0.3, 0, 0.3), (1.25, 1, 0.25), (2.0, 2, None)]
)
def test_a_delay_is_put_into_a_drive(delay, whole, fraction):
    actuator = with_delay(emps.reference_drive(), delay).actuator
    assert (actuator.delay_samples, actuator.delay_fraction) == (whole, fraction)


@pytest.mark.slow
def test_the_study_writes_what_it_compares(tmp_path):
    case = synthetic_case(speeds=(5e-3, 0.02, 0.1), travel=4e-3)
    with Report("evolution", tmp_path) as report:
        evolution_study(report, case, runs=1, seconds=5.0, max_ratio=0.5)
    written = json.loads((tmp_path / "result.json").read_text())
    rows = written["tables"]["equal_quality"]["rows"]
    assert [row[1] for row in rows] == ["1 of 1"] * 3
    assert written["figures"] == ["evolution.png"]
    assert set(written["history"]) == {"gradient", "evolution"}
    columns = ["parameter", "unit", "starting drive", "two stages", "gradient", "truth"]
    assert written["tables"]["routes"]["columns"] == columns
    starting, staged, by_gradient, _ = written["tables"]["routes"]["rows"][-1][2:]
    assert by_gradient < staged < starting
    assert written["notes"][-1].startswith("To come within 0.1 % of the best cost (1 run), the gradient search takes ")
    assert report.page.conclusions == written["notes"][-1:]
    assert len(report.page.charts["evolution"].panels) == 2


def test_bad_requests_are_refused(tmp_path):
    with pytest.raises(ParameterError, match=r"--data .*: no DATA_EMPS\.mat in it"):
        emps_case(tmp_path)
    with Report("evolution", None) as report, pytest.raises(ParameterError, match="must be positive"):
        evolution_study(report, synthetic_case(speeds=(0.05,)), runs=0)
    assert isinstance(synthetic_case(speeds=(0.05,)).truth.friction.viscous, Directional)
