"""Controllers with every part that an export must hold, and their code compiled and replayed."""

import os
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np

from diffdrive import motion
from diffdrive.controllers import KINDS
from diffdrive.controllers.base import Feedforward
from diffdrive.controllers.cascade import Cascade
from diffdrive.controllers.filters import PT1, PT2, Notch, SecondOrder
from diffdrive.model.parameters import Sensor
from diffdrive.paper import paper_axis
from diffdrive.simulation import simulate
from experiments.exports.c99 import c_files
from experiments.exports.replay import replay_of
from experiments.exports.trace import program_of

STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Werror")
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]


def full_cascade(plant, **changes):
    """A cascade with every part that is optional."""
    filters = (PT1(2e-4), PT2(900.0), SecondOrder(400.0, 0.1, 500.0, 0.6), Notch(350.0, 60.0), Notch(120.0, 20.0, 12.0))
    values = {
        "kp": 40.0, "kv": 6e4, "reset_time": 0.02, "velocity_feedforward": 0.9, "feedforward": Feedforward.of(plant),
        "velocity_samples": 3, "force_feedforward": 0.7, "force_limit": 250.0, "velocity_filter_time": 3e-4,
        "reference_filter_time": 1e-3, "reference_delay_samples": 5, "position_every": 4, "filters": filters,
    }  # fmt: skip
    return Cascade(**(values | changes))


def _variants():
    axis = paper_axis()
    two = replace(axis, drive=replace(axis.drive, motor_encoder=Sensor(resolution=5e-8)))
    plant = axis.drive.plant
    exponent = {"friction.stribeck_exponent": 1.7}
    no_friction = {"friction.coulomb_screw": 0.0, "friction.load_coefficient": 0.0, "friction.breakaway_gap": 0.0}
    observed = paper_axis("pd+fc+ls")
    return {kind: paper_axis(kind) for kind in KINDS if KINDS[kind].example is not None} | {
        "cascade, all parts": axis.with_controller(full_cascade(plant)),
        "cascade, long lines": axis.with_controller(
            full_cascade(plant, velocity_samples=40, reference_delay_samples=50, filters=())
        ),
        "cascade, motor": two.with_controller(
            Cascade(60.0, 8e4, 4e5, position_feedback="scale", velocity_feedback="motor")
        ),
        "cascade, motor alone": two.with_controller(
            Cascade(60.0, 8e4, position_feedback="motor", velocity_feedback="motor")
        ),
        "exponent of the Stribeck curve": observed.replace(exponent),
        "no Coulomb friction": observed.replace(no_friction),
    }


VARIANTS = _variants()


def lap(axis, samples=2001):
    """Three periods of a sine of 40 mm/s."""
    duration = (samples - 1) / axis.rate
    frequency = 3.0 / duration
    amplitude = 0.04 / (2.0 * np.pi * frequency)
    return motion.sine(amplitude=amplitude, frequency=frequency, duration=duration, rate=axis.rate)


def with_random_gains(axis, seed):
    """The axis with every gain up to a factor of two larger or smaller."""
    random = np.random.default_rng(seed)
    return axis.with_gains(**{name: float(gain) * 2.0 ** random.uniform(-1, 1) for name, gain in axis.gains.items()})


def replayed_program(axis, controller_axis=None, samples=2001, single=False):
    """The program of a controller, and the replay of a run of `axis`; `controller_axis` may have other gains."""
    run = simulate(axis, lap(axis, samples), 5e3)
    other = axis if controller_axis is None else controller_axis
    program = program_of(other.controller, axis.sampling.period, "axis_x", single=single)
    return program, replay_of(program, other, lap(axis, samples), run)


def compiled_differences(program, replay, folder, compiler="gcc", flags=("-O1", "-ffp-contract=off")):
    """The relative difference of each output, of code that is compiled without a warning."""
    tolerances = dict.fromkeys(replay.outputs, 1e-9)
    for file, text in c_files(program, "a test", replay, tolerances).items():
        (folder / file).write_text(text)
    sources = ("axis_x.c", "axis_x_bench.c")
    made = subprocess.run(
        [compiler, *STRICT, *flags, "-o", "bench", *sources, "-lm"], cwd=folder, capture_output=True, text=True
    )
    assert made.returncode == 0, made.stderr
    ran = subprocess.run([folder / "bench", "axis_x_run.csv"], cwd=folder, capture_output=True, text=True)
    found = re.findall(r"^(\w+) +largest .* relative ([-+.\w]+)", ran.stdout, re.MULTILINE)
    assert [name for name, _ in found] == list(replay.outputs), ran.stdout + ran.stderr
    return {name: float(text) for name, text in found}, ran.returncode


def has(program):
    """Whether a program is on this machine, in the search path or where a variable of its name says."""
    return shutil.which(os.environ.get(program.upper(), program)) is not None
