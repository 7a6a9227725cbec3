"""A command that sits at a limit: that of the amplifier, or of the recorder alone."""

from collections.abc import Iterator

import numpy as np

from diffdrive.axis import Axis
from diffdrive.logs.checks.dynamics import inverse_dynamics
from diffdrive.logs.checks.explanation import DECISIVE, SAMPLES_PER_INDEPENDENT
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.statistics import longest_piece, sampling_period
from diffdrive.logs.checks.stuck import clipped_samples, samples_at_extreme
from diffdrive.logs.log import Log, Signal

RECORDER = "log it over a wider range, or leave these samples out"


def clipped_command(log: Log, axis: Axis | None, controller_command: Signal | None) -> Iterator[Finding]:
    """A command that sits at a limit while the axis moves; `controller_command` [n] (N) where it is known."""
    limit = None if axis is None else axis.drive.actuator.force_limit
    moves = log.position if log.reference is None else log.reference
    for extreme in (float(np.max(log.command)), float(np.min(log.command))):
        at_extreme = samples_at_extreme(log.command, extreme)
        # at rest a command may well stand still at its extreme: the weight of a vertical axis
        if at_extreme is None or np.ptp(moves[at_extreme]) < 0.01 * np.ptp(moves):
            continue
        is_force_limit = limit is not None and abs(abs(extreme) / float(limit) - 1) < 1e-3
        is_recorders = _is_recorders_limit(log, axis, controller_command)
        amplifier = f"set actuator.force_limit = {abs(extreme):.6g} N"
        note = ""
        if is_force_limit:
            remedy = "that is the drive file's force_limit"
        elif is_recorders is None:
            remedy = f"if it is the amplifier's limit, {amplifier}; if it is the recorder's, {RECORDER}"
        elif is_recorders:
            remedy, note = RECORDER, ", but the table moves as by all that the controller gives: in the recorder alone"
        else:
            remedy, note = amplifier, ", and the table moves by no more"
        yield Finding(
            "note" if is_force_limit else "warning",
            "command",
            f"the command sits at {extreme:.6g} for {100 * np.mean(at_extreme):.2g} % of the samples: it is clipped "
            f"there{note}",
            remedy,
            "clipped",
        )


def _is_recorders_limit(log: Log, axis: Axis | None, controller_command: Signal | None) -> bool | None:
    """Whether the table moves as by the unclipped command; None where the balance of forces is undecided."""
    if controller_command is None or axis is None:
        return None
    unclipped = np.where(clipped_samples(log.command), controller_command, log.command)
    piece, load = longest_piece(log), log.load
    disturbance = 0.0 if log.disturbance is None else log.disturbance
    dynamics_unclipped, dynamics_logged = (
        inverse_dynamics(
            log.position[piece],
            (force + disturbance)[piece],
            sampling_period(log),
            axis.drive,
            0.0 if load is None else load[piece],
        )
        for force in (unclipped, log.command)
    )
    if (
        dynamics_unclipped is None
        or dynamics_logged is None
        or min(dynamics_unclipped.misfit, dynamics_logged.misfit) == 0
    ):
        return None
    independent = (piece.stop - piece.start) / SAMPLES_PER_INDEPENDENT
    log_ratio = independent * float(np.log(dynamics_logged.misfit / dynamics_unclipped.misfit))
    return None if abs(log_ratio) < DECISIVE else log_ratio > 0
