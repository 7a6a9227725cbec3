"""Faults of a log in sentences: what was found, with numbers, and what to do about it."""

from collections.abc import Callable
from typing import NamedTuple

from diffdrive.axis import Axis
from diffdrive.logs.checks.consistency import EXACT, ConsistencyResult
from diffdrive.logs.checks.explanation import ROUGH, WRONG_UNIT, ChannelFault
from diffdrive.logs.checks.factors import unit_error_text
from diffdrive.logs.checks.finding import Severity
from diffdrive.logs.checks.statistics import percent
from diffdrive.logs.log import Log

# A shift is certain if it explains the command five times better, and to EXACT.
BETTER = 0.2
UNIT_MEND = '--unit command=-N or [units] command = "-N" (in volts -V)'


class FaultText(NamedTuple):
    """One fault as a finding says it."""

    severity: Severity
    channel: str
    message: str
    remedy: str
    resembles: str | None = None  # an effect of the catalogue that would look alike
    amount: float | None = None
    invalidates_log: bool = False


def describe_fault(fault: ChannelFault, log: Log, outcome: ConsistencyResult, description: Axis) -> FaultText:
    """The sentences for one fault of an explanation."""
    return _DESCRIPTIONS[fault.cause](fault, log, outcome, description)


def _misfit(outcome: ConsistencyResult) -> float:
    assert outcome.best.fit is not None
    return outcome.best.fit.error


def _misfit_text(outcome: ConsistencyResult) -> str:
    return f"({percent(_misfit(outcome))} % instead of {percent(min(outcome.plain.error, 1.0))} %)"


def _swapped(fault: ChannelFault, log: Log, outcome: ConsistencyResult, description: Axis) -> FaultText:
    return FaultText(
        "fatal",
        "position",
        "reference and position are exchanged: only the other way round the drive file's controller gives the command, "
        f"to {percent(_misfit(outcome))} %, and mass and friction are positive",
        "exchange the two columns",
        invalidates_log=True,
    )


def _rounded(fault: ChannelFault, log: Log, outcome: ConsistencyResult, description: Axis) -> FaultText:
    step = fault.numbers["step"]
    if fault.channel == "command":
        return FaultText(
            "warning",
            "command",
            f"the command has steps of {step:.4g}, and is the drive file's controller's to within half of one",
            "log it with more digits, or before the converter",
        )
    ratio = fault.numbers["ratio"]
    return FaultText(
        "fatal" if ratio > 100 else "warning",
        fault.channel,
        f"the {fault.channel} moves in steps of {step:.4g} m, {ratio:.4g} times the drive file's resolution of "
        f"{step / ratio:g} m; smoothed, it belongs to the command {_misfit_text(outcome)}",
        "log all digits, or correct sensor.resolution if the scale is so coarse",
    )


def _filtered(fault: ChannelFault, log: Log, outcome: ConsistencyResult, description: Axis) -> FaultText:
    numbers = fault.numbers
    if numbers["lag"]:
        what = f"a first-order lag of {numbers['lag']:.3g} samples"
    else:
        where = "centred" if numbers["centred"] else "the last ones"
        what = f"an average over {numbers['length']:.0f} samples, {where}"
    late = f", {numbers['delay']:.3g} samples late" if numbers["delay"] else ""
    return FaultText(
        "fatal" if numbers["delay"] >= 1 else "warning",
        fault.channel,
        f"the {fault.channel} was filtered before it was logged: {what}{late} {_misfit_text(outcome)}",
        f"log the raw {fault.channel}; until then put the same filter on the other channels, so that they belong "
        "together again",
    )


def _decimated(fault: ChannelFault, log: Log, outcome: ConsistencyResult, description: Axis) -> FaultText:
    count = fault.numbers["skipped"]
    return FaultText(
        "fatal",
        "time",
        f"only one row in {count:.0f} was kept, and the time was counted at the full rate: {count:.0f} times slower "
        f"the drive file's controller gives the command {_misfit_text(outcome)}",
        f"multiply the time by {count:.0f}; better, log every sample",
        invalidates_log=True,
    )


def _rectified(fault: ChannelFault, log: Log, outcome: ConsistencyResult, description: Axis) -> FaultText:
    return FaultText(
        "fatal",
        "command",
        f"the command is the absolute value of what the drive file's controller gives {_misfit_text(outcome)}",
        "log the command with its sign",
        invalidates_log=True,
    )


