"""The axes of the withheld-effect check: faults are as large for each as for the paper's."""

import dataclasses
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from diffdrive.axis_file.drive_file import read_axis, write_axis
from diffdrive.controllers import PD, Cascade, PDGains, Tracking, UnknownController
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.friction import coulomb
from diffdrive.model.parameters import Sampling, Sensor
from diffdrive.motion.builders import from_array
from experiments.cli import main as cli
from experiments.studies.control import Control
from experiments.studies.withheld import generate
from experiments.studies.withheld.axes import AXES
from experiments.studies.withheld.draw import draw, log_faults
from experiments.studies.withheld.equations import FaultParameters, MachineStructure
from experiments.studies.withheld.faults import KNOWN
from experiments.studies.withheld.machine import MachineInputs, run
from experiments.studies.withheld.outsiders import OUTSIDE, PLACED

OTHERS = [name for name in AXES if name != "paper"]


def drawn(*effects, axis="paper", seed=3):
    return draw(np.random.default_rng([seed, 1, 0]), effects, AXES[axis])


def test_the_papers_axis_is_taken_where_none_is_named():
    one, same = draw(np.random.default_rng([3, 1, 0]), ("cogging",)), drawn("cogging")
    assert (one.nominal, one.true, one.faults, one.rate) == (same.nominal, same.true, same.faults, same.rate)


@pytest.mark.parametrize("axis", OTHERS)
@pytest.mark.parametrize("name", [*KNOWN, *OUTSIDE])
def test_a_fault_is_drawn_for_every_axis(axis, name):
    case, paper = drawn(name, axis=axis), drawn(name)
    assert case.faults[0].size == paper.faults[0].size
    assert case.faults[0].structure == paper.faults[0].structure
    for log in range(2):
        faults, _ = log_faults(case, log, 200.0)
        assert np.all(np.isfinite(faults))
        assert faults != FaultParameters() or case.faults[0].drive_factors or case.faults[0].random_scales
    if name in PLACED:  # somewhere along the way
        ways = [(one.reference.min(), one.reference.max()) for one in case.inputs]
        assert any(low < case.faults[0].parameters[PLACED[name]] < high for low, high in ways)


@pytest.mark.parametrize("axis", OTHERS)
def test_a_fault_is_as_large_a_share_of_what_it_spoils(axis):
    """Forces of the friction, waves of the travel, loads of what presses the guides, resonances in hertz."""

    def friction(case):
        return float(coulomb(case.nominal.friction, 1.0, 0.0))

    def share(case, name):
        fault, drive = case.faults[0].parameters, case.nominal
        travel = float(np.ptp(case.inputs[0].reference))
        return {
            "constant_force": lambda: fault["constant"] / friction(case),
            "position_friction": lambda: fault.get("slope", 0.0) * travel + fault.get("wave_period", 0.0) / travel,
            "applied_load": lambda: (
                fault["extra_load"] * float(drive.friction.load_coefficient.positive) / friction(case)
            ),
            "compliance": lambda: fault["stiffness"] / float(drive.plant.mass),
        }[name]()

    for name in ("constant_force", "position_friction", "applied_load", "compliance"):
        ratio = share(drawn(name, axis=axis), name) / share(drawn(name), name)
        assert 0.6 < ratio < 1.7, name


@pytest.mark.parametrize("axis", AXES)
def test_a_sound_machine_of_any_axis_is_the_simulators(axis):
    """Two programs and two integrators: they agree to a hundredth of the distance before sliding."""
    study_axis, rate = AXES[axis], 2000.0
    time = np.arange(600) / rate
    reference = study_axis.length_ratio * 1e-3 * (1.0 - np.cos(2.0 * np.pi * 5.0 * time))
    bandwidth, mass = float(np.mean(study_axis.bandwidth)), float(study_axis.drive.plant.mass)
    gain = mass * bandwidth
    if study_axis.cascaded:
        control = Control(1.0, bandwidth / 5.0, gain, gain * bandwidth / 5.0, 0.9)
        ours = Cascade(bandwidth / 5.0, gain, gain * bandwidth / 5.0, 0.9, velocity_samples=2)
    else:
        control = Control(0.0, gain * bandwidth, 0.6 * gain)
        ours = PD(Tracking(PDGains(gain * bandwidth, 0.6 * gain)))
    still = np.zeros_like(time)
    inputs = MachineInputs(reference, still, still, still, still, still)
    position, _, motor = run(
        study_axis.drive, FaultParameters(), MachineStructure(), control, 1e-12, inputs, rate,
        2 if study_axis.cascaded else 1,
    )  # fmt: skip
    unquantised = dataclasses.replace(study_axis.drive, sensor=Sensor(None, 0.0))
    simulated = simulate_loop(unquantised, ours, from_array(time, reference), sampling=Sampling(rate, 40)).position
    bristle = float(coulomb(study_axis.drive.friction, 1.0, 0.0)) / float(
        study_axis.drive.friction.bristle_stiffness.positive
    )
    assert np.max(np.abs(position - simulated)) < 0.01 * bristle
    assert np.max(np.abs(motor - position)) < 2e-12  # a screw that does not wind up


