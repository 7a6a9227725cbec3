"""Inverse dynamics of a log: mass and friction that its command and position imply, beside those of the drive file.

The force balance of a sliding table is linear in them:

    u = m a + F_C+ [v > 0] - F_C- [v < 0] + b v

Each column is that of the nominal drive, so that the coefficients are ratios to its values. Where there is no drive
file, they are the values themselves. Signals and columns go through the same smoothing, so that none of it counts.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation

from diffdrive.logs.checks.statistics import SMOOTHING, derivative, smooth_signal, window_length
from diffdrive.logs.log import Signal
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import Directional

# Below this share of the top speed the bristle and the Stribeck curve decide, not the balance above.
SLIDING = 0.1
FEWEST = 50  # sliding samples in a direction
# A nominal mass or friction is right within a factor of two on a neglected axis: two deviations of its logarithm.
NOMINAL_STD = np.log(2.0) / 2
# One machine of a hundred is another one, or has changed: by a factor e, give or take.
CHANGED, CHANGED_STD = np.log(100.0), 1.0
ACCURACY = (
    0.05  # relative: what smoothing and the friction's memory leave out; at most 0.05 on sound logs of many drives
)
BLOCK = 0.2  # s: forces that a model leaves out last as long as an acceleration does


class DynamicsEstimate(NamedTuple):
    """A ratio to the nominal value (or a value in SI units), and its standard deviation."""

    value: float
    std: float

    @property
    def is_determined(self) -> bool:
        """Whether the log says more than the drive file's tolerance."""
        return self.std < NOMINAL_STD * abs(self.value)

    @property
    def deviation(self) -> float:
        """Standard deviations by which the logarithm of the ratio is off 0, the accuracy of the balance included."""
        relative = np.hypot(ACCURACY, self.std / max(abs(self.value), 1e-300))
        return float(abs(np.log(self.value)) / relative) if self.value > 0 else np.inf

    @property
    def is_off_nominal(self) -> bool:
        """Whether the ratio is determined, and not 1."""
        return self.std < 0.5 * abs(self.value) and self.deviation > 3.0

    @property
    def may_be_positive(self) -> bool:
        """Whether it may be above zero: not two standard deviations below."""
        return self.value >= -2 * self.std


class DynamicsFit(NamedTuple):
    """Estimates from the sliding samples; `friction` is the mean of both directions, free of any constant force."""

    mass: DynamicsEstimate
    friction: DynamicsEstimate  # Coulomb, mean of both directions
    friction_positive: DynamicsEstimate  # Coulomb, in this direction alone: a constant force is part of it
    friction_negative: DynamicsEstimate
    viscous: DynamicsEstimate
    misfit: float  # RMS of what is left, over the RMS of the force

    @property
    def is_physical(self) -> bool:
        """Whether such a machine can exist: its mass is above zero, and its friction costs force."""
        return self.mass.may_be_positive and self.friction.may_be_positive

    @property
    def neg_log_likelihood(self) -> float:
        """Negative log likelihood (nats) given the drive file: of its machine within tolerance, or of another one.

        Negative mass or friction count by how many standard deviations they are below zero.
        """
        estimates = (self.mass, self.friction, self.viscous)
        impossible = sum(
            0.5 * (estimate.value / estimate.std) ** 2 for estimate in estimates[:2] if not estimate.may_be_positive
        )
        determined = [estimate for estimate in estimates if 2 * estimate.std < max(1.0, estimate.value)]
        nominal = sum(_neg_log_prior(estimate, NOMINAL_STD) for estimate in determined)
        changed = CHANGED + sum(
            _neg_log_prior(estimate, CHANGED_STD) + np.log(CHANGED_STD / NOMINAL_STD) for estimate in determined
        )
        return float(impossible + min(nominal, changed))

    @property
    def differs_from_nominal(self) -> bool:
        """Whether a ratio to the drive file's value is beyond what the balance of forces can be off."""
        return any(estimate.is_off_nominal for estimate in self[:4])

    @property
    def is_constant_force(self) -> bool:
        """Whether only the difference between the directions is off: a constant force is part of it."""
        return (
            not self.mass.is_off_nominal
            and not self.friction.is_off_nominal
            and self.friction_positive.is_off_nominal
            and self.friction_negative.is_off_nominal
        )

    @property
    def beyond_tolerance(self) -> bool:
        """Whether mass or friction are off by more than a factor of two: no drive file is so wrong."""
        return any(
            estimate.value > 2 * estimate.std and abs(np.log(estimate.value)) > 2 * NOMINAL_STD for estimate in self[:4]
        )


def _neg_log_prior(estimate: DynamicsEstimate, std: float) -> float:
    """Negative log of a log-normal prior about 1; of a value that may be zero, at the largest that it may have."""
    value = max(estimate.value, 2 * estimate.std, 1e-12)
    return float(0.5 * np.log(value) ** 2 / (std**2 + (estimate.std / value) ** 2))


