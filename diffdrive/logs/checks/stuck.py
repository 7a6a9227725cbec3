"""Signals that stand still while others move: clipped, frozen, constant."""

from collections.abc import Iterator

import numpy as np

from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.grid import fit_count_grid
from diffdrive.logs.checks.statistics import EqualStretch, equal_stretches, sampling_period, top_speed
from diffdrive.logs.log import Log, Signal

# Equal samples from which a stretch is looked at; noise on the counts makes a few by chance.
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


def samples_at_extreme(signal: Signal, at: float) -> np.ndarray | None:
    """Samples that sit exactly at an extreme value far more often than at those next to it, or None."""
    values, counts = np.unique(signal, return_counts=True)
    if len(values) < 20:  # a staircase sits at its extremes by design
        return None
    top = counts[-1] if at == values[-1] else counts[0]
    beside = counts[-6:-1] if at == values[-1] else counts[1:6]
    return signal == at if top >= 20 and top > EXTREME_RATIO * beside.max() else None


def clipped_samples(command: Signal) -> np.ndarray:
    """Samples at which the command sits at an extreme value far more often than next to it."""
    there = np.zeros(len(command), bool)
    for at in (float(np.max(command)), float(np.min(command))):
        at_level = samples_at_extreme(command, at)
        there |= False if at_level is None else at_level
    return there


def _standing_stretches(log: Log, name: str) -> list[EqualStretch]:
    """Stretches in which a position stands although the reference goes where it should have followed."""
    signal, reference = log.channels[name], log.reference
    runs = equal_stretches(signal, SHORTEST_STRETCH)
    if reference is None or name == "reference" or not runs:
        return []
    standing = np.zeros(len(signal), bool)
    for run in runs:
        if np.ptp(reference[run.start : run.stop]) > 0.01 * np.ptp(reference):
            standing[run.start : run.stop] = True
    if not standing.any():
        return []
    rest = (reference - signal)[~standing]
    usual = float(np.quantile(np.abs(rest - np.median(rest)), 0.999)) if len(rest) > 100 else 0.0
    return [
        run
        for run in runs
        if np.ptp(reference[run.start : run.stop]) > max(BEYOND * usual, 0.01 * float(np.ptp(reference)))
    ]


def _stretches_before_jumps(signal: Signal) -> list[EqualStretch]:
    """Stretches at whose end the signal jumps to make up for them, farther than it ever moves in one sample."""
    steps = np.abs(np.diff(signal))
    usual = float(np.quantile(steps, 0.999)) if len(steps) else 0.0
    grid = fit_count_grid(signal)
    least = 3 * max(usual, 3 * grid.step if grid else 0.0)
    return [
        run
        for run in equal_stretches(signal, SHORTEST_STRETCH)
        if run.stop < len(signal) and run.start > 0 and steps[run.stop - 1] > max(least, 1e-9)
    ]


def _table_moved(log: Log, run: EqualStretch) -> bool:
    """Whether the table moved on while the reference stood: a set-point may step, and then the table waits for it.

    Either the table is where the reference goes next as it wakes, or it moved that way over the latter half.
    """
    reference, position = log.reference, log.position
    assert reference is not None
    level, jump = reference[run.start], reference[run.stop] - reference[run.start]
    position = position + float(np.median(reference - position))  # zeros may differ
    there = (position[run.stop - 1] - level) / jump > 0.5
    since = (position[run.stop - 1] - position[(run.start + run.stop) // 2]) / jump
    return bool(there or since > ON_THE_MOVE)


def frozen_position(log: Log) -> Iterator[Finding]:
    """Reference, position or motor position that stands while it should move."""
    for name in ("reference", "position", "motor_position"):
        signal = log.channels.get(name)
        if signal is None or np.ptp(signal) == 0:
            continue
        frozen = _standing_stretches(log, name) or _stretches_before_jumps(signal)
        if name == "reference":
            frozen = [run for run in frozen if _table_moved(log, run)]
        if not frozen:
            continue
        longest = max(frozen, key=lambda run: run.length)
        level = float(signal[longest.start])
        share = sum(run.length for run in frozen) / len(signal)
        span = f"t = {log.time[longest.start]:.6g} to {log.time[longest.stop - 1]:.6g} s"
        if level in (float(np.max(signal)), float(np.min(signal))) and longest.start > 0:
            what = (
                f"the {name} sits at its extreme of {level:.6g} m while the axis moves on, {100 * share:.2g} % of the "
            )
            yield Finding(
                "fatal",
                name,
                what + f"samples, longest {span}: clipped or frozen",
                "widen the logger's range, or cut these stretches out and list the gaps",
                "clipped",
            )
        else:
            yield Finding(
                "fatal",
                name,
                f"the {name} is frozen at {level:.6g} m, longest {span}, {100 * share:.2g} % of the samples in all",
                "encoder dead or logger stuck: cut the stretch out and list the gap",
                "frozen",
            )


def frozen_command(log: Log) -> Iterator[Finding]:
    """A command that stands within its range while the table moves."""
    steps = np.diff(log.command)
    if np.ptp(log.command) == 0 or np.mean(steps == 0) > 0.5:  # a coarse command stands often
        return
    fast = top_speed(log.position, sampling_period(log))
    at_extreme = (float(np.max(log.command)), float(np.min(log.command)))
    runs = [run for run in equal_stretches(log.command, SHORTEST_STRETCH) if log.command[run.start] not in at_extreme]
    lengths = sorted(run.length for run in runs)
    for run in sorted(runs, key=lambda run: -run.length)[:1]:
        travel = float(np.ptp(log.position[run.start : run.stop]))
        # it must outlast the other standing stretches three times, and the table must be on the move meanwhile
        ordinary = lengths[-2] if len(lengths) > 1 else 1
        if run.length < max(20, 3 * ordinary) or travel < 0.1 * fast * run.length * sampling_period(log):
            continue
        # where the error stands as well, as at a count of the scale a sample, so may the command
        if log.reference is not None:
            error = log.reference - log.position
            if np.ptp(error[run.start : run.stop]) < 1e-6 * np.ptp(error):
                continue
        span = f"t = {log.time[run.start]:.6g} to {log.time[run.stop - 1]:.6g} s"
        yield Finding(
            "fatal",
            "command",
            f"the command is frozen at {log.command[run.start]:.6g} from {span} while the table moves {travel:.3g} m",
            "the logger was stuck: cut the stretch out and list the gap",
            "frozen",
        )