def _reversed(fault: ChannelFault, log: Log, outcome: ConsistencyResult, description: Axis) -> FaultText:
    assert outcome.best.fit is not None
    if fault.channel != "command":
        return FaultText(
            "fatal",
            fault.channel,
            f"the position is {fault.numbers['ratio']:.4g} times the reference: its sign is reversed, and the command "
            f"says that it is the {fault.channel}'s {_misfit_text(outcome)}",
            f"reverse the {fault.channel}",
            invalidates_log=True,
        )
    ratio = fault.numbers["ratio"]
    size = f", and 1 unit of it is {1 / abs(ratio):.4g} N" if abs(abs(ratio) - 1) > WRONG_UNIT else ""
    return FaultText(
        "fatal",
        "command",
        f"the command is {ratio:.4g} times what the drive file's controller gives: its sign is reversed{size}",
        f"reverse the command, in newtons by {UNIT_MEND}, or position and reference (the controller cannot tell which)",
        invalidates_log=outcome.best.fit.error < ROUGH,
    )


def _gain(fault: ChannelFault, log: Log, outcome: ConsistencyResult, description: Axis) -> FaultText:
    ratio, fit = fault.numbers["ratio"], outcome.best.fit
    assert fit is not None
    if fault.numbers.get("both"):
        return FaultText(
            "fatal",
            "position",
            f"position and reference are {ratio:.4g} times what they should be{unit_error_text(ratio)}: the command "
            "fits the drive file's controller otherwise, and mass and friction are then those of the drive file",
            "correct the unit of position and reference",
            invalidates_log=not 1 / 3 < ratio < 3,
        )
    if fault.channel != "command":
        return FaultText(
            "fatal" if not 1 / 1.5 < ratio < 1.5 else "warning",
            fault.channel,
            f"the position is {ratio:.4g} times the reference{unit_error_text(ratio)}, and the command says that it "
            f"is the {fault.channel} that has the wrong unit {_misfit_text(outcome)}",
            f"correct the unit of the {fault.channel}, or the lead, gear or counts per turn behind it",
        )
    factor, off = 1 / ratio, abs(ratio - 1)
    large = not 1 / 3 < ratio < 3
    gains = "" if large else ", or correct the controller's gains"
    if off <= WRONG_UNIT:
        return FaultText(
            "warning",
            "command",
            f"the command is {ratio:.5g} times what the drive file's controller gives: force constant or gains are off "
            f"by {percent(ratio - 1)} %",
            f"correct the gains, or multiply the command by {factor:.5g}",
        )
    what = "volts, amperes or per mille taken as newtons?" if large else "a force constant or a gain is wrong"
    return FaultText(
        "fatal",
        "command",
        f"the command is {ratio:.5g} times what the drive file's controller gives (to {percent(fit.error)} %): {what}",
        f"multiply the command by {factor:.4g} N per unit of it (where [units] says what one is, multiply that by "
        f"{factor:.4g}){gains}",
        None if large else "force_gain",
        None if large else factor - 1.0,
    )


def _offset(fault: ChannelFault, log: Log, outcome: ConsistencyResult, description: Axis) -> FaultText:
    if fault.channel == "command":
        return FaultText(
            "warning",
            "command",
            f"the command carries a constant {fault.numbers['newtons']:.4g} N that the drive file's controller does "
            "not give",
            "an offset of the amplifier or of the logger, or a weight that is fed forward: subtract it if nothing acts",
        )
    metres = fault.numbers["metres"]
    return FaultText(
        "warning",
        fault.channel,
        f"the zero of the reference lies {1e3 * -metres:.6g} mm from that of the position",
        f"add {1e3 * metres:.6g} mm to the reference, or take it off the position"
        + (", which lies off the motor's encoder by as much" if fault.channel == "position" else ""),
    )


def _other_controller(fault: ChannelFault, log: Log, outcome: ConsistencyResult, description: Axis) -> FaultText:
    taps = fault.numbers.get("taps")
    if "ratio" in fault.numbers:
        what = f"with all gains {fault.numbers['ratio']:.4g} times the drive file's"
    elif "samples" in fault.numbers:
        what = f"that forms its velocity over {fault.numbers['samples']:.0f} samples"
    elif taps:
        what = f"that forms its velocity over up to {taps:.0f} samples, as a filter or a fit does"
    else:
        parts = [value for name, value in sorted(fault.numbers.items()) if name.startswith("part")]
        what = (
            f"with other gains, whose parts are {', '.join(f'{value:.4g}' for value in parts)} times the drive file's"
        )
    return FaultText(
        "warning",
        "command",
        f"the command is that of a controller {what} {_misfit_text(outcome)}",
        "state the controller that ran in the drive file; no channel is to be moved or scaled",
    )


