"""Descriptions of faults: what was found, with numbers, and what to do about it."""

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
UNIT_REMEDY = '--unit command=-N or [units] command = "-N" (in volts -V)'


class FaultText(NamedTuple):
    """The texts of a finding for one fault."""

    severity: Severity
    channel: str
    message: str
    remedy: str
    resembles: str | None = None  # an effect of the catalogue that would show alike
    amount: float | None = None
    invalidates_log: bool = False


def describe_fault(fault: ChannelFault, log: Log, result: ConsistencyResult, axis: Axis) -> FaultText:
    """The texts for one fault of an explanation."""
    return _DESCRIPTIONS[fault.cause](fault, log, result, axis)


def _misfit(result: ConsistencyResult) -> float:
    assert result.best.fit is not None
    return result.best.fit.error


def _misfit_text(result: ConsistencyResult) -> str:
    return f"({percent(_misfit(result))} % instead of {percent(min(result.fit_as_logged.error, 1.0))} %)"


def _swapped(fault: ChannelFault, log: Log, result: ConsistencyResult, axis: Axis) -> FaultText:
    return FaultText(
        "fatal",
        "position",
        "reference and position are exchanged: only the other way round the drive file's controller gives the command, "
        f"to {percent(_misfit(result))} %, and mass and friction are positive",
        "exchange the two columns",
        invalidates_log=True,
    )


def _rounded(fault: ChannelFault, log: Log, result: ConsistencyResult, axis: Axis) -> FaultText:
    step = fault.parameters["step"]
    if fault.channel == "command":
        return FaultText(
            "warning",
            "command",
            f"the command is rounded to steps of {step:.4g} N; to within half a step it is the output of the drive "
            "file's controller",
            "log it with more digits, or before the D/A converter",
        )
    ratio = fault.parameters["ratio"]
    return FaultText(
        "fatal" if ratio > 100 else "warning",
        fault.channel,
        f"the {fault.channel} moves in steps of {step:.4g} m, {ratio:.4g} times the drive file's resolution of "
        f"{step / ratio:g} m; smoothed, it agrees with the command {_misfit_text(result)}",
        "log all digits, or correct sensor.resolution if the scale is so coarse",
    )


def _filtered(fault: ChannelFault, log: Log, result: ConsistencyResult, axis: Axis) -> FaultText:
    parameters = fault.parameters
    if parameters["lag"]:
        filter_text = f"a first-order lag of {parameters['lag']:.3g} samples"
    else:
        window_text = "centred" if parameters["centred"] else "the last ones"
        filter_text = f"an average over {parameters['length']:.0f} samples, {window_text}"
    delay_text = f", {parameters['delay']:.3g} samples late" if parameters["delay"] else ""
    return FaultText(
        "fatal" if parameters["delay"] >= 1 else "warning",
        fault.channel,
        f"the {fault.channel} was filtered before it was logged: {filter_text}{delay_text} {_misfit_text(result)}",
        f"log the raw {fault.channel}; until then put the same filter on the other channels, so that they agree again",
    )


def _decimated(fault: ChannelFault, log: Log, result: ConsistencyResult, axis: Axis) -> FaultText:
    count = fault.parameters["skipped"]
    return FaultText(
        "fatal",
        "time",
        f"only one row in {count:.0f} was kept, and the time was counted at the full rate: {count:.0f} times slower "
        f"the drive file's controller gives the command {_misfit_text(result)}",
        f"multiply the time by {count:.0f}; better, log every sample",
        invalidates_log=True,
    )


def _rectified(fault: ChannelFault, log: Log, result: ConsistencyResult, axis: Axis) -> FaultText:
    return FaultText(
        "fatal",
        "command",
        f"the command is the absolute value of what the drive file's controller gives {_misfit_text(result)}",
        "log the command with its sign",
        invalidates_log=True,
    )


