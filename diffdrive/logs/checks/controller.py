"""The logged command against the drive file's controller: its unit, its sign, its timing, and what was added to it."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from diffdrive.drive_file import DriveDescription
from diffdrive.logs.checks.balance import balance, who_is_wrong
from diffdrive.logs.checks.comparison import EXACT, EXPLAINED, Comparison
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.replay import remembers_nothing
from diffdrive.logs.checks.statistics import percent
from diffdrive.logs.log import Log

# A match beyond this says nothing about a few per cent.
ROUGH = 0.1
# A shift is certain if it explains the command five times better, and to EXACT.
BETTER = 0.2
# A force constant is known to some per cent; an error above a tenth is a unit or a wrong gain.
WRONG_UNIT, OFF = 0.1, 0.005
# A load that an observer remembers wrongly scales friction, and so most of the command: in logs cut out of others by up
# to 18 times what it leaves unexplained.
REMEMBERED = 20.0


def timing(log: Log, found: Comparison, description: DriveDescription) -> Iterator[Finding]:
    """Shifts by whole samples; and that there is none."""
    best, plain = found.best, found.plain
    if (best.reference, best.position) == (0, 0):
        early, now, late = found.around
        if plain.fit.error < 0.1 and min(early, late) > 2 * now:
            delay = description.drive.actuator.delay_samples
            also = f", so actuator.delay_samples = {delay} must lie between the command and the force" if delay else ""
            over = " over the later half of the log, its past being unknown" if found.late else ""
            yield Finding(
                "note",
                "command",
                f"the drive file's controller gives the logged command to {percent(now)} % at shift 0{over}, one "
                f"sample earlier to {percent(early)} %, one later to {percent(late)} %: no unit delay is in the "
                f"recording{also}",
                "nothing to mend: command, reference and position are recorded in time",
            )
        return
    whole = best.reference % 1 == 0 and best.position % 1 == 0
    certain = whole and best.fit.error < EXACT and best.fit.error < BETTER * plain.fit.error
    numbers = f"({percent(best.fit.error)} % instead of {percent(plain.fit.error)} %)"
    yield Finding(
        "fatal" if certain else "warning",
        *_shift_told(best.reference, best.position, numbers, partial(_moved, log)),
    )


def _samples(count: float) -> str:
    return "one sample" if abs(count) == 1 else f"{abs(count):.2g} samples"


def _moved(log: Log, channel: str, by: float) -> str:
    """Where to move a channel of a log, and the option that does it, beyond what it was moved by already."""
    mend = f"shift the {channel} by {by:+.2g} samples"
    if by % 1:
        return mend
    before = log.moved.get(channel, 0)
    key, whole = f"{log.name}:{channel}", round(before + by)
    given = f'"{key}={whole:+d}"' if " " in key else f"{key}={whole:+d}"
    more = f" more than the {before:+d} by which it was moved" if before else ""
    return f'{mend}{more} (--shift {given}, or "{key}" = {whole} in [shifts])'


def _shift_told(
    i: float, j: float, numbers: str, moved: Callable[[str, float], str]
) -> tuple[str, str, str, str | None, float | None]:
    """Channel, finding, mend, what resembles it and how much of that, for C(reference[k - i], position[k - j]).

    A table seems to answer so many samples sooner as its command is recorded late, or its position early.
    """
    if i == j:
        way = "late" if i > 0 else "early"
        return (
            "command",
            f"the recorded command is {_samples(i)} {way} (shift {i:+.2g}) against reference and position: the "
            f"controller gives it from the values of sample k{-i:+.2g} {numbers}",
            moved("command", -i)
            + ("; if the controller really computes that long, set actuator.delay_samples besides" if i > 0 else ""),
            "loop_delay",
            -i,
        )
    if (i - j) % 1 != 0:
        way = "early" if j > i else "late"
        return (
            "position",
            f"the position is {abs(j - i):.2g} of a sample {way} (shift {i - j:+.2g}) against the reference {numbers}; "
            "which of the two is out of time cannot be told",
            "resampled, or logged by another interrupt: log the raw samples of one interrupt",
            None,
            None,
        )
    if i == 0 or j == 0:
        channel, shift = ("position", j) if i == 0 else ("reference", i)
        way = "early" if shift > 0 else "late"
        real = " or the controller works on an older measurement" if i == 0 and shift > 0 else ""
        return (
            channel,
            f"the recorded {channel} is {_samples(shift)} {way} (shift {-shift:+.2g}) against the other channels{real}:"
            f" the controller gives the command from its value of sample k{-shift:+.2g} {numbers}",
            moved(channel, shift),
            "loop_delay" if channel == "position" else None,
            -shift if channel == "position" else None,
        )
    return (
        "command",
        f"reference and position are shifted against the command by different amounts, {-i:+.2g} and {-j:+.2g} samples "
        f"{numbers}",
        f"{moved('reference', i)} and {moved('position', j)}; which channel is in time cannot be told",
        "loop_delay",
        -j,
    )


def unit_and_sign(log: Log, found: Comparison, description: DriveDescription) -> Iterator[Finding]:
    """The factor between the logged command and the controller's, and a constant beside it."""
    fit = found.best.fit
    ratio = float(fit.coefficients[0])
    if ratio == 0:
        return
    factor = 1 / abs(ratio)
    if ratio < 0:
        size = f", and 1 unit of it is {factor:.4g} N" if abs(factor - 1) > WRONG_UNIT else ""
        yield Finding(
            "fatal",
            "command",
            f"the command is {ratio:.4g} times what the drive file's controller gives: its sign is reversed{size}",
            'reverse the command, in newtons by --unit command=-N or [units] command = "-N" (in volts -V), or position '
            "and reference (the controller cannot tell which)",
            voids=fit.error < ROUGH,
        )
        return
    large = not 1 / 3 < ratio < 3
    # what the controller explains but roughly says nothing about a few per cent
    if not large and fit.error > ROUGH:
        return
    off = abs(ratio - 1)
    # some hundred samples are one correlation time
    doubt = 3 * fit.error / np.sqrt(max(1.0, len(fit.residual) / 100))
    if not remembers_nothing(description.controller):
        doubt = REMEMBERED * fit.error
    if large or off > max(WRONG_UNIT, doubt):
        what = "volts, amperes or per mille taken as newtons? " if large else "a force constant or a gain is wrong "
        yield Finding(
            "fatal",
            "command",
            f"the command is {ratio:.5g} times what the drive file's controller gives (to {percent(fit.error)} %): "
            + what
            + (who_is_wrong(balance(log, description), ratio) if large else ""),
            f"multiply the command by {factor:.4g} N per unit of it (where [units] says what one is, multiply that by "
            f"{factor:.4g}), or correct the controller's gains",
            None if large else "force_gain",
            None if large else 1.0 / ratio - 1.0,
        )
    elif off > max(OFF, doubt):
        yield Finding(
            "warning",
            "command",
            f"the command is {ratio:.5g} times what the drive file's controller gives: force constant or gains are off "
            f"by {percent(ratio - 1)} %",
            f"correct the gains, or multiply the command by {factor:.5g}",
        )
    offset = float(fit.coefficients[-1])
    size = float(np.std(log.command))
    if remembers_nothing(description.controller) and abs(offset) > max(0.02, 3 * fit.error) * size:
        yield Finding(
            "warning",
            "command",
            f"the command carries a constant {offset / ratio:.4g} N that the drive file's controller does not give",
            "an offset of the amplifier or of the logger, or a weight that is fed forward: subtract it if nothing acts",
        )


