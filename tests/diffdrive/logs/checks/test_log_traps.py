"""Traps that real logs hold, put into a sound simulated log one at a time: each must be found and named."""

import re

import numpy as np
import pytest

from diffdrive.logs.checks.examine import examine
from tests.support.sound_log import (
    COUNT,
    DRIVE,
    FASTEST,
    FORCE_PER_VOLT,
    SOUND,
    SPEED,
    both,
    decimated,
    delayed,
    frozen,
    matching,
    repeated,
    replaced,
    rounded,
    spiked,
    square,
    with_nan,
    without_rows,
)

VELOCITY = np.gradient(SOUND.position, SOUND.time)
MOTOR = SOUND.position + 3e-8 * np.random.default_rng(0).standard_normal(COUNT)
MEASURED = np.convolve(VELOCITY, np.ones(5) / 5, "same")
jitter = np.random.default_rng(1).uniform(-1, 1, COUNT)

# name -> (the log, severity, channel, what its text must say)
CORRUPTED = {
    # units of the command
    "volts": (
        replaced(command=SOUND.command / FORCE_PER_VOLT),
        "fatal",
        "command",
        r"0\.00626\d* times.*volts.*159\.6 N",
    ),
    "millinewtons": (replaced(command=1e3 * SOUND.command), "fatal", "command", r"1000 times.*0\.001 N"),
    "kilonewtons": (replaced(command=1e-3 * SOUND.command), "fatal", "command", r"0\.001 times.*1000 N"),
    "motor torque": (replaced(command=SOUND.command * 0.005 / 2 / np.pi), "fatal", "command", r"0\.0007957.*1257 N"),
    "wrong gear": (replaced(command=2 * SOUND.command), "fatal", "command", r"2 times what.*0\.5 N"),
    "force constant": (replaced(command=0.95 * SOUND.command), "warning", "command", r"0\.95 times.*-5 %"),
    "volts, no reference": (
        replaced(command=SOUND.command / FORCE_PER_VOLT, reference=None),
        "fatal",
        "command",
        r"0\.006\d+ times what mass.*1\d\d N",
    ),
    "offset": (replaced(command=SOUND.command + 20), "warning", "command", r"a constant (20|19\.9\d*) N"),
    # units of the position
    "millimetres": (
        replaced(**{k: 1e3 * v for k, v in both.items()}),
        "fatal",
        "position",
        r"reference are 1000 times what they should be.*mm",
    ),
    "micrometres": (
        replaced(**{k: 1e6 * v for k, v in both.items()}),
        "fatal",
        "position",
        r"reference are 1e\+06 times.*um for m",
    ),
    "inches": (
        replaced(**{k: v / 0.0254 for k, v in both.items()}),
        "fatal",
        "position",
        r"reference are 39\.37 times.*inches",
    ),
    "thousandths": (
        replaced(**{k: 1e-3 * v for k, v in both.items()}),
        "fatal",
        "position",
        r"reference are 0\.001 times.*mm for m",
    ),
    "position in mm": (
        replaced(position=1e3 * SOUND.position),
        "fatal",
        "position",
        r"100[01] times the reference.*mm for m",
    ),
    "position in inches": (
        replaced(position=SOUND.position / 0.0254),
        "fatal",
        "position",
        r"39\.\d* times the ref.*inches",
    ),
    "position in degrees": (
        replaced(position=np.degrees(SOUND.position)),
        "fatal",
        "position",
        r"57\.\d* times the reference.*degrees",
    ),
    "position in radians of a turn": (
        replaced(position=2 * np.pi * SOUND.position),
        "fatal",
        "position",
        r"6\.2\d* times the reference.*2 pi",
    ),
    "position in counts": (replaced(position=SOUND.position / 1e-7), "fatal", "position", r"times the reference"),
    "wrong lead": (replaced(position=1.05 * SOUND.position), "warning", "position", r"1\.05\d* times the reference"),
    # signs
    "command reversed": (replaced(command=-SOUND.command), "fatal", "command", r"-1 times what.*sign is reversed"),
    "command reversed, no reference": (
        replaced(command=-SOUND.command, reference=None),
        "fatal",
        "command",
        r"against the motion.*reversed",
    ),
    "position reversed": (replaced(position=-SOUND.position), "fatal", "position", r"-(1|1\.0\d*) times the reference"),
    "velocity reversed": (replaced(velocity=-MEASURED), "fatal", "velocity", r"sign is reversed"),
    "motor reversed": (replaced(motor_position=-MOTOR), "fatal", "motor_position", r"-1 times the position"),
    "load reversed": (replaced(load=np.full(COUNT, -5e3)), "fatal", "load", r"negative throughout \(-5000"),
    "load lifts": (
        replaced(load=2e4 * np.sin(SOUND.time) - 1.6e4),
        "fatal",
        "load",
        r"falls to -1\.6e\+04 N.*lift off",
    ),
    "load cell zero": (replaced(load=5e3 * np.sin(3 * SOUND.time)), "warning", "load", r"down to -\d+"),
    # timing
    **{
        f"{channel} {shift:+d}": (
            replaced(**{channel: delayed(SOUND.channels[channel], shift)}),
            "fatal",
            channel,
            rf"(one|2) samples? {'late' if shift > 0 else 'early'} \(shift {re.escape(format(shift, '+d'))}\)",
        )
        for channel in ("command", "position", "reference")
        for shift in (-2, -1, 1, 2)
    },
    "clock 1e-5 slow": (replaced(time=SOUND.time * (1 + 1e-5)), "warning", "time", r"off .* by -1e-05.*0\.03 ms"),
    "clock 2e-5 fast": (replaced(time=SOUND.time * (1 - 2e-5)), "warning", "time", r"by 2e-05.*0\.06 ms"),
    "wrong rate": (replaced(time=SOUND.time * 1.25), "fatal", "time", r"1600 Hz, 0\.8 times"),
    "milliseconds": (replaced(time=SOUND.time * 1e3 * 1.1), "fatal", "time", r"times the drive file's 2000 Hz"),
    "every fifth": (decimated(SOUND, 5), "warning", "time", r"one sample in 5: 400 Hz"),
    "stamps rounded": (
        replaced(time=SOUND.time + 2e-8 * jitter),
        "note",
        "time",
        r"rounded by up to \d+\.?\d* ns.*drift by",
    ),
    "stamps scattered": (replaced(time=SOUND.time + 6e-5 * jitter), "warning", "time", r"scatter by up to .* us"),
    "not sorted": (replaced(time=SOUND.time[::-1]), "fatal", "time", r"do not increase, first at sample 1"),
    # rows
    "lost, stamped": (
        without_rows(SOUND, slice(900, 907), restamp=False),
        "fatal",
        "time",
        r"7 samples are missing at 1 ",
    ),
    "lost, listed": (
        replaced(without_rows(SOUND, slice(900, 907), restamp=False), gaps=(900,)),
        "warning",
        "time",
        r"1 gaps, 0\.0035 s",
    ),
    "lost, not stamped": (
        without_rows(SOUND, slice(FASTEST, FASTEST + 3), restamp=True),
        "fatal",
        "time",
        r"3 rows were lost at 1 places",
    ),
    "repeated row": (repeated(SOUND, FASTEST), "fatal", "time", r"1 rows were repeated"),
    "a few samples": (decimated(SOUND, 100), "fatal", "time", r"only 60 samples"),
    # the count grid
    "resampled": (
        replaced(position=np.interp(SOUND.time + 1.7e-4, SOUND.time, SOUND.position)),
        "warning",
        "position",
        r"off the count grid of 1e-07 m.*resampled or filtered",
    ),
    "resampled, in time": (
        replaced(position=np.interp(SOUND.time + 1.7e-4, SOUND.time, SOUND.position)),
        "warning",
        "reference",
        r"position is 0\.3\d of a sample early \(shift -0\.3\d\)",
    ),
    "filtered": (
        replaced(position=np.convolve(np.pad(SOUND.position, 2, "edge"), np.ones(5) / 5, "valid")),
        "warning",
        "position",
        r"filtered before it was logged: an average over 5 samples, centred",
    ),
    "coarse": (replaced(position=rounded(SOUND.position, 1e-6)), "warning", "position", r"steps of 1e-06 m, 10 times"),
    "four digits": (
        replaced(position=rounded(SOUND.position, 1e-4)),
        "fatal",
        "position",
        r"steps of 0\.0001 m, 1000 times",
    ),
    "coarse command": (
        replaced(command=rounded(SOUND.command, 20.0)),
        "warning",
        "command",
        r"is rounded to steps of 20 N; to within half a step",
    ),
    # clipped, frozen, constant, spikes
    "command clipped": (
        replaced(command=np.clip(SOUND.command, -150, 150)),
        "warning",
        "command",
        r"sits at 150 for .*clipped",
    ),
    "position clipped": (
        replaced(position=np.minimum(SOUND.position, 0.03)),
        "fatal",
        "position",
        r"extreme of 0\.03 m.*clipped",
    ),
    "encoder dead": (
        replaced(position=frozen(SOUND.position, 3000, 3800)),
        "fatal",
        "position",
        r"frozen at .* t = 1\.5 to 1\.8995 s",
    ),
    "reference stuck": (
        replaced(reference=frozen(SOUND.reference, 900, 960)),
        "fatal",
        "reference",
        r"frozen.*t = 0\.45 to 0\.4795",
    ),
    "command stuck": (
        replaced(command=frozen(SOUND.command, 3000, 3200)),
        "fatal",
        "command",
        r"frozen.*t = 1\.5 to 1\.5995 s",
    ),
    "logger stuck": (
        replaced(**{n: frozen(SOUND.channels[n], 900, 960) for n in ("reference", "position", "command")}),
        "fatal",
        "position",
        r"frozen.*t = 0\.45 to 0\.4795",
    ),
    "spikes in position": (
        replaced(position=spiked(SOUND.position, 1e-4)),
        "warning",
        "position",
        r"3 single-.* 0\.0001\d* m",
    ),
    "spikes in reference": (
        replaced(reference=spiked(SOUND.reference, 1e-3)),
        "warning",
        "reference",
        r"3 single-.*0\.001 m",
    ),
    "spikes in command": (
        replaced(command=spiked(SOUND.command, -900)),
        "warning",
        "command",
        r"3 single-.* -(9\d\d|89\d)",
    ),
    "spikes in load": (replaced(load=spiked(np.sin(SOUND.time) + 5e3, 400)), "warning", "load", r"3 single-.* 400 N"),
    "position dead": (
        replaced(position=np.zeros(COUNT)),
        "fatal",
        "position",
        r"is 0 throughout, while command and ref",
    ),
    "command dead": (replaced(command=np.full(COUNT, 7.0)), "fatal", "command", r"is 7 throughout"),
    "reference dead": (replaced(reference=np.full(COUNT, 0.01)), "warning", "reference", r"is 0\.01 throughout"),
    "not a number": (replaced(position=with_nan(SOUND.position)), "fatal", "position", r"3 of 6000 .*first sample 100"),
    "infinite": (replaced(command=with_nan(SOUND.command, np.inf)), "fatal", "command", r"3 of 6000"),
    # derived channels
    "velocity derived": (replaced(velocity=VELOCITY), "note", "velocity", r"central difference of the position"),
    "velocity in mm/s": (
        replaced(velocity=1e3 * MEASURED),
        "fatal",
        "velocity",
        r"\d{3,4}(\.\d+)? times the position's der.*mm",
    ),
    "velocity in m/min": (replaced(velocity=60 * MEASURED), "fatal", "velocity", r"(60|59\.9\d*) times.*per minute"),
    "motor copied": (
        replaced(motor_position=SOUND.position),
        "warning",
        "motor_position",
        r"is a copy of the position",
    ),
    "motor in turns": (replaced(motor_position=MOTOR / 0.005), "fatal", "motor_position", r"200 times the position"),
    "load computed": (replaced(load=5 * SOUND.command + 9e3), "warning", "load", r"5 times the command plus 9000 N"),
    "position copied": (replaced(position=SOUND.reference), "fatal", "position", r"tracking error is zero"),
    "reference copied": (replaced(reference=SOUND.position), "fatal", "position", r"tracking error is zero"),
    "feed-forward": (
        replaced(command=100 * np.gradient(SPEED, SOUND.time) + 2e3 * SPEED),
        "warning",
        "command",
        r"from the reference alone",
    ),
    "another controller": (
        replaced(command=SOUND.command + 1e5 * (SOUND.reference - 0.02)),
        "warning",
        "command",
        r"only to \d+ %",
    ),
    # disturbances
    "disturbance twice": (
        replaced(command=SOUND.command + square(50.0), disturbance=square(50.0)),
        "warning",
        "disturbance",
        r"contains 1 N.*twice",
    ),
    "disturbance in volts": (
        replaced(command=SOUND.command + FORCE_PER_VOLT * square(0.5), disturbance=square(0.5)),
        "fatal",
        "disturbance",
        r"159\.\d+ N per unit",
    ),
    "pulses without a channel": (
        replaced(command=SOUND.command - square(80.0)),
        "warning",
        "command",
        r"a force of -(80|79\.\d+|80\.\d+) N is added .* switched, in \d\d %",
    ),
    "temperature": (replaced(temperature=np.full(COUNT, 293.0)), "warning", "temperature", r"293 degC.*"),
    # what the motion cannot teach
    "one direction": (
        replaced(**{n: s[:1500] for n, s in SOUND.channels.items()}),
        "note",
        "position",
        r"positive direction only",
    ),
    "short": (
        replaced(**{n: s[:1000] for n, s in SOUND.channels.items()}),
        "note",
        "position",
        r"moves for 0\.\d+ s only",
    ),
    "begins in motion": (
        replaced(**{n: s[600:] for n, s in SOUND.channels.items()}),
        "note",
        "position",
        r"begins in motion, at \d+(\.\d+)? mm/s",
    ),
}


# two samples are found as one is, by the same replays: a second of them each
MARKED = [pytest.param(name, marks=[pytest.mark.long] * name.endswith(("+2", "-2"))) for name in CORRUPTED]


@pytest.mark.parametrize("name", MARKED)
def test_each_trap_is_found_and_named(name):
    log, severity, channel, text = CORRUPTED[name]
    findings = examine(log, DRIVE)
    assert matching(findings, severity, channel, text), "\n".join(map(str, findings))
    assert severity == "fatal" or not [one for one in findings if one.severity == "fatal"], findings


def test_a_log_at_rest_is_noted_and_does_no_harm():
    noise = 1e-7 * np.round(np.random.default_rng(2).normal(0, 0.5, COUNT))
    rest = replaced(reference=np.zeros(COUNT), position=noise, command=-4e6 * noise)
    assert matching(examine(rest), "note", "position", "rests throughout")
    assert matching(examine(rest, DRIVE), "note", "position", "rests throughout")
