"""Sound logs whose controller has a past that they do not hold: cut out of a longer motion, gapped, under a load."""

import dataclasses

import numpy as np
import pytest

from diffdrive import motion
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.errors import LoadEstimatorWarning
from diffdrive.library import PAPER_DRIVE
from diffdrive.logs import Log
from diffdrive.logs.checks.consistency import explain_command
from diffdrive.logs.checks.examine import examine
from diffdrive.logs.checks.relation import controller_relation
from diffdrive.loop.simulate import simulate_loop
from tests.support.sound_log import (
    FORCE_PER_VOLT,
    axis_of,
    complaints,
    delayed,
    matching,
    replaced,
    simulate_log,
    without_rows,
)

pytestmark = pytest.mark.filterwarnings(f"ignore::{LoadEstimatorWarning.__module__}.LoadEstimatorWarning")

TEMPLATE = read_axis(PAPER_DRIVE)  # "pd+fc+le": a load estimator on a friction observer
RATE = TEMPLATE.sampling.rate


def log_of(description, reference, load=0.0) -> Log:
    loads = np.full(len(reference.time), load)
    run = simulate_loop(
        description.drive, description.controller, reference, loads, sampling=description.sampling, seed=1
    )
    run.require_ok()
    return Log("cut", time=run.time, position=run.position, command=run.command, reference=run.reference)


def cut(log: Log, start: int, stop: int | None = None) -> Log:
    return replaced(log, **{name: signal[start:stop] for name, signal in log.channels.items()})


@pytest.fixture(scope="module")
def sine():
    """The template's drive over a sine: 30 000 samples."""
    return log_of(TEMPLATE, motion.sine(amplitude=0.015, frequency=0.5, duration=3.0, rate=RATE))


@pytest.fixture(scope="module")
def fast():
    """The same under a load that no column holds, faster."""
    reference = motion.sine(amplitude=0.005, frequency=2.0, duration=2.0, rate=RATE)
    return log_of(TEMPLATE, reference, load=8_000.0)


@pytest.mark.parametrize(
    "start", [1000, 9000, *(pytest.param(start, marks=pytest.mark.long) for start in (5000, 15_000))]
)
def test_a_sound_log_that_begins_in_motion_passes(sine, start):
    findings = examine(cut(sine, start), TEMPLATE)
    assert complaints(findings) == []


def test_one_missing_sample_is_no_wrong_force_constant(sine):
    log = replaced(without_rows(sine, [9000], restamp=False), gaps=(9000,))
    (gap,) = complaints(examine(log, TEMPLATE))
    assert gap.channel == "time"


@pytest.mark.parametrize("start", [1500, 6200])
def test_a_load_that_the_controller_learnt_before_the_log_passes(fast, start):
    assert complaints(examine(cut(fast, start), TEMPLATE)) == []


@pytest.mark.long
@pytest.mark.parametrize(("kind", "more"), [("pd+ff+dob", {"cutoff": 100.0}), ("pd+fc+ls", {})])
def test_a_log_that_begins_in_a_dwell_between_two_strokes_passes(kind, more):
    """The table rests, but its bristles are bent and the observer knows by how much."""
    drive = axis_of(kind, rate=RATE, kp=7.98e6, kd=15_960.0, **more)
    reference = motion.jerk_limited(distance=0.05, speed=0.08, acceleration=2.0, jerk=50.0, rate=RATE)
    log = simulate_log(drive, reference)
    half = len(log.time) // 2
    assert complaints(examine(cut(log, half), drive)) == []


@pytest.mark.parametrize(
    ("kind", "load", "first", "last"), [("pd+fc", 0.0, 10_447, 14_967), ("pd+fc+le", 8_000.0, 11_847, 15_656)]
)
def test_a_short_log_that_ends_in_a_rest_is_not_told_of_pulses_or_of_its_sign(kind, load, first, last):
    """Its later half tells nothing, and in its first one the friction that holds the table acts until it moves."""
    drive = axis_of(kind, rate=RATE, kp=7.98e6, kd=15_960.0, noise=0.0, resolution=1e-8 if load == 0.0 else None)
    reference = motion.jerk_limited(distance=0.05, speed=0.08, acceleration=2.0, jerk=50.0, dwell=0.2, rate=RATE)
    findings = examine(cut(log_of(drive, reference, load), first, last), drive)
    assert not [one for one in complaints(findings) if one.severity == "fatal" or "pulses" in one.message], findings


def pulses(log: Log) -> np.ndarray:
    return np.where(np.sin(2 * np.pi * 1.3 * log.time) < 0, 80.0, 0.0)


CORRUPTED = {
    "volts": (
        lambda log: replaced(log, command=log.command / FORCE_PER_VOLT),
        "fatal",
        r"volts.*by 1(59|60)\.?\d* N per",
    ),
    "wrong gear": (lambda log: replaced(log, command=1.3 * log.command), "fatal", r"1\.(29|3)\d* times"),
    "force constant": (
        lambda log: replaced(log, command=0.95 * log.command),
        "warning",
        r"off by -(4\.[5-9]|5|5\.[0-5]) %",
    ),
    "reversed": (lambda log: replaced(log, command=-log.command), "fatal", "sign is reversed"),
    "late": (lambda log: replaced(log, command=delayed(log.command, 1)), "fatal", r"one sample late \(shift \+1\)"),
    "pulses": (
        lambda log: replaced(log, command=log.command - pulses(log)),
        "warning",
        r"force of -?(79|80)\.?\d* N is",
    ),
    "another controller": (
        lambda log: replaced(log, command=log.command + 1e5 * log.reference),
        "warning",
        r"logged command only to \d+ %",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("start", [0, 5000])
@pytest.mark.parametrize("name", CORRUPTED)
def test_true_traps_are_found_all_the_same(sine, name, start):
    corrupt, severity, text = CORRUPTED[name]
    findings = examine(corrupt(cut(sine, start)), TEMPLATE)
    assert matching(findings, severity, "command", text), "\n".join(map(str, findings))


@pytest.mark.long
def test_a_shift_and_pulses_may_come_together_in_a_long_log():
    """The shift is looked for in a window of the log, the pulses in what that window shows."""
    drive = axis_of(noise=3e-7)
    log = simulate_log(drive, motion.sine(amplitude=0.015, frequency=0.5, duration=22.0, rate=drive.sampling.rate))
    assert len(log.time) > 40_000
    findings = examine(replaced(log, command=delayed(log.command, 2) - 0.2 * pulses(log)), drive)
    assert matching(findings, "fatal", "command", r"2 samples late \(shift \+2\)")
    assert matching(findings, "warning", "command", "a force of -16 N is added")


def test_a_log_whose_past_is_unknown_is_judged_by_its_later_half(sine):
    late = [
        explain_command(controller_relation(log, TEMPLATE)).relation.after_transient for log in (cut(sine, 5000), sine)
    ]
    assert late == [True, False]
    assert matching(examine(cut(sine, 5000), TEMPLATE), "note", "position", "begins in motion")


@pytest.mark.long
def test_the_worst_of_a_past_is_no_shift_of_a_smooth_log():
    """Without noise and counts, a remembered load moves the command as a part of a sample would."""
    drive = axis_of("pd+fc+le", rate=RATE, kp=7.98e6, kd=15_960.0, noise=0.0, resolution=None)
    log = log_of(drive, motion.sine(amplitude=0.015, frequency=0.5, duration=4.0, rate=RATE), load=8_000.0)
    log = dataclasses.replace(cut(log, 4373, 18_657), name="smooth")
    assert complaints(examine(log, drive)) == []
