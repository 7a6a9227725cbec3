"""Drive files: what is written is read back, in any unit, for every controller."""

import dataclasses
import tomllib
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import axis_tables, parse_axis, read_axis, write_axis
from diffdrive.controllers import (
    DOBVSC,
    KINDS,
    PD,
    Cascade,
    DisturbanceObserver,
    Feedforward,
    FrictionCompensation,
    PDFeedforwardDOB,
    PDGains,
    Tracking,
    UnknownController,
)
from diffdrive.controllers.base import paper_tracking
from diffdrive.errors import DriveFileError
from diffdrive.model.parameters import Actuator, Drive, Sampling, Sensor
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.model.quantity import Directional
from diffdrive.motion.motion import Limits
from diffdrive.observers.friction_observer import KalmanObserver, LoadStateObserver, LoadStateTuning, Tuning
from diffdrive.observers.load_estimator import FixedLoad, InnovationLoad
from diffdrive.paper import example_controllers

ROOT = Path(__file__).parents[3]
BENCH = (ROOT / "../shared/data/bench").resolve()
BENCH_FILES = sorted(BENCH.glob("*/drive.toml"))
TEMPLATES = sorted((ROOT / "diffdrive/library").glob("*.toml"))

DRIVE = Drive(
    plant=paper_drive().plant,
    friction=paper_drive().friction,
    actuator=Actuator(force_limit=2000.0, limit_rounding=5.0, delay_samples=2, delay_fraction=0.25),
    sensor=Sensor(resolution=1e-7, noise=2e-8),
)
PLANT, FRICTION = DRIVE.plant, DRIVE.friction
TRACKING = paper_tracking(DRIVE, PAPER_KP, PAPER_KD)
BARE = Tracking(PDGains(kp=1e6, kd=2e3))
OBSERVER = DisturbanceObserver.of(PLANT, 240.0)
TUNING = Tuning(1e-16, 2e-10, 3e-12, 4e-16)

CONTROLLERS = {
    "unknown": UnknownController(),
    "pd": PD(BARE),
    "pd with feed-forward": PD(TRACKING),
    "dobvsc": DOBVSC(TRACKING, OBSERVER, reach=2.0, layer=3e-3, slope=200.0),
    "pd+ff+dob": PDFeedforwardDOB(TRACKING, OBSERVER, FRICTION, load=500.0),
    "pd+fc": FrictionCompensation(TRACKING, KalmanObserver(PLANT, FRICTION, TUNING, FixedLoad(1000.0))),
    "pd+fc+le": FrictionCompensation(
        TRACKING, KalmanObserver(PLANT, FRICTION, TUNING, InnovationLoad(50.0, 4e-3, -100.0, 1e-4, 20.0))
    ),
    "pd+fc+ls": FrictionCompensation(
        BARE,
        LoadStateObserver(PLANT, FRICTION, LoadStateTuning(1e-16, 1e-11, 1e-15, 500.0, 1e-15), 10.0, floor=-200.0),
    ),
    "cascade": Cascade(kp=50.0, kv=1e5, ki=1e6, velocity_feedforward=0.9, velocity_samples=3),
    "cascade with feed-forward": Cascade(kp=50.0, kv=1e5, feedforward=Feedforward.of(PLANT)),
}
OTHERS = {name: kind.example(DRIVE) for name, kind in KINDS.items() if kind.example is not None}
ALL = OTHERS | CONTROLLERS


def description(controller=CONTROLLERS["pd"], **changes) -> Axis:
    whole = Axis(DRIVE, controller, Sampling(5000.0, 8), Limits((-0.1, 0.05), 0.5, 10.0))
    return dataclasses.replace(whole, **changes)


def paper_tables() -> dict:
    return axis_tables(Axis(paper_drive(), PD(TRACKING), Sampling(), Limits()))


def assert_same(one: Axis, other: Axis) -> None:
    for field in ("drive", "controller"):
        a, b = getattr(one, field), getattr(other, field)
        assert jax.tree.structure(a) == jax.tree.structure(b)
        assert bool(eqx.tree_equal(a, b))
    assert one.sampling == other.sampling
    assert one.limits == other.limits