def _reversed(fault: ChannelFault, log: Log, result: ConsistencyResult, axis: Axis) -> FaultText:
    assert result.best.fit is not None
    if fault.channel != "command":
        return FaultText(
            "fatal",
            fault.channel,
            f"the position is {fault.parameters['ratio']:.4g} times the reference: its sign is reversed, and the "
            f"command says that it is the {fault.channel}'s {_misfit_text(result)}",
            f"reverse the {fault.channel}",
            invalidates_log=True,
        )
    ratio = fault.parameters["ratio"]
    factor_text = f", and 1 unit of it is {1 / abs(ratio):.4g} N" if abs(abs(ratio) - 1) > WRONG_UNIT else ""
    return FaultText(
        "fatal",
        "command",
        f"the command is {ratio:.4g} times what the drive file's controller gives: its sign is reversed{factor_text}",
        f"reverse the command, in newtons by {UNIT_REMEDY}, or position and reference (the controller does not "
        "show which)",
        invalidates_log=result.best.fit.error < ROUGH,
    )


def _gain(fault: ChannelFault, log: Log, result: ConsistencyResult, axis: Axis) -> FaultText:
    ratio, fit = fault.parameters["ratio"], result.best.fit
    assert fit is not None
    if fault.parameters.get("both"):
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
            f"is the {fault.channel} that has the wrong unit {_misfit_text(result)}",
            f"correct the unit of the {fault.channel}, or the lead, gear or counts per turn behind it",
        )
    correction, error = 1 / ratio, abs(ratio - 1)
    is_large = not 1 / 3 < ratio < 3
    gains_text = "" if is_large else ", or correct the controller's gains"
    if error <= WRONG_UNIT:
        return FaultText(
            "warning",
            "command",
            f"the command is {ratio:.5g} times what the drive file's controller gives: force constant or gains are off "
            f"by {percent(ratio - 1)} %",
            f"correct the gains, or multiply the command by {correction:.5g}",
        )
    cause = "volts, amperes or per mille taken as newtons?" if is_large else "a force constant or a gain is wrong"
    return FaultText(
        "fatal",
        "command",
        f"the command is {ratio:.5g} times what the drive file's controller gives (to {percent(fit.error)} %): {cause}",
        f"multiply the command by {correction:.4g} N per unit of it (where [units] says what one is, multiply that by "
        f"{correction:.4g}){gains_text}",
        None if is_large else "force_gain",
        None if is_large else correction - 1.0,
    )


def _offset(fault: ChannelFault, log: Log, result: ConsistencyResult, axis: Axis) -> FaultText:
    if fault.channel == "command":
        return FaultText(
            "warning",
            "command",
            f"the command carries a constant {fault.parameters['newtons']:.4g} N that the drive file's controller does "
            "not give",
            "an offset of the amplifier or of the logger, or a weight that is fed forward: subtract it if nothing acts",
        )
    metres = fault.parameters["metres"]
    return FaultText(
        "warning",
        fault.channel,
        f"the zero of the reference lies {1e3 * -metres:.6g} mm from that of the position",
        f"add {1e3 * metres:.6g} mm to the reference, or take it off the position"
        + (", which lies off the motor's encoder by as much" if fault.channel == "position" else ""),
    )


def _other_controller(fault: ChannelFault, log: Log, result: ConsistencyResult, axis: Axis) -> FaultText:
    taps = fault.parameters.get("taps")
    if "ratio" in fault.parameters:
        controller_text = f"with all gains {fault.parameters['ratio']:.4g} times the drive file's"
    elif "samples" in fault.parameters:
        controller_text = f"that forms its velocity over {fault.parameters['samples']:.0f} samples"
    elif taps:
        controller_text = f"that forms its velocity over up to {taps:.0f} samples, as a filter or a fit does"
    else:
        factors = [value for name, value in sorted(fault.parameters.items()) if name.startswith("part")]
        controller_text = (
            f"with other gains, whose parts are {', '.join(f'{value:.4g}' for value in factors)} times the drive file's"
        )
    return FaultText(
        "warning",
        "command",
        f"the command is that of a controller {controller_text} {_misfit_text(result)}",
        "state the controller that ran in the drive file; no channel is to be shifted or scaled",
    )


