"""The controller as a relation between reference, position and command: which of several logs does it hold for?

A controller is software: put to its own inputs it gives back its output to the rounding of the log. So each hypothesis
on what happened to a log is judged by the command that the drive file's controller gives in the log as it would be
without that.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from diffdrive.axis import Axis
from diffdrive.logs.checks.bursts import find_bursts
from diffdrive.logs.checks.dynamics import DynamicsFit, inverse_dynamics
from diffdrive.logs.checks.motion import speed_at
from diffdrive.logs.checks.replay import (
    SETTLE,
    ControllerAndDrive,
    controller_arrays,
    controller_commands,
    is_linear,
    is_memoryless,
)
from diffdrive.logs.checks.statistics import RobustFit, longest_piece, robust_fit, sampling_period
from diffdrive.logs.checks.stuck import clipped_samples
from diffdrive.logs.log import Log, Signal

LONGEST = 40_000  # samples that hypotheses are judged by: what happened to a log shows anywhere in it
FEWEST = 50  # samples that a fit is made of
LANES = 16  # replays that run side by side: a fixed number, so that one compiled program serves all
# s: a controller that remembers is not judged by less; in it the table may hardly leave its rest.
SHORTEST = 0.5


class LoopSignals(NamedTuple):
    """The part of a log that the controller connects, [n] each, at samples `period` (s) apart."""

    reference: Signal  # the position itself where none was logged
    position: Signal
    command: Signal
    period: float


@dataclass(frozen=True)
class ControllerRelation:
    """A drive file's controller put to a stretch of a log; `late`: judged by its later half, its past forgotten."""

    description: Axis
    log: Log
    piece: slice
    late: bool = False

    @property
    def logged(self) -> LoopSignals:
        """The stretch as it was logged."""
        log, piece = self.log, self.piece
        reference = log.position if log.reference is None else log.reference
        return LoopSignals(reference[piece], log.position[piece], log.command[piece], sampling_period(log))

    @cached_property
    def software(self) -> ControllerAndDrive:
        """What is put to the log."""
        return controller_arrays(self.description)

    @property
    def disturbance(self) -> Signal | None:
        """The known disturbance of the stretch, where there is one."""
        whole = self.log.disturbance
        return None if whole is None or np.std(whole[self.piece]) == 0 else whole[self.piece]

    def outputs(self, cases: Sequence[LoopSignals]) -> list[Signal]:
        """The controller's command (N) for each, all of one length and period.

        The controller runs at its own rate: signals at a slower one are interpolated between their samples.
        """
        fed = self.late and not is_linear(self.description.controller)
        slower = max(1, round(cases[0].period * self.description.sampling.rate))
        speed = speed_at(self.log, self.piece.start) / slower
        given: list[Signal] = []
        for first in range(0, len(cases), LANES):
            some = list(cases[first : first + LANES])
            count = len(some)
            some += [some[-1]] * (0 if count == 1 else LANES - count)
            command = controller_commands(
                self.software,
                _upsample(np.stack([one.reference for one in some]), slower),
                _upsample(np.stack([one.position for one in some]), slower),
                some[0].period / slower,
                speed,
                _upsample(some[0].command, slower) if fed else None,
            )
            given += list(command[:count, ::slower])
        return given

    def judged(self, signal: Signal) -> Signal:
        """A signal without its ends, what the controller's past reaches, and what no controller gave."""
        within = slice(len(signal) // 2 if self.late else SETTLE, -SETTLE)
        return signal[within][~self.not_the_controllers[within]]

    @cached_property
    def not_the_controllers(self) -> np.ndarray:
        """Samples at which the command is not the controller's: at a limit, or in a burst."""
        command = self.log.command[self.piece]
        found = clipped_samples(self.log.command)[self.piece]
        for one in find_bursts(command, sampling_period(self.log)):
            found[max(0, one.start - 2) : one.stop + 2] = True
        return found

    def fit(self, command: Signal, *columns: Signal) -> RobustFit:
        """The command as a combination of columns, the known disturbance and a constant, in this order."""
        known = [] if self.disturbance is None else [self.judged(self.disturbance)]
        return robust_fit([*(self.judged(column) for column in columns), *known], self.judged(command))

    def dynamics(self, signals: LoopSignals) -> DynamicsFit | None:
        """The inverse dynamics of mended signals."""
        log, piece = self.log, self.piece
        load = 0.0 if log.load is None else log.load[piece]
        force = signals.command if log.disturbance is None else signals.command + log.disturbance[piece]
        return inverse_dynamics(
            signals.position, force, signals.period, self.description.drive, load, self.not_the_controllers
        )

    def plain(self) -> tuple[Signal, RobustFit] | None:
        """The controller's command for the log as it is, and the logged one by it; None where it gives nothing."""
        given = self.judged(self.logged.command)
        if len(given) < FEWEST or np.std(given) == 0:
            return None
        output = self.outputs([self.logged])[0]
        if not np.all(np.isfinite(output)) or np.std(self.judged(output)) == 0:
            return None
        return output, self.fit(self.logged.command, output)


def _upsample(signals: np.ndarray, parts: int) -> np.ndarray:
    """Signals [..., n] with so many samples for each of theirs, by a cubic spline through theirs."""
    if parts == 1:
        return signals
    at = np.arange(signals.shape[-1])
    return CubicSpline(at, signals, axis=-1)(np.arange((len(at) - 1) * parts + 1) / parts)


def controller_relation(log: Log, description: Axis) -> ControllerRelation | None:
    """The relation over the log's most varied stretch; None without a reference, at another rate, or if too short."""
    piece, step = longest_piece(log), sampling_period(log)
    count = piece.stop - piece.start
    forgets = is_memoryless(description.controller)
    if log.reference is None or count < 20 * SETTLE or (not forgets and count * step < SHORTEST):
        return None
    return ControllerRelation(description, log, piece)
