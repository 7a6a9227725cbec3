"""The benchmark: jobs by turns, and what it refuses."""

import json
import shutil
from contextlib import nullcontext

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.model.parameters import Sampling
from diffdrive.model.presets import paper_drive
from experiments.benchmarks import clock, hand_written, roof, suite
from experiments.benchmarks.arithmetic import operations, step_operations
from experiments.benchmarks.figures import bench_figure
from experiments.cli.main import app
from experiments.reports.report import Report
from experiments.studies.paper import scenario as paper


def test_jobs_take_turns_and_the_first_run_does_not_count(monkeypatch):
    now, done = [0.0], []

    def job(name, takes):
        def run():
            done.append(name)
            now[0] += takes * (100.0 if done.count(name) == 1 else 1.0)  # the first run compiles

        return run

    monkeypatch.setattr(clock.time, "perf_counter", lambda: now[0])
    timings = clock.time_interleaved({"a": job("a", 1.0), "b": job("b", 2.0)}, rounds=3)
    assert {name: timing.best for name, timing in timings.items()} == {"a": 1.0, "b": 2.0}
    assert done[4:] == ["a", "b"] * 3


def test_a_short_job_is_run_several_times_in_a_turn(monkeypatch):
    now, runs = [0.0], [0]

    def run():
        runs[0] += 1
        now[0] += clock.MIN_TURN / 10

    monkeypatch.setattr(clock.time, "perf_counter", lambda: now[0])
    timings = clock.time_interleaved({"short": run}, rounds=2)
    assert runs[0] == 2 + 2 * 10
    assert timings["short"].median == pytest.approx(clock.MIN_TURN / 10)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc to compile the roof's kernels")
def test_the_roof_is_of_work_that_is_done(monkeypatch):
    monkeypatch.setattr(roof, "READ_SIZE", roof.VECTOR_SIZE * roof.CHAINS * 100)
    begun = roof.VECTOR_SIZE * sum(1.0 + k for k in range(roof.CHAINS))  # each chain begins a step above the last
    each = roof.VECTOR_SIZE * roof.CHAINS * roof.ROUNDS
    with roof.kernels() as (jobs, size):
        assert jobs["fused"]() == pytest.approx(begun + 0.75 * each)
        assert jobs["added"]() == pytest.approx(begun + each)
        assert jobs["multiplied"]() == pytest.approx(begun)
        assert jobs["divided"]() == pytest.approx(begun)  # twice is not at all
        assert jobs["read"]() == size / 8


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("real-time factor", 700.0, "yes"), ("real-time factor", 500.0, "NO"), ("real-time factor", np.nan, "NO"),
        ("warm start, s", 2.0, "yes"), ("warm start, s", np.nan, "NO"), ("warm start, s", None, "not measured"),
    ],
)  # fmt: skip
def test_a_bar_is_reached_by_numbers_alone(name, value, says):
    assert suite._verdict(name, value) == says


def test_the_result_counts_bars_and_names_those_that_are_missed():
    assert suite.in_words({}, ["accuracy"]) == ("Measured: accuracy, of which no figure has a bar to reach.", None)
    measured = {"dearest effect": 1.25, "warm start, s": 4.0, "off_nm": 3.0}
    assert suite.in_words(measured, []) == (
        "1 of 2 figures reach their bar; not warm start, s: 4, should be at most 3.0.", False
    )  # fmt: skip
    assert suite.in_words({"dearest effect": 1.25}, []) == ("1 of 1 figures reach their bar.", True)


def test_a_part_that_there_is_not_is_refused():
    result = CliRunner().invoke(app, ["bench", "--part", "speed"])
    assert isinstance(result.exception, ParameterError)
    assert "no such part; known: single" in str(result.exception)


@pytest.mark.long
def test_growth_is_told_and_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(clock, "ROUNDS", 1)
    result = CliRunner().invoke(app, ["bench", "--part", "growth", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    tables = json.loads((tmp_path / "result.json").read_text())["tables"]
    rows, by = tables["growth"]["rows"], tables["growth_with_parameters"]["rows"]
    assert [row[0] for row in rows] == [1_000, 10_000, 100_000]
    assert [row[0] for row in by] == [0, 1, 2, 4, 8]
    assert all(row[1] > 0.0 for row in rows + by)


@pytest.mark.long
def test_lanes_are_swept_in_both_precisions(tmp_path, monkeypatch):
    monkeypatch.setattr(hand_written, "SWEEP_LANES", 128)
    monkeypatch.setattr(hand_written, "OTHER_SWEEP_LANES", (64,))
    monkeypatch.setattr(hand_written, "_baselines", lambda *_: nullcontext({}))
    with Report("bench", tmp_path) as report:
        assert hand_written.swept_lanes(report) == {}  # nobody to compare with
    assert 0.0 < report.data["single precision"]["off_nm_median"] < 5.0
    rows = report.data["tables"]["sweep"]["rows"]
    assert [row[0] for row in rows] == ["ours, 128 lanes", "ours, 64 lanes", "ours in single precision, 128 lanes"]
    assert all(row[1] > 0.0 for row in rows)


def test_a_step_by_hand_that_computes_something_else_or_nothing_is_not_compared():
    hand_written._require_equal_cost({"C, one lane": lambda: (np.array([1e-8, 0.0]), None)}, 1e-8, 5)
    for wrong in (2e-8, np.nan):
        with pytest.raises(DiffdriveError, match="differs from ours"):
            hand_written._require_equal_cost(
                {"C, one lane": lambda wrong=wrong: (np.array([wrong, 0.0]), None)}, 1e-8, 5
            )


def test_every_panel_is_drawn():
    lanes = {"columns": ["lanes", "ns a lane-step"], "rows": [[1, 500.0], [64, 50.0]]}
    others = {"columns": ["what", "ns", "over PD"], "rows": [["PD", 40.0, 1.0], ["PD+FC", 60.0, 1.5]]}
    figure = bench_figure({"lanes": lanes, "controllers": others, "effects": others})
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["Lanes on one core", "Controllers", "Effects"]
    assert [len(axis.patches) for axis in figure.axes] == [0, 2, 2]
    rows = [[5, "ours", 260.0, 1.0, 400.0], [5, "C", 270.0, 1.0, 390.0]]
    (axis,) = bench_figure({"single": {"columns": ["substeps", "what", "ns a step"], "rows": rows}}).axes
    assert [bar.get_width() for bar in axis.patches] == [270.0, 260.0]
    assert bench_figure({"start": others}) is None


def test_operations_are_counted_through_loops_and_branches():
    def inner(x, _):
        return x * 2.0 + 1.0, None

    def outer(x):
        x = jax.lax.scan(inner, x, None, length=5)[0]
        return jnp.where(x > 0.0, x / 3.0, 0.0)

    jaxpr = jax.make_jaxpr(outer)(jnp.asarray(1.0)).jaxpr
    assert operations(jaxpr) == 5 * 2 + 1 + 8 + 1


def test_a_substep_is_counted_once_each_and_more_control_is_more_arithmetic():
    drive = paper_drive()
    controllers = paper.controllers(drive)
    one, two, four = (step_operations(drive, controllers["PD"], Sampling(1e4, n)) for n in (1, 2, 4))
    assert four - two == 2 * (two - one) > 0
    counts = [step_operations(drive, controllers[name], Sampling(1e4, 2)) for name in ("PD", "PD+FC", "PD+FC+LE")]
    assert counts == sorted(counts)
