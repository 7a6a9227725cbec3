"""The controller as an analytical redundancy relation between reference, position and command (Isermann).

A controller is software: with its own inputs it reproduces its output to the rounding of the log. So each hypothesis
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
    Difference,
    backward,
    central,
    controller_arrays,
    controller_commands,
)
from diffdrive.logs.checks.statistics import RobustFit, longest_piece, robust_fit, sampling_period
from diffdrive.logs.checks.stuck import clipped_samples
from diffdrive.logs.log import Log, Samples, Signal

LONGEST = 40_000  # samples that hypotheses are judged by: what happened to a log shows anywhere in it
FEWEST = 50  # samples that a fit is made of
LANES = 16  # replays that run side by side: a fixed number, so that one compiled program serves all
# s: a controller with states is not judged by less; in it the table may hardly leave its rest.
SHORTEST = 0.5
# What explains the command this well needs no other explanation; an initial load that decays slowly leaves the latter.
EXPLAINED_AS_LOGGED, EXPLAINED_AFTER_TRANSIENT = 1e-3, 3e-3


class ControllerSignals(NamedTuple):
    """The signals of a log that the controller relates to one another, [n] each, at samples `period` (s) apart."""

    reference: Signal  # the position itself where none was logged
    position: Signal
    command: Signal
    period: float


@dataclass(frozen=True)
class ControllerRelation:
    """A drive file's controller and a stretch of a log, by its later half alone if `after_transient`."""

    axis: Axis
    log: Log
    piece: slice
    after_transient: bool = False

    @cached_property
    def logged(self) -> ControllerSignals:
        """The stretch as it was logged."""
        log, piece = self.log, self.piece
        reference = log.position if log.reference is None else log.reference
        return ControllerSignals(reference[piece], log.position[piece], log.command[piece], sampling_period(log))

    @property
    def feeds_logged_command(self) -> bool:
        """Whether the controller is given the logged command as the force that acted, in the place of its own."""
        return self.after_transient and self.axis.controller.has_friction_observer

    @cached_property
    def arrays(self) -> ControllerAndDrive:
        """The controller and the drive as arrays."""
        return controller_arrays(self.axis)

    @cached_property
    def first_speed(self) -> float:
        """Speed (m/s) at the first sample of the stretch."""
        return speed_at(self.log, self.piece.start)

    @property
    def disturbance(self) -> Signal | None:
        """The known disturbance of the stretch, where there is one."""
        disturbance = self.log.disturbance
        return None if disturbance is None or np.std(disturbance[self.piece]) == 0 else disturbance[self.piece]

    @cached_property
    def difference(self) -> Difference:
        """How the controller takes the speed of its reference, which the log does not hold.

        Backwards, half a sample late, where that explains the log as it is and central differences do not: a cascade
        with full feed-forward would else seem to have other gains.
        """
        return next((one for one in (central, backward) if self._explains_as_logged(one)), central)

    def _explains_as_logged(self, difference: Difference) -> bool:
        replay = self._replay(difference)
        enough = EXPLAINED_AFTER_TRANSIENT if self.after_transient else EXPLAINED_AS_LOGGED
        return replay is not None and replay[1].error < enough

    def controller_commands(self, cases: Sequence[ControllerSignals]) -> list[Signal]:
        """The controller's command (N) [n] for each of the signals, all of one length and period.

        The controller runs at its own rate: signals at a slower one are interpolated between their samples.
        """
        return self._commands(cases, self.difference)

    def _commands(self, cases: Sequence[ControllerSignals], difference: Difference) -> list[Signal]:
        upsampling = max(1, round(cases[0].period * self.axis.sampling.rate))
        speed = self.first_speed / upsampling
        commands: list[Signal] = []
        for first in range(0, len(cases), LANES):
            batch = list(cases[first : first + LANES])
            count = len(batch)
            batch += [batch[-1]] * (0 if count == 1 else LANES - count)
            command = controller_commands(
                self.arrays,
                _upsample(np.stack([case.reference for case in batch]), upsampling),
                _upsample(np.stack([case.position for case in batch]), upsampling),
                batch[0].period / upsampling,
                speed,
                _upsample(batch[0].command, upsampling) if self.feeds_logged_command else None,
                difference,
            )
            commands += list(command[:count, ::upsampling])
        return commands

    def valid_samples(self, signal: Signal) -> Samples:
        """A signal without its ends, the controller's initial transient, and the excluded samples."""
        within = slice(len(signal) // 2 if self.after_transient else SETTLE, -SETTLE)
        return signal[within][~self.excluded[within]]

    @cached_property
    def excluded(self) -> np.ndarray:
        """Mask of the samples at which the command is not the controller's: at a limit, or in a burst."""
        command = self.log.command[self.piece]
        excluded = clipped_samples(self.log.command)[self.piece]
        for burst in find_bursts(command, sampling_period(self.log)):
            excluded[max(0, burst.start - 2) : burst.stop + 2] = True
        return excluded

    def fit(self, command: Signal, *columns: Signal) -> RobustFit:
        """The command as a combination of columns, the known disturbance and a constant, in this order."""
        known = [] if self.disturbance is None else [self.valid_samples(self.disturbance)]
        return robust_fit([*(self.valid_samples(column) for column in columns), *known], self.valid_samples(command))

    def dynamics(self, signals: ControllerSignals) -> DynamicsFit | None:
        """Mass and friction that the signals imply."""
        log, piece = self.log, self.piece
        load = 0.0 if log.load is None else log.load[piece]
        force = signals.command if log.disturbance is None else signals.command + log.disturbance[piece]
        return inverse_dynamics(signals.position, force, signals.period, self.axis.drive, load, self.excluded)

    def replay_as_logged(self) -> tuple[Signal, RobustFit] | None:
        """The controller's command (N) for the log as it is, and the logged one's fit by it; None without variation."""
        return self._replay(self.difference)

    def _replay(self, difference: Difference) -> tuple[Signal, RobustFit] | None:
        command = self.valid_samples(self.logged.command)
        if len(command) < FEWEST or np.std(command) == 0:
            return None
        output = self._commands([self.logged], difference)[0]
        if not np.all(np.isfinite(output)) or np.std(self.valid_samples(output)) == 0:
            return None
        return output, self.fit(self.logged.command, output)


def _upsample(signals: np.ndarray, factor: int) -> np.ndarray:
    """Signals [..., n] at `factor` times their rate, by cubic splines."""
    if factor == 1:
        return signals
    rows = np.arange(signals.shape[-1])
    return CubicSpline(rows, signals, axis=-1)(np.arange((len(rows) - 1) * factor + 1) / factor)


def controller_relation(log: Log, axis: Axis) -> ControllerRelation | None:
    """The relation over the log's most varied stretch; None without a reference, at another rate, or if too short."""
    piece, period = longest_piece(log), sampling_period(log)
    count = piece.stop - piece.start
    memoryless = axis.controller.is_memoryless
    if log.reference is None or count < 20 * SETTLE or (not memoryless and count * period < SHORTEST):
        return None
    return ControllerRelation(axis, log, piece)
