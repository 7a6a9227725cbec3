"""Something that is switched on and off within the command beside the controller's output, such as test pulses."""

from typing import NamedTuple

import numpy as np

from diffdrive.logs.checks.statistics import RobustFit, robust_fit, robust_std
from diffdrive.logs.log import Signal

# The two levels must stand clear of what scatters around them, like the bits of a binary signal; and a switch is rare,
# or the increments would not show the controller.
CLEAR = 10.0
RARE = 0.05


class SwitchedForce(NamedTuple):
    """The fit of the command by controller and switch, the switch's height in the command's unit, and how it went."""

    fit: RobustFit
    amplitude: float
    switch_count: int
    duty: float  # of the samples, on


def find_switched_force(command: Signal, output: Signal) -> SwitchedForce | None:
    """The switch, if controller and one switch explain the command.

    The increments from sample to sample show the controller: between switches they are the controller's
    alone, and a robust fit ignores the rest.
    """
    increments = robust_fit([np.diff(output)], np.diff(command))
    residual = command - increments.coefficients[0] * output
    low, high = np.quantile(residual, [0.02, 0.98])
    is_on = residual > (low + high) / 2
    switch_count = int(np.sum(np.diff(is_on.astype(int)) != 0))
    if not 0 < switch_count < RARE * len(is_on) or not 0.02 < np.mean(is_on) < 0.98:
        return None
    levels = float(np.median(residual[is_on])), float(np.median(residual[~is_on]))
    if levels[0] - levels[1] < CLEAR * max(robust_std(residual[is_on]), robust_std(residual[~is_on])):
        return None
    fits = [(state, robust_fit([output, state.astype(float)], command)) for state in (is_on, ~is_on)]
    column, fit = min(
        fits, key=lambda candidate: abs(candidate[1].coefficients[-1])
    )  # off is where the controller alone is seen
    return SwitchedForce(fit, float(fit.coefficients[1]), switch_count, float(np.mean(column)))
