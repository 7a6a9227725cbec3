"""Two encoders of one axis: lost motion, and what screw and scale make of the difference of motor and table."""

from collections.abc import Iterator

from diffdrive.axis import Axis
from diffdrive.errors import ParameterError
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.ratios import motor_follows_position
from diffdrive.logs.encoders.comparison import compare_encoders
from diffdrive.logs.encoders.result import EncoderComparison, in_words
from diffdrive.logs.log import Log

MEND_PLAY = (
    "look at nut, coupling and bearing of the screw, and its preload; state it in the drive file as "
    "[effects.backlash], or let a diagnosis find it; identify with the encoder that the controller uses"
)
MEND_WIND_UP = "state it in the drive file as [effects.compliance]; identify with the encoder that the controller uses"


def compared(log: Log, axis: Axis | None) -> EncoderComparison | None:
    """Motor against table; None without a second encoder, in another unit or sign, or where the table hardly moves."""
    if log.motor_position is None or any(motor_follows_position(log)):
        return None
    try:
        return compare_encoders(log, axis)
    except ParameterError:
        return None


def two_encoders(log: Log, axis: Axis | None) -> Iterator[Finding]:
    """Lost motion; linear error, error per turn, drift and time between the encoders."""
    comparison = compared(log, axis)
    if comparison is not None:
        yield from _lost_motion(comparison)
        yield from _screw(comparison)


def _lost_motion(comparison: EncoderComparison) -> Iterator[Finding]:
    error, backlash = comparison.reversal_error, comparison.backlash
    if error is None or backlash is None or not comparison.has_lost_motion:
        return
    scatter = "" if comparison.scatter is None else f", scatter {1e6 * comparison.scatter:.2g} um"
    message = (
        f"motor and table are {in_words(error, 1e6)} um apart between the two directions over "
        f"{len(comparison.reversals)} reversals{scatter}"
    )
    change = comparison.change_along_stroke
    if change is not None and change.is_significant:
        message += f", {in_words(change, 1e6)} um more for each metre along the stroke"
    if comparison.has_backlash:
        message += f": lost motion, {in_words(backlash, 1e6)} um of it backlash whatever the force"
        yield Finding("warning", "motor_position", message, MEND_PLAY, "lost motion")
    elif comparison.may_be_all_backlash:
        message += ": lost motion, backlash or wind-up under friction, which this log does not separate"
        yield Finding("warning", "motor_position", message, MEND_PLAY, "lost motion")
    else:
        message += f": wind-up of the screw under friction, with no more than {1e6 * backlash.high:.3g} um of backlash"
        yield Finding("note", "motor_position", message, MEND_WIND_UP, "lost motion")


def _screw(comparison: EncoderComparison) -> Iterator[Finding]:
    errors = [text for text, _ in comparison.kinematics()]
    if errors:
        yield Finding(
            "note",
            "motor_position",
            f"motor against table: {', '.join(errors)}",
            "compensate them in the control, or state the first two in the drive file as [effects.lead_error]",
            "screw",
        )
