"""Estimates with intervals, in the names and units of the drive file."""

import enum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import Scalar
from tuning.identification.problem import IdentificationProblem, Innovations
from tuning.identification.uncertainty import Covariance
from tuning.identification.unknowns import Unknowns, free_paths, with_value
from tuning.optimisation.space import SearchSpace


class EstimateStatus(enum.StrEnum):
    """What became of a parameter."""

    FITTED = "fitted"
    FIXED = "fixed"
    UNDETERMINED = "not determined"
    AT_BOUND = "at its bound"


class ParameterEstimate(NamedTuple):
    """One parameter as found, between `low` and `high` with 95 % confidence.

    Both are `value` where it was not fitted, and NaN where it ended at its bound. The search was free to move it from
    `lowest` to `highest`, the others as found; both are `value` where it was not free.
    """

    name: str  # as in the drive file, with .positive or .negative where the directions differ
    unit: str
    believed: float
    value: float
    low: float
    high: float
    lowest: float
    highest: float
    status: EstimateStatus


class ReportedParameter(NamedTuple):
    """One parameter as it is reported: which unknown it rests on, and its value."""

    key: str
    side: str  # "positive", "negative", or "" where both directions are one
    unit: str
    unknown: str
    value: Scalar

    @property
    def name(self) -> str:
        """Key and side."""
        return f"{self.key}.{self.side}" if self.side else self.key

    @property
    def path(self) -> str:
        """Where the unknown is in the search space."""
        return f"{self.unknown}.{self.side}" if self.side else self.unknown


NORMAL = 1.959964  # half-width of a 95 % interval in standard deviations
OPEN = 50.0  # half-width in the logarithm, beyond which an interval is simply open
LINEAR = ("constant_force", "breakaway_gap", "coulomb_screw", "delay")  # may be of either sign


def reported_parameters(drive: Drive, unknowns: Unknowns, symmetric: frozenset[str]) -> list[ReportedParameter]:
    """Every parameter that can be identified; those in `symmetric` have one value for both directions."""
    friction = drive.friction
    pairs = (
        ("coulomb_at_no_load", "N", "coulomb", unknowns.coulomb),
        ("coulomb_screw", "N", "coulomb", friction.coulomb_screw),
        ("load_coefficient", "1", "load_coefficient", friction.load_coefficient),
        ("breakaway_gap", "N", "breakaway", friction.breakaway_gap),
        ("stribeck_velocity", "m/s", "stribeck_velocity", friction.stribeck_velocity),
        ("viscous", "N*s/m", "viscous", friction.viscous),
        ("bristle_stiffness", "N/m", "bristle_stiffness", friction.bristle_stiffness),
        ("bristle_damping", "N*s/m", "bristle_damping", friction.bristle_damping),
    )
    rows = [
        ReportedParameter("mass", "", "kg", "mass", drive.plant.mass),
        ReportedParameter("constant_force", "", "N", "constant_force", drive.plant.constant_force),
    ]
    for key, unit, unknown, pair in pairs:
        if unknown in symmetric:
            rows.append(ReportedParameter(key, "", unit, unknown, pair.positive))
        else:
            rows.append(ReportedParameter(key, "positive", unit, unknown, pair.positive))
            rows.append(ReportedParameter(key, "negative", unit, unknown, pair.negative))
    return [*rows, ReportedParameter("delay", "", "periods", "delay", unknowns.delay)]


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

    symmetric = frozenset(
        path for path in free_paths(problem.believed_unknowns) if path in ("bristle_stiffness", "bristle_damping")
    )
    before = reported_parameters(problem.believed, problem.believed_unknowns, symmetric)
    point = jnp.asarray(theta)
    estimated, slope = np.asarray(values(point)), np.asarray(jax.jacfwd(values)(point))
    covariance_of_values = slope @ covariance.matrix @ slope.T
    widths = covariance.quantile * np.sqrt(np.diag(covariance_of_values))
    bounds = _reported_bounds(point, innovations, problem, symmetric)
    at_bound = set(SearchSpace(innovations.free, problem.origin).near_bound(theta))
    table = []
    for row, value, width, direction in zip(before, estimated, widths, slope, strict=True):
        if row.path in undetermined:
            status = EstimateStatus.UNDETERMINED
        elif row.path in at_bound or (row.path in bounds and not np.any(direction)):
            # its own, or that of what a drive file can say (no viscous friction below zero)
            status = EstimateStatus.AT_BOUND
        else:
            status = EstimateStatus.FITTED if np.any(direction) else EstimateStatus.FIXED
        if status is EstimateStatus.AT_BOUND:
            low, high = np.nan, np.nan  # the optimum may lie beyond: no interval describes that
        elif row.key in LINEAR or value <= 0:
            low, high = value - width, value + width
        else:
            factor = np.exp(min(width / value, OPEN))
            low, high = value / factor, value * factor
        lowest, highest = bounds.get(row.path, {}).get(row.name, (value, value))
        table.append(
            ParameterEstimate(
                row.name, row.unit, float(row.value), float(value), float(low), float(high), lowest, highest, status
            )
        )
    return table, covariance_of_values * (covariance.quantile / NORMAL) ** 2


def _reported_bounds(
    theta: Float[Array, " k"], innovations: Innovations, problem: IdentificationProblem, symmetric: frozenset[str]
) -> dict[str, dict[str, tuple[float, float]]]:
    """For each free path the bounds of what is reported of it, by name, the other unknowns as found."""
    unknowns = innovations.unpack(theta, problem)[1]

    def values_at(path: str, end: float) -> dict[str, float]:
        moved = with_value(unknowns, path, end)
        return {
            row.name: float(row.value) for row in reported_parameters(moved.drive(problem.believed), moved, symmetric)
        }

    found = {}
    for path, low, high in innovations.free:
        lowest, highest = values_at(path, low), values_at(path, high)
        found[path] = {name: (lowest[name], highest[name]) for name in lowest}
    return found
