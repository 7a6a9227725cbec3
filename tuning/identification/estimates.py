"""Estimates with intervals, in the names and units of the drive file."""

import enum
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import Directional
from diffdrive.model.uncertainty import MAX_LOG_DEVIATION, Deviation, Uncertainty
from diffdrive.numerics.arrays import Scalar
from tuning.identification.parameters import PARAMETERS, SIDES, IdentifiedParameter, parameter_at
from tuning.identification.problem import IdentificationProblem, Innovations
from tuning.identification.uncertainty import Covariance
from tuning.identification.unknowns import Unknowns, free_paths, with_value
from tuning.optimisation.space import near_bound


class EstimateStatus(enum.StrEnum):
    """What became of a parameter."""

    FITTED = "fitted"
    FIXED = "fixed"
    UNDETERMINED = "not determined"
    AT_BOUND = "at its bound"
    IN_A_SUM = "only in a sum"  # with a parameter that the logs do not determine: as good as that one's value


class ParameterEstimate(NamedTuple):
    """One parameter as found, between `low` and `high` with 95 % confidence.

    Both are `value` where it was not fitted, and NaN where it ended at its bound or is known only in a sum. The search
    was free to move it from `lowest` to `highest`, the others as found; both are `value` where it was not free.
    """

    path: str  # in the axis, with .positive or .negative where the directions differ
    unit: str
    believed: float
    value: float
    low: float
    high: float
    lowest: float
    highest: float
    status: EstimateStatus

    @property
    def name(self) -> str:
        """The path without the part of the axis, as tables and options have it."""
        return self.path.partition(".")[2]


class ReportedParameter(NamedTuple):
    """One parameter as it is reported, in a direction or in both, and its value."""

    parameter: IdentifiedParameter
    side: str  # ".positive", ".negative", or "" where both directions are one
    value: Scalar

    @property
    def path(self) -> str:
        """In an axis."""
        return f"{self.parameter.path}{self.side}"

    @property
    def unknown(self) -> str:
        """Path in the search space of the unknown that it rests on."""
        return f"{self.parameter.unknown}{self.side}"


NORMAL = 1.959964  # half-width of a 95 % interval in standard deviations
OPEN = 50.0  # half-width in the logarithm, beyond which an interval is simply open


def reported_parameters(drive: Drive, unknowns: Unknowns, symmetric: frozenset[str]) -> list[ReportedParameter]:
    """Every parameter that can be identified; those in `symmetric` have one value for both directions."""
    rows = []
    for parameter in PARAMETERS:
        value = parameter.value(drive, unknowns)
        if value is None:
            continue
        if not isinstance(value, Directional):
            rows.append(ReportedParameter(parameter, "", value))
        elif parameter.unknown in symmetric:
            rows.append(ReportedParameter(parameter, "", value.positive))
        else:
            pair = zip(SIDES, (value.positive, value.negative), strict=True)
            rows += [ReportedParameter(parameter, side, one) for side, one in pair]
    return rows


def symmetric_bristle(problem: IdentificationProblem) -> frozenset[str]:
    """Which parameters of the bristle have one value for both directions."""
    both = ("bristle_stiffness", "bristle_damping")
    return frozenset(path for path in free_paths(problem.believed_unknowns) if path in both)


