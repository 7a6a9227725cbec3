"""The axes of the withheld-effect check: faults are as large for each as for the paper's."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from diffdrive.controllers import PD, PDGains, Tracking
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.friction import coulomb
from diffdrive.model.parameters import Sampling
from diffdrive.motion.builders import from_array
from experiments.cli import main as cli
from experiments.studies.withheld import generate
from experiments.studies.withheld.axes import AXES
from experiments.studies.withheld.draw import draw, log_faults
from experiments.studies.withheld.faults import KNOWN, OUTSIDE, PLACED
from experiments.studies.withheld.machine import FaultParameters, MachineInputs, MachineStructure, run

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
    bandwidth = float(np.mean(study_axis.bandwidth))
    mass = float(study_axis.drive.plant.mass)
    gains = mass * bandwidth**2, 0.6 * mass * bandwidth
    still = np.zeros_like(time)
    position, _ = run(
        study_axis.drive,
        FaultParameters(),
        MachineStructure(),
        gains,
        1e-15,
        MachineInputs(reference, still, still, still, still),
        rate,
    )
    unquantised = study_axis.drive.__class__(
        **{**vars(study_axis.drive), "sensor": study_axis.drive.sensor.__class__(None, 0.0)}
    )
    ours = simulate_loop(
        unquantised, PD(Tracking(PDGains(*gains))), from_array(time, reference), sampling=Sampling(rate, 40)
    ).position
    bristle = float(coulomb(study_axis.drive.friction, 1.0, 0.0)) / float(
        study_axis.drive.friction.bristle_stiffness.positive
    )
    assert np.max(np.abs(position - ours)) < 0.01 * bristle


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
