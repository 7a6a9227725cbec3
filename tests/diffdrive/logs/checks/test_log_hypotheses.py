"""What happened to a log is named, or its rivals are: no mend is stated that does not lead back to the sound log."""

import dataclasses
import re

import numpy as np
import pytest

from diffdrive import motion
from diffdrive.controllers import UnknownController
from diffdrive.errors import LogError
from diffdrive.logs import Log, read_log
from diffdrive.logs.checks.examine import examine, examine_together
from diffdrive.logs.mapping import ColumnMapping
from diffdrive.logs.write import write_csv
from tests.support.sound_log import FORCE_PER_VOLT, axis_of, simulate_log

RATE = 2_000.0
DRIVE = axis_of(kp=4e6, kd=3e4, noise=0.0)
UNKNOWN = dataclasses.replace(DRIVE, controller=UnknownController())


def triangle():
    return motion.triangular(speed=0.030, stroke=0.015, rounding=0.1, duration=4.0, rate=RATE)


def of(machine, controller=DRIVE) -> Log:
    return simulate_log(dataclasses.replace(machine, controller=controller.controller), triangle())


SOUND = of(DRIVE)


def but(**channels) -> Log:
    return dataclasses.replace(SOUND, **channels)


def rounded(signal, step):
    return step * np.round(signal / step)


