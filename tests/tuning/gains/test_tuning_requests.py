"""What is asked of a tuning: a limit is kept or refused, and nothing that cannot be checked counts as kept."""

from types import SimpleNamespace

import numpy as np
import pytest

import diffdrive as dd
import tuning
from diffdrive.errors import CheckpointError, ParameterError
from diffdrive.loop.smooth import smooth
from tests.support.small_tuning import controller, requirements
from tuning.gains import setup
from tuning.gains.checkpoint import Checkpoint
from tuning.gains.plan import TuningPlan
from tuning.gains.sequential import SearchState
from tuning.gains.setup import set_up

LAP = dd.motion.triangular(speed=0.010, stroke=0.0009, rounding=0.02, duration=0.2, rate=dd.paper_axis().rate)
PLAN = TuningPlan(motion=LAP, loads=(0.0, 8_000.0), load_steps=2, machines=1, settle=0.05)
NOISES, ERRORS = (2.0, 5.0, 3.0, 4.0), (10.0, 20.0, 30.0, 40.0)


def judged(noise, error, code="ok"):
    """What a run of a scenario leaves."""
    return SimpleNamespace(
        command_noise=noise, load_error=error, run=SimpleNamespace(status=SimpleNamespace(code=code))
    )


@pytest.fixture
def axis(monkeypatch):
    """An axis that estimates the load; what its gains as given do in the scenarios is made up."""
    levels = iter([judged(noise, error) for noise, error in zip(NOISES, ERRORS, strict=True)])
    monkeypatch.setattr(setup, "run_scenario", lambda *_: next(levels))
    return dd.paper_axis("pd+fc+ls")


def test_limits_relative_to_the_gains_as_given_are_the_default(axis):
    limits = set_up(axis, PLAN).limits
    assert limits.command_noise == 2.0 * 5.0
    np.testing.assert_allclose(limits.load_error, 1.1 * np.array(ERRORS))


def test_none_is_no_limit_and_nothing_is_simulated_for_it(axis, monkeypatch):
    monkeypatch.setattr(setup, "run_scenario", None)
    found = set_up(axis, PLAN, tuning.Requirements(command_noise=None, load_error=None))
    assert (found.limits.command_noise, found.limits.load_error, found.notes) == (None, None, ())
    assert found.constraints.limits.command_noise is None


def test_a_limit_in_newtons_is_that_limit_beside_one_relative_to_the_gains(axis):
    limits = set_up(axis, PLAN, tuning.Requirements(command_noise=tuning.AsGiven(1.0), load_error=100.0)).limits
    assert (limits.command_noise, limits.load_error) == (5.0, 100.0)


@pytest.mark.long
def test_nothing_is_relative_to_gains_with_which_the_loop_diverges(axis, monkeypatch):
    monkeypatch.setattr(setup, "run_scenario", lambda *_: judged(1e47, 1e30, "diverged"))
    found = set_up(axis, PLAN)
    assert (found.limits.command_noise, found.limits.load_error) == (None, None)
    assert "diverges with the gains as given" in found.notes[0]
    assert set_up(axis, PLAN, tuning.Requirements(command_noise=20.0)).limits.command_noise == 20.0
    with pytest.raises(ParameterError, match=r"command_noise: The loop diverges with the gains as given.*or None"):
        set_up(axis, PLAN, tuning.Requirements(command_noise=tuning.AsGiven(1.0)))


@pytest.mark.parametrize(
    ("controller", "requirements", "objective", "says"),
    [
        ("pd", {"load_error": 100.0}, {}, "requirements: load_error: this controller estimates no load"),
        ("pd", {"load_error": tuning.AsGiven(1.0)}, {}, "requirements: load_error"),
        ("pd+fc", {}, {"load_error": 1e-3}, "objective: load_error: this controller estimates no load"),
        ("pd+fc+ls", {"load_settling": 1.0}, {}, r"requirements: load_settling: this controller has no load estimator"),
    ],
)
def test_what_cannot_be_seen_of_a_controller_is_refused(controller, requirements, objective, says):
    with pytest.raises(ParameterError, match=says):
        set_up(dd.paper_axis(controller), PLAN, tuning.Requirements(**requirements), tuning.Objective(**objective))


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"gain_margin": 1e3}, "gain_margin: must be from 0 to 313 dB, got 1000.0; 6 to 12 are usual"),
        ({"gain_margin": None}, "gain_margin: must be from 0 to 313 dB, got None"),
        ({"phase_margin": 100.0}, "phase_margin: must be from 0 to 90 degrees"),
        ({"peak_sensitivity": 0.9}, "peak_sensitivity: must be at least 1, got 0.9; None is no limit"),
        ({"command_noise": np.inf}, "command_noise: must be above 0 N, got inf; None is no limit"),
        ({"load_error": 0.0}, "load_error: must be above 0 N, got 0.0; None is no limit"),
        ({"load_settling": -1.0}, "load_settling: must be above 0 s"),
    ],
)
def test_a_requirement_that_no_loop_can_keep_is_refused_by_name(asked, says):
    with pytest.raises(ParameterError, match=says.replace(".", r"\.")):
        tuning.Requirements(**asked)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"error": -1.0}, "error: must be at least 0, got -1"),
        ({"peak": np.nan}, "peak: must be at least 0, got nan"),
        ({"error": 0.0}, "all are zero"),
        ({"aggregation": "median"}, "no aggregation 'median'; known: mean, worst, cvar"),
    ],
)
def test_an_objective_that_cannot_be_is_refused_where_it_is_made(asked, says):
    with pytest.raises(ParameterError, match=says):
        tuning.Objective(**asked)


@pytest.mark.parametrize("factor", [0.0, -1.0, np.inf, "twice"])
def test_a_factor_of_the_gains_as_given_is_a_positive_number(factor):
    with pytest.raises(ParameterError, match="AsGiven: factor: must be above 0"):
        tuning.AsGiven(factor)


def test_a_tuning_goes_on_from_its_folder_alone(tmp_path):
    folder, state = tmp_path / "new", SearchState(theta=(1.0, 2.0))
    Checkpoint(str(folder), np.zeros(2)).save(0, state)
    assert Checkpoint(folder, np.zeros(2)).state_of(0) == state
    for other in (np.zeros((2, 1)), np.zeros(4, np.float32)):  # of the same bytes
        with pytest.raises(CheckpointError, match="is the checkpoint of another tuning"):
            Checkpoint(folder, other)


@pytest.mark.long
def test_no_phase_margin_is_no_requirement():
    limits = tuning.Requirements(phase_margin=0.0).limits(None, None)
    assert limits.phase is None
    assert "phase margin" not in requirements(limits).loop_constraints(smooth(controller()))