def test_every_kind_that_can_be_simulated_has_gains_for_the_papers_testbed():
    assert {name for name, kind in KINDS.items() if kind.example is None} == {"unknown"}
    assert [one.kind for one in example_controllers(DRIVE).values()] == list(example_controllers(DRIVE))


def test_every_kind_is_round_tripped_here():
    assert {axis_tables(description(c))["controller"]["kind"] for c in ALL.values()} == set(KINDS)


@pytest.mark.parametrize("controller", ALL.values(), ids=ALL.keys())
def test_written_tables_are_read_back_equal(controller, tmp_path):
    written = description(controller)
    assert_same(parse_axis(axis_tables(written)), written)
    write_axis(tmp_path / "drive.toml", written)
    assert_same(read_axis(tmp_path / "drive.toml"), written)


@pytest.mark.parametrize(
    "changes",
    [
        {"sampling": Sampling(10_000.0)},
        {"limits": Limits()},
        {"limits": Limits(stroke=(-np.inf, 0.5))},
        {"limits": Limits(speed=0.3)},
        {"drive": paper_drive(quantised=False)},
    ],
)
def test_what_is_absent_stays_absent(changes, tmp_path):
    written = description(**changes)
    write_axis(tmp_path / "drive.toml", written)
    assert_same(read_axis(tmp_path / "drive.toml"), written)


@pytest.mark.parametrize(
    "floorless",
    [
        FrictionCompensation(TRACKING, KalmanObserver(PLANT, FRICTION, load_estimator=InnovationLoad(floor=None))),
        FrictionCompensation(TRACKING, LoadStateObserver(PLANT, FRICTION, floor=None)),
    ],
    ids=["le", "ls"],
)
def test_a_load_estimate_without_floor_stays_without(floorless):
    assert_same(parse_axis(axis_tables(description(floorless))), description(floorless))


@settings(max_examples=50, deadline=None)
@given(st.floats(1e-3, 1e6), st.floats(0.0, 1e9), st.floats(0.0, 1e9), st.floats(10.0, 1e6))
def test_numbers_survive_to_the_last_digit(mass, forward, back, rate):
    plant = dataclasses.replace(PLANT, mass=mass, damping=Directional(forward, back))
    written = description(drive=dataclasses.replace(DRIVE, plant=plant), sampling=Sampling(rate))
    text = tomli_w.dumps(axis_tables(written))
    assert_same(parse_axis(tomllib.loads(text)), written)


@pytest.mark.parametrize(
    ("table", "key", "text", "si"),
    [
        ("plant", "mass", "100 kg", 100.0),
        ("plant", "mass", "0.1 t", 100.0),
        ("plant", "mass", "  1e2kg ", 100.0),
        ("plant", "constant_force", "-1.5 kN", -1500.0),
        ("sensor", "resolution", "0.1 um", 1e-7),
        ("sensor", "resolution", "0.1 µm", 1e-7),
        ("sensor", "noise", "20 nm", 2e-8),
        ("actuator", "force_limit", "2 kN", 2000.0),
        ("friction", "bristle_stiffness", "33.5 N/um", 3.35e7),
        ("friction", "stribeck_velocity", "60 mm/min", 1e-3),
        ("friction", "load_coefficient", "3.66e-4", 3.66e-4),
        ("friction", "viscous", "1.8265 N*s/mm", 1826.5),
        ("friction", "viscous", "1826.5 N·s/m", 1826.5),
        ("controller", "kp", "8 N/um", 8e6),
        ("limits", "speed", "30 m/min", 0.5),
        ("limits", "acceleration", "1 g_0", 9.80665),
        ("sampling", "rate", "2 kHz", 2000.0),
    ],
)
def test_units_are_converted(table, key, text, si):
    tables = paper_tables()
    tables[table][key] = text
    read = parse_axis(tables)
    place = {
        "plant": read.drive.plant,
        "friction": read.drive.friction,
        "actuator": read.drive.actuator,
        "sensor": read.drive.sensor,
        "controller": getattr(read.controller, "tracking").gains,  # noqa: B009
        "limits": read.limits,
        "sampling": read.sampling,
    }[table]
    value = getattr(place, key)
    sides = (value.positive, value.negative) if isinstance(value, Directional) else (value,)
    assert sides == pytest.approx((si,) * len(sides), rel=1e-12)


