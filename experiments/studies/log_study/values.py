"""Faults in the values of a channel: its unit, sign, zero, digits, filter, and single samples."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from diffdrive.logs.log import Log, Signal
from experiments.studies.log_study.drives import StudyDrive
from experiments.studies.log_study.fault import (
    COMMAND_SHARE,
    FaultKind,
    LogFault,
    channel_fault,
    following_error,
    log_uniform,
    moving_samples,
    noise_std,
    robust_range,
    with_channels,
)
from experiments.studies.log_study.sound import LogCase

RATIOS = (1000.0, 1e-3, 25.4, 1 / 25.4, 2 * np.pi, 0.5 / np.pi)
COUNTER = 2**16


def controller_known(drive: StudyDrive) -> bool:
    """Whether the drive file names the controller."""
    return drive.kind != "unknown"


def swapped(case: LogCase, rng: np.random.Generator) -> LogFault:
    """Reference and position exchanged."""
    log = case.log
    return LogFault(
        exchange(log), log, "reference and position", ("swapped",), ("reference", "position"), undo=exchange
    )  # fmt: skip


def exchange(log: Log) -> Log:
    """The log with reference and position exchanged."""
    assert log.reference is not None
    return replace(log, reference=log.position, position=log.reference)


def _rounded(case: LogCase, channel: str, step: float) -> LogFault:
    signal = getattr(case.log, channel)
    unit = "N" if channel == "command" else "m"
    return channel_fault(case, channel, step * np.round(signal / step), f"to {step:.3g} {unit}", "rounded")


def position_rounded(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """To 2 to 200 times the resolution: still a position, hence at least twenty steps of travel."""
    step = case.drive.resolution * log_uniform(rng, 2.0, 200.0)
    return None if robust_range(case.log.position) < 20 * step else _rounded(case, "position", step)


def reference_rounded(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """As the position."""
    step = case.drive.resolution * log_uniform(rng, 5.0, 200.0)
    return None if robust_range(case.log.position) < 20 * step else _rounded(case, "reference", step)


def command_rounded(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """To some per cent of its range, and three times its noise at least: less changes nothing."""
    step = robust_range(case.log.command) * log_uniform(rng, 0.02, 0.15)
    return None if step < 3 * noise_std(case.log.command) else _if_significant(case, _rounded(case, "command", step))


def _if_significant(case: LogCase, fault: LogFault) -> LogFault | None:
    """The fault, if it changes the command by more than the uncertainty of a force constant; else None."""
    change = np.std(fault.log.command - case.log.command)
    return fault if change > COMMAND_SHARE * np.std(case.log.command) else None


def averaged(signal: Signal, width: int, *, trailing: bool) -> Signal:
    """Mean of `width` samples, the last of them or the one in the middle being the sample itself."""
    return uniform_filter1d(signal, width, mode="nearest", origin=(width - 1) // 2 if trailing else 0)


def _averaged(case: LogCase, rng: np.random.Generator, channel: str) -> LogFault:
    width, trailing = int(rng.integers(1, 21)) * 2 + 1, bool(rng.integers(2))
    amount = f"{width} samples, {'the last' if trailing else 'centred'}"
    return channel_fault(
        case, channel, averaged(getattr(case.log, channel), width, trailing=trailing), amount, "filtered"
    )  # fmt: skip


def position_averaged(case: LogCase, rng: np.random.Generator) -> LogFault:
    """Over 3 to 41 samples."""
    return _averaged(case, rng, "position")


def command_averaged(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """Over 3 to 41 samples."""
    return _if_significant(case, _averaged(case, rng, "command"))


def _offset(
    case: LogCase, channel: str, amount: float, channels: tuple[str, ...], rivals: tuple[str, ...] = ()
) -> LogFault:
    unit = "N" if channel == "command" else "m"

    def undo(log: Log) -> Log:
        return with_channels(log, {channel: getattr(log, channel) - amount})

    return channel_fault(
        case, channel, getattr(case.log, channel) + amount, f"{amount:+.3g} {unit}", "offset", undo=undo,
        channels=channels, rivals=rivals,
    )  # fmt: skip


def zero_of_length(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """Reference or position from another zero, 1 um to 50 mm: which of them moved, no log says.

    It must be a visible part of the following error; without a known controller, one that no loop has.
    """
    amount = log_uniform(rng, 1e-6, 0.05) * float(rng.choice([-1.0, 1.0]))
    error = following_error(case.log)
    least = 0.2 * float(np.std(error)) if controller_known(case.drive) else 10.0 * float(np.max(np.abs(error)))
    if abs(amount) < max(least, 5 * case.drive.resolution):
        return None
    # with a stiffness the same command constant explains it; with none, no loop does
    channels = ("reference", "position", "command") if case.drive.static_stiffness else ("reference", "position")
    return _offset(case, str(rng.choice(["reference", "position"])), amount, channels)


def zero_of_command(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """1 to 30 % of the command's range.

    Where an integral or an observer compensates it, the machine may have that force: a log cannot tell.
    """
    amount = robust_range(case.log.command) * log_uniform(rng, 0.01, 0.3) * float(rng.choice([-1.0, 1.0]))
    if case.drive.static_stiffness:
        return _offset(case, "command", amount, ("command", "reference", "position"))
    return _offset(case, "command", amount, ("command", "reference", "position"), ("other machine",))


def _draw_factor(case: LogCase, rng: np.random.Generator, *, electric: bool) -> tuple[float, str]:
    """A unit's factor, or any; without a known controller beyond what friction can be off by."""
    least = 1.05 if controller_known(case.drive) else 4.0
    kind = rng.integers(3 if electric else 2)
    if kind == 2:
        factor = 1 / rng.uniform(10.0, 200.0)
        return factor, f"N as V, {1 / factor:.4g} N/V"
    factor = float(rng.choice(RATIOS)) if kind else log_uniform(rng, least, 20.0) ** float(rng.choice([-1.0, 1.0]))
    return factor, f"x {factor:.5g}"


