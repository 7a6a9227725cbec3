"""Machines whose motion and load differ: each goes through its own cycle as if it were alone."""

import dataclasses
import json

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from diffdrive.axis import Axis
from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.library import PAPER_DRIVE
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.parameters import Actuator, Drive, Sampling, Sensor
from diffdrive.model.presets import paper_drive
from diffdrive.motion.motion import Limits
from diffdrive.motion.text import LOADS, MOTIONS, motion_recipe, parse_load, parse_motion
from experiments.cli.main import app
from experiments.studies.paper import scenario as paper
from tuning.sweeps.costs import costs_of, machines_at_once, part_costs
from tuning.sweeps.duty_cycles import _rounded_up, at_corners
from tuning.sweeps.engine import block_size
from tuning.sweeps.machines import lane
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.possible import machine_cycles, require_possible

PAPER = paper_drive()
DRIVE = Drive(PAPER.plant, PAPER.friction, PAPER.actuator, Sensor(1e-7))
RATE = 1e4
SINE = "sine:amplitude=1mm,frequency=20Hz,duration=0.05s"
REMOVAL = "material_removal:workpiece=400kg,removal_rate=200kg/s,cuts=0.01~0.03"
VARY = ("plant.mass=lognormal:3%", "motion.amplitude=uniform:0.2..2 mm", "motion.duration=uniform:-50%..+50%",
        "load.workpiece=uniform:100..800 kg")  # fmt: skip


def plan(vary=VARY, samples=96, texts=(SINE,), load=REMOVAL, limits=Limits(), name="PD+FC+LE", drive=DRIVE, **more):
    recipes = {text: motion_recipe(text) for text in texts}
    motions = {text: parse_motion(text, RATE) for text in texts}
    axis = Axis(drive, paper.controllers(drive)[name], Sampling(RATE, 1), limits)
    return SweepPlan.of(axis, {name: axis.controller}, motions, vary, samples, recipes=recipes, load=load, **more)


def rows(planned):
    return {name: np.array(column) for name, column in part_costs(planned, 0).to_pydict().items()}


@pytest.mark.long
def test_each_machine_has_the_errors_of_its_own_motion_under_its_own_load():
    planned = plan(settle=0.01, name="PD")
    told = rows(planned)
    drives, _, _, _ = planned.machines(planned.numbers(0))
    lengths = set()
    for k in (0, 31, 64, 95):
        amplitude, duration, workpiece = (
            float(told[name][k]) for name in ("motion.amplitude", "motion.duration", "load.workpiece")
        )
        there = parse_motion(f"sine:amplitude={amplitude!r},frequency=20,duration={duration!r}", RATE)
        load = parse_load(REMOVAL.replace("400kg", f"{workpiece!r}"), there.time)
        run = simulate_loop(lane(drives, k), planned.axis.controller, there, load, sampling=planned.axis.sampling)
        assert told["rms_m"][k] == pytest.approx(run.rms_error(0.01), rel=1e-3)  # a quantum may fall to the other side
        assert told["peak_m"][k] == pytest.approx(run.peak_error(0.01), rel=1e-2)
        assert not told["diverged"][k]
        lengths.add(len(there.time))
    assert len(lengths) == 4
    assert 1e-3 / np.median(told["motion.amplitude"]) == pytest.approx(1e-3 / 1.1e-3, rel=0.05)


@pytest.mark.long
def test_a_machine_has_the_same_bits_whichever_cycles_are_beside_it():
    """Shorter ones, longer ones, another length to which all are filled up."""
    planned = plan()
    together = costs_of(planned, planned.numbers(0), SINE, planned.controllers)["PD+FC+LE"].costs
    for k in (5, 70):
        alone = costs_of(planned, np.array([k]), SINE, planned.controllers)["PD+FC+LE"].costs
        for one, same in zip(together, alone, strict=True):
            assert one[k] == same[0]


def test_a_load_alone_may_vary_and_a_setting_of_several_motions_is_relative_to_each():
    told = rows(plan(("load.removal_rate=uniform:+0%..+10%",), 8))
    assert np.ptp(told["load.removal_rate"]) > 10.0
    assert len(set(told["rms_m"])) == 8
    two = ("sine:amplitude=1mm,frequency=20Hz,duration=0.05s", "sine:amplitude=3mm,frequency=10Hz,duration=0.05s")
    told = rows(plan(("motion.amplitude=uniform:-10%..+10%",), 8, two))
    small, large = (told["motion.amplitude"][told["motion"] == one] for one in two)
    assert large == pytest.approx(3.0 * small, rel=1e-12)
    assert len(set(small)) == 8