def averaged(signal, count, centred=True):
    pad = (count // 2, count // 2) if centred else (count - 1, 0)
    return np.convolve(np.pad(signal, pad, mode="edge"), np.ones(count) / count, "valid")


def every(skip: int) -> Log:
    kept = {name: signal[::skip] for name, signal in SOUND.channels.items() if name != "time"}
    return but(**kept, time=SOUND.time[: len(kept["position"])])


def with_bursts(force=100.0, samples=16, at=(1200, 2500, 4100, 6600)) -> Log:
    command = SOUND.command.copy()
    for k in at:
        command[k : k + samples] += force
    return but(command=command)


def filtered_velocity() -> Log:
    """The controller's velocity is the slope of a line through the last four positions."""
    slopes = np.array([0.3, 0.1, -0.1, -0.3]) * RATE  # newest first
    error = SOUND.reference - SOUND.position
    late = np.stack([np.concatenate([np.full(k, error[0]), error[: len(error) - k]]) for k in range(4)])
    gains = DRIVE.controller.tracking.gains
    return but(command=float(gains.kp) * error + float(gains.kd) * (slopes @ late))


def motor(lost: float) -> np.ndarray:
    speed = np.gradient(SOUND.reference)
    return SOUND.position + 0.5 * lost * np.sign(np.where(np.abs(speed) > 1e-9, speed, 1.0)) + 1e-8


counts = np.round(SOUND.position / 1e-7)


def machine(mass=100.0, coulomb=(63.43, 64.95), guide=3.66e-4):
    friction = dataclasses.replace(
        DRIVE.drive.friction,
        coulomb_screw=type(DRIVE.drive.friction.coulomb_screw)(*coulomb),
        load_coefficient=type(DRIVE.drive.friction.coulomb_screw)(guide, guide),
    )
    plant = dataclasses.replace(DRIVE.drive.plant, mass=mass)
    return dataclasses.replace(DRIVE, drive=dataclasses.replace(DRIVE.drive, friction=friction, plant=plant))


FALLEN = of(machine(coulomb=(13.0, 13.0), guide=0.7e-4))
OTHER = of(machine(mass=170.0, coulomb=(145.0, 35.0)))

# what happened -> the log, the cause, the channels that it may be said of, whether a mend must be stated
HAPPENED = {
    "reference and position swapped": (
        but(reference=SOUND.position, position=SOUND.reference),
        "swapped",
        {"reference", "position"},
        True,
    ),
    "rounded to 10 um": (but(position=rounded(SOUND.position, 1e-5)), "rounded", {"position"}, False),
    "rounded to 1 um": (but(position=rounded(SOUND.position, 1e-6)), "rounded", {"position"}, False),
    "averaged, centred": (but(position=averaged(SOUND.position, 21)), "filtered", {"position"}, False),
    "averaged, the last ones": (but(position=averaged(SOUND.position, 12, False)), "filtered", {"position"}, False),
    "command averaged": (but(command=averaged(SOUND.command, 15)), "filtered", {"command"}, False),
    "every second row": (every(2), "decimated", {"time"}, True),
    "every fifth row": (every(5), "decimated", {"time"}, True),
    "zero of the reference": (but(reference=SOUND.reference + 0.01), "offset", {"reference", "position"}, True),
    "velocity by a fit": (filtered_velocity(), "other controller", {"command"}, False),
    "counter of 16 bits": (
        but(position=((counts + 2**15) % 2**16 - 2**15) * 1e-7),
        "wrapped",
        {"position"},
        True,
    ),
    "absolute value": (but(command=np.abs(SOUND.command)), "rectified", {"command"}, False),
    "volts": (but(command=SOUND.command / FORCE_PER_VOLT), "gain", {"command"}, True),
    "reversed": (but(command=-SOUND.command), "reversed", {"command"}, True),
    "bursts": (with_bursts(), "burst", {"command"}, False),
    "friction fallen to a fifth": (FALLEN, "other machine", {"command"}, False),
    "another machine": (OTHER, "other machine", {"command"}, False),
    "lost motion": (but(motor_position=motor(340e-6)), "lost motion", {"motor_position"}, False),
}


OTHERS = {
    "cascade": axis_of("cascade", 60.0, 2e4, ki=2e6, noise=0.0),
    "pd+fc": axis_of("pd+fc", 4e6, 1.2e4, noise=0.0),
}


@pytest.fixture(scope="module", params=OTHERS)
def remembering(request):
    """A controller that remembers, and a sound log of it."""
    drive = OTHERS[request.param]
    return drive, simulate_log(drive, triangle())


def complaints(findings):
    return [one for one in findings if one.severity != "note"]


@pytest.mark.long
@pytest.mark.parametrize("name", HAPPENED)
def test_what_happened_is_named_first_and_a_mend_leads_back_to_the_sound_log(name):
    log, cause, channels, mended = HAPPENED[name]
    findings = examine(log, DRIVE)
    first = complaints(findings)[0]
    assert (first.cause, first.channel in channels) == (cause, True), "\n".join(map(str, findings))
    stated = [one for one in findings if one.repair is not None]
    assert bool(stated) is mended
    for one in stated:
        log = one.repair.apply(log)
    if not mended or cause == "decimated":
        return
    for channel, signal in SOUND.channels.items():
        size = np.ptp(signal)
        assert np.max(np.abs(log.channels[channel] - log.channels[channel][0] - signal + signal[0])) < 1e-5 * size


@pytest.mark.long
@pytest.mark.parametrize("skip", [2, 3])
def test_rows_that_are_left_out_are_no_other_gains_and_no_pulses(remembering, skip):
    drive, log = remembering
    kept = {name: signal[::skip] for name, signal in log.channels.items() if name != "time"}
    first = complaints(examine(dataclasses.replace(log, **kept, time=log.time[: len(kept["position"])]), drive))[0]
    assert first.cause == "decimated", first
    assert first.repair.steps[0].factor == skip


@pytest.mark.long
def test_what_single_channels_show_of_exchanged_columns_is_not_said_beside(remembering):
    drive, log = remembering
    exchanged = dataclasses.replace(log, reference=log.position, position=log.reference)
    assert [one.cause for one in complaints(examine(exchanged, drive))] == ["swapped"]


@pytest.mark.long
def test_a_cascade_with_a_velocity_over_four_samples_is_another_controller():
    drive = OTHERS["cascade"]
    other = dataclasses.replace(drive, controller=dataclasses.replace(drive.controller, velocity_samples=4))
    [finding] = complaints(examine(simulate_log(other, triangle()), drive))
    assert finding.cause == "other controller"
    assert "its velocity over 4 samples" in finding.message
    assert "no channel is to be shifted" in finding.remedy


def test_a_command_that_overflows_is_no_outlier():
    """An integer of 14 bits, each 0.02 N."""
    counts = np.round((SOUND.command * 164.0 / np.abs(SOUND.command).max() * 1.2) / 0.02)
    scaled = but(command=0.02 * counts)
    overflowed = dataclasses.replace(scaled, command=0.02 * ((counts + 2**13) % 2**14 - 2**13))
    [finding, *_] = complaints(examine(overflowed))
    assert (finding.cause, finding.channel) == ("wrapped", "command")
    np.testing.assert_allclose(finding.repair.apply(overflowed).command, scaled.command, atol=1e-9)


def test_a_force_that_is_switched_is_no_overflow():
    relay = but(command=np.where(SOUND.command > 0, 163.84, -163.84))
    assert not [one for one in examine(relay, DRIVE) if one.cause == "wrapped"]


def test_long_pulses_that_the_table_ignores_stand_in_the_log_alone():
    """Half a second of 60 N would have moved the table by centimetres."""
    command = SOUND.command.copy()
    command[2000:3000] += 60.0
    [finding] = complaints(examine(but(command=command), DRIVE))
    assert finding.cause == "burst"
    assert "never acted" in finding.message
    assert "disturbance" not in finding.remedy


@pytest.mark.parametrize(
    "name", [name for name, (_, cause, *_) in HAPPENED.items() if cause in ("rounded", "filtered")]
)
def test_what_loses_digits_is_no_unit_and_no_offset(name):
    findings = examine(HAPPENED[name][0], DRIVE)
    assert not {one.cause for one in findings} & {"gain", "offset", "burst", "reversed"}


def test_friction_that_fell_is_no_unit_error_and_never_fatal():
    for drive in (DRIVE, UNKNOWN):
        findings = examine(FALLEN, drive)
        assert not [one for one in findings if one.severity == "fatal"]
        (machine,) = [one for one in findings if one.cause == "other machine"]
        assert "0.2" in machine.message


@pytest.mark.parametrize(
    ("name", "log", "cause"),
    [
        ("sound", SOUND, None),
        ("swapped", HAPPENED["reference and position swapped"][0], "swapped"),
        ("volts", HAPPENED["volts"][0], "gain"),
        ("reversed", HAPPENED["reversed"][0], "reversed"),
        ("absolute value", HAPPENED["absolute value"][0], "rectified"),
        ("every second row", HAPPENED["every second row"][0], "decimated"),
        ("another machine", OTHER, "other machine"),
        ("rounded", HAPPENED["rounded to 10 um"][0], "rounded"),
        ("averaged", HAPPENED["averaged, centred"][0], "filtered"),
    ],
)
def test_without_a_controller_mass_friction_and_counts_decide(name, log, cause):
    found = complaints(examine(log, UNKNOWN))
    assert [one.cause for one in found[:1]] == ([] if cause is None else [cause]), "\n".join(map(str, found))


def test_a_constant_that_two_causes_explain_names_both_and_states_no_mend():
    """20 N beside the command of a PD, or a zero that is 5 um off: no log of this loop decides."""
    first = complaints(examine(but(command=SOUND.command + 20.0), DRIVE))[0]
    assert first.cause == "offset"
    assert first.rivals == ("offset",)
    assert first.repair is None
    assert "does not rule out" in first.remedy


def test_two_logs_that_contradict_one_another_are_named():
    stiff = of(machine(coulomb=(115.0, 117.0)))
    (found,) = examine_together([SOUND, dataclasses.replace(stiff, name="stiff")], DRIVE)
    assert (found.severity, found.cause) == ("warning", "machines differ")
    assert re.search(r"friction of 7[01]\.\d N", found.message)
    assert "stiff" in found.message
    assert examine_together([SOUND, of(DRIVE)], DRIVE) == []
    assert examine_together([SOUND, stiff])[0].cause == "machines differ"


@pytest.mark.parametrize(("written", "declared"), [(1e3, "us"), (1.0, "us"), (1e6, "ms"), (1e3, "s"), (1.0, "ms")])
def test_a_time_in_another_unit_than_declared_names_the_unit_that_it_has(tmp_path, written, declared):
    path = tmp_path / "run.csv"
    write_csv(path, SOUND.channels | {"time": written * SOUND.time})
    mapping = ColumnMapping(units={"time": declared})
    truth = {1.0: "s", 1e3: "ms", 1e6: "us"}[written]
    with pytest.raises(LogError, match=rf'read in {declared}, make .* Write \[units\] time = "{truth}"'):
        read_log(path, mapping=mapping, rate=RATE)
    assert read_log(path, mapping=ColumnMapping(units={"time": truth}), rate=RATE).rate == pytest.approx(RATE)
