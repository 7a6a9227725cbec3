"""The axes of the package: each follows a motion as its equations say, with margins, also where its data sheet errs."""

import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import diffdrive as dd
from diffdrive.axis_file.drive_file import axis_tables, parse_axis
from diffdrive.library import OWN_FOLDER
from diffdrive.motion.text import parse_motion
from experiments.cli.options import DEFAULT_MOTION
from experiments.studies.emps import axis as emps
from tuning.gains.requirements import Requirements

FILES = {path.stem: path for path in sorted(OWN_FOLDER.glob("*.toml"))}
AXES = {name: dd.read_axis(path) for name, path in FILES.items()}
GENERIC = {"cnc", "gantry", "linear", "vertical"}
SPEEDS = (0.0, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 0.1, -1e-3, -1e-2)  # m/s: rest, the Stribeck curve, sliding
LEAST = Requirements()  # what `tune` keeps where nothing else is asked for

each = pytest.mark.parametrize("name", AXES)
each_generic = pytest.mark.parametrize("name", sorted(GENERIC))


def least_margins(axis, machine=None, load=0.0):
    """Gain margin (dB) and phase margin (deg), the least over the speeds; every loop must be stable."""
    found = [dd.linearise(axis, velocity=speed, load=load, machine=machine).margins() for speed in SPEEDS]
    assert all(bool(one.stable) for one in found)
    return min(float(one.gain_margin) for one in found), min(float(one.phase_margin) for one in found)


def test_the_package_has_measured_axes_and_generic_ones():
    assert set(AXES) == GENERIC | {"paper", "emps"}
    assert {axis.name for axis in AXES.values()} == set(AXES)


@each
@pytest.mark.parametrize("load", [0.0, 5_000.0])
def test_an_axis_has_the_margins_that_the_tuner_asks_for(name, load):
    gain, phase = least_margins(AXES[name], load=load)
    assert gain > LEAST.gain_margin
    assert phase > LEAST.phase_margin


@each
def test_an_axis_keeps_half_of_its_gain_margin_on_machines_two_deviations_off(name):
    """One parameter at a time, both ways: 3 dB and 20 degrees, beyond which a loop rings."""
    axis = AXES[name]
    known = axis.uncertainty
    assert known is not None
    for path, deviation in zip(known.names, known.deviations, strict=True):
        base, side = path.removesuffix(".positive").removesuffix(".negative"), path.rpartition(".")[2]
        for sign in (-2.0, 2.0):
            value = axis.value(base)
            pair = value if isinstance(value, tuple) else (value, value)
            moved = [one * math.exp(sign * deviation.value) if deviation.is_relative else one + sign * deviation.value
                     for one in pair]  # fmt: skip
            if side in ("positive", "negative"):
                moved = [moved[0], pair[1]] if side == "positive" else [pair[0], moved[1]]
            machine = axis.replace({base: tuple(moved) if isinstance(value, tuple) else moved[0]})
            gain, phase = least_margins(axis, machine)
            assert gain > 0.5 * LEAST.gain_margin, (path, sign)
            assert phase > 20.0, (path, sign)


TYPICAL = "typical, not from a data sheet"
UNSTATED = ("damping", "breakaway_gap", "stribeck_velocity", "viscous", "bristle_stiffness", "bristle_damping")


@each_generic
def test_what_no_data_sheet_states_is_named_typical_beside_its_number(name):
    text = FILES[name].read_text(encoding="utf-8")
    for key in UNSTATED:
        (comment,) = re.findall(rf"^{key} = [^#]*# (.*)$", text, re.M)
        assert TYPICAL in comment, key
    assert TYPICAL in tomllib.loads(text)["provenance"]["assumed"]
    assert [line for line in text.splitlines() if "wipers" in line and TYPICAL not in line] == []


def test_the_page_names_what_is_typical():
    page = (Path(__file__).resolve().parents[3] / "docs/reference/axes.md").read_text(encoding="utf-8")
    for part in ("preload torque of the nut", "friction coefficient", "preload of the guides", "wipers and cable"):
        (row,) = re.findall(rf"^\| {part} \|.*$", page, re.M)
        assert TYPICAL in row
    assert f"*{TYPICAL}*, and the files say so beside each number" in page