def inverse_dynamics(
    position: Signal,
    force: Signal,
    period: float,
    drive: Drive | None = None,
    load: Signal | float = 0.0,
    exclude: np.ndarray | None = None,
) -> DynamicsFit | None:
    """Mass and friction from a motion; None where the table does not slide both ways.

    `position` (m) and `force` (N) at samples `period` (s) apart; `load` (N) lies on the guides. Samples near those of
    the mask `exclude` do not count. With a drive, ratios to its nominal values; without, kg, N and N s/m.
    """
    weight = 0.0 if drive is None else float(drive.plant.constant_force)
    smoothed_position, smoothed_force = smooth_signal(position, period), derivative(force + weight, period, 0)
    speed = smoothed_position.first_derivative
    sliding = np.abs(speed) > SLIDING * float(np.quantile(np.abs(speed), 0.999))
    if exclude is not None and exclude.any():
        sliding &= ~binary_dilation(exclude, iterations=window_length(1.0 / period, SMOOTHING) // 2)
    forwards = speed > 0
    if min(np.sum(sliding & forwards), np.sum(sliding & ~forwards)) < FEWEST or np.std(smoothed_force[sliding]) == 0:
        return None
    inertia, dry, drag = _regressors(smoothed_position.second_derivative, speed, drive, load)
    regressors = np.column_stack([inertia, np.where(forwards, dry, 0.0), np.where(forwards, 0.0, dry), drag])[sliding]
    return _weighted_fit(regressors, smoothed_force[sliding], sliding, max(1, int(BLOCK / period)))


def _regressors(acceleration: Signal, speed: Signal, drive: Drive | None, load: Signal | float) -> tuple[Signal, ...]:
    """Forces of inertia, dry friction and drag (N); of one unit each without a drive."""
    direction = np.sign(speed)
    if drive is None:
        return acceleration, direction, speed
    friction = drive.friction

    def by_direction(value: Directional) -> Signal:
        return np.where(speed > 0, float(value.positive), float(value.negative))

    stribeck_velocity = np.maximum(by_direction(friction.stribeck_velocity), 1e-12)
    exponent = friction.stribeck_exponent
    stribeck = np.exp(-((np.abs(speed) / stribeck_velocity) ** (1.0 if exponent is None else float(exponent))))
    level = friction.coulomb_at(load)
    coulomb = np.where(speed > 0, level.positive, level.negative)
    dry = (coulomb + by_direction(friction.breakaway_gap) * stribeck) * direction
    drag = (by_direction(drive.plant.damping) + by_direction(friction.viscous)) * speed
    return float(drive.plant.mass) * acceleration, dry, drag


def _weighted_fit(regressors: np.ndarray, target: Signal, sliding: np.ndarray, block: int) -> DynamicsFit:
    """Robust least squares; the standard deviations allow for the residual's correlation, by blocks."""
    rms = float(np.sqrt(np.mean(target**2)))
    # a column without any content, such as no viscous friction, says nothing
    scales = np.sqrt(np.mean(regressors**2, axis=0))
    scales = np.where(scales > 1e-9 * rms, scales, np.inf)
    scaled = np.where(np.isfinite(scales), regressors / scales, 0.0)
    weights = np.ones(len(target))
    for _ in range(5):
        normal = scaled.T @ (scaled * weights[:, None]) + 1e-9 * len(target) * np.eye(4)
        solution = np.linalg.solve(normal, scaled.T @ (weights * target))
        residual = target - scaled @ solution
        residual_std = max(1.4826 * float(np.median(np.abs(residual))), 1e-9 * rms)
        weights = 1.0 / np.maximum(np.abs(residual) / (2 * residual_std), 1.0)
    residual = np.clip(residual, -10 * residual_std, 10 * residual_std)
    inverse = np.linalg.inv(normal)
    covariance = inverse * float(np.mean(residual**2)) * _samples_per_independent(residual, sliding, block)
    values = solution / scales
    stds = np.sqrt(np.diag(covariance)) / scales
    stds = np.where(np.isfinite(scales), np.maximum(stds, 1e-9 * np.abs(values)), np.inf)
    mean = (values[1] + values[2]) / 2
    friction_covariance = covariance[1:3, 1:3] / np.outer(scales[1:3], scales[1:3])
    friction_std = max(float(np.sqrt(max(friction_covariance.sum(), 0.0))) / 2, 1e-9 * abs(float(mean)))
    estimates = [DynamicsEstimate(float(value), float(std)) for value, std in zip(values, stds, strict=True)]
    misfit = float(np.sqrt(np.mean(residual**2))) / rms
    return DynamicsFit(
        estimates[0], DynamicsEstimate(float(mean), friction_std), estimates[1], estimates[2], estimates[3], misfit
    )


def _samples_per_independent(residual: Signal, sliding: np.ndarray, block: int) -> float:
    """How many samples count as one: the variance of block means over that of white noise."""
    full = np.zeros(len(sliding))
    full[sliding] = residual
    count = len(full) // block
    if count < 4:
        return float(block)
    counts = sliding[: count * block].reshape(count, block).sum(axis=1)
    sums = full[: count * block].reshape(count, block).sum(axis=1)
    power = float(np.mean(residual**2))
    return float(np.clip(np.mean(sums**2) / max(power * np.mean(counts), 1e-300), 1.0, block))