def test_a_screw_winds_up_by_the_force_that_acts_and_an_elastic_one_by_itself():
    axis, rate, wind_up = AXES["gantry"], 1000.0, 5e-9
    time = np.arange(300) / rate
    still = np.zeros_like(time)
    reference = 1e-3 * (1.0 - np.cos(2.0 * np.pi * 5.0 * time))
    inputs = MachineInputs(reference, still, still, still, still, still)
    control, drive = Control(1.0, 20.0, 6e4, 1e6, 1.0), axis.drive
    rigid = run(drive, FaultParameters(), MachineStructure(), control, 1e-12, inputs, rate, 1, wind_up)
    np.testing.assert_allclose((rigid.motor - rigid.position)[1:], wind_up * rigid.command[:-1], atol=2e-12)
    faults = FaultParameters(stiffness=2e8, screw_damping=0.5, motor_share=0.4, table_friction=1.0)
    elastic = run(drive, faults, MachineStructure(elastic=True), control, 1e-12, inputs, rate)
    wound = elastic.motor - elastic.position
    assert np.ptp(wound) == pytest.approx(np.ptp(rigid.motor - rigid.position), rel=0.5)


@pytest.mark.parametrize("name", ["gantry", "cnc", "cnc-trace"])
def test_the_drive_file_of_a_case_holds_its_loop_and_its_trace(name, tmp_path):
    case = drawn(axis=name)
    axis = generate._nominal_axis(case)
    path = tmp_path / "drive.toml"
    write_axis(path, axis)
    read = read_axis(path)
    assert read.log_rate == pytest.approx(case.rate / case.samples_a_row)
    assert read.controller == axis.controller
    assert isinstance(read.controller, UnknownController) == (name == "cnc-trace")
    assert (read.drive.motor_encoder is not None) == (name == "gantry")
    assert (case.inputs[0].motor_noise is not None) == (name == "gantry")
    assert case.samples_a_row > 1 or name != "cnc-trace"


def test_a_scale_beside_the_motor_has_waves_of_its_own_in_the_place_of_the_screws_error():
    gantry = AXES["gantry"]
    assert generate.seen_on(("lead_error",), gantry) == ("interpolation_error",)
    assert generate.seen_on(("lead_error", "interpolation_error"), gantry) == ("cogging", "interpolation_error")
    assert generate.seen_on(("cogging", "lead_error"), gantry) == ("cogging", "interpolation_error")
    assert generate.seen_on(("lead_error",), AXES["cnc"]) == ("lead_error",)


def test_a_linear_motor_has_no_fault_of_a_screw():
    linear, screws = AXES["linear"], {"lead_error", "backlash", "compliance", "swallowed_screw"}
    assert generate.seen_on(("backlash",), linear) == ("frame_vibration",)
    assert generate.seen_on(("frame_vibration", "compliance"), linear) == ("frame_vibration", "position_friction")
    for effects in generate.draw_effects(3, 200):
        instead = generate.seen_on(effects, linear)
        assert not screws & set(instead)
        assert len(set(instead)) == len(effects)


ALIKE = {  # shares, times, frequencies and phases, which are what they are on any axis
    "load_start", "load_end", "wave", "wave_phase", "middle", "drift_viscous", "drift_coulomb", "drift_time", "growth",
    "onset", "rested", "cogging_phase", "second", "sixth", "process_frequency", "process_phase", "process_start",
    "process_end", "base_ratio", "base_frequency", "base_damping", "screw_damping", "motor_share", "table_friction",
    "gain", "limit", "lag", "delay", "lead", "lead_phase", "linear", "interpolation_phase", "chip_start", "droop",
    "fading", "fading_time", "bumper_place", "spin_start", "spin_rise", "spin_fastest", "film_time", "commutation",
    "commutation_phase",
}  # fmt: skip


def test_every_dimension_of_a_fault_is_scaled_to_its_axis():
    assert set(FaultParameters._fields) - AXES["gantry"].sizes().keys() == ALIKE


def test_a_control_lags_by_what_it_does_not_feed_forward():
    assert Control(0.0, 1e6, 1e4).following_error(0.2) == 0.0
    assert Control(1.0, 40.0, 1e5, 1e6, 0.9).following_error(-0.2) == pytest.approx(0.1 * 0.2 / 40.0)


def test_machines_of_several_axes_come_in_turn_and_are_no_others(tmp_path, monkeypatch):
    drawn_axes = []

    def followable(seed, number, effects, axis):
        drawn_axes.append(axis)
        raise KeyboardInterrupt if len(drawn_axes) > 3 else StopIteration

    monkeypatch.setattr(generate, "_draw_followable", followable)
    drive_axes = (AXES["gantry"], AXES["linear"])
    parts = tmp_path / "parts"
    for number in range(3):
        with pytest.raises(RuntimeError):  # what a generator makes of it
            list(generate.generate(tmp_path / "cases", parts, 0, 4, drive_axes))
        parts.mkdir(exist_ok=True)
        drawn_there = {
            "drawn": {"seed": 0, "of": 4, "axis": repr(drive_axes[number % 2]), "by": generate.source_digest()}
        }
        (parts / f"{number + 1:03d}.json").write_text(json.dumps(drawn_there))
        case = tmp_path / "cases" / f"{number + 1:03d}"
        case.mkdir(parents=True)
        (case / "drive.toml").write_text("")
    assert drawn_axes == [drive_axes[0], drive_axes[1], drive_axes[0]]
    with pytest.raises(generate.ParameterError, match="axis"):
        list(generate.generate(tmp_path / "cases", parts, 0, 4, drive_axes[::-1]))


def test_an_axis_that_is_unknown_is_refused():
    result = CliRunner().invoke(cli.app, ["withheld", "--out", "nowhere", "--axis", "hexapod"])
    assert "hexapod" in str(result.exception)
    assert "gantry" in str(result.exception)
