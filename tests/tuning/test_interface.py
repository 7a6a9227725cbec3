"""The public interface of tuning: what guards the command line guards Python, and results say what they are worth."""

import dataclasses
import json

import numpy as np
import pytest

import diffdrive as dd
import experiments
import tuning
from diffdrive.errors import LogError, ParameterError, ResultError
from tests.support.sound_log import DRIVE, SOUND
from tuning.gains import pareto
from tuning.gains.tune import SearchOptions

AXIS = dd.paper_axis(controller="pd+fc+ls")
LAP = dd.motion.triangular(speed=0.010, stroke=0.0009, rounding=0.02, duration=0.2, rate=AXIS.rate)


@pytest.mark.parametrize("call", [tuning.identify, tuning.diagnose])
def test_logs_that_cannot_be_used_are_refused_in_python_too(call):
    with pytest.raises(LogError, match="is sampled at"):
        call(AXIS, SOUND)
    with pytest.raises(LogError, match="holds the same samples as"):
        call(DRIVE, [SOUND, dataclasses.replace(SOUND, name="again")])
    with pytest.raises(LogError, match="no log is given"):
        call(DRIVE, [])


def test_a_log_that_would_mislead_is_not_identified_from():
    with pytest.raises(LogError, match=r"reverse.*force=True identifies all the same"):
        tuning.identify(DRIVE, SOUND.replace(command=-SOUND.command))


def test_an_axis_with_effects_is_not_identified():
    with pytest.raises(ParameterError, match="cogging: identification knows no effects"):
        tuning.identify(DRIVE.with_effects(dd.effects.Cogging(cosine=1.0)), SOUND)


def test_an_effect_that_is_not_known_cannot_be_left_out():
    with pytest.raises(ParameterError, match=r"without: no effect 'coging'; did you mean 'cogging'\?$"):
        tuning.diagnose(DRIVE, SOUND, without=["coging"])
    with pytest.raises(ParameterError, match=r"without: no effect 'gravity'; known: applied_load, "):
        tuning.diagnose(DRIVE, SOUND, without=["gravity"])
    with pytest.raises(ParameterError, match=r"without: must be a list of names, such as \['cogging'\], got 'cogging'"):
        tuning.diagnose(DRIVE, SOUND, without="cogging")


@pytest.mark.parametrize(
    ("name", "value"), [("most_effects", 0), ("most_effects", 1.5), ("tolerance", 0.0), ("tolerance", 2.0)]
)
def test_a_search_that_cannot_be_is_refused_before_the_logs_are_read(name, value):
    with pytest.raises(ParameterError, match=f"{name}: must be"):
        tuning.diagnose(DRIVE, ["no such file"], **{name: value})


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"loads": (5.0, 1.0)}, "loads: give the lowest and the highest"),
        ({"loads": (0.0, 12e3), "load_steps": 1}, "load_steps: must be a whole number from 2 on, got 1"),
        ({"starts": 0}, "starts: must be a whole number from 1 on, got 0"),
        ({"starts": 10**12}, "starts"),
        ({"max_steps": 0}, "max_steps: must be a whole number from 1 on, got 0"),
        ({"machines": 0}, "machines: must be a whole number from 1 on, got 0"),
        ({"spread": -0.1}, r"spread -0\.1: give a share from 0 to 50%, as 3% or 0\.03"),
        ({"seed": -1}, "seed: must be a whole number from 0 on, got -1"),
        ({"speed": 0.0}, r"speed: must be above 0 m/s, got 0\.0"),
        ({"settle": np.nan}, "settle: must be at least 0 s, got nan"),
    ],
)
def test_a_tuning_that_cannot_be_is_refused_by_name(asked, says):
    with pytest.raises(ParameterError, match=says):
        tuning.tune(AXIS, LAP, **asked)


@pytest.fixture(scope="module")
def tuned():
    seen = []
    result = tuning.tune(
        AXIS, LAP, loads=(0.0, 8_000.0), machines=1, starts=1, max_steps=3, settle=0.05,
        requirements=tuning.Requirements(command_noise=100.0), progress=lambda *step: seen.append(step),
    )  # fmt: skip
    return result, seen


@pytest.mark.long
def test_tuned_gains_say_what_they_are_worth_held_out(tuned):
    result, seen = tuned
    assert result.accepted
    assert result.status.ok
    assert {one.role for one in result.runs} == {"tuned on", "held out"}
    held_out = [one for one in result.runs if one.role == "held out"]
    assert result.held_out.rms_after == pytest.approx(np.mean([one.after.rms for one in held_out]))
    assert result.held_out.rms_after < result.held_out.rms_before
    before, after = result.gains["kp"]
    assert before == pytest.approx(AXIS.gains["kp"], rel=1e-12)
    assert after == pytest.approx(result.axis.gains["kp"], rel=1e-12)
    assert after > 1.1 * before
    assert result.axis.name == "tuned"
    assert "held out" in str(result)
    assert seen[-1] == ("verifying on the exact simulator", 1, 1)


@pytest.mark.long
def test_a_report_of_tuned_gains_has_the_axis_to_run(tuned, tmp_path):
    experiments.report(tuned[0], tmp_path / "out")
    told = json.loads((tmp_path / "out" / "tuning.json").read_text())
    assert (told["schema"], told["status"]["ok"], told["accepted"]) == ("tuning/2", True, True)
    assert dd.read_axis(tmp_path / "out" / "tuned.toml").gains == pytest.approx(tuned[0].axis.gains)
    assert {"nyquist.png", "tuning.png", "verification.csv"} <= {one.name for one in (tmp_path / "out").iterdir()}