def cruise(axis, speed=0.05):
    """A stroke to and fro, and the last tenth of the second before each stroke ends its cruise."""
    motion = dd.motion.jerk_limited(
        distance=0.05, speed=speed, acceleration=1.0, jerk=50.0, rate=axis.rate, dwell=0.2
    )  # fmt: skip
    ends = {}
    for sign in (1.0, -1.0):
        at_speed = np.flatnonzero(np.isclose(motion.velocity, sign * speed, rtol=1e-9))
        ends[sign] = at_speed[-round(0.1 * axis.rate) :]
    return motion, ends


@each
@pytest.mark.filterwarnings("ignore::diffdrive.errors.LoadEstimatorWarning")
def test_an_axis_follows_at_constant_speed_as_its_controller_says(name):
    """With an integral the error is (1 - share of the speed fed forward) v / kp; EMPS's has none, and a lag of its own.

    Then the velocity loop needs kv (kp e - v) for friction and offset. The paper's has the friction compensated.
    """
    axis = AXES[name]
    motion, ends = cruise(axis)
    run = dd.simulate(axis, motion).require_ok()
    counts = 2.0 * float(axis.drive.sensor.resolution)
    for sign, samples in ends.items():
        speed, expected = sign * 0.05, 0.0
        if name == "emps":
            friction = sign * 20.3935 + 203.5034 * speed - 3.1648
            expected = speed / 160.18 + friction / (8557.4 * 160.18)
        elif name != "paper":
            assert float(axis.controller.velocity_feedforward) == 1.0
        assert np.mean(run.error[samples]) == pytest.approx(expected, abs=counts)


@each
@pytest.mark.filterwarnings("ignore::diffdrive.errors.LoadEstimatorWarning")
def test_an_axis_reaches_its_limits(name):
    """Full speed and acceleration, to and fro over the stroke: the force suffices, and friction is what it says."""
    axis = AXES[name]
    limits = axis.limits
    speed, acceleration = min(limits.speed, 0.2), min(limits.acceleration, 2.0)
    if name in GENERIC:
        speed, acceleration = limits.speed, limits.acceleration
    distance = 0.98 * limits.stroke[1] if math.isfinite(limits.stroke[1]) else 0.1
    motion = dd.motion.jerk_limited(
        distance=distance, speed=speed, acceleration=acceleration, jerk=50.0 * acceleration, rate=axis.rate, dwell=0.2
    )
    run = dd.simulate(axis, motion).require_ok()
    assert run.peak_error() < 1e-3 + speed / 160.0  # EMPS's lag; and all others have their speed fed forward
    limit = axis.drive.actuator.force_limit
    if limit is not None:
        assert np.max(np.abs(run.command)) < 0.75 * float(limit)  # half is for cutting, the reversal may peak


@each_generic
def test_gains_are_those_that_the_file_derives(name):
    """From the sum T of the loop's small lags: kp = 1 / (16 T), kv = m / (4 T), T_n = 16 T."""
    axis = AXES[name]
    lag = 2.0 / axis.rate + 1.0 / (2.0 * math.pi * float(axis.drive.actuator.current_loop_frequency))
    for notch in axis.controller.filters:
        depth = 1.0 - 10.0 ** (-notch.depth / 20.0)
        lag += depth * notch.width / (2.0 * math.pi * notch.frequency**2)
    derived = {"kp": 1.0 / (16.0 * lag), "kv": float(axis.drive.plant.mass) / (4.0 * lag), "reset_time": 16.0 * lag}
    assert {key: axis.gains[key] for key in derived} == pytest.approx(derived, rel=5e-3)


@pytest.mark.parametrize(
    ("name", "lead", "inertia"), [("cnc", 16e-3, 9e-4), ("gantry", 40e-3, 20e-4), ("vertical", 20e-3, 9e-4)]
)
def test_the_mass_is_as_uncertain_as_the_rotor(name, lead, inertia):
    """A tolerance of 10 % of its inertia is a standard deviation of 10 % / sqrt(3)."""
    axis = AXES[name]
    rotor = inertia * (2.0 * math.pi / lead) ** 2
    assert axis.sheet.rotor_mass == pytest.approx(rotor)
    stated = dict(zip(axis.uncertainty.names, axis.uncertainty.deviations, strict=True))["plant.mass"]
    assert stated.value == pytest.approx(0.1 * rotor / math.sqrt(3.0) / float(axis.drive.plant.mass), rel=0.1)


