"""Sound logs pass, simulated and real; what was done to a log is told with its number, whatever the number."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from diffdrive import motion
from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.logs.checks.examine import examine
from diffdrive.logs.log import Log
from diffdrive.model.parameters import Sensor
from experiments.studies.emps import axis as emps
from tests.support.sound_log import (
    DRIVE,
    FORCE_PER_VOLT,
    RATE,
    SOUND,
    axis_of,
    both,
    complaints,
    delayed,
    matching,
    replaced,
    simulate_log,
    two_sines,
)


def test_sound_log_passes_with_and_without_a_drive_file():
    assert complaints(examine(SOUND, DRIVE)) == []
    assert examine(SOUND) == []


def test_the_worst_comes_first():
    log = replaced(command=-SOUND.command, motor_position=SOUND.position, time=SOUND.time * (1 + 1e-5))
    order = [("fatal", "warning", "note").index(one.severity) for one in examine(log, DRIVE)]
    assert order == sorted(order)
    assert {0, 1} <= set(order)


@pytest.mark.long
def test_units_of_position_and_of_command_are_told_apart_by_coulomb_friction():
    """Both leave the same factor between command and controller; without stroke and counts only friction tells."""
    loose = dataclasses.replace(DRIVE, limits=motion.Limits(), drive=axis_of(resolution=None).drive)
    slow = {name: signal / 10 for name, signal in both.items()}
    blamed = examine(replaced(**slow), loose)
    assert matching(blamed, "fatal", "position", r"reference are 0\.1 times what they should be")
    blamed = examine(replaced(command=SOUND.command / 10), loose)
    assert matching(blamed, "fatal", "command", r"multiply the command by 10 N")


def test_a_unit_delay_of_the_actuator_is_confirmed_outside_the_recording():
    drive = axis_of(kp=1e6, kd=8e3, delay=1)
    findings = examine(simulate_log(drive, two_sines()), drive)
    assert complaints(findings) == []
    assert matching(
        findings, "note", "command", r"no unit delay is in the recording, so actuator.delay_samples = 1 must"
    )


def test_a_clip_at_the_known_limit_is_no_complaint():
    drive = dataclasses.replace(
        DRIVE,
        drive=dataclasses.replace(DRIVE.drive, actuator=dataclasses.replace(DRIVE.drive.actuator, force_limit=150.0)),
    )
    findings = examine(replaced(command=np.clip(SOUND.command, -150, 150)), drive)
    assert matching(findings, "note", "command", "force_limit")
    assert complaints(findings) == []


def test_an_unquantised_position_is_noted():
    findings = examine(simulate_log(axis_of(resolution=None), two_sines()))
    assert matching(findings, "note", "position", "no count grid")
    assert complaints(findings) == []


@pytest.mark.long
@given(st.floats(-4.0, 4.0))
@settings(max_examples=12)
def test_every_unit_of_the_command_is_recovered(power):
    findings = examine(replaced(command=10**power * SOUND.command), DRIVE)
    told = [re.search(r"by ([\d.e+-]+) N per unit", one.remedy) for one in findings if one.channel == "command"]
    factors = [float(one.group(1)) for one in told if one]
    if abs(10**power - 1) > 0.1:
        assert factors == [pytest.approx(10**-power, rel=1e-3)]
    elif abs(10**power - 1) > 0.01:
        assert matching(findings, "warning", "command", "force constant or gains are off")


@pytest.mark.long
@given(st.integers(-2, 2), st.integers(-2, 2))
@settings(max_examples=8)
def test_every_shift_is_recovered(command, position):
    log = replaced(command=delayed(SOUND.command, command), position=delayed(SOUND.position, position))
    found = [one for one in examine(log, DRIVE) if "shift" in one.message and one.severity != "note"]
    if command == 0 and position == 0:
        assert not found
        return
    # command and position against the reference: the same shift of both is one of the reference
    late, behind = command, command - position
    if max(abs(late), abs(behind)) > 2:  # beyond what is tried
        return
    (only,) = found
    # the table seems to answer sooner by as much as the position is ahead of the command
    assert only.resembles == ("loop_delay" if behind else None)
    assert only.amount == (-behind if behind else None)
    if late == behind:
        assert only.channel == "command"
        assert f"shift {late:+d}" in only.message
    elif late == 0:
        assert only.channel == "position"
        assert f"shift {-behind:+d}" in only.message
    elif behind == 0:
        assert only.channel == "reference"
        assert f"shift {-late:+d}" in only.message
    else:
        assert f"{-late:+d} and {-behind:+d} samples" in only.message


@given(st.floats(60.0, 200.0))
@settings(max_examples=6)
def test_every_clipping_level_is_told(level):
    findings = examine(replaced(command=np.clip(SOUND.command, -level, level)), DRIVE)
    told = [float(re.search(r"sits at (\S+)", one.message).group(1)) for one in findings if "clipped" in one.message]
    if np.mean(SOUND.command > level) > 0.01:
        assert max(told) == pytest.approx(level, rel=1e-5)


@pytest.mark.long
@given(
    mass=st.floats(30.0, 300.0),
    gain=st.floats(0.3, 1.5),
    noise=st.sampled_from([0.0, 1e-8, 5e-8]),
    resolution=st.sampled_from([None, 1e-8, 1e-7, 1e-6]),
    which=st.sampled_from(["two sines", "triangle", "strokes", "one way", "chirp"]),
    seed=st.integers(0, 100),
)
@settings(max_examples=12)
def test_sound_logs_of_other_axes_pass(mass, gain, noise, resolution, which, seed):
    drive = axis_of(
        kp=3.99e6 * gain, kd=12_170 * gain * (mass / 100) ** 0.5, mass=mass, noise=noise, resolution=resolution
    )
    reference = {
        "two sines": lambda: two_sines(),
        "triangle": lambda: motion.triangular(speed=0.01, stroke=0.0095, rounding=0.1, duration=3.0, rate=RATE),
        "strokes": lambda: motion.jerk_limited(distance=0.05, speed=0.08, acceleration=2.0, jerk=50.0, rate=RATE),
        "one way": lambda: motion.constant_speed(speed=0.01, ramp=0.1, duration=3.0, rate=RATE),
        "chirp": lambda: motion.chirp(amplitude=1e-3, from_frequency=0.5, to_frequency=8.0, duration=3.0, rate=RATE),
    }[which]()
    log = simulate_log(drive, reference, seed)
    assert complaints(examine(log, drive)) == []
    assert complaints(examine(log)) == []


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("pd", {"feedforward": True}),
        ("dobvsc", {"cutoff": 100.0}),
        ("pd+ff+dob", {"cutoff": 100.0}),
        ("pd+fc", {}),
        ("pd+fc+ls", {}),
        ("cascade", {"ki": 1e5, "velocity_samples": 2, "velocity_feedforward": 0.5}),
    ],
)
def test_sound_logs_of_every_controller_pass(kind, more):
    rate = RATE if kind == "cascade" else 10_000.0
    gains = {"kp": 160.0, "kd": 8e3} if kind == "cascade" else {"kp": 7.98e6, "kd": 15_960.0}
    drive = axis_of(kind, rate=rate, **gains, **more)
    log = simulate_log(drive, motion.jerk_limited(distance=0.05, speed=0.08, acceleration=2.0, jerk=50.0, rate=rate))
    assert complaints(examine(log, drive)) == []
    volts = examine(replaced(log, command=log.command / FORCE_PER_VOLT), drive)
    assert matching(volts, "fatal", "command", r"multiply the command by 1(59|60)(\.\d+)? N per unit"), volts


@pytest.mark.long
def test_lengths_in_another_unit_are_told_beside_a_controller_that_is_not_linear():
    """A saturating one: its command for the log in metres is not that for millimetres over a thousand."""
    drive = axis_of("dobvsc", cutoff=100.0)
    log = simulate_log(drive, motion.jerk_limited(distance=0.05, speed=0.08, acceleration=2.0, jerk=50.0, rate=RATE))
    found = examine(replaced(log, position=1e3 * log.position, reference=1e3 * log.reference), drive)
    assert matching(found, "fatal", "position", r"position and reference are 1000 times .*mm for m"), found


SHARED = Path(__file__).resolve().parents[5] / "shared" / "data"
without_bench = pytest.mark.skipif(not (SHARED / "bench").is_dir(), reason="the bench logs are not here")
without_emps = pytest.mark.skipif(emps.find_folder() is None, reason="the EMPS files are not here")


@without_bench
@pytest.mark.parametrize("machine", [2, 6, 12, 17, 19, 23])
def test_faulty_machines_with_sound_loggers_pass(machine):
    """Lag, backlash, delay, limits, shocks, cutting forces, pitch errors: the machine's faults are not the log's."""
    assert complaints(examined(machine, "a")) == []


@without_bench
@pytest.mark.slow
@pytest.mark.parametrize("machine", range(1, 35))
def test_every_bench_log_passes(machine):
    for which in "ab":
        assert complaints(examined(machine, which)) == []


def examined(machine: int, which: str):
    pandas = pytest.importorskip("pandas")
    folder = SHARED / "bench" / f"{machine:02d}"
    table = pandas.read_parquet(folder / f"log-{which}.parquet")
    log = Log(folder.name, **{name: table[name].to_numpy() for name in table.columns})
    return examine(log, read_axis(folder / "drive.toml"))


def emps_log(which: str, *, newtons: bool) -> tuple[Log, Axis]:
    """An EMPS file as it lies there (or with its force constant applied), and the drive that the benchmark states."""
    path = emps.find_folder() / emps.FILES[which]
    data, record = scipy.io.loadmat(path), emps.read(path)
    constant = float(data["gtau"].item()) if newtons else 1.0
    log = Log(
        which,
        time=data["t"].ravel(),
        reference=data["qg"].ravel(),
        position=data["qm"].ravel(),
        command=constant * data["vir"].ravel(),
        disturbance=constant * data["pulses_N"].ravel() if "pulses_N" in data else None,
    )
    drive = dataclasses.replace(emps.reference_drive(), sensor=Sensor(resolution=5e-8))
    return log, Axis(drive, emps.controller(record), emps.SAMPLING, motion.Limits())


STAMPS = ("warning", "time", r"rounded by up to \d+\.\d ns.*drifts by 0\.(398|199) ms")
BEGINS = ("note", "position", r"in motion, at 7\.\d+ mm/s and 0\.1 mm behind")
VOLTS = ("fatal", "command", r"0\.0284\d* times.*volts.*by 35\.1\d N per unit")
OFF_GRID = ("warning", "position", "off the count grid of 5e-08 m.*resampled or filtered")
TWICE = ("warning", "disturbance", r"contains 1\.013\d N per unit of the disturbance")
PULSE_VOLTS = ("fatal", "disturbance", r"contains 35\.6\d+ N per unit of the disturbance \(1\.01\d+ units")


@pytest.mark.long
@without_emps
@pytest.mark.parametrize(
    ("which", "newtons", "told"),
    [
        ("estimation", True, [STAMPS, BEGINS]),
        ("estimation", False, [STAMPS, BEGINS, VOLTS]),
        ("pulses", True, [STAMPS, BEGINS, OFF_GRID, TWICE]),
        ("pulses", False, [STAMPS, BEGINS, OFF_GRID, PULSE_VOLTS, VOLTS]),
    ],
)
def test_emps_tells_its_own_traps_and_no_others(which, newtons, told):
    findings = examine(*emps_log(which, newtons=newtons))
    for severity, channel, text in told:
        assert matching(findings, severity, channel, text), (text, [str(one) for one in findings])
    assert len(findings) == len(told)


@without_emps
def test_emps_volts_are_told_from_mass_and_friction_alone():
    log, drive = emps_log("estimation", newtons=False)
    (volts,) = matching(examine(replaced(log, reference=None), drive), "fatal", "command", "than|times what mass")
    assert float(re.search(r"about ([\d.]+) N per unit", volts.remedy).group(1)) == pytest.approx(35.15, rel=0.1)


@pytest.mark.long
@without_emps
@pytest.mark.parametrize("newtons", [True, False])
def test_emps_pulses_are_seen_although_no_channel_holds_them(newtons):
    log, drive = emps_log("pulses", newtons=newtons)
    findings = examine(replaced(log, disturbance=None), drive)
    assert matching(findings, "warning", "command", r"a force of 178\.\d N is added .* 49 times switched, in 50 %")
    assert bool(matching(findings, *VOLTS)) != newtons
    assert len(complaints(findings)) == (3 if newtons else 4)


@without_emps
def test_single_precision_is_neither_a_filter_nor_a_unit():
    log, drive = emps_log("estimation", newtons=True)
    rounded = replaced(log, position=log.position.astype(np.float32).astype(float))
    assert [one.channel for one in complaints(examine(rounded, drive))] == ["time"]


@without_emps
def test_emps_counts_are_found_without_being_told():
    assert not matching(examine(emps_log("estimation", newtons=True)[0]), "note", "position", "no count grid")
    assert matching(examine(emps_log("pulses", newtons=True)[0]), "note", "position", "no count grid")


def test_a_command_that_stands_with_the_error_is_not_frozen():
    """A PD loop on a coarse, noise-free scale that moves whole counts a sample: while the error stands, it does."""
    still = slice(2000, 2040)
    error = (SOUND.reference - SOUND.position).copy()
    error[still] = error[still.start]
    command = SOUND.command.copy()
    command[still] = command[still.start]
    with_error = dataclasses.replace(SOUND, position=SOUND.reference - error, command=command)
    without = dataclasses.replace(SOUND, command=command)
    frozen = [any("command is frozen" in one.message for one in examine(log)) for log in (with_error, without)]
    assert frozen == [False, True]