def _burst(fault: ChannelFault, log: Log, outcome: ConsistencyResult, description: Axis) -> FaultText:
    numbers = fault.numbers
    disturbance = "give it to the log as its disturbance, and subtract it from the command"
    recording = "subtract it from the command, or log the command that reached the amplifier"
    either = f"if it acted on the table, {disturbance}; if it stands in the log alone, {recording}"
    what, mend = {
        1.0: (": test pulses?", disturbance),
        0.0: (", to which the table does not react: this force never acted", recording),
    }.get(numbers["acted"], ("", either))
    return FaultText(
        "warning",
        "command",
        f"a force of {numbers['newtons']:.4g} N is added to what the drive file's controller gives, "
        f"{numbers['changes']:.0f} times switched, in {100 * numbers['share']:.0f} % of the samples{what}",
        mend,
    )


def _shifted(fault: ChannelFault, log: Log, outcome: ConsistencyResult, description: Axis) -> FaultText:
    assert outcome.best.fit is not None
    i, j = fault.numbers["reference"], fault.numbers["position"]
    error = outcome.best.fit.error
    severity: Severity = (
        "fatal" if i % 1 == 0 and j % 1 == 0 and error < EXACT and error < BETTER * outcome.plain.error else "warning"
    )
    numbers = _misfit_text(outcome)
    # A table seems to answer so many samples sooner as its command is recorded late, or its position early.
    if i == j:
        way = "late" if i > 0 else "early"
        also = "; if the controller really computes that long, set actuator.delay_samples besides" if i > 0 else ""
        return FaultText(
            severity,
            "command",
            f"the recorded command is {_samples_text(i)} {way} (shift {i:+.2g}) against reference and position: the "
            f"controller gives it from the values of sample k{-i:+.2g} {numbers}",
            _shift_remedy(log, "command", -i) + also,
            "loop_delay",
            -i,
        )
    if (i - j) % 1 != 0:
        way = "early" if j > i else "late"
        return FaultText(
            severity,
            "position" if fault.channel == "command" else fault.channel,
            f"the position is {abs(j - i):.2g} of a sample {way} (shift {i - j:+.2g}) against the reference {numbers}; "
            "which of the two is out of time cannot be told",
            "resampled, or logged by another interrupt: log the raw samples of one interrupt",
        )
    if i == 0 or j == 0:
        channel, by = ("position", j) if i == 0 else ("reference", i)
        way = "early" if by > 0 else "late"
        real = " or the controller works on an older measurement" if i == 0 and by > 0 else ""
        return FaultText(
            severity,
            channel,
            f"the recorded {channel} is {_samples_text(by)} {way} (shift {-by:+.2g}) against the other channels{real}:"
            f" the controller gives the command from its value of sample k{-by:+.2g} {numbers}",
            _shift_remedy(log, channel, by),
            "loop_delay" if channel == "position" else None,
            -by if channel == "position" else None,
        )
    return FaultText(
        severity,
        "command",
        f"reference and position are shifted against the command by different amounts, {-i:+.2g} and {-j:+.2g} samples "
        f"{numbers}",
        f"{_shift_remedy(log, 'reference', i)} and {_shift_remedy(log, 'position', j)}; which channel is in time "
        "cannot be told",
        "loop_delay",
        -j,
    )


def _samples_text(count: float) -> str:
    return "one sample" if abs(count) == 1 else f"{abs(count):.2g} samples"


def _shift_remedy(log: Log, channel: str, by: float) -> str:
    """Where to move a channel of a log, and the option that does it, beyond what it was moved by already."""
    mend = f"shift the {channel} by {by:+.2g} samples"
    if by % 1:
        return mend
    before = log.shifts.get(channel, 0)
    key, whole = f"{log.name}:{channel}", round(before + by)
    given = f'"{key}={whole:+d}"' if " " in key else f"{key}={whole:+d}"
    more = f" more than the {before:+d} by which it was moved" if before else ""
    return f'{mend}{more} (--shift {given}, or "{key}" = {whole} in [shifts])'


_DESCRIPTIONS: dict[str, Callable[[ChannelFault, Log, ConsistencyResult, Axis], FaultText]] = {
    "swapped": _swapped,
    "rounded": _rounded,
    "filtered": _filtered,
    "decimated": _decimated,
    "rectified": _rectified,
    "reversed": _reversed,
    "gain": _gain,
    "offset": _offset,
    "other controller": _other_controller,
    "burst": _burst,
    "shifted": _shifted,
}
