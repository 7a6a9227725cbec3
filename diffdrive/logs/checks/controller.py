"""The logged command against the drive file's controller: its unit, its sign, its timing, and what was added to it."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from diffdrive.drive_file import DriveDescription
from diffdrive.logs.checks.balance import balance, who_is_wrong
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.replay import SETTLE, outputs, remembers_nothing, shifted
from diffdrive.logs.checks.statistics import Fit, longest_piece, mean_step, robust_fit
from diffdrive.logs.log import Log, Signal

# Whole-sample shifts of reference and of position that are tried.
REACH = 2
# A controller is software: put to its own inputs it gives back its output to the rounding of the log. 3 % is the most
# that a coarse log or numerical derivatives of the reference cost; beyond half it is another controller.
EXPLAINED, RELATED = 0.03, 0.5
# A shift is certain if it explains the command five times better, and to 1 %.
BETTER, EXACT = 0.2, 0.01
# A force constant is known to some per cent; an error above a tenth is a unit or a wrong gain.
WRONG_UNIT, OFF = 0.1, 0.005


class Match(NamedTuple):
    """How well the controller gives the command when reference and position are shifted by whole samples."""

    reference: int  # samples by which the reference is taken later
    position: int
    fit: Fit
    output: Signal


class Comparison(NamedTuple):
    """The best match, that without a shift, and the relative errors with the controller's output shifted alone."""

    best: Match
    plain: Match
    around: tuple[float, float, float]  # |fit - command| / |command|, output one sample early, in time, one late

    @property
    def related(self) -> bool:
        """Whether the controller has anything to do with the command."""
        return self.best.fit.error < RELATED


def _fit(log: Log, piece: slice, output: Signal) -> Fit:
    inner = slice(SETTLE, -SETTLE)
    columns = [output[inner]]
    if log.disturbance is not None and np.std(log.disturbance[piece]) > 0:
        columns.append(log.disturbance[piece][inner])
    return robust_fit(columns, log.command[piece][inner])


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
    return Comparison(best, plain, _around(log, piece, plain))


def _around(log: Log, piece: slice, plain: Match) -> tuple[float, float, float]:
    inner = slice(SETTLE, -SETTLE)
    command, gain = log.command[piece][inner], plain.fit.coefficients[0]
    misses = (plain.fit.residual + gain * (plain.output - shifted(plain.output, s))[inner] for s in (-1, 0, 1))
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
    return best if best.fit.error < 0.5 * plain.fit.error and best.fit.error < 0.2 else plain


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
                f"the drive file's controller gives the logged command to {100 * now:.2g} % at shift 0, one "
                f"sample earlier to {100 * early:.2g} %, one later to {100 * late:.2g} %: no unit delay is in the recording{also}",
                "simulate the controller without a delay between measurement and command",
            )
        return
    certain = best.fit.error < max(EXACT, 1e-9) and best.fit.error < BETTER * plain.fit.error
    numbers = f"({100 * best.fit.error:.2g} % instead of {100 * plain.fit.error:.2g} %)"
    yield Finding("fatal" if certain else "warning", *_shift_told(best.reference, best.position, numbers))


def _samples(count: int) -> str:
    return "one sample" if abs(count) == 1 else f"{abs(count)} samples"


def _shift_told(i: int, j: int, numbers: str) -> tuple[str, str, str]:
    """Channel, finding and mend for a command that is C(reference[k - i], position[k - j])."""
    if i == j:
        way, back = ("late", -i) if i > 0 else ("early", -i)
        return (
            "command",
            f"the recorded command is {_samples(i)} {way} (shift {i:+d}) against reference and position: the "
            f"controller gives it from the values of sample k{-i:+d} {numbers}",
            f"shift the command by {back:+d} samples"
            + ("; if the controller really computes that long, set actuator.delay_samples besides" if i > 0 else ""),
        )
    if i == 0 or j == 0:
        channel, shift = ("position", j) if i == 0 else ("reference", i)
        way = "early" if shift > 0 else "late"
        real = " or the controller works on an older measurement" if i == 0 and shift > 0 else ""
        return (
            channel,
            f"the recorded {channel} is {_samples(shift)} {way} (shift {-shift:+d}) against the other channels{real}: "
            f"the controller gives the command from its value of sample k{-shift:+d} {numbers}",
            f"shift the {channel} by {shift:+d} samples",
        )
    return (
        "command",
        f"reference and position are shifted against the command by different amounts, {-i:+d} and {-j:+d} samples "
        f"{numbers}",
        f"shift the reference by {i:+d} and the position by {j:+d} samples; which channel is in time cannot be told",
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
    off = abs(ratio - 1)
    doubt = 3 * fit.error / np.sqrt(max(1.0, len(fit.residual) / 100))  # some hundred samples are one correlation time
    if off > WRONG_UNIT:
        large = not 1 / 3 < ratio < 3
        what = "volts, amperes or per mille taken as newtons? " if large else "a force constant or a gain is wrong "
        yield Finding(
            "fatal",
            "command",
            f"the command is {ratio:.5g} times what the drive file's controller gives (to {100 * fit.error:.2g} %): "
            + what
            + (who_is_wrong(balance(log, description), ratio) if large else ""),
            f"multiply the command by {factor:.4g} N per unit of it, or correct the controller's gains",
        )
    elif off > max(OFF, doubt):
        yield Finding(
            "warning",
            "command",
            f"the command is {ratio:.5g} times what the drive file's controller gives: force constant or gains are off "
            f"by {100 * (ratio - 1):.2g} %",
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


def explained(found: Comparison) -> Iterator[Finding]:
    """A controller that is not, or not quite, the one that made this command."""
    error = found.best.fit.error
    if error > EXPLAINED:
        yield Finding(
            "warning",
            "command",
            f"the drive file's controller gives the logged command only to {100 * min(error, 1.0):.2g} %, whatever the "
            "shift and the scale",
            "another kind of controller, other gains, a filter, or something that is added to the command",
        )
