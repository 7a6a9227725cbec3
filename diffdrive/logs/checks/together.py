"""Several logs of one machine: where they contradict one another."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from diffdrive.axis import Axis
from diffdrive.logs.checks.balance import nominal_friction
from diffdrive.logs.checks.dynamics import ACCURACY, DynamicsEstimate, DynamicsFit, inverse_dynamics
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.statistics import longest_piece, sampling_period
from diffdrive.logs.log import Log

CLEAR = 3.0  # standard deviations


class _LogDynamics(NamedTuple):
    log: Log
    dynamics: DynamicsFit


def contradictions(logs: Sequence[Log], axis: Axis | None = None) -> Iterator[Finding]:
    """Mass and friction of two logs of one machine, where they differ by more than their uncertainty."""
    dynamics_of_logs = [_LogDynamics(log, found) for log in logs if (found := _dynamics(log, axis)) is not None]
    for quantity, what, unit in (("mass", "mass", "kg"), ("friction", "Coulomb friction", "N")):
        estimates = [(item.log, getattr(item.dynamics, quantity)) for item in dynamics_of_logs]
        estimates = [(log, estimate) for log, estimate in estimates if estimate.is_determined and estimate.value > 0]
        if len(estimates) < 2:
            continue
        (low_log, low), (high_log, high) = (pick(estimates, key=lambda pair: pair[1].value) for pick in (min, max))
        if _distance(low, high) <= CLEAR:
            continue
        nominal = _nominal(quantity, axis)
        yield Finding(
            "warning",
            "command",
            f"{low_log.name} implies {what} of {nominal * low.value:.3g} {unit}, {high_log.name} "
            f"{nominal * high.value:.3g} {unit}: one machine has not both",
            "logs of two machines, of two loads that no column holds, or before and after a change: identify each by "
            "itself, or state what lay on the table",
            "machines differ",
            ("other machine", "gain"),
        )


def _dynamics(log: Log, axis: Axis | None) -> DynamicsFit | None:
    piece, period = longest_piece(log), sampling_period(log)
    force = log.command[piece] + (0.0 if log.disturbance is None else log.disturbance[piece])
    if np.ptp(force) == 0 or np.ptp(log.position[piece]) == 0:
        return None
    drive = None if axis is None else axis.drive
    load = 0.0 if log.load is None else log.load[piece]
    return inverse_dynamics(log.position[piece], force, period, drive, load)


def _distance(low: DynamicsEstimate, high: DynamicsEstimate) -> float:
    """Standard deviations between two estimates, the accuracy of both included."""
    relative = np.sqrt(2 * ACCURACY**2 + (low.std / low.value) ** 2 + (high.std / high.value) ** 2)
    return float(np.log(high.value / low.value) / relative)


def _nominal(quantity: str, axis: Axis | None) -> float:
    if axis is None:
        return 1.0
    if quantity == "mass":
        return float(axis.drive.plant.mass)
    return sum(nominal_friction(axis)) / 2