@pytest.fixture
def searched_again(tuned, monkeypatch):
    """What a Pareto front searches, and the search that it finds each time: that of the result."""
    asked, found = [], [tuned[0].search]

    def search(controller, lanes, constraints, space, **named):
        asked.append((controller, float(constraints.limits.command_noise), space, named["objective"], named["options"]))
        return found[0]

    monkeypatch.setattr(pareto, "search_gains", search)
    return asked, found


@pytest.mark.long
def test_a_pareto_front_is_searched_as_its_result_was(tuned, searched_again, tmp_path):
    result, front = tuned[0], tuning.pareto_front(tuned[0], [30.0, 10.0])
    assert searched_again[0] == [
        (AXIS.controller, limit, result.setup.space, result.objective, SearchOptions(starts=1, max_steps=3))
        for limit in (10.0, 30.0)
    ]
    assert front.status.ok
    assert [point.rms for point in front.points] == pytest.approx([result.held_out.rms_after] * 2)
    experiments.report(front, tmp_path)
    told = json.loads((tmp_path / "pareto.json").read_text())
    assert (told["schema"], [point["noise_limit_N"] for point in told["points"]]) == ("pareto/1", [10.0, 30.0])


@pytest.mark.long
def test_a_pareto_front_goes_on_from_its_folder(tuned, tmp_path):
    raised = []

    def interrupts(stage, done, most):  # once, as Ctrl-C does
        if "20 N" in stage and done and not raised:
            raised.append(done)
            raise KeyboardInterrupt

    stopped = tuning.pareto_front(tuned[0], [10.0, 20.0], resume=tmp_path, progress=interrupts)
    assert (stopped.status.code, len(stopped.points)) == ("interrupted", 1)
    steps = []
    front = tuning.pareto_front(tuned[0], [10.0, 20.0], resume=tmp_path, progress=lambda *one: steps.append(one))
    assert front.points == tuning.pareto_front(tuned[0], [10.0, 20.0]).points
    assert not [done for stage, done, _ in steps if "10 N" in stage and done < 3]  # that one had come to its end


@pytest.mark.long
def test_a_pareto_front_says_what_it_has_not(tuned, searched_again):
    found, search = searched_again[1], tuned[0].search
    constraints = {**search.point.constraints, "phase margin": np.array([0.2])}
    found[0] = dataclasses.replace(search, point=search.point._replace(constraints=constraints))
    missed = tuning.pareto_front(tuned[0], [10.0])
    assert (missed.status.code, missed.notes) == ("not_accepted", ("10 N: phase margin is missed by 20 %",))
    state = dataclasses.replace(search.best.state, status="interrupted after 1 steps")
    found[0] = dataclasses.replace(search, best=dataclasses.replace(search.best, state=state))
    stopped = tuning.pareto_front(tuned[0], [10.0, 20.0])
    assert (stopped.status.code, stopped.points) == ("interrupted", ())
    with pytest.raises(ResultError, match="interrupted after 0 of 2 limits"):
        tuning.pareto_front(tuned[0], [10.0, 20.0], throw=True)


@pytest.mark.long
@pytest.mark.parametrize(("limits", "says"), [([5.0, -1.0], "noise_limits: must be above 0 N, got -1"), ([], "one")])
def test_limits_of_a_pareto_front_are_above_zero(tuned, limits, says):
    with pytest.raises(ParameterError, match=says):
        tuning.pareto_front(tuned[0], limits)


@pytest.mark.long
def test_a_sweep_goes_on_where_it_was_and_counts_as_by_hand(tmp_path):
    asked = {"vary": {"load": "uniform:0..8 kN", "plant.mass": "lognormal:3%"}, "samples": 48, "tolerance": 1.5e-6}
    asked["settle"] = 0.0
    found = tuning.sweep(AXIS, LAP, against={"pd": dd.paper_axis()}, resume=tmp_path, **asked)
    again = tuning.sweep(AXIS, LAP, against={"pd": dd.paper_axis()}, resume=tmp_path, **asked)
    assert again.frame.equals(found.frame)
    frame = found.frame.to_pandas()
    assert len(frame) == 2 * 48
    for controller in ("paper", "pd"):
        peaks = frame[frame.controller == controller].peak_m
        assert found.exceedance(controller).share == pytest.approx(np.mean(peaks > 1.5e-6))
        low, high = found.exceedance(controller).interval
        assert low <= found.exceedance(controller).share <= high
    assert found.quantile("pd", 0.5) > found.quantile("paper", 0.5)
    assert "pd" in str(found)
    assert json.loads(found.save(tmp_path).read_text())["schema"] == "sweep/1"
    with pytest.raises(ParameterError, match="no controller 'cascade'"):
        found.exceedance("cascade")
    with pytest.raises(ParameterError, match="is the axis itself"):
        tuning.sweep(AXIS, LAP, against={"paper": AXIS}, **asked)


@pytest.mark.long
def test_what_is_not_ok_raises_where_that_is_asked_for(tuned):
    result = dataclasses.replace(tuned[0], status=dataclasses.replace(tuned[0].status, ok=False, message="too late"))
    with pytest.raises(ResultError, match="too late"):
        result.require_ok()
