"""How well the parameters of a machine are known: a standard deviation of each, and their correlations.

Nothing of it is simulated: it says how far machines may be from the one that is stated. The values that it is about
stand in the drive alone, so that it goes with them where they change.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

from diffdrive.numerics.correlation import Correlation, correlation_matrix, root_of

MAX_LOG_DEVIATION = 1.0  # deviation of a logarithm: already a factor of 55 at four of them, wider is a slip of the pen


class Deviation(NamedTuple):
    """A standard deviation: of the logarithm of a parameter where it `is_relative`, else in the parameter's SI unit."""

    value: float
    is_relative: bool = True


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of parameters of plant and friction about their values, by path, and their correlations.

    A parameter is log-normal where its deviation is relative, else normal. The path of one that may differ between the
    directions, such as `friction.viscous`, stands for both together; `.positive` or `.negative` behind it for one.

    Examples:
        >>> known = Uncertainty.of(
        ...     {"plant.mass": Deviation(0.01), "plant.constant_force": Deviation(2.0, is_relative=False)},
        ...     {"plant.mass": {"plant.constant_force": -0.9}},
        ... )
        >>> axis = dataclasses.replace(axis, uncertainty=known)

    """

    names: tuple[str, ...]
    deviations: tuple[Deviation, ...]
    correlation: tuple[tuple[float, ...], ...]  # [n, n]

    @classmethod
    def of(cls, deviations: Mapping[str, Deviation], correlation: Correlation = MappingProxyType({})) -> "Uncertainty":
        """From deviations by the paths of parameters and correlations of pairs; those not stated are independent.

        Raises `ParameterError` for correlations that no parameters can have.
        """
        matrix = correlation_matrix(correlation, tuple(deviations), "has no standard deviation: state one, too")
        if deviations:
            root_of(matrix)
        return cls(tuple(deviations), tuple(deviations.values()), tuple(map(tuple, matrix.tolist())))

    @property
    def correlations(self) -> dict[str, dict[str, float]]:
        """The correlation of every pair, each pair once."""
        rows = zip(self.names[:-1], self.correlation, strict=False)
        return {name: dict(zip(self.names[k:], row[k:], strict=True)) for k, (name, row) in enumerate(rows, start=1)}