def estimates(
    theta: Float[np.ndarray, " k"],
    innovations: Innovations,
    problem: IdentificationProblem,
    covariance: Covariance,
    undetermined: set[str],
) -> tuple[list[ParameterEstimate], Float[np.ndarray, "q q"]]:
    """The table of estimates at theta, and their covariance.

    Positive parameters get the interval of their logarithm.
    """

    def values(theta: Float[Array, " k"]) -> Float[Array, " q"]:
        drive, unknowns = innovations.unpack(theta, problem)
        return jnp.stack([jnp.asarray(row.value) for row in reported_parameters(drive, unknowns, symmetric)])

    symmetric = symmetric_bristle(problem)
    before = reported_parameters(problem.believed, problem.believed_unknowns, symmetric)
    point = jnp.asarray(theta)
    estimated, slope = np.asarray(values(point)), np.asarray(jax.jacfwd(values)(point))
    covariance_of_values = slope @ covariance.matrix @ slope.T
    widths = covariance.quantile * np.sqrt(np.diag(covariance_of_values))
    bounds = _reported_bounds(point, innovations, problem, symmetric)
    at_bound = set(near_bound(innovations.free, theta + problem.origin))
    table = []
    for row, value, width, direction in zip(before, estimated, widths, slope, strict=True):
        if row.unknown in undetermined:
            status = EstimateStatus.UNDETERMINED
        elif row.unknown in at_bound or (row.unknown in bounds and not np.any(direction)):
            # its own, or that of what a drive file can say (no viscous friction below zero)
            status = EstimateStatus.AT_BOUND
        else:
            status = EstimateStatus.FITTED if np.any(direction) else EstimateStatus.FIXED
        if status is EstimateStatus.FITTED and _rests_on_open_slope(row, problem, undetermined):
            status = EstimateStatus.IN_A_SUM
        if status in (EstimateStatus.AT_BOUND, EstimateStatus.IN_A_SUM):
            # the optimum may lie beyond; or another share of the sum would do as well: no interval describes that
            low, high = np.nan, np.nan
        elif row.parameter.is_signed or value <= 0:
            low, high = value - width, value + width
        else:
            factor = np.exp(min(width / value, OPEN))
            low, high = value / factor, value * factor
        lowest, highest = bounds.get(row.unknown, {}).get(row.path, (value, value))
        unit, believed, found = row.parameter.unit, float(row.value), (float(value), float(low), float(high))
        table.append(ParameterEstimate(row.path, unit, believed, *found, lowest, highest, status))
    return table, covariance_of_values * (covariance.quantile / NORMAL) ** 2


def left_open(table: Sequence[ParameterEstimate], covariance: Float[np.ndarray, "q q"]) -> Uncertainty | None:
    """How well the parameters that were fitted are known: those that a drive has, by their paths in it; None for none.

    One that is known only in a sum is as uncertain as the sum: its other part stays as in the drive.
    """
    variance = np.diag(covariance)
    kept = [
        k
        for k, one in enumerate(table)
        if one.status in (EstimateStatus.FITTED, EstimateStatus.IN_A_SUM)
        and parameter_at(one.path).in_drive
        and 0.0 < variance[k] < np.inf
    ]
    if not kept:
        return None
    of_kept = np.sqrt(variance[kept])
    # with all digits: of nearly determined pairs no other numbers are possible
    correlation = np.clip(covariance[np.ix_(kept, kept)] / np.outer(of_kept, of_kept), -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    deviations = [_deviation(table[k], float(one)) for k, one in zip(kept, of_kept, strict=True)]
    names = [table[k].path for k in kept]
    return Uncertainty(tuple(names), tuple(deviations), tuple(map(tuple, correlation.tolist())))


def _deviation(one: ParameterEstimate, deviation: float) -> Deviation:
    if parameter_at(one.path).is_signed or one.value <= 0.0:
        return Deviation(deviation, is_relative=False)
    # beyond that nothing is known of it but that it is positive
    return Deviation(min(deviation / one.value, MAX_LOG_DEVIATION))


def _rests_on_open_slope(row: ReportedParameter, problem: IdentificationProblem, undetermined: set[str]) -> bool:
    """Whether it is what an undetermined load coefficient leaves of the friction at no load."""
    slope = f"load_coefficient{row.side}"
    return row.path.startswith("friction.coulomb_screw") and (
        slope in undetermined and float(problem.believed.friction.initial_load) > 0.0
    )


def _reported_bounds(
    theta: Float[Array, " k"], innovations: Innovations, problem: IdentificationProblem, symmetric: frozenset[str]
) -> dict[str, dict[str, tuple[float, float]]]:
    """For each free unknown the bounds of what is reported of it, by path, the other unknowns as found."""
    unknowns = innovations.unpack(theta, problem)[1]

    def values_at(path: str, end: float) -> dict[str, float]:
        moved = with_value(unknowns, path, end)
        return {
            row.path: float(row.value) for row in reported_parameters(moved.drive(problem.believed), moved, symmetric)
        }

    found = {}
    for (path, _), low, high in zip(innovations.free, *np.asarray(problem.bounds), strict=True):
        lowest, highest = values_at(path, low), values_at(path, high)
        found[path] = {reported: (lowest[reported], highest[reported]) for reported in lowest}
    return found
