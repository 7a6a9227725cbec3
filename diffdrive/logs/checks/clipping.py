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


def clipped_command(log: Log, description: Axis | None, given: Signal | None) -> Iterator[Finding]:
    """A command that sits at a limit while the axis moves; `given` is the controller's own command, where known."""
    limit = None if description is None else description.drive.actuator.force_limit
    moves = log.position if log.reference is None else log.reference
    for at in (float(np.max(log.command)), float(np.min(log.command))):
        there = samples_at_extreme(log.command, at)
        # at rest a command may well stand still at its extreme: the weight of a vertical axis
        if there is None or np.ptp(moves[there]) < 0.01 * np.ptp(moves):
            continue
        known = limit is not None and abs(abs(at) / float(limit) - 1) < 1e-3
        recorded = _is_recorders_limit(log, description, given)
        amplifier = f"set actuator.force_limit = {abs(at):.6g} N"
        where = ""
        if known:
            mend = "that is the drive file's force_limit"
        elif recorded is None:
            mend = f"if it is the amplifier's limit, {amplifier}; if it is the recorder's, {RECORDER}"
        elif recorded:
            mend, where = RECORDER, ", but the table moves as by all that the controller gives: in the recorder alone"
        else:
            mend, where = amplifier, ", and the table moves by no more"
        yield Finding(
            "note" if known else "warning",
            "command",
            f"the command sits at {at:.6g} for {100 * np.mean(there):.2g} % of the samples: it is clipped there{where}",
            mend,
            "clipped",
        )


def _is_recorders_limit(log: Log, description: Axis | None, given: Signal | None) -> bool | None:
    """Whether the table moves as by the controller's whole command; None where the balance of forces does not tell."""
    if given is None or description is None:
        return None
    whole = np.where(clipped_samples(log.command), given, log.command)
    piece, load = longest_piece(log), log.load
    beside = 0.0 if log.disturbance is None else log.disturbance
    by_whole, by_logged = (
        inverse_dynamics(
            log.position[piece],
            (force + beside)[piece],
            sampling_period(log),
            description.drive,
            0.0 if load is None else load[piece],
        )
        for force in (whole, log.command)
    )
    if by_whole is None or by_logged is None or min(by_whole.misfit, by_logged.misfit) == 0:
        return None
    independent = (piece.stop - piece.start) / SAMPLES_PER_INDEPENDENT
    nats = independent * float(np.log(by_logged.misfit / by_whole.misfit))
    return None if abs(nats) < DECISIVE else nats > 0
