"""The machines of the withheld-effect check: what is drawn, and what the key says of it."""

import dataclasses
import json
import math
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from diffdrive.effects.catalogue import EFFECTS
from experiments.studies.withheld import generate
from experiments.studies.withheld.axes import AXES
from experiments.studies.withheld.draw import draw, log_faults, without_fault
from experiments.studies.withheld.equations import FaultParameters
from experiments.studies.withheld.faults import KNOWN, PITFALLS
from experiments.studies.withheld.outsiders import OUTSIDE, PLACED, UNSEEN
from experiments.studies.withheld.truth import true_parameters

ALL = [*KNOWN, *OUTSIDE, *PITFALLS]


def drawn(*effects, seed=3):
    return draw(np.random.default_rng([seed, 1, 0]), effects)


@pytest.mark.parametrize("name", ALL)
def test_every_fault_is_drawn_in_numbers_that_hold_and_alike_by_its_seed(name):
    case, same = drawn(name), drawn(name)
    assert case.rate in AXES["paper"].rates
    for log in range(2):
        faults, structure = log_faults(case, log, 200.0)
        assert (faults, structure) == log_faults(same, log, 200.0)
        assert np.all(np.isfinite(faults))
        assert faults != FaultParameters() or case.faults[0].drive_factors or case.faults[0].random_scales
        inputs = case.inputs[log]
        signals = jax.tree.leaves(inputs)
        assert len({len(signal) for signal in signals}) == 1
        assert np.all(np.isfinite(signals))
        assert np.all(inputs.load >= 0.0)
        np.testing.assert_array_equal(signals, jax.tree.leaves(same.inputs[log]))
        assert len(inputs.reference) / case.rate > 8.0
    assert case.true == same.true
    assert case.true != drawn(name, seed=4).true
    known = {field.name for field in dataclasses.fields(EFFECTS[case.faults[0].effect])} if name not in OUTSIDE else ()
    assert true_parameters(case, case.faults[0], 200.0).keys() <= {*known, "amplitude"}
    assert bool(true_parameters(case, case.faults[0], 200.0)) == (
        name not in OUTSIDE and name != "presliding_hysteresis"
    )
    json.dumps(generate.key_of(case, 200.0))


def test_machines_differ_in_what_the_engineer_knows():
    cases = [drawn("cogging", seed=seed) for seed in range(30)]
    assert {case.rate for case in cases} == set(AXES["paper"].rates)
    assert len({float(case.nominal.friction.initial_load) for case in cases}) == 30
    loaded = [bool(inputs.load.any()) for case in cases for inputs in case.inputs]
    assert 0 < sum(loaded) < len(loaded)


def single_effect(effect):
    """A machine with the effect, its fault, and the drive without, all else alike."""
    case = drawn(effect)
    return case, case.faults[0], without_fault(case, 0).true


def test_a_machine_without_one_of_its_faults_has_the_other():
    case = drawn("friction_asymmetry", "force_gain")
    friction, gain = without_fault(case, 1), without_fault(case, 0)
    assert [one.effect for one in friction.faults] == ["friction_asymmetry"]
    assert friction.true == case.true
    assert [one.effect for one in gain.faults] == ["force_gain"]
    assert gain.true != case.true
    assert log_faults(gain, 0)[0].gain == log_faults(case, 0)[0].gain


@pytest.mark.parametrize(("share", "visible"), [(0.5, False), (2.0, True)])
@pytest.mark.parametrize("log", [0, 1])
def test_each_of_two_effects_is_seen_in_a_log(monkeypatch, share, visible, log):
    """A limit that is hardly reached is none: a machine with it and another effect is drawn again."""
    case = drawn("force_limit", "force_gain")
    noise = np.hypot(case.noise, case.resolution / math.sqrt(12.0))
    wave = np.tile([1.0, -1.0], 50)
    limit = share * noise * wave

    def run(machine, which, peak=None):
        effects = {fault.effect for fault in machine.faults}
        position = 50.0 * noise * wave * ("force_gain" in effects) + limit * ("force_limit" in effects) * (which == log)
        return SimpleNamespace(position=position)

    monkeypatch.setattr(generate, "_simulate_log", run)
    assert generate._is_visible(case, [run(case, 0), run(case, 1)], 200.0) == visible
    alone = drawn("force_limit")
    assert generate._is_visible(alone, [run(alone, 0), run(alone, 1)], 200.0)