def _scaled(
    case: LogCase, scaled: tuple[str, ...], factor: float, amount: str, *, also_channels: tuple[str, ...] = (),
    rivals: tuple[str, ...] = (),
) -> LogFault:  # fmt: skip
    def scale_by(log: Log, by: float) -> Log:
        return with_channels(log, {channel: by * getattr(log, channel) for channel in scaled})

    return LogFault(
        scale_by(case.log, factor), case.log, amount, ("gain",), scaled + also_channels, rivals,
        undo=lambda log: scale_by(log, 1 / factor),
    )  # fmt: skip


def gain_of_position(case: LogCase, rng: np.random.Generator) -> LogFault:
    """The position in another unit; where only the two lengths are evidence, the reference may be the wrong one."""
    factor, amount = _draw_factor(case, rng, electric=False)
    return _scaled(
        case, ("position",), factor, amount, also_channels=() if controller_known(case.drive) else ("reference",)
    )


def gain_of_reference(case: LogCase, rng: np.random.Generator) -> LogFault:
    """The reference in another unit; likewise."""
    factor, amount = _draw_factor(case, rng, electric=False)
    return _scaled(
        case, ("reference",), factor, amount, also_channels=() if controller_known(case.drive) else ("position",)
    )


def gain_of_both(case: LogCase, rng: np.random.Generator) -> LogFault:
    """Both lengths in another unit."""
    factor, amount = _draw_factor(case, rng, electric=False)
    both = ("reference", "position") + (() if case.log.motor_position is None else ("motor_position",))
    return _scaled(case, both, factor, amount)


def gain_of_command(case: LogCase, rng: np.random.Generator) -> LogFault:
    """Volts, or another factor; where no controller is known, another machine would need the same command."""
    factor, amount = _draw_factor(case, rng, electric=True)
    return _scaled(
        case, ("command",), factor, amount, rivals=() if controller_known(case.drive) else ("other machine",)
    )


def reversed_sign(case: LogCase, rng: np.random.Generator) -> LogFault:
    """Of one channel, or of all where the drive file distinguishes the mirrored axis."""
    names = ["reference", "position", "command"] + ([] if case.drive.mirrorable else ["all"])
    which = str(rng.choice(names))
    channels = tuple(name for name in case.log.channels if name not in ("time", "load")) if which == "all" else (which,)

    def undo(log: Log) -> Log:
        return with_channels(log, {channel: -getattr(log, channel) for channel in channels})

    return LogFault(undo(case.log), case.log, which, ("reversed",), channels, undo=undo)


