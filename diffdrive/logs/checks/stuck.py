"""Signals that stand still while others move: clipped, frozen, constant."""

from collections.abc import Iterator

import numpy as np

from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.grid import fit_count_grid
from diffdrive.logs.checks.statistics import EqualStretch, equal_stretches, sampling_period, top_speed
from diffdrive.logs.log import Log, Signal

# Equal samples from which a stretch counts; noise on the counts makes a few by chance.
SHORTEST_STRETCH = 5
# Samples at the extreme level, beside those at the next levels: a sine's crest in counts holds 2.4 times its neighbour.
EXTREME_RATIO = 5.0
# A tracking error within a standing stretch that the rest of the log nowhere reaches.
BEYOND = 5.0
ON_THE_MOVE = 0.1  # of the jump that makes up for a standstill: so far a table that waits does not move


def constant(log: Log) -> Iterator[Finding]:
    """Channels that never change; a load, a temperature or an absent disturbance may."""
    moving = {name for name, signal in log.channels.items() if np.ptp(signal) > 0} - {"time"}
    for name in ("reference", "position", "command", "motor_position", "velocity", "current"):
        signal = log.channels.get(name)
        if signal is not None and name not in moving and moving & {"reference", "position", "command"}:
            yield Finding(
                "fatal" if name in ("position", "command") else "warning",
                name,
                f"the {name} is {signal[0]:.6g} throughout, while {' and '.join(sorted(moving))} change",
                "the channel is dead or the wrong column was taken",
                "duplicate",
            )


def samples_at_extreme(signal: Signal, extreme: float) -> np.ndarray | None:
    """Samples that sit exactly at an extreme value far more often than at those next to it, or None."""
    values, counts = np.unique(signal, return_counts=True)
    if len(values) < 20:  # a staircase sits at its extremes by design
        return None
    count = counts[-1] if extreme == values[-1] else counts[0]
    neighbours = counts[-6:-1] if extreme == values[-1] else counts[1:6]
    return signal == extreme if count >= 20 and count > EXTREME_RATIO * neighbours.max() else None


def clipped_samples(command: Signal) -> np.ndarray:
    """Samples at which the command sits at an extreme value far more often than next to it."""
    clipped = np.zeros(len(command), bool)
    for extreme in (float(np.max(command)), float(np.min(command))):
        at_extreme = samples_at_extreme(command, extreme)
        clipped |= False if at_extreme is None else at_extreme
    return clipped


def _standing_stretches(log: Log, name: str) -> list[EqualStretch]:
    """Stretches in which a position stands although the reference goes where it should have followed."""
    signal, reference = log.channels[name], log.reference
    stretches = equal_stretches(signal, SHORTEST_STRETCH)
    if reference is None or name == "reference" or not stretches:
        return []
    standing = np.zeros(len(signal), bool)
    for stretch in stretches:
        if np.ptp(reference[stretch.start : stretch.stop]) > 0.01 * np.ptp(reference):
            standing[stretch.start : stretch.stop] = True
    if not standing.any():
        return []
    errors = (reference - signal)[~standing]
    usual_error = float(np.quantile(np.abs(errors - np.median(errors)), 0.999)) if len(errors) > 100 else 0.0
    return [
        stretch
        for stretch in stretches
        if np.ptp(reference[stretch.start : stretch.stop]) > max(BEYOND * usual_error, 0.01 * float(np.ptp(reference)))
    ]


def _stretches_before_jumps(signal: Signal) -> list[EqualStretch]:
    """Stretches at whose end the signal jumps to make up for them, farther than it ever moves in one sample."""
    steps = np.abs(np.diff(signal))
    usual_step = float(np.quantile(steps, 0.999)) if len(steps) else 0.0
    grid = fit_count_grid(signal)
    smallest_jump = 3 * max(usual_step, 3 * grid.step if grid else 0.0)
    return [
        stretch
        for stretch in equal_stretches(signal, SHORTEST_STRETCH)
        if stretch.stop < len(signal) and stretch.start > 0 and steps[stretch.stop - 1] > max(smallest_jump, 1e-9)
    ]