def disturbance(log: Log, found: Comparison) -> Iterator[Finding]:
    """How much of the known disturbance is in the command: none, if it is a force beside the command."""
    fit = found.best.fit
    if log.disturbance is None or len(fit.coefficients) < 3:
        return
    ratio, inside = float(fit.coefficients[0]), float(fit.coefficients[1])
    if abs(inside) * np.std(log.disturbance) < max(10 * fit.error, 1e-3) * np.std(log.command) or ratio == 0:
        return
    newtons = inside / ratio
    right = abs(newtons - 1) < 0.02
    raw = f" ({inside:.5g} units of the command)" if abs(ratio - 1) > WRONG_UNIT else ""
    yield Finding(
        "warning" if right else "fatal",
        "disturbance",
        f"the command contains {newtons:.5g} N per unit of the disturbance{raw}"
        + (": the disturbance is counted twice" if right else ": its scale is wrong, and it is counted twice"),
        "subtract it from the command" + ("" if right else f", and multiply the disturbance by {newtons:.5g}"),
    )


def added(found: Comparison) -> Iterator[Finding]:
    """A force that is switched on and off within the command, and that no channel holds."""
    if found.switched is None:
        return
    newtons = found.switched.height / float(found.best.fit.coefficients[0])
    yield Finding(
        "warning",
        "command",
        f"a force of {newtons:.4g} N is added to what the drive file's controller gives, {found.switched.changes} "
        f"times switched, in {100 * found.switched.share:.0f} % of the samples: test pulses?",
        "give it to the log as its disturbance, and subtract it from the command",
    )


def explained(found: Comparison, description: DriveDescription) -> Iterator[Finding]:
    """A controller that is not, or not quite, the one that made this command."""
    error = found.best.fit.error
    if error > EXPLAINED:
        yield Finding(
            "warning",
            "command",
            f"the drive file's controller gives the logged command only to {percent(min(error, 1.0))} %, whatever the "
            "shift and the scale",
            "another kind of controller, other gains, a filter, or something that is added to the command"
            + ("" if remembers_nothing(description.controller) else "; or what it remembered: log a longer motion"),
        )