def wrapped(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """The position's counter has 16 bits."""
    period, position = COUNTER * case.drive.resolution, case.log.position
    low = float(rng.choice([0.0, -0.5])) * period
    short = (position - low) % period + low
    if np.sum(np.abs(np.diff(short)) > 0.5 * period) < 2:
        return None

    def undo(log: Log) -> Log:
        full = np.unwrap(log.position, period=period)
        return replace(log, position=full + period * np.round(np.median(log.reference - full) / period))

    return channel_fault(case, "position", short, f"at {period:.3g} m", "wrapped", undo=undo)


def rectified(case: LogCase, rng: np.random.Generator) -> LogFault:
    """The command without its sign."""
    return channel_fault(case, "command", np.abs(case.log.command), "absolute value", "rectified")


def clipped(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """The command's logger saturates for one to twenty per cent of the samples."""
    size = np.abs(case.log.command)
    level = float(np.quantile(size, 1.0 - log_uniform(rng, 0.01, 0.2)))
    if level > 0.9 * np.max(size):
        return None
    return channel_fault(case, "command", np.clip(case.log.command, -level, level), f"at {level:.3g} N", "clipped")


def frozen(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """The position stands for 20 to 500 ms while the table moves."""
    length = round(log_uniform(rng, 0.02, 0.5) * case.drive.rate)
    begin = int(rng.choice(moving_samples(case.log)))
    position = case.log.position.copy()
    if begin + length > len(position):
        return None
    travel = float(np.ptp(position[begin : begin + length]))
    position[begin : begin + length] = position[begin]
    least = max(100 * case.drive.resolution, 3 * float(np.std(following_error(case.log))))
    if travel < least:
        return None
    return channel_fault(
        case, "position", position, f"{1e3 * length / case.drive.rate:.3g} ms, {travel:.3g} m", "frozen"
    )


def outliers(case: LogCase, rng: np.random.Generator) -> LogFault:
    """One to twenty samples of position or command far from their neighbours."""
    channel = str(rng.choice(["position", "command"]))
    signal = getattr(case.log, channel).copy()
    samples = rng.choice(np.arange(50, len(signal) - 50, 10), int(rng.integers(1, 21)), replace=False)
    least = (
        max(0.02 * robust_range(signal), 20 * noise_std(signal))
        if channel == "command"
        else 200 * case.drive.resolution
    )
    size = least * log_uniform(rng, 1.0, 20.0)
    signal[samples] += size * rng.choice([-1.0, 1.0], len(samples))
    return channel_fault(case, channel, signal, f"{len(samples)} of {size:.3g} in the {channel}", "outliers")


def burst(case: LogCase, rng: np.random.Generator) -> LogFault:
    """Pulses of 20 to 100 % of the command's range, 2 to 20 ms long, to which the table does not react."""
    command, places = case.log.command.copy(), int(rng.integers(1, 6))
    length = max(2, round(rng.uniform(2e-3, 20e-3) * case.drive.rate))
    size = robust_range(command) * rng.uniform(0.2, 1.0)
    pulses = np.zeros(len(command))
    room = len(command) // (places + 1)
    for k in range(places):
        begin = (k + 1) * room - int(rng.integers(0, room // 2))
        pulses[begin : begin + length] = size * float(rng.choice([-1.0, 1.0]))

    def undo(log: Log) -> Log:
        return replace(log, command=log.command - pulses)

    amount = f"{places} of {size:.3g} N, {1e3 * length / case.drive.rate:.3g} ms"
    return channel_fault(case, "command", command + pulses, amount, "burst", undo=undo)


VALUE_FAULTS = (
    FaultKind("reference and position exchanged", swapped),
    FaultKind("position rounded", position_rounded),
    FaultKind("reference rounded", reference_rounded, controller_known),
    FaultKind("command rounded", command_rounded),
    FaultKind("position averaged", position_averaged),
    FaultKind("command averaged", command_averaged, controller_known),
    FaultKind("zero of reference or position", zero_of_length),
    FaultKind("constant on the command", zero_of_command, controller_known),
    FaultKind("gain of position", gain_of_position),
    FaultKind("gain of reference", gain_of_reference),
    FaultKind("gain of both lengths", gain_of_both),
    FaultKind("gain of command", gain_of_command),
    FaultKind("sign", reversed_sign),
    FaultKind("counter of 16 bits", wrapped),
    FaultKind("absolute value of the command", rectified),
    FaultKind("clipped command", clipped),
    FaultKind("frozen position", frozen),
    FaultKind("outliers", outliers),
    FaultKind("pulses in the command", burst, controller_known),
)
