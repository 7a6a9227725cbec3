"""The logged command against the drive file's controller: its unit, its sign, its timing, and what was added to it."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from diffdrive.drive_file import DriveDescription
from diffdrive.logs.checks.balance import balance, who_is_wrong
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.replay import SETTLE, outputs, remembers_nothing, shifted
from diffdrive.logs.checks.statistics import Fit, longest_piece, mean_step, percent, robust_fit
from diffdrive.logs.checks.stuck import clipped
from diffdrive.logs.checks.switching import Switched, switching
from diffdrive.logs.log import Log, Signal

# Whole-sample shifts of reference and of position that are tried.
REACH = 2
# A controller is software: put to its own inputs it gives back its output to the rounding of the log. 3 % is the most
# that a coarse log or numerical derivatives of the reference cost; beyond half it is another controller.
EXPLAINED, ROUGH, RELATED = 0.03, 0.1, 0.5
# A shift is certain if it explains the command five times better, and to 1 %.
BETTER, EXACT = 0.2, 0.01
# A force constant is known to some per cent; an error above a tenth is a unit or a wrong gain.
WRONG_UNIT, OFF = 0.1, 0.005


class Match(NamedTuple):
    """How well the controller gives the command when reference and position are shifted by whole samples."""

    reference: float  # samples by which the reference is taken later
    position: float
    fit: Fit
    output: Signal


class Comparison(NamedTuple):
    """The best match, that without a shift, and the relative errors with the controller's output shifted alone."""

    best: Match
    plain: Match
    around: tuple[float, float, float]  # |fit - command| / |command|, output one sample early, in time, one late
    switched: Switched | None  # a force that is added to the command at times

    @property
    def related(self) -> bool:
        """Whether the controller has anything to do with the command."""
        return self.best.fit.error < RELATED


def _inside(log: Log, piece: slice, signal: Signal) -> Signal:
    """A signal (of the log or of the piece) without its ends and without the samples at which the command is clipped:
    there it is not the controller's.
    """
    whole = len(signal) == len(log.time)
    inner = signal[piece] if whole else signal
    return inner[SETTLE:-SETTLE][~clipped(log.command)[piece][SETTLE:-SETTLE]]


def _fit(log: Log, piece: slice, *outputs: Signal) -> Fit:
    columns = [_inside(log, piece, output) for output in outputs]
    if log.disturbance is not None and np.std(log.disturbance[piece]) > 0:
        columns.append(_inside(log, piece, log.disturbance))
    return robust_fit(columns, _inside(log, piece, log.command))


def compare(log: Log, description: DriveDescription) -> Comparison | None:
    """Put the controller to the log; None where that says nothing: no reference, another rate, no motion."""
    piece = longest_piece(log)
    same_rate = abs(mean_step(log) * description.sampling.rate - 1) < 0.01
    if log.reference is None or not same_rate or piece.stop - piece.start < 20 * SETTLE:
        return None
    reference, position = log.reference[piece], log.position[piece]
    output = outputs(description, reference[None], position[None])[0]
    if not np.all(np.isfinite(output)) or np.std(output) == 0 or np.std(log.command[piece]) == 0:
        return None
    plain = Match(0, 0, _fit(log, piece, output), output)
    best = plain
    if plain.fit.error > 1e-3:
        best = _best_shift(log, description, piece, plain)
    switched = None
    if best.fit.error > EXPLAINED and log.disturbance is None:
        switched = switching(_inside(log, piece, log.command), _inside(log, piece, best.output))
        best = best if switched is None else best._replace(fit=switched.fit)
    return Comparison(best, plain, _around(log, piece, plain), switched)


def _around(log: Log, piece: slice, plain: Match) -> tuple[float, float, float]:
    command, gain = _inside(log, piece, log.command), plain.fit.coefficients[0]
    changes = (_inside(log, piece, plain.output - shifted(plain.output, s)) for s in (-1, 0, 1))
    misses = (plain.fit.residual + gain * change for change in changes)
    early, now, late = (float(np.linalg.norm(miss) / np.linalg.norm(command)) for miss in misses)
    return early, now, late


def _best_shift(log: Log, description: DriveDescription, piece: slice, plain: Match) -> Match:
    window = slice(piece.start, min(piece.stop, piece.start + 40_000))  # a shift shows in any stretch of the log
    reference, position = log.reference[window], log.position[window]  # type: ignore[index]
    pairs = [(i, j) for i in range(-REACH, REACH + 1) for j in range(-REACH, REACH + 1)]
    commands = outputs(
        description,
        np.stack([shifted(reference, i) for i, _ in pairs]),
        np.stack([shifted(position, j) for _, j in pairs]),
    )
    matches = [Match(i, j, _fit(log, window, u), u) for (i, j), u in zip(pairs, commands, strict=True)]
    best = min(matches, key=lambda match: (match.fit.error, abs(match.reference) + abs(match.position)))
    parts = [
        _part(log, window, u, commands[pairs.index((0, 0))], pair)
        for pair, u in zip(pairs, commands, strict=True)
        if pair in ((0, 1), (1, 0), (1, 1))
    ]
    part = min(parts, key=lambda match: match.fit.error)
    # a part of a sample must earn its place against whole ones
    if max(abs(part.reference), abs(part.position)) < 0.95 and part.fit.error < 0.5 * best.fit.error:
        best = part
    return best if best.fit.error < 0.5 * plain.fit.error and best.fit.error < 0.2 else plain