def _burst(fault: ChannelFault, log: Log, result: ConsistencyResult, axis: Axis) -> FaultText:
    parameters = fault.parameters
    disturbance = "give it to the log as its disturbance, and subtract it from the command"
    recording = "subtract it from the command, or log the command that reached the amplifier"
    unknown = f"if it acted on the table, {disturbance}; if it stands in the log alone, {recording}"
    origin, remedy = {
        1.0: (": test pulses?", disturbance),
        0.0: (", to which the table does not react: this force never acted", recording),
    }.get(parameters["acted"], ("", unknown))
    return FaultText(
        "warning",
        "command",
        f"a force of {parameters['newtons']:.4g} N is added to what the drive file's controller gives, "
        f"{parameters['changes']:.0f} times switched, in {100 * parameters['share']:.0f} % of the samples{origin}",
        remedy,
    )


def _shifted(fault: ChannelFault, log: Log, result: ConsistencyResult, axis: Axis) -> FaultText:
    assert result.best.fit is not None
    reference, position = fault.parameters["reference"], fault.parameters["position"]
    error = result.best.fit.error
    severity: Severity = (
        "fatal"
        if reference % 1 == 0 and position % 1 == 0 and error < EXACT and error < BETTER * result.fit_as_logged.error
        else "warning"
    )
    misfits = _misfit_text(result)
    # A table seems to answer so many samples sooner as its command is recorded late, or its position early.
    if reference == position:
        direction = "late" if reference > 0 else "early"
        more = (
            "; if the controller really computes that long, set actuator.delay_samples besides" if reference > 0 else ""
        )
        return FaultText(
            severity,
            "command",
            f"the recorded command is {_samples_text(reference)} {direction} (shift {reference:+.2g}) against "
            f"reference and position: the controller gives it from the values of sample k{-reference:+.2g} {misfits}",
            _shift_remedy(log, "command", -reference) + more,
            "loop_delay",
            -reference,
        )
    if (reference - position) % 1 != 0:
        direction = "early" if position > reference else "late"
        return FaultText(
            severity,
            "position" if fault.channel == "command" else fault.channel,
            f"the position is {abs(position - reference):.2g} of a sample {direction} (shift "
            f"{reference - position:+.2g}) against the reference {misfits}; which of the two is mistimed "
            "cannot be determined",
            "resampled, or logged by another interrupt: log the raw samples of one interrupt",
        )
    if reference == 0 or position == 0:
        channel, shift = ("position", position) if reference == 0 else ("reference", reference)
        direction = "early" if shift > 0 else "late"
        cause = " or the controller works on an older measurement" if reference == 0 and shift > 0 else ""
        return FaultText(
            severity,
            channel,
            f"the recorded {channel} is {_samples_text(shift)} {direction} (shift {-shift:+.2g}) against the other "
            f"channels{cause}: the controller gives the command from its value of sample k{-shift:+.2g} {misfits}",
            _shift_remedy(log, channel, shift),
            "loop_delay" if channel == "position" else None,
            -shift if channel == "position" else None,
        )
    return FaultText(
        severity,
        "command",
        f"reference and position are shifted against the command by different amounts, {-reference:+.2g} and "
        f"{-position:+.2g} samples {misfits}",
        f"{_shift_remedy(log, 'reference', reference)} and {_shift_remedy(log, 'position', position)}; which "
        "channel is in time is undetermined",
        "loop_delay",
        -position,
    )


def _samples_text(count: float) -> str:
    return "one sample" if abs(count) == 1 else f"{abs(count):.2g} samples"


def _shift_remedy(log: Log, channel: str, shift: float) -> str:
    """How to shift a channel of a log, and the option for it, beyond the shifts already applied."""
    remedy = f"shift the {channel} by {shift:+.2g} samples"
    if shift % 1:
        return remedy
    applied = log.shifts.get(channel, 0)
    key, total = f"{log.name}:{channel}", round(applied + shift)
    assignment = f'"{key}={total:+d}"' if " " in key else f"{key}={total:+d}"
    more = f" more than the {applied:+d} by which it was shifted" if applied else ""
    return f'{remedy}{more} (--shift {assignment}, or "{key}" = {total} in [shifts])'


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
