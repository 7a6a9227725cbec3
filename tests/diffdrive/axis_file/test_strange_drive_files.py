"""Every key of a drive file at values that nobody means: one line that names it, or a run with a status; never more."""

import copy
import math
import time
import warnings

import numpy as np
import pytest

from diffdrive import motion as motions
from diffdrive.axis_file.drive_file import axis_tables, parse_axis
from diffdrive.controllers import KINDS
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.errors import DiffdriveError, DriveFileError, LoadEstimatorWarning
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.presets import paper_drive
from diffdrive.model.quantity import quantities

STRANGE = [0.0, -1.0, 1e-300, 1e-12, 1e12, 1e300, -1e300, 10**30]
NO_NUMBERS = [math.nan, math.inf, -math.inf, 10**400, True, [], {}, [[]] * 500, "1e999 N", "x" * 5000, "\x1b[31m"]
SECONDS = 60.0  # for one compilation on a busy machine
PAPER = {
    "plant": {"mass": 100.0, "damping": [380.0, 260.0], "constant_force": 0.0},
    "friction": {
        "coulomb_screw": [63.43, 64.95],
        "load_coefficient": 3.66e-4,
        "initial_load": 15_200.0,
        "breakaway_gap": 20.0,
        "stribeck_velocity": 2e-3,
        "viscous": 1700.0,
        "bristle_stiffness": 3.35e7,
        "bristle_damping": 1e4,
        "stribeck_exponent": 1.5,
    },
    "actuator": {"force_limit": 2000.0, "limit_rounding": 10.0, "delay_fraction": 0.5},
    "sensor": {"resolution": 1e-7, "noise": 1e-8},
    "motor_encoder": {"resolution": 1e-8, "noise": 1e-9},
    "trace": {"rate": 1000.0, "sample": "mean", "command_noise": 1.0, "command_offset": -1e-4},
    "sampling": {"rate": 10_000.0},
    "limits": {"stroke": [-0.1, 0.1], "speed": 0.5, "acceleration": 5.0},
}
GAINS = {"kp": 1e6, "kd": 16_000.0}
CONTROLLERS = {
    name: kind.example(paper_drive()).table() for name, kind in KINDS.items() if kind.example is not None
} | {
    "pd": GAINS,
    "dobvsc": GAINS | {"cutoff": 100.0},
    "pd+ff+dob": GAINS | {"cutoff": 100.0},
    "pd+fc": GAINS,
    "pd+fc+le": GAINS,
    "pd+fc+ls": GAINS,
    "cascade": {
        "kp": 50.0,
        "kv": 16_000.0,
        "reset_time": 0.02,
        "feedforward": True,
        "force_feedforward": 0.9,
        "force_limit": 1500.0,
        "limit_rounding": 10.0,
        "velocity_filter_time": 2e-4,
        "reference_filter_time": 1e-3,
        "filters": [{"kind": "notch", "frequency": 700.0, "width": 200.0, "depth": 30.0}],
    },
}
STATIC = {
    ("actuator", "delay_samples"),
    ("controller", "velocity_samples"),
    ("controller", "reference_delay_samples"),
    ("controller", "position_every"),
    ("sampling", "substeps"),
    ("trace", "rate"),
    ("sampling", "rate"),
}


def tables_of(kind):
    tables = copy.deepcopy(PAPER) | {"controller": {"kind": kind} | CONTROLLERS[kind]}
    return axis_tables(parse_axis(tables, "axis.toml"))


def places(tables, above=()):
    """Every key that holds no table, and the tables above it."""
    for key, value in tables.items():
        if isinstance(value, dict):
            yield from places(value, (*above, key))
        else:
            yield above, key


def with_value(tables, above, key, value):
    changed = copy.deepcopy(tables)
    table = changed
    for name in above:
        table = table.setdefault(name, {})
    table[key] = value
    return changed


def outcome(tables):
    """What comes of a drive file: "refused", or the status of a short run."""
    began, refused = time.perf_counter(), ""
    try:
        description = parse_axis(tables, "axis.toml")
        rate = description.sampling.rate
        move = motions.sine(amplitude=1e-5, frequency=rate / 100.0, duration=200.0 / rate, rate=rate)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LoadEstimatorWarning)
            run = simulate_loop(
                description.drive, description.controller, move, sampling=description.sampling,
                limits=description.limits,
            )  # fmt: skip
    except DiffdriveError as problem:
        refused = f"refused: {problem}"
    assert time.perf_counter() - began < SECONDS
    if refused:
        assert not {"\n", "\x1b"} & set(refused)
        assert len(refused) < 600, refused
        return refused
    assert run.status.ok == bool(np.all(np.isfinite(run.command)) and "ok" in run.status.message)
    return run.status.message


def require_sensible(tables, above, key, value):
    said = outcome(with_value(tables, above, key, value))
    assert said.startswith(("refused: ", "ok", "diverged: ", "saturated: ")), (above, key, value, said)
    return said


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=() if kind == "pd" else pytest.mark.slow) for kind in CONTROLLERS]
)
def test_every_number_of_a_drive_file_may_be_strange(kind):
    """The machine's once, the controller's with each kind: all runs of a kind are one program."""
    tables = tables_of(kind)
    assert outcome(tables).startswith("ok")
    for above, key in places(tables):
        if key in ("kind", "feedforward") or (above[0], key) in STATIC or (above[0] != "controller" and kind != "pd"):
            continue
        for value in STRANGE:
            said = require_sensible(tables, above, key, value)
            if above[0] != "controller":
                assert "the loop is unstable with these gains" not in said or abs(value) < 1e30, (
                    above,
                    key,
                    value,
                    said,
                )


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=() if kind in ("pd", "cascade") else pytest.mark.long) for kind in CONTROLLERS]
)
def test_no_key_of_a_drive_file_takes_what_is_no_number(kind):
    tables = tables_of(kind)
    for above, key in places(tables):
        for value in NO_NUMBERS:
            meant = (above[0] == "limits" and value == math.inf) or (key == "feedforward" and value is True)
            meant = meant or (key == "filters" and value == [])
            late = (above[0], key) in STATIC and value == 10**400  # whether it fits is seen with the motion
            if meant or late:
                continue
            with pytest.raises(DriveFileError) as refusal:
                parse_axis(with_value(tables, above, key, value), "axis.toml")
            assert len(str(refusal.value)) < 600


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_every_parameter_of_an_effect_may_be_strange(name):
    tables = tables_of("pd") | {"effects": {name: {}}}
    known = [path for path, _, _ in quantities(EFFECTS[name]())]
    amplitudes = {key: 1e-7 for key in ("cosine", "sine") if key in known}
    for key in known:
        for value in STRANGE:
            tables["effects"][name] = amplitudes
            require_sensible(tables, ("effects", name), key, value)


@pytest.mark.parametrize(("table", "key"), sorted(STATIC))
def test_what_sizes_the_program_may_be_strange(table, key):
    tables = tables_of("cascade" if table == "controller" else "pd")
    for value in [-1, 10**9, 10**12, 10**30, 10**400, 1e12, 0.5, math.nan, math.inf, True, "7"]:
        require_sensible(tables, (table,), key, value)


def test_every_kind_of_controller_is_tried():
    assert {*CONTROLLERS, "unknown"} == {*KINDS}