def _table_moved(log: Log, stretch: EqualStretch) -> bool:
    """Whether the table moved on while the reference stood: a set-point may step, and then the table waits for it.

    Either the table is where the reference goes next as it wakes, or it moved that way over the latter half.
    """
    reference, position = log.reference, log.position
    assert reference is not None
    level, jump = reference[stretch.start], reference[stretch.stop] - reference[stretch.start]
    position = position + float(np.median(reference - position))  # zeros may differ
    has_arrived = (position[stretch.stop - 1] - level) / jump > 0.5
    moved_lately = (position[stretch.stop - 1] - position[(stretch.start + stretch.stop) // 2]) / jump
    return bool(has_arrived or moved_lately > ON_THE_MOVE)


def frozen_position(log: Log) -> Iterator[Finding]:
    """Reference, position or motor position that stands while it should move."""
    for name in ("reference", "position", "motor_position"):
        signal = log.channels.get(name)
        if signal is None or np.ptp(signal) == 0:
            continue
        frozen = _standing_stretches(log, name) or _stretches_before_jumps(signal)
        if name == "reference":
            frozen = [stretch for stretch in frozen if _table_moved(log, stretch)]
        if not frozen:
            continue
        longest = max(frozen, key=lambda stretch: stretch.length)
        level = float(signal[longest.start])
        share = sum(stretch.length for stretch in frozen) / len(signal)
        span_text = f"t = {log.time[longest.start]:.6g} to {log.time[longest.stop - 1]:.6g} s"
        if level in (float(np.max(signal)), float(np.min(signal))) and longest.start > 0:
            message = (
                f"the {name} sits at its extreme of {level:.6g} m while the axis moves on, {100 * share:.2g} % of the "
            )
            yield Finding(
                "fatal",
                name,
                message + f"samples, longest {span_text}: clipped or frozen",
                "widen the logger's range, or cut these stretches out and list the gaps",
                "clipped",
            )
        else:
            yield Finding(
                "fatal",
                name,
                f"the {name} is frozen at {level:.6g} m, longest {span_text}, {100 * share:.2g} % of the samples in "
                "all",
                "encoder dead or logger stuck: cut the stretch out and list the gap",
                "frozen",
            )


def frozen_command(log: Log) -> Iterator[Finding]:
    """A command that stands within its range while the table moves."""
    steps = np.diff(log.command)
    if np.ptp(log.command) == 0 or np.mean(steps == 0) > 0.5:  # a coarse command stands often
        return
    speed = top_speed(log.position, sampling_period(log))
    extremes = (float(np.max(log.command)), float(np.min(log.command)))
    stretches = [
        stretch
        for stretch in equal_stretches(log.command, SHORTEST_STRETCH)
        if log.command[stretch.start] not in extremes
    ]
    lengths = sorted(stretch.length for stretch in stretches)
    for stretch in sorted(stretches, key=lambda stretch: -stretch.length)[:1]:
        travel = float(np.ptp(log.position[stretch.start : stretch.stop]))
        # it must outlast the other standing stretches three times, and the table must be on the move meanwhile
        ordinary = lengths[-2] if len(lengths) > 1 else 1
        if stretch.length < max(20, 3 * ordinary) or travel < 0.1 * speed * stretch.length * sampling_period(log):
            continue
        # where the error stands as well, as at a count of the scale a sample, so may the command
        if log.reference is not None:
            error = log.reference - log.position
            if np.ptp(error[stretch.start : stretch.stop]) < 1e-6 * np.ptp(error):
                continue
        span_text = f"t = {log.time[stretch.start]:.6g} to {log.time[stretch.stop - 1]:.6g} s"
        yield Finding(
            "fatal",
            "command",
            f"the command is frozen at {log.command[stretch.start]:.6g} from {span_text} while the table moves "
            f"{travel:.3g} m",
            "the logger was stuck: cut the stretch out and list the gap",
            "frozen",
        )