def _part(log: Log, window: slice, late: Signal, now: Signal, pair: tuple[int, int]) -> Match:
    """The match at the part of a whole shift that explains the command best, by interpolation."""
    ratio, change = _fit(log, window, now, late - now).coefficients[:2]
    share = float(change / ratio) if ratio else 0.0
    output = now + share * (late - now)
    return Match(share * pair[0], share * pair[1], _fit(log, window, output), output)


def timing(found: Comparison, description: DriveDescription) -> Iterator[Finding]:
    """Shifts by whole samples; and that there is none."""
    best, plain = found.best, found.plain
    if (best.reference, best.position) == (0, 0):
        early, now, late = found.around
        if plain.fit.error < 0.1 and min(early, late) > 2 * now:
            delay = description.drive.actuator.delay_samples
            also = f", so actuator.delay_samples = {delay} must lie between the command and the force" if delay else ""
            yield Finding(
                "note",
                "command",
                f"the drive file's controller gives the logged command to {percent(now)} % at shift 0, one "
                f"sample earlier to {percent(early)} %, one later to {percent(late)} %: no unit delay is in the "
                f"recording{also}",
                "simulate the controller without a delay between measurement and command",
            )
        return
    whole = best.reference % 1 == 0 and best.position % 1 == 0
    certain = whole and best.fit.error < EXACT and best.fit.error < BETTER * plain.fit.error
    numbers = f"({percent(best.fit.error)} % instead of {percent(plain.fit.error)} %)"
    yield Finding("fatal" if certain else "warning", *_shift_told(best.reference, best.position, numbers))


def _samples(count: float) -> str:
    return "one sample" if abs(count) == 1 else f"{abs(count):.2g} samples"


def _shift_told(i: float, j: float, numbers: str) -> tuple[str, str, str, str | None]:
    """Channel, finding, mend and what resembles it for a command that is C(reference[k - i], position[k - j])."""
    if i == j:
        way, back = ("late", -i) if i > 0 else ("early", -i)
        return (
            "command",
            f"the recorded command is {_samples(i)} {way} (shift {i:+.2g}) against reference and position: the "
            f"controller gives it from the values of sample k{-i:+.2g} {numbers}",
            f"shift the command by {back:+.2g} samples"
            + ("; if the controller really computes that long, set actuator.delay_samples besides" if i > 0 else ""),
            "loop_delay",
        )
    if (i - j) % 1 != 0:
        way = "early" if j > i else "late"
        return (
            "position",
            f"the position is {abs(j - i):.2g} of a sample {way} (shift {i - j:+.2g}) against the reference {numbers}; "
            "which of the two is out of time cannot be told",
            "resampled, or logged by another interrupt: log the raw samples of one interrupt",
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
            f"shift the {channel} by {shift:+.2g} samples",
            "loop_delay" if channel == "position" else None,
        )
    return (
        "command",
        f"reference and position are shifted against the command by different amounts, {-i:+.2g} and {-j:+.2g} samples "
        f"{numbers}",
        f"shift the reference by {i:+.2g} and the position by {j:+.2g} samples (which channel is in time cannot be "
        "told)",
        "loop_delay",
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
            "reverse the command, or position and reference (the controller cannot tell which)",
        )
        return
    large = not 1 / 3 < ratio < 3
    # what the controller explains but roughly says nothing about a few per cent
    if not large and fit.error > ROUGH:
        return
    off = abs(ratio - 1)
    doubt = 3 * fit.error / np.sqrt(max(1.0, len(fit.residual) / 100))  # some hundred samples are one correlation time
    if off > WRONG_UNIT:
        what = "volts, amperes or per mille taken as newtons? " if large else "a force constant or a gain is wrong "
        yield Finding(
            "fatal",
            "command",
            f"the command is {ratio:.5g} times what the drive file's controller gives (to {percent(fit.error)} %): "
            + what
            + (who_is_wrong(balance(log, description), ratio) if large else ""),
            f"multiply the command by {factor:.4g} N per unit of it, or correct the controller's gains",
            None if large else "force_gain",
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


def explained(found: Comparison) -> Iterator[Finding]:
    """A controller that is not, or not quite, the one that made this command."""
    error = found.best.fit.error
    if error > EXPLAINED:
        yield Finding(
            "warning",
            "command",
            f"the drive file's controller gives the logged command only to {percent(min(error, 1.0))} %, whatever the "
            "shift and the scale",
            "another kind of controller, other gains, a filter, or something that is added to the command",
        )