def test_truths_are_those_of_the_catalogue_on_the_true_drive():
    case, fault, nominal = single_effect("payload_mass")
    assert true_parameters(case, fault)["mass"] == pytest.approx(float(case.true.plant.mass - nominal.plant.mass))
    case, fault, nominal = single_effect("friction_asymmetry")
    altered = EFFECTS["friction_asymmetry"](**true_parameters(case, fault)).alter(nominal).friction.coulomb_screw
    there = case.true.friction.coulomb_screw
    assert altered.positive - altered.negative == pytest.approx(there.positive - there.negative)


@pytest.mark.parametrize("which", ["stribeck_velocity", "stribeck_exponent", "breakaway_gap", "viscous"])
def test_the_shape_of_friction_is_told_as_the_catalogue_bends_it(which):
    seed = next(seed for seed in range(50) if which in drawn("friction_shape", seed=seed).faults[0].drive_factors)
    case = drawn("friction_shape", seed=seed)
    fault = case.faults[0]
    truth, factor = true_parameters(case, fault), fault.drive_factors[which]
    if which == "stribeck_exponent":
        assert case.true.friction.stribeck_exponent == pytest.approx(factor)
        assert without_fault(case, 0).true.friction.stribeck_exponent == pytest.approx(1.0)
        assert case.nominal.friction.stribeck_exponent is None
    if which != "viscous":
        assert truth == {which: pytest.approx(math.log(factor))}
        return
    friction, plant = case.true.friction, case.true.plant
    total = friction.viscous.positive + friction.viscous.negative + plant.damping.positive + plant.damping.negative
    assert truth == {"viscous": pytest.approx(0.5 * float(total) * (1 - 1 / factor))}


def test_a_screws_frequency_is_that_of_the_true_masses_and_windows_are_counted_from_halfway():
    case = drawn("compliance")
    truth = true_parameters(case, case.faults[0])
    s, mass = truth["motor_share"], float(case.true.plant.mass)
    angular = 2 * np.pi * truth["frequency"]
    assert angular**2 * s * (1 - s) * mass == pytest.approx(case.faults[0].parameters["stiffness"])
    case = drawn("process_force")
    truth, faults = true_parameters(case, case.faults[0]), case.faults[0].parameters
    np.testing.assert_allclose(np.subtract(truth["start"], faults["process_start"]), 0.005)
    np.testing.assert_allclose(np.subtract(truth["end"], faults["process_end"]), -0.005)


def test_a_limit_is_one_for_the_machine():
    case = drawn("force_limit")
    limit = true_parameters(case, case.faults[0], 200.0)["limit"]
    assert limit == log_faults(case, 0, 200.0)[0].limit == log_faults(case, 1, 200.0)[0].limit
    assert 150.0 < limit < 200.0
    assert true_parameters(case, case.faults[0]) == {}


@pytest.mark.parametrize("name", PLACED)
def test_what_is_met_at_a_place_is_met(name):
    for seed in range(20):
        case = drawn(name, seed=seed)
        place = case.faults[0].parameters[PLACED[name]]
        ways = [(log.reference.min(), log.reference.max()) for log in case.inputs]
        assert any(low + 0.1 * (high - low) < place < high - 0.1 * (high - low) for low, high in ways)


def test_no_two_faults_are_one():
    """A spring beside a tilt is a spring that is neutral elsewhere; a loose screw is an elastic one."""
    pairs = {frozenset(kind) for seed in range(40) for kind in generate.draw_effects(seed, 120) if len(kind) == 2}
    assert {"constant_force", "cogging"} in pairs
    assert not pairs & {frozenset(("constant_force", "position_spring")), frozenset(("compliance", "backlash"))}


def test_kinds_mix_every_effect_with_none_two_outsiders_and_pitfalls():
    kinds = generate.draw_effects(0, 120)
    assert len(kinds) == 120
    assert sum(kind == () for kind in kinds) == 19
    assert sum(len(kind) == 2 for kind in kinds) == 19
    assert sum(kind[0] in OUTSIDE for kind in kinds if kind) == 19
    assert all(sum(kind == (name,) for kind in kinds) in (1, 2) for name in UNSEEN)  # each as often as the others
    assert sum(kind[0] in PITFALLS for kind in kinds if kind) == 6
    assert set(KNOWN) <= {kind[0] for kind in kinds if len(kind) == 1}
    case = drawn("swallowed_frame")
    key = generate.key_of(case)
    assert key["pitfall"]
    assert key["effects"][0]["name"] == "frame_vibration"
    assert not generate.key_of(drawn("frame_vibration"))["pitfall"]