def test_the_head_of_the_vertical_axis_stays_where_it_is_without_a_motor():
    axis = AXES["vertical"]
    friction = axis.drive.friction
    held = float(friction.coulomb_screw.positive + friction.load_coefficient.positive * friction.initial_load)
    assert 0.0 < -float(axis.drive.plant.constant_force) < held


def test_the_gantry_is_stable_on_its_screw_because_of_the_notch():
    axis = AXES["gantry"]
    machine = axis.with_effects(dd.effects.Compliance(frequency=204.0, motor_share=0.24))
    gain, phase = least_margins(axis, machine)
    assert gain > LEAST.gain_margin
    assert phase > LEAST.phase_margin
    tables = axis_tables(axis)
    del tables["controller"]["filters"]
    bare = parse_axis(tables)
    assert not bool(dd.linearise(bare, velocity=0.01, machine=machine).margins().stable)


def test_the_gantry_shows_its_two_encoders_apart_on_an_elastic_screw():
    """Motor minus scale is the screw's wind-up: the table's share of the friction over the screw's stiffness."""
    axis = AXES["gantry"]
    machine = axis.with_effects(dd.effects.Compliance(frequency=204.0, motor_share=0.24))
    motion, ends = cruise(axis)
    run = dd.simulate(axis, motion, machine=machine).require_ok()
    stiffness = (2.0 * math.pi * 204.0) ** 2 * 0.24 * 0.76 * float(axis.drive.plant.mass)
    friction = axis.drive.friction
    slides = float(friction.coulomb_screw.positive + friction.load_coefficient.positive * friction.initial_load)
    slides += 0.05 * float(friction.viscous.positive + axis.drive.plant.damping.positive)
    for sign, samples in ends.items():
        apart = np.mean(run.motor_position[samples] - run.measured[samples])
        assert apart == pytest.approx(sign * 0.5 * slides / stiffness, abs=0.5 * float(axis.drive.sensor.resolution))


def test_the_paper_and_emps_are_the_machines_of_their_studies():
    assert AXES["paper"].parameters == dd.paper_axis("pd+fc+le").parameters
    assert AXES["paper"].gains == pytest.approx(dd.paper_axis("pd+fc+le").gains, rel=1e-6)
    published, ours = emps.reference_drive(), AXES["emps"].drive
    assert ours.friction == published.friction
    assert ours.plant == published.plant


PAGE = Path(__file__).parents[3] / "docs" / "reference" / "axes.md"


@each
@pytest.mark.filterwarnings("ignore::diffdrive.errors.LoadEstimatorWarning")
def test_the_page_says_how_it_does(name):
    """To the digits that are printed there: margins at 10 mm/s and the least of them, errors of two motions."""
    axis = AXES[name]
    row = next(re.findall(r"-?[\d.]+", line) for line in PAGE.read_text(encoding="utf-8").splitlines()
               if re.match(rf"\| {name} \| [\d.]+ \|", line))  # fmt: skip
    at_10 = dd.linearise(axis, velocity=0.01).margins()
    margins = (at_10.gain_margin, at_10.phase_margin, at_10.crossover, *least_margins(axis))
    assert [*map(float, row[:5])] == pytest.approx([*map(float, margins)], rel=0.01, abs=0.6)
    fast = dd.motion.jerk_limited(distance=0.06, speed=0.1, acceleration=1.0, jerk=50.0, rate=axis.rate, dwell=0.2)
    runs = [dd.simulate(axis, motion) for motion in (parse_motion(DEFAULT_MOTION, axis.rate), fast)]
    errors = [1e6 * error for run in runs for error in (run.rms_error(), run.peak_error())]
    assert [*map(float, row[5:])] == pytest.approx(errors, rel=0.06)


@each
def test_an_axis_says_where_its_numbers_are_from(name):
    said = dd.axes()[name].provenance
    assert all((said.title, said.source, said.measured, said.assumed))
    assert said.source.startswith("generic") == (name in GENERIC) == (said.measured == "nothing")


@each
def test_every_deviation_has_its_reason_in_the_file(name):
    text = FILES[name].read_text(encoding="utf-8")
    lines = text.partition("[uncertainty]\n")[2].splitlines()
    assert len(lines) == len(AXES[name].uncertainty.names) == len(tomllib.loads(text)["uncertainty"])
    assert [line for line in lines if "  # " not in line] == []
