"""What a missing force depends on, in words, and where in the machine that points to."""

from collections.abc import Sequence

from diffdrive.support.spans import rescaled
from tuning.diagnosis.gap.dependence import Dependence
from tuning.diagnosis.levels import LACKING

DIGITS = 2
NAMES = {
    ("position", "force"): ("a force that depends on position", "motor, screw or guide"),
    ("position", "friction"): ("a friction that depends on position", "guide, screw or cover"),
    ("speed", "friction"): ("a friction that depends on speed otherwise than the drive file has it", "lubrication"),
    ("time", "force"): ("a force that comes and goes with time", "process or environment"),
    ("time", "friction"): ("a friction that changes with time", "load, temperature, lubrication or dirt"),
    ("command", "force"): ("a force that is not in proportion to the command", "amplifier or motor"),
    ("past commands", "force"): ("a force that follows the command earlier or later", "control or current loop"),
    ("position", "scale"): ("an error of the scale that depends on position", "scale"),
}
UNITS = {"position": "m", "speed": "m/s", "time": "s", "command": "N", "past commands": "N"}


def dependence_says(one: Dependence) -> str:
    """One function: what it is, how large, where most of it lies, and which part that points to."""
    what, part = NAMES[one.of, one.kind]
    size = _with_unit(one.rms, "m" if one.kind == "scale" else "N")
    says = f"{what}, {size} RMS"
    if one.low is not None and one.high is not None and one.of != "past commands":
        [(low, _, _), (high, _, _)], unit = rescaled([(one.low, None, None), (one.high, None, None)], UNITS[one.of])
        says += f", most of it between {_rounded(low, 3)} and {_rounded(high, 3)} {unit}"
        says += f" of log {one.log}" if one.log else ""
    return f"{says} ({part})"


def dependences_say(found: Sequence[Dependence], what: str) -> str:
    """One sentence: the likeliest, and those that are as likely."""
    if not found:
        return f"{what} depends on nothing in particular: neither place, speed, time nor command explains any of it"
    alike = [one for one in found if one.evidence > found[0].evidence - LACKING]
    return f"{what} looks most like {', or '.join(map(dependence_says, alike))}"


def _with_unit(value: float, unit: str) -> str:
    [(scaled, _, _)], unit = rescaled([(value, None, None)], unit)
    return f"{_rounded(scaled, DIGITS)} {unit}"


def _rounded(value: float, digits: int) -> str:
    return f"{float(f'{value:.{digits}g}'):g}"
