"""The drive file's controller put to a log: which shift, and which past, explains the logged command best.

A controller that remembers began before the log did. So it is put to the log twice: over all of it, fed what it asks
for itself, so that no wrong unit of the logged command reaches its observer; and, where that does not explain the
command, over the later half, by which it has forgotten how it began.
"""

from typing import NamedTuple

import numpy as np

from diffdrive.drive_file import DriveDescription
from diffdrive.logs.checks.motion import speed_at
from diffdrive.logs.checks.replay import SETTLE, is_linear, outputs, remembers_nothing, shifted
from diffdrive.logs.checks.statistics import Fit, longest_piece, mean_step, robust_fit
from diffdrive.logs.checks.stuck import clipped
from diffdrive.logs.checks.switching import Switched, switching
from diffdrive.logs.log import Log, Signal

# Whole-sample shifts of reference and of position that are tried.
REACH = 2
# A controller is software: put to its own inputs it gives back its output to the rounding of the log. 3 % is the most
# that a coarse log or numerical derivatives of the reference cost; beyond half it is another controller.
EXPLAINED, RELATED = 0.03, 0.5
# s: a controller that remembers is not judged by less; in it the table may hardly leave its rest.
SHORTEST = 0.5
# What explains the command this well needs no other explanation; a load that is slow to be forgotten leaves the latter.
PLAINLY, PLAINLY_LATE = 1e-3, 3e-3
# A shift must leave less than these shares of the misfit; a past can look a little like one.
CLEAR, CLEAR_OF_THE_PAST = 0.5, 0.1
# An observer fed by the log follows it even where its scale is wrong, so it must come as close as this to be believed.
EXACT = 0.01


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
    late: bool  # only over the later half: the controller's past is not in the log

    @property
    def related(self) -> bool:
        """Whether the controller has anything to do with the command."""
        return self.best.fit.error < RELATED