def test_each_direction_may_have_its_own_unit():
    tables = paper_tables()
    tables["friction"]["coulomb_screw"] = ["0.06 kN", 65]
    assert parse_axis(tables).drive.friction.coulomb_screw == Directional(60.0, 65.0)


@pytest.mark.parametrize("stroke", [[-0.05, 0.1], ["-50 mm", "0.1 m"]])
def test_stroke_from_lowest_to_highest(stroke):
    assert parse_axis(paper_tables() | {"limits": {"stroke": stroke}}).limits.stroke == pytest.approx((-0.05, 0.1))


@pytest.mark.parametrize("length", [0.15, "150 mm", [0.1], [0.0, 0.1, 0.2]])
def test_a_stroke_needs_both_ends(length):
    with pytest.raises(DriveFileError, match=r"\[limits\] stroke: must be \[lowest, highest\]"):
        parse_axis(paper_tables() | {"limits": {"stroke": length}})


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("mass", "kg"),
        ("mass", "100,5 kg"),
        ("mass", "100 200 kg"),
        ("mass", "1.000.000 kg"),
        ("mass", "2*50 kg"),
        ("mass", "100"),
        ("mass", "100 mm"),
        ("mass", ""),
        ("mass", "heavy"),
        ("mass", "nan kg"),
    ],
)
def test_what_is_not_one_number_with_its_unit_is_not_guessed(key, text):
    tables = paper_tables()
    tables["plant"][key] = text
    with pytest.raises(DriveFileError, match=rf"\[plant\] {key}: .*kg"):
        parse_axis(tables)


@pytest.mark.parametrize("text", ["1500 rad/s", "60 rpm"])
def test_an_angular_frequency_is_not_taken_for_hertz(text):
    tables = axis_tables(description(CONTROLLERS["dobvsc"]))
    tables["controller"]["cutoff"] = text
    with pytest.raises(DriveFileError, match=r"\[controller\] cutoff: .*must be in Hz"):
        parse_axis(tables)


def test_the_paper_controllers_feed_motion_forward_unless_told_otherwise_and_bare_loops_do_not():
    bare = {"pd", "cascade"}
    for controller in CONTROLLERS.values():
        tables = axis_tables(description(controller))
        kind = tables["controller"]["kind"]
        if kind == "unknown":
            continue
        del tables["controller"]["feedforward"]
        read = parse_axis(tables).controller
        feedforward = read.feedforward if isinstance(read, Cascade) else read.tracking.feedforward
        assert feedforward == (None if kind in bare else Feedforward.of(PLANT))


def test_a_controller_believes_in_the_plant_of_its_file():
    tables = axis_tables(description(CONTROLLERS["pd+fc"]))
    tables["plant"]["mass"] = 130.0
    tables["friction"]["viscous"] = 2000.0
    read = parse_axis(tables)
    assert read.controller.observer.plant == read.drive.plant
    assert read.controller.observer.friction == read.drive.friction
    assert read.controller.tracking.feedforward.mass == 130.0


@pytest.mark.skipif(not BENCH_FILES, reason=f"{BENCH} is not there")
def test_all_bench_drives_are_there():
    assert len(BENCH_FILES) == 34


@pytest.mark.skipif(not BENCH_FILES, reason=f"{BENCH} is not there")
@pytest.mark.parametrize("path", BENCH_FILES, ids=[path.parent.name for path in BENCH_FILES])
def test_bench_drives_are_read_and_survive_a_round_trip(path):
    read = read_axis(path)
    raw = tomllib.loads(path.read_text())
    assert read.drive.plant.mass == raw["plant"]["mass"]
    assert read.sampling.rate == raw["sampling"]["rate"]
    assert read.controller.tracking.gains == PDGains(raw["controller"]["kp"], raw["controller"]["kd"])
    assert_same(parse_axis(axis_tables(read)), read)


@pytest.mark.skipif(not TEMPLATES, reason="diffdrive/library holds no drive file")
@pytest.mark.parametrize("path", TEMPLATES, ids=[path.stem for path in TEMPLATES])
def test_the_drive_files_shipped_with_the_package_are_read(path):
    assert_same(parse_axis(axis_tables(read_axis(path))), read_axis(path))