@pytest.mark.long
def test_a_loop_that_runs_away_after_the_end_of_its_cycle_has_not_diverged():
    """Short cycles beside long ones, at whose end the loop is beyond what a number can be."""
    late = dataclasses.replace(DRIVE, actuator=Actuator(delay_samples=60))
    vary = ("motion.duration=loguniform:0.03..1.5 s",)
    planned = plan(vary, 64, load="0", name="PD", drive=late)
    costs, diverged_at = costs_of(planned, planned.numbers(0), SINE, ["PD"])["PD"]
    duration = rows(planned)["motion.duration"]
    stayed = np.isnan(diverged_at)
    assert 3 < np.sum(stayed) < 40
    assert duration[stayed].max() < duration[~stayed].min()
    assert np.all(diverged_at[~stayed] <= duration[~stayed])
    assert np.all(np.isfinite(costs.rms[stayed]) & np.isfinite(costs.command_noise[stayed]))
    for k in np.flatnonzero(stayed)[:3]:
        alone, at = costs_of(planned, np.array([k]), SINE, ["PD"])["PD"]
        assert np.isnan(at).all()
        assert (alone.rms[0], alone.peak[0], alone.command_noise[0]) == (
            costs.rms[k], costs.peak[k], costs.command_noise[k],
        )  # fmt: skip


@pytest.mark.long
def test_how_many_are_held_at_once_changes_nothing(monkeypatch):
    planned = plan()
    assert len(planned.numbers(0)) > 64
    found = []
    for held in (64, 128):  # in two portions, the second of them not full, and in one
        monkeypatch.setattr("tuning.sweeps.costs.machines_at_once", lambda *_, held=held: held)
        found.append(costs_of(planned, planned.numbers(0), SINE, planned.controllers)["PD+FC+LE"].costs)
    assert all(np.array_equal(one, other) for one, other in zip(*found, strict=True))


def test_memory_bounds_how_many_are_held_at_once(monkeypatch):
    planned = plan()
    assert machines_at_once(planned, SINE) == block_size(own_cycles=True) * len(jax.devices())
    monkeypatch.setattr("tuning.sweeps.costs.MAX_BYTES", 1.0)
    assert machines_at_once(planned, SINE) == block_size(own_cycles=True)


def test_what_no_machine_runs_refuses_none():
    """A nominal load that lifts the table, a nominal motion that is too fast and too short."""
    require_possible(plan(("load.before=uniform:1..2 kN",), 8, load="step:at=0.01s,to=0,before=-16kN"), [0])
    slow = ("motion.amplitude=uniform:0.1..0.2 mm", "motion.duration=uniform:0.08..0.1 s")
    require_possible(plan(slow, 8, load="0", limits=Limits(speed=0.05), settle=0.06), [0])
    with pytest.raises(DiffdriveError, match=r"machine \d+ cannot be: .*lifts the table"):
        require_possible(plan(("load.before=uniform:-17..-16 kN",), 8, load="step:at=0.01s,to=0,before=1kN"), [0])


def test_loads_are_added_when_each_acts():
    """A cut that takes away what was laid on before it."""
    later = ("load.change=fixed:-19 kN", "load.change.begin=fixed:0.03 s", "load.change.end=fixed:0.04 s")
    require_possible(plan(later, 8, load="ramp:start=0.01,end=0.02,to=20kN"), [0])
    with pytest.raises(DiffdriveError, match=r"machine 0 cannot be: a load of -\d+ N lifts the table"):
        require_possible(plan(later, 8, load="ramp:start=0.045,end=0.05,to=20kN"), [0])
    with pytest.raises(ParameterError, match=r"load.change does not vary: give it, too"):
        plan(("load.change.end=fixed:0.04 s",), 8, load="step:at=0.01s,to=10kN")


def test_every_setting_of_the_load_over_time_has_its_own_name():
    """Also beside a load that changes: no name is a force here and a time there."""
    vary = ("load.to=uniform:5..10 kN", "load.at=uniform:0.01..0.03 s", "load.change=fixed:1 kN",
            "load.change.end=fixed:0.02 s")  # fmt: skip
    planned, numbers = plan(vary, 8, load="step:at=0.01s,to=9kN"), np.arange(8)
    values = planned.values(numbers, SINE)
    for k, (motion, load) in enumerate(machine_cycles(planned, numbers, SINE)):
        assert load.max() == values["load.to"][k] > 5e3
        assert motion.time[np.argmax(load)] == pytest.approx(values["load.at"][k], abs=1e-4)
    _, ramps, _, _ = planned.machines(numbers)
    assert np.all(np.asarray(ramps.change) == 1e3)
    assert np.all(np.asarray(ramps.end) == 0.02)