class _Replay(NamedTuple):
    """How the controller is put to a piece of a log."""

    log: Log
    description: DriveDescription
    piece: slice
    late: bool  # what it began with is forgotten, and no longer looks like a shift or a scale

    def outputs(self, shifts: list[tuple[int, int]]) -> np.ndarray:
        """The controller's commands (N) [m, n] with reference and position some samples later."""
        reference, position = self.log.reference[self.piece], self.log.position[self.piece]  # type: ignore[index]
        # a linear controller forgets all but a constant by itself; fed by the log, it would follow any command
        fed = self.late and not is_linear(self.description.controller)
        return outputs(
            self.description,
            np.stack([shifted(reference, i) for i, _ in shifts]),
            np.stack([shifted(position, j) for _, j in shifts]),
            speed_at(self.log, self.piece.start),
            self.log.command[self.piece] if fed else None,
        )

    def judged(self, signal: Signal) -> Signal:
        """A signal (of the log or of the piece) without its ends, without what the controller's past reaches, and
        without the samples at which the command is clipped: there it is not the controller's.
        """
        inner = signal[self.piece] if len(signal) == len(self.log.time) else signal
        within = slice(len(inner) // 2 if self.late else SETTLE, -SETTLE)
        return inner[within][~clipped(self.log.command)[self.piece][within]]

    def fit(self, *outputs: Signal) -> Fit:
        columns = [self.judged(output) for output in outputs]
        disturbance = self.log.disturbance
        if disturbance is not None and np.std(disturbance[self.piece]) > 0:
            columns.append(self.judged(disturbance))
        return robust_fit(columns, self.judged(self.log.command))


def compare(log: Log, description: DriveDescription) -> Comparison | None:
    """Put the controller to the log; None where that says nothing: no reference, another rate, too short, no motion."""
    piece, step, forgets = longest_piece(log), mean_step(log), remembers_nothing(description.controller)
    count = piece.stop - piece.start
    too_short = count < 20 * SETTLE or (not forgets and count * step < SHORTEST)
    if log.reference is None or abs(step * description.sampling.rate - 1) > 0.01 or too_short:
        return None
    found = _explained(_Replay(log, description, piece, late=False))
    if found is None or found.plain.fit.error < PLAINLY or forgets:
        return found
    late = _explained(_Replay(log, description, piece, late=True))
    return late if late is not None and _is_the_past(found, late) else found


def _is_the_past(whole: Comparison, late: Comparison) -> bool:
    """Whether the later half is explained better, and by the same controller: a constant explains a rest, too."""
    closer = late.best.fit.error < min(0.5 * whole.best.fit.error, EXACT)
    scales = late.best.fit.coefficients[0], whole.best.fit.coefficients[0]
    return closer and 0.5 * abs(scales[1]) < abs(scales[0]) < 2.0 * abs(scales[1])


def _explained(replay: _Replay) -> Comparison | None:
    """The best explanation in this way of replaying; None where the controller or the log gives nothing."""
    log, piece = replay.log, replay.piece
    output = replay.outputs([(0, 0)])[0]
    if not np.all(np.isfinite(output)) or np.std(output) == 0 or np.std(log.command[piece]) == 0:
        return None
    best = plain = Match(0, 0, replay.fit(output), output)
    if plain.fit.error > (PLAINLY_LATE if replay.late else PLAINLY):
        best = _best_shift(replay, plain)
    switched = None
    if best.fit.error > EXPLAINED and log.disturbance is None:
        seen = replay._replace(piece=slice(piece.start, piece.start + len(best.output)))
        switched = switching(seen.judged(log.command), seen.judged(best.output))
        best = best if switched is None else best._replace(fit=switched.fit)
    if switched is not None and switched.changes == 1 and not remembers_nothing(replay.description.controller):
        switched = None  # the friction that held the table as the log began, until it moved
    return Comparison(best, plain, _around(replay, plain), switched, replay.late)


def _around(replay: _Replay, plain: Match) -> tuple[float, float, float]:
    command, gain = replay.judged(replay.log.command), plain.fit.coefficients[0]
    changes = (replay.judged(plain.output - shifted(plain.output, s)) for s in (-1, 0, 1))
    misses = (plain.fit.residual + gain * change for change in changes)
    early, now, late = (float(np.linalg.norm(miss) / np.linalg.norm(command)) for miss in misses)
    return early, now, late


def _best_shift(replay: _Replay, plain: Match) -> Match:
    piece = replay.piece
    replay = replay._replace(piece=slice(piece.start, min(piece.stop, piece.start + 40_000)))  # a shift shows anywhere
    pairs = [(i, j) for i in range(-REACH, REACH + 1) for j in range(-REACH, REACH + 1)]
    commands = replay.outputs(pairs)
    matches = [Match(i, j, replay.fit(u), u) for (i, j), u in zip(pairs, commands, strict=True)]
    best = min(matches, key=lambda match: (match.fit.error, abs(match.reference) + abs(match.position)))
    # what is remembered wrongly looks like a part of a sample
    if replay.late or remembers_nothing(replay.description.controller):
        now = commands[pairs.index((0, 0))]
        parts = [_part(replay, commands[pairs.index(pair)], now, pair) for pair in ((0, 1), (1, 0), (1, 1))]
        part = min(parts, key=lambda match: match.fit.error)
        # a part of a sample must earn its place against whole ones
        if max(abs(part.reference), abs(part.position)) < 0.95 and part.fit.error < 0.5 * best.fit.error:
            best = part
    clear = CLEAR if remembers_nothing(replay.description.controller) else CLEAR_OF_THE_PAST
    return best if best.fit.error < min(clear * plain.fit.error, 0.2) else plain


def _part(replay: _Replay, late: Signal, now: Signal, pair: tuple[int, int]) -> Match:
    """The match at the part of a whole shift that explains the command best, by interpolation."""
    ratio, change = replay.fit(now, late - now).coefficients[:2]
    share = float(change / ratio) if ratio else 0.0
    output = now + share * (late - now)
    return Match(share * pair[0], share * pair[1], replay.fit(output), output)
