"""What a controller is tuned for: one number from the signals of an ensemble, by parts and aggregation chosen by name.

    signals -> per lane: RMS and peak of the tracking error, load error -> weighed -> over the lanes: mean, worst, CVaR

For a least-squares search the number becomes a sum of squares with the same gradient at the point at hand: each sample
is weighed by how much the number grows with its square (iteratively reweighted least squares).
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from diffdrive.errors import ParameterError
from diffdrive.loop.metrics import safe_sqrt
from diffdrive.numerics.arrays import Scalar
from diffdrive.support.bounds import require_number
from diffdrive.support.registry import Registry
from tuning.gains.scenarios import EnsembleSignals

PEAK_NORM = 16  # the p-norm that stands for the largest
MAXIMUM_SHARPNESS = 20.0  # of the smooth maximum over lanes, relative to their mean
TAIL = 0.25  # of the lanes, that CVaR is the mean of
TINY = 1e-30

Lanes = Float[Array, " lanes"]


Aggregation = Callable[[Lanes], Scalar]


def register_aggregation(name: str) -> Callable[[Aggregation], Aggregation]:
    """Make a way from the costs of the scenarios to one number known to `Objective` and to `diffdrive tune`.

    Args:
        name: what `Objective(aggregation=...)` and `--aggregation` call it.

    Returns:
        A decorator of a function from the costs, one per scenario, to their scalar; it must be differentiable by JAX
        and must not fall where a cost grows. One of your own is replaced by one that is registered under its name.

    Raises:
        ParameterError: The name is that of an aggregation that the package has.

    Examples:
        >>> @tuning.register_aggregation("sum of squares")
        ... def sum_of_squares(costs):
        ...     return jnp.sum(costs**2)

    """

    def register(aggregation: Aggregation) -> Aggregation:
        AGGREGATIONS.add(name, aggregation)
        return aggregation

    return register


def mean(costs: Lanes) -> Scalar:
    """The mean over the lanes."""
    return jnp.mean(costs)


def worst(costs: Lanes) -> Scalar:
    """A smooth maximum over the lanes."""
    scale = jnp.mean(costs) / MAXIMUM_SHARPNESS + TINY
    return scale * jax.nn.logsumexp(costs / scale)


def cvar(costs: Lanes) -> Scalar:
    """The mean of the worst quarter of the lanes, at least one (conditional value at risk)."""
    count = max(1, round(TAIL * len(costs)))
    return jnp.mean(lax.top_k(costs, count)[0])


AGGREGATIONS: Registry[Aggregation] = Registry("aggregation", {"mean": mean, "worst": worst, "cvar": cvar})


@dataclass(frozen=True)
class Objective:
    """Weights of the parts, each in cost per unit, and the name of the aggregation over the lanes.

    Raises:
        ParameterError: A weight is negative, or all are zero; there is no such aggregation.

    Examples:
        >>> Objective(peak=5e5, aggregation="worst")

    """

    error: float = 1e6  # per m of RMS tracking error: the cost is then in micrometres
    peak: float = 0.0  # per m of the smooth maximum of the tracking error
    load_error: float = 0.0  # per N of RMS load error
    aggregation: str = "mean"

    def __post_init__(self) -> None:
        for name in ("error", "peak", "load_error"):
            require_number(name, getattr(self, name), at_least=0.0)
        if not (self.error or self.peak or self.load_error):
            raise ParameterError("error, peak, load_error: all are zero, so that nothing is to be minimised")
        if self.aggregation not in AGGREGATIONS:
            raise ParameterError(f"no aggregation '{self.aggregation}'; known: {', '.join(AGGREGATIONS)}")

    def __call__(self, signals: EnsembleSignals) -> Scalar:
        """The number."""
        return AGGREGATIONS[self.aggregation](self.lane_costs(signals))

    def lane_costs(self, signals: EnsembleSignals) -> Lanes:
        """The cost of each lane."""
        costs = self.error * rms(signals.error)
        if self.peak:
            costs = costs + self.peak * peak(signals.error)
        if self.load_error:
            costs = costs + self.load_error * rms(signals.require_load_error("objective"))
        return costs

    def weights(self, signals: EnsembleSignals) -> EnsembleSignals:
        """Square roots of the weights with which the squares of the signals have the gradient of the objective."""

        def root(slope: Array, signal: Array) -> Array:
            safe = jnp.where(jnp.abs(signal) > TINY, signal, 1.0)
            return jnp.asarray(safe_sqrt(jnp.where(jnp.abs(signal) > TINY, jnp.maximum(slope / safe, 0.0), 0.0)))

        slopes = jax.grad(self.__call__)(signals)
        return jax.tree.map(lambda slope, signal: lax.stop_gradient(root(slope, signal)), slopes, signals)


def rms(signal: Float[Array, "lanes n"]) -> Lanes:
    """Root mean square of each lane."""
    return jnp.asarray(safe_sqrt(jnp.mean(signal**2, axis=1)))


def peak(signal: Float[Array, "lanes n"]) -> Lanes:
    """A smooth maximum of each lane's magnitude, never below it."""
    largest = lax.stop_gradient(jnp.max(jnp.abs(signal), axis=1, keepdims=True)) + TINY
    return largest[:, 0] * jnp.sum((signal / largest) ** PEAK_NORM, axis=1) ** (1.0 / PEAK_NORM)