@pytest.mark.parametrize(
    ("vary", "texts", "load", "says"),
    [
        ("motion.stroke=uniform:1..2 mm", (SINE,), "0", "no setting that every motion has.*motion.amplitude"),
        ("motion.amplitude=uniform:1..2 N", (SINE,), "0", "motion.amplitude"),
        ("motion.frequency=uniform:1..2 Hz", (SINE, "triangular:speed=0.1,stroke=2mm,rounding=5ms,duration=0.05"), "0",
         "those that may vary are motion.duration"),
        ("motion.speeds=uniform:1..2 m/s", ("staircase:speeds=0.01;0.02,travel=1mm,acceleration=1",), "0",
         "no setting that every motion has as one number"),
        ("motion.repeats=uniform:1..2", ("trapezoidal:distance=1mm,speed=0.1,acceleration=10",), "0", "no setting"),
        ("load.workpiece=uniform:1..2 kg", (SINE,), "3 kN", "no setting that the load over time has"),
        ("load.cuts=uniform:1..2 s", (SINE,), REMOVAL, "those that may vary are .*load.workpiece"),
    ],
)  # fmt: skip
def test_what_is_no_setting_of_motion_or_load_is_said(vary, texts, load, says):
    with pytest.raises(DiffdriveError, match=says):
        plan((vary,), 8, texts, load)


def test_what_the_axis_cannot_do_is_found_before_anything_runs():
    """Between speed and stroke: neither end of either alone is too much."""
    triangle = "triangular:speed=0.1m/s,stroke=4mm,rounding=30ms,duration=0.1s"
    vary = ("motion.speed=uniform:0.05..0.2 m/s", "motion.stroke=uniform:2..8 mm")
    with pytest.raises(ParameterError, match=r"machine \d+ cannot be: .*does not fit between reversals"):
        require_possible(plan(vary, 64, (triangle,), "0"), [0])
    require_possible(plan(vary, 64, (triangle.replace("30ms", "8ms"),), "0"), [0])
    with pytest.raises(ParameterError, match=r"machine \d+ cannot be: .*speed leaves 0.15 m/s"):
        require_possible(plan(vary, 64, (triangle.replace("30ms", "8ms"),), "0", Limits(speed=0.15)), [0])
    with pytest.raises(ParameterError, match=r"machine \d+ cannot be: .*is used up"):
        require_possible(plan(("load.workpiece=uniform:1..50 kg",), 64), [0])


def test_the_machines_at_the_corners_are_those_nearest_to_them():
    shares = np.array([[0.5, 0.5], [0.1, 0.2], [0.9, 0.8], [0.9, 0.1], [0.2, 0.9], [0.6, 0.4]])
    assert at_corners(shares) == [1, 2, 3, 4]
    many = np.random.default_rng(0).random((50, 9))
    assert set(at_corners(many)) == {*np.argmax(many, axis=0), *np.argmin(many, axis=0)}


@given(st.integers(1, 10**9))
def test_lengths_are_few_and_hardly_longer(count):
    longer = _rounded_up(count)
    assert count <= longer <= count * 9 / 8
    assert len(bin(longer).rstrip("0").removeprefix("0b")) <= 4
    assert _rounded_up(longer) == longer


def test_the_settings_that_may_vary_are_numbers_of_every_kind_of_motion_and_load():
    texts = {
        "trapezoidal": (
            "distance=1mm,speed=0.1,acceleration=10",
            {"distance", "speed", "acceleration", "dwell", "start"},
        ),
        "staircase": ("speeds=0.01,travel=1mm,acceleration=1", {"travel", "acceleration", "dwell", "start"}),
    }
    for kind, (text, names) in texts.items():
        assert set(motion_recipe(f"{kind}:{text}").numbers()) == names
    assert {"triangular", "sine"} <= set(MOTIONS)
    assert "material_removal" in LOADS


@pytest.mark.long
def test_a_sweep_over_motions_is_told_drawn_and_run_again(tmp_path):
    out = tmp_path / "swept"
    arguments = ("sweep", PAPER_DRIVE, "--motion", SINE, "--motion", SINE.replace("1mm", "3mm"), "--samples", 256,
                 "--settle", 0.01, "--record", "error", "--out", out)  # fmt: skip
    arguments += ("--vary", "motion.amplitude=uniform:-80%..+80%", "--vary", "motion.duration=uniform:-40%..+40%")
    result = CliRunner().invoke(app, [str(one) for one in arguments])
    if result.exit_code:
        raise AssertionError(result.output) from result.exception
    written = json.loads((out / "result.json").read_text())
    assert written["motions"] == {"sine": SINE, "sine #2": SINE.replace("1mm", "3mm")}
    assert written["results"][0]["sensitivity"][0]["name"] == "motion.amplitude"
    again = ("replay", out, "--machine", 9, "--motion", "sine #2", "--out", tmp_path / "again")
    result = CliRunner().invoke(app, [str(one) for one in again])
    assert result.exit_code == 0, result.output
    written = json.loads((tmp_path / "again" / "result.json").read_text())
    assert written["as_in_the_sweep"] == {"to_the_last_bit": True}
    values = {row[0]: row[2] for row in written["tables"]["machine"]["rows"]}
    assert 0.6e-3 < values["motion.amplitude"] < 5.4e-3
