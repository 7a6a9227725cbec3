"""No finding on sound logs, no certain mend where another explanation stands, and numbers in the unit of the mend."""

import dataclasses

import numpy as np
import pytest

from diffdrive.logs.checks.examine import examine
from diffdrive.motion.builders import from_array
from tests.diffdrive.logs.checks.test_log_hypotheses import (
    DRIVE,
    HAPPENED,
    OTHERS,
    RATE,
    SOUND,
    UNKNOWN,
    averaged,
    but,
    complaints,
    machine,
    motor,
    of,
    rounded,
    triangle,
)
from tests.support import sound_log
from tests.support.sound_log import FORCE_PER_VOLT, axis_of, frozen, simulate_log

COUNT = len(SOUND.time)
STEPS = 1e-4 * (np.arange(COUNT) // 1000 % 2)


def wrapped(findings):
    return [one for one in findings if one.cause == "wrapped"]


def lagging(signal, samples=8.0):
    """The signal behind a first-order lag, as a loop follows it."""
    after = np.exp(-np.arange(100) / samples)
    return np.convolve(np.pad(signal, (99, 0), mode="edge"), after / after.sum(), "valid")


TWO_LEVELS = {
    "a reference of steps": {"reference": STEPS, "position": rounded(lagging(STEPS), 1e-7)},
    "noise on it": {"reference": STEPS + 1e-8 * np.random.default_rng(0).standard_normal(COUNT)},
    "a sawtooth": {"reference": SOUND.time % 0.5 * 0.01, "position": lagging(SOUND.time % 0.5 * 0.01)},
    "a resting table that flickers": {"position": 1e-7 * np.random.default_rng(0).integers(0, 2, COUNT)},
    "flicker below the resolution": {"position": 4e-8 * (np.arange(COUNT) // 7 % 2)},
}


@pytest.mark.parametrize("name", TWO_LEVELS)
@pytest.mark.parametrize("drive", [UNKNOWN, None])
def test_steps_and_flicker_are_no_overflow(name, drive):
    assert not wrapped(examine(but(**TWO_LEVELS[name]), drive))


@pytest.mark.parametrize("bits", [14, 16])
def test_a_counter_that_overflows_once_each_way_is_unwrapped(bits):
    counts = np.round(SOUND.position / 1e-7)
    log = but(position=((counts + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)) * 1e-7)
    [finding] = wrapped(examine(log, UNKNOWN))
    np.testing.assert_allclose(finding.repair.apply(log).position, 1e-7 * counts, atol=1e-9)


@pytest.mark.parametrize("count", [5, 21])
def test_a_set_point_on_counts_and_an_averaged_position_are_not_exchanged(count):
    log = but(reference=rounded(SOUND.reference, 1e-7), position=averaged(SOUND.position, count))
    assert [one.cause for one in complaints(examine(log, UNKNOWN))] == ["filtered"]


def test_exchanged_columns_without_a_controller_leave_a_filter_as_their_rival():
    """A loop whose feedforward is too large is ahead of its reference."""
    [finding] = complaints(examine(HAPPENED["reference and position swapped"][0], UNKNOWN))
    assert (finding.cause, finding.rivals, finding.repair) == ("swapped", ("filtered",), None)


def test_rows_left_out_of_the_log_of_a_heavier_machine_name_other_numbers():
    """Of 150 kg every fifth row looks like 100 kg and every fourth."""
    heavy = of(machine(mass=150.0))
    kept = {name: signal[::5] for name, signal in heavy.channels.items() if name != "time"}
    log = dataclasses.replace(heavy, **kept, time=heavy.time[: len(kept["position"])])
    [finding] = complaints(examine(log, UNKNOWN))
    assert (finding.cause, finding.repair) == ("decimated", None)
    assert "decimated" in finding.rivals
    assert "multiply the time by 5" in finding.remedy


def test_a_force_constant_from_mass_and_friction_is_known_to_their_tolerance():
    [finding] = complaints(examine(HAPPENED["volts"][0], UNKNOWN))
    assert (finding.cause, finding.rivals, finding.repair) == ("gain", ("other machine",), None)
    low, high = (float(one) for one in finding.remedy.split("command, ")[1].split(" N where")[0].split(" to "))
    assert low < FORCE_PER_VOLT < high
    assert high == pytest.approx(4 * low, rel=0.01)


def test_a_shift_that_hardly_explains_more_than_nothing_is_not_certain():
    some = {name: signal[2000:2400] for name, signal in sound_log.SOUND.channels.items()}
    noise = 0.03 * np.std(some["command"]) * np.random.default_rng(1).standard_normal(400)
    some["command"] = np.roll(some["command"], 1) + noise
    first = complaints(examine(sound_log.replaced(**some), sound_log.DRIVE))[0]
    assert (first.severity, first.cause, first.rivals, first.repair) == ("warning", "shifted", ("nothing",), None)
    assert "nothing at all" in first.remedy


def test_a_known_disturbance_is_no_part_of_the_gains():
    """Its coefficient in the command is 0 but for rounding, of either sign."""
    log = simulate_log(axis_of(kp=2.8e6, kd=4e4, noise=0.0), triangle())
    disturbance = np.random.default_rng(1).choice([-1.0, 1.0], 41).repeat(200)[: len(log.time)]
    [finding] = complaints(examine(dataclasses.replace(log, disturbance=disturbance), DRIVE))
    assert "whose parts are 0.7, 1.333 times" in finding.message


LIMIT = 160.0  # N
ACTUATOR = dataclasses.replace(DRIVE.drive.actuator, force_limit=LIMIT)
LIMITED = of(dataclasses.replace(DRIVE, drive=dataclasses.replace(DRIVE.drive, actuator=ACTUATOR)))
SATURATED = dataclasses.replace(LIMITED, command=np.clip(LIMITED.command, -LIMIT, LIMIT))
IN_VOLTS = dataclasses.replace(SATURATED, command=SATURATED.command / FORCE_PER_VOLT)


def clipped(log, drive=DRIVE):
    found = [one for one in complaints(examine(log, drive)) if one.cause == "clipped"]
    assert len(found) == 2  # either way
    return found


@pytest.mark.parametrize("log", [SATURATED, IN_VOLTS], ids=["N", "V"])
def test_a_limit_of_the_amplifier_is_stated_in_newtons(log):
    assert {one.remedy for one in clipped(log)} == {"set actuator.force_limit = 160 N"}


def test_a_limit_in_a_unit_that_is_not_known_is_not_stated_in_newtons():
    for one in clipped(IN_VOLTS, UNKNOWN):
        assert "settle the unit" in one.remedy
        assert " N" not in one.remedy


def test_a_command_that_only_the_recorder_clipped_sets_no_limit_of_the_drive():
    for one in clipped(but(command=np.clip(SOUND.command, -130.0, 130.0))):
        assert "recorder alone" in one.message
        assert "force_limit" not in one.remedy


def test_a_motor_in_millimetres_has_no_lost_motion():
    [finding] = complaints(examine(but(motor_position=1e3 * motor(0.0)), DRIVE))
    assert (finding.cause, finding.channel) == ("gain", "motor_position")


@pytest.mark.long
def test_a_drive_that_is_switched_off_after_its_motion_is_looked_at():
    cascade = OTHERS["cascade"]
    log = simulate_log(cascade, triangle())
    rest = np.zeros(2 * len(log.time))
    after = {name: np.r_[signal, rest + signal[-1]] for name, signal in log.channels.items()}
    after |= {"time": np.arange(3 * len(log.time)) / RATE, "command": np.r_[log.command, rest]}
    assert not [one for one in examine(dataclasses.replace(log, **after), cascade) if one.severity == "fatal"]


@pytest.mark.parametrize("drive", [DRIVE, *OTHERS.values()], ids=["pd", *OTHERS])
def test_a_set_point_in_steps_is_not_frozen(drive):
    time = np.arange(int(8 * RATE)) / RATE
    findings = examine(simulate_log(drive, from_array(time, 1e-4 * np.floor(time / 0.8))), drive)
    assert not [one for one in findings if one.severity == "fatal" or one.channel == "reference"]


@pytest.mark.parametrize("stop", [3008, 3200, 3900])
def test_a_reference_that_stands_while_the_table_moves_is_frozen(stop):
    [finding] = complaints(examine(but(reference=frozen(SOUND.reference, 3000, stop)), DRIVE))
    assert (finding.severity, finding.cause, finding.channel) == ("fatal", "frozen", "reference")


def test_a_second_encoder_that_is_dead_hides_no_sign_and_is_no_rival_of_it():
    findings = complaints(examine(but(command=-SOUND.command, motor_position=frozen(motor(0.0), 2000, 4000)), DRIVE))
    assert [one.cause for one in findings] == ["reversed", "frozen"]
    sign = findings[0]
    assert (sign.rivals, sign.repair) == ((), None)
    assert "besides, motor_position" in sign.remedy
    assert "not certain" not in sign.remedy


def test_a_log_of_many_short_pieces_is_refused():
    [finding] = examine(but(gaps=tuple(range(4, COUNT, 4))), DRIVE)
    assert (finding.severity, finding.cause) == ("fatal", "unreadable")
    assert "no more than 4 of them" in finding.message
