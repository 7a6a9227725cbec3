"""Robust linear regression of the passes of an axis, whose residuals are coloured and differ from pass to pass.

A residual is that of its pass, u, and one along it, e. Passes are weighted by the variances of both (random effects,
by quasi-demeaning), samples by Huber's function. The interval of a coefficient has a part of each. Of e: the variance
of its influences summed over lags with Bartlett's weights, up to a bandwidth from their own correlation (Newey and
West 1987; Andrews 1991), with the quantile of a bandwidth that is a fixed share of the log (Kiefer and Vogelsang
2005). Of u: Student's, with as many degrees of freedom as passes are left.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import t as student

from diffdrive.logs.checks.statistics import robust_std

LEVEL = 0.95  # of all intervals
_BLOCKS = 4000  # stretches of a long log over which influences are summed
_MOST_SAMPLES = 100_000
_ITERATIONS, _ROUNDS = 15, 3  # of Huber's weights; of the variances
# A column of which the others leave less than this share of its norm is determined by them.
_NEW = 1e-3
_MOST_SHARE = 0.5  # of a coefficient's information, for which one pass is corrected
BETWEEN = ("zero", "direction", "drift", "change")  # columns that only the differences of passes show


class Estimate(NamedTuple):
    """A value and the ends of its 95 % interval, in SI units."""

    value: float
    low: float
    high: float

    @property
    def half_width(self) -> float:
        """Half of the interval."""
        return 0.5 * (self.high - self.low)

    @property
    def is_significant(self) -> bool:
        """Whether zero is outside the interval."""
        return self.low > 0.0 or self.high < 0.0

    def times(self, factor: float) -> "Estimate":
        """In another unit."""
        low, high = sorted((factor * self.low, factor * self.high))
        return Estimate(factor * self.value, low, high)


class Influences(NamedTuple):
    """Errors of an estimate as sums: of stretches of the log, and of passes (one standard deviation each)."""

    along: Float[np.ndarray, " blocks"]
    passes: Float[np.ndarray, " passes"]
    freedom: int  # of the variance between passes

    def times(self, factor: float) -> "Influences":
        """Of a multiple of the estimate."""
        return Influences(factor * self.along, factor * self.passes, self.freedom)

    def plus(self, other: "Influences") -> "Influences":
        """Of the sum of two estimates whose passes have nothing in common."""
        passes = np.concatenate([self.passes, other.passes])
        return Influences(self.along + other.along, passes, min(self.freedom, other.freedom))


class Regression(NamedTuple):
    """Coefficients by name; those that the other columns determine are left out."""

    names: tuple[str, ...]
    coefficients: Float[np.ndarray, " p"]
    along: Float[np.ndarray, "blocks p"]
    passes: Float[np.ndarray, "passes p"]
    freedom: int
    residual: Float[np.ndarray, " m"]  # of the samples that count
    thinning: int  # each so-manieth of those given

    def value(self, name: str) -> float:
        """A coefficient; zero where it is not determined."""
        return float(self.coefficients[self.names.index(name)]) if name in self.names else 0.0

    def influences(self, weights: dict[str, float]) -> Influences:
        """Of a sum of coefficients so weighted."""
        w = np.array([weights.get(name, 0.0) for name in self.names])
        return Influences(self.along @ w, self.passes @ w, self.freedom)

    def estimate(self, name: str) -> Estimate | None:
        """A coefficient and its interval; None where it is not determined."""
        return interval(self.value(name), self.influences({name: 1.0})) if name in self.names else None

    def amplitude(self, cosine: str, sine: str) -> Estimate | None:
        """Of a wave, from the coefficients of its cosine and sine."""
        a, b = self.value(cosine), self.value(sine)
        size = float(np.hypot(a, b))
        return interval(size, self.influences({cosine: a / size, sine: b / size})) if size > 0.0 else None


def _long_run(series: Float[np.ndarray, " m"]) -> tuple[float, float]:
    """Variance of the sum of a correlated series, and the bandwidth of it as a share of the series."""
    m = len(series)
    series = series - np.mean(series)
    variance = float(series @ series)
    if m < 4 or variance == 0.0:
        return variance, 0.0
    rho = float(np.clip(series[1:] @ series[:-1] / variance, 0.0, 1.0 - 1.0 / m))
    bandwidth = 1.1447 * (4.0 * rho**2 / (1.0 - rho**2) ** 2 * m) ** (1.0 / 3.0)
    bandwidth = float(np.clip(bandwidth, 1.0, 0.5 * m))
    lags = int(np.ceil(bandwidth)) - 1
    if lags:
        covariance = np.fft.irfft(np.abs(np.fft.rfft(series, 2 * m)) ** 2)[1 : lags + 1]
        variance += 2.0 * float((1.0 - np.arange(1, lags + 1) / bandwidth) @ covariance)
    return max(variance, 0.0) * m / (m - 1.0), bandwidth / m


def interval(value: float, influences: Influences) -> Estimate:
    """Of an estimate with these influences."""
    variance, share = _long_run(influences.along)
    along = (1.9600 + 2.9694 * share + 0.4160 * share**2 - 0.5324 * share**3) * np.sqrt(variance)
    passes = 0.0
    if influences.freedom > 0:
        passes = student.ppf(0.5 + 0.5 * LEVEL, influences.freedom) * np.linalg.norm(influences.passes)
    half = float(np.hypot(along, passes))
    return Estimate(value, value - half, value + half)


def _independent(columns: dict[str, Float[np.ndarray, " n"]]) -> dict[str, float]:
    """The columns that those before them do not determine, and their norms."""
    sizes: dict[str, float] = {}
    basis: list[np.ndarray] = []
    for name, column in columns.items():
        size = float(np.linalg.norm(column))
        rest = column.astype(float)
        for _ in range(2):  # twice is enough
            for one in basis:
                rest = rest - (one @ rest) * one
        new = float(np.linalg.norm(rest))
        if size > 0.0 and new > _NEW * size:
            sizes[name] = size
            basis.append(rest / new)
    return sizes


def _huber(
    x: Float[np.ndarray, "n p"], y: Float[np.ndarray, " n"], solution: Float[np.ndarray, " p"]
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " n"]]:
    """The robust solution, and the weight of each sample."""
    weights, tiny = np.ones(len(y)), np.finfo(float).tiny
    for _ in range(_ITERATIONS):
        weighted = x * weights[:, None]
        step = np.linalg.lstsq(weighted.T @ x, weighted.T @ (y - x @ solution), rcond=None)[0]
        solution = solution + step
        residual = np.abs(y - x @ solution)
        scale = max(robust_std(residual * np.where(np.arange(len(y)) % 2, 1.0, -1.0)), 1e-12 * float(np.std(y)), tiny)
        weights = np.minimum(1.0, 1.5 * scale / np.maximum(residual, tiny))
        if float(np.max(np.abs(x @ step))) < 1e-3 * scale:
            break
    return solution, weights


def regress(
    columns: dict[str, Float[np.ndarray, " n"]], y: Float[np.ndarray, " n"], number: Int[np.ndarray, " n"]
) -> Regression:
    """Fit y by the columns, the more important ones first: what earlier ones determine is left out.

    `number` is the pass of each sample, in order. Of a long log every so-manieth sample counts: what is correlated
    from one to the next loses nothing by that.
    """
    thinning = 1 + len(y) // _MOST_SAMPLES
    columns, y = {name: column[::thinning] for name, column in columns.items()}, y[::thinning]
    _, group = np.unique(number[::thinning], return_inverse=True)
    count = np.bincount(group).astype(float)
    sizes = _independent(columns)
    names = tuple(sizes)
    scale = np.array([sizes[name] for name in names])
    x = np.stack([columns[name] for name in names], axis=1) / scale

    def means(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " passes"]:
        return np.bincount(group, values) / count

    mean_x, mean_y = np.stack([means(one) for one in x.T], axis=1), means(y)
    freedom = len(count) - sum(name in names for name in BETWEEN)
    theta, of_pass = np.zeros(len(count)), np.zeros(len(count))
    solution = np.zeros(len(names))
    for _ in range(_ROUNDS if freedom > 0 else 1):
        tx, ty = x - theta[group, None] * mean_x[group], y - theta[group] * mean_y[group]
        solution, weights = _huber(tx, ty, solution)
        residual = y - x @ solution
        if freedom <= 0:
            break
        offset = means(residual)
        noise = _long_run(residual - offset[group])[0] / len(y)  # of one sample, were they independent
        between = float(offset @ offset) / freedom
        spread = max(0.0, between - float(np.mean(noise / count)))
        of_pass = spread + noise / count
        theta = 1.0 - np.sqrt(noise / np.maximum(noise + count * spread, np.finfo(float).tiny))
    left = ty - tx @ solution
    inside = tx[weights == 1.0]  # where Huber's function has a slope
    bread = inside.T @ inside if len(inside) > 0.5 * len(tx) else (tx * weights[:, None]).T @ tx
    inverse = np.linalg.pinv(bread, hermitian=True) / scale[:, None]
    along = tx * (weights * left)[:, None]
    if freedom > 0:
        # a pass that decides a coefficient pulls its own residual towards zero (jackknife over passes)
        share = np.stack([np.bincount(group, one) for one in (tx @ inverse.T * scale * tx).T], axis=1)
        along = tx * (weights * (left - means(left)[group]))[:, None]
        along = along @ inverse.T / (1.0 - np.clip(share, 0.0, _MOST_SHARE))[group]
    else:
        along = along @ inverse.T
    starts = np.linspace(0, len(y), min(_BLOCKS, len(y)), endpoint=False).astype(int)
    along = np.add.reduceat(along, starts, axis=0)
    shift = np.stack([np.bincount(group, one * weights) for one in tx.T], axis=1) * (1.0 - theta)[:, None]
    passes = np.sqrt(of_pass)[:, None] * (shift @ inverse.T)
    return Regression(names, solution / scale, along, passes, max(freedom, 0), residual, thinning)
