"""A notch is proposed where the resonance is; tuned, it buys more than what it costs."""

import dataclasses

import numpy as np
import pytest

import diffdrive as dd
import tuning
from diffdrive.controllers import Cascade, Feedforward
from diffdrive.errors import ParameterError
from diffdrive.frequency.resonances import find_resonances
from diffdrive.model.quantity import Directional

FREQUENCY = np.geomspace(0.5, 5_000.0, 4_000)


def gain_of(resonance, damping, crossover=20.0):
    """A velocity loop, -1 in slope, and a table behind an elastic screw."""
    s = 1j * FREQUENCY
    return crossover / s * resonance**2 / (s**2 + 2.0 * damping * resonance * s + resonance**2)


@pytest.mark.parametrize("damping", [0.01, 0.05])
@pytest.mark.parametrize("resonance", [80.0, 900.0])
def test_a_resonance_is_found_with_its_damping(resonance, damping):
    [found] = find_resonances(FREQUENCY, gain_of(resonance, damping))
    assert found.frequency == pytest.approx(resonance, rel=1e-2)  # the slope of the loop moves it
    assert found.damping == pytest.approx(damping, rel=0.1)
    assert found.gain == pytest.approx(20.0 / resonance / (2.0 * damping), rel=0.02)


def test_a_loop_without_a_resonance_has_none():
    assert find_resonances(FREQUENCY, gain_of(500.0, 0.8)) == []
    assert find_resonances(FREQUENCY, 20.0 / (1j * FREQUENCY)) == []


def test_of_two_resonances_the_higher_peak_comes_first():
    both = gain_of(150.0, 0.05) + 0.2 * gain_of(700.0, 0.002)
    assert [one.frequency for one in find_resonances(FREQUENCY, both)] == pytest.approx([150.0, 700.0], rel=0.01)


def two_masses(resonance=120.0):
    """The paper's drive behind an elastic screw, under a cascade that is slow enough for it.

    Its friction hardly falls with the speed: behind such a screw the paper's would let the table stick and slip at
    1 mm/s, whatever the gains, and no margin could be kept.
    """
    axis = dd.paper_axis(controller="cascade")
    drive = dataclasses.replace(
        axis.drive,
        actuator=dataclasses.replace(axis.drive.actuator, delay_samples=1),
        friction=dataclasses.replace(axis.drive.friction, breakaway_gap=Directional(2.0, 2.0)),
    )
    axis = axis.with_drive(drive).with_effects(
        dd.effects.Compliance(frequency=resonance, damping=0.02, motor_share=0.5, table_friction=0.9)
    )
    controller = Cascade(
        kp=15.0, kv=2_000.0, reset_time=0.05, velocity_feedforward=1.0, feedforward=Feedforward.of(axis.drive.plant)
    )
    return axis.with_controller(controller)


@pytest.mark.long
def test_a_notch_is_proposed_on_the_resonance_and_lowers_it():
    axis = two_masses()
    proposed = tuning.propose_notch(axis)
    (notch,) = proposed.controller.filters
    assert notch.frequency == pytest.approx(120.0, rel=0.03)
    assert 10.0 < notch.depth < 40.0
    at = np.array([notch.frequency])
    before, after = (abs(dd.linearise(one, velocity=0.010).response(at)[0]) for one in (axis, proposed))
    assert 20.0 * np.log10(before / after) == pytest.approx(notch.depth, abs=0.1)
    assert {"filter1_frequency", "filter1_width", "filter1_depth"} <= proposed.gains.keys()


def test_where_there_is_nothing_to_suppress_none_is_proposed():
    with pytest.raises(ParameterError, match=r"no resonance: above the crossover .* as in \[effects\.compliance\]"):
        tuning.propose_notch(dd.paper_axis(controller="cascade"))


def test_a_controller_without_filters_is_refused():
    with pytest.raises(ParameterError, match="a PD has no filters of its command; a cascade has"):
        dd.paper_axis(controller="pd").controller.with_filter(dd.controllers.Notch(100.0, 10.0))


@pytest.mark.slow
def test_at_equal_margins_a_notch_on_a_two_mass_axis_halves_the_tracking_error():
    required = tuning.Requirements(gain_margin=6.0, phase_margin=30.0, command_noise=None)
    axis = two_masses()
    plain, notched = (
        tuning.tune(one, speed=0.010, requirements=required, machines=1, starts=2)
        for one in (axis, tuning.propose_notch(axis))
    )
    for best in (plain, notched):
        assert best.accepted, best.status
        assert best.margins.gain_margin > 5.9
        assert best.margins.phase_margin > 29.0
    assert notched.held_out.rms_after < 0.5 * plain.held_out.rms_after
    assert notched.tuned_on.rms_after < 0.5 * plain.tuned_on.rms_after
