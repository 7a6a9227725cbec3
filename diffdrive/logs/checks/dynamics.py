"""Inverse dynamics of a log: mass and friction that its command and position ask for, beside those of the drive file.

The force balance of a sliding table is linear in them:

    u = m a + F_C+ [v > 0] - F_C- [v < 0] + b v

Each column is that of the nominal drive, so that the coefficients are ratios to its values. Where there is no drive
file, they are the values themselves. Signals and columns go through the same smoothing, so that none of it counts.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation

from diffdrive.logs.checks.statistics import SMOOTHING, Signal, derivative, smooth_signal, window_length
from diffdrive.model.parameters import Directional, Drive

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
    def determined(self) -> bool:
        """Whether the log says more than the drive file's tolerance."""
        return self.std < NOMINAL_STD * abs(self.value)

    @property
    def away(self) -> float:
        """Standard deviations by which the ratio is off 1, the accuracy of the balance included."""
        relative = np.hypot(ACCURACY, self.std / max(abs(self.value), 1e-300))
        return float(abs(np.log(self.value)) / relative) if self.value > 0 else np.inf

    @property
    def off(self) -> bool:
        """Whether the ratio is determined, and not 1."""
        return self.std < 0.5 * abs(self.value) and self.away > 3.0

    @property
    def positive(self) -> bool:
        """Whether it may be above zero: not two standard deviations below."""
        return self.value >= -2 * self.std


class DynamicsFit(NamedTuple):
    """What the sliding samples ask for; `friction` is the mean of both directions, which no constant force touches."""

    mass: DynamicsEstimate
    friction: DynamicsEstimate  # Coulomb, mean of both directions
    positive: DynamicsEstimate  # Coulomb, in this direction alone: a constant force is part of it
    negative: DynamicsEstimate
    viscous: DynamicsEstimate
    misfit: float  # RMS of what is left, over the RMS of the force

    @property
    def physical(self) -> bool:
        """Whether such a machine can exist: its mass is above zero, and its friction costs force."""
        return self.mass.positive and self.friction.positive

    @property
    def surprise(self) -> float:
        """Minus the log likelihood beside the drive file, in nats: of its machine within tolerance, or of another one.

        Negative mass or friction count by how many standard deviations they are below zero.
        """
        parts = (self.mass, self.friction, self.viscous)
        impossible = sum(0.5 * (one.value / one.std) ** 2 for one in parts[:2] if not one.positive)
        known = [one for one in parts if 2 * one.std < max(1.0, one.value)]
        nominal = sum(_neg_log_prior(one, NOMINAL_STD) for one in known)
        other = CHANGED + sum(_neg_log_prior(one, CHANGED_STD) + np.log(CHANGED_STD / NOMINAL_STD) for one in known)
        return float(impossible + min(nominal, other))

    @property
    def changed(self) -> bool:
        """Whether a ratio to the drive file's value is beyond what the balance of forces can be off."""
        return any(one.off for one in self[:4])

    @property
    def one_sided(self) -> bool:
        """Whether only the difference between the directions is off: a constant force is part of it."""
        return not self.mass.off and not self.friction.off and self.positive.off and self.negative.off

    @property
    def beyond_tolerance(self) -> bool:
        """Whether mass or friction are off by more than a factor of two: no drive file is so wrong."""
        return any(one.value > 2 * one.std and abs(np.log(one.value)) > 2 * NOMINAL_STD for one in self[:4])


def _neg_log_prior(one: DynamicsEstimate, std: float) -> float:
    """Of a value that may be zero, that of the largest that it may have."""
    value = max(one.value, 2 * one.std, 1e-12)
    return float(0.5 * np.log(value) ** 2 / (std**2 + (one.std / value) ** 2))


def inverse_dynamics(
    position: Signal,
    force: Signal,
    step: float,
    drive: Drive | None = None,
    load: Signal | float = 0.0,
    without: np.ndarray | None = None,
) -> DynamicsFit | None:
    """Mass and friction that a motion asks for; None where the table does not slide both ways.

    `position` (m) and `force` (N) at samples `step` (s) apart; `load` (N) lies on the guides. Samples near those of
    the mask `without` do not count. With a drive, ratios to its nominal values; without, kg, N and N s/m.
    """
    weight = 0.0 if drive is None else float(drive.plant.constant_force)
    motion, given = smooth_signal(position, step), derivative(force + weight, step, 0)
    speed = motion.rate
    sliding = np.abs(speed) > SLIDING * float(np.quantile(np.abs(speed), 0.999))
    if without is not None and without.any():
        sliding &= ~binary_dilation(without, iterations=window_length(1.0 / step, SMOOTHING) // 2)
    ahead = speed > 0
    if min(np.sum(sliding & ahead), np.sum(sliding & ~ahead)) < FEWEST or np.std(given[sliding]) == 0:
        return None
    inertia, dry, drag = _regressors(motion.curvature, speed, drive, load)
    stack = np.column_stack([inertia, np.where(ahead, dry, 0.0), np.where(ahead, 0.0, dry), drag])[sliding]
    return _weighted_fit(stack, given[sliding], sliding, max(1, int(BLOCK / step)))


def _regressors(acceleration: Signal, speed: Signal, drive: Drive | None, load: Signal | float) -> tuple[Signal, ...]:
    """Forces of inertia, dry friction and drag; of one unit each where no drive is given."""
    direction = np.sign(speed)
    if drive is None:
        return acceleration, direction, speed
    friction = drive.friction

    def towards(value: Directional) -> Signal:
        return np.where(speed > 0, float(value.positive), float(value.negative))

    slow, curve = np.maximum(towards(friction.stribeck_velocity), 1e-12), friction.stribeck_exponent
    falling = np.exp(-((np.abs(speed) / slow) ** (1.0 if curve is None else float(curve))))
    pressed = float(friction.initial_load) + load
    level = towards(friction.coulomb_screw) + towards(friction.load_coefficient) * pressed
    dry = (level + towards(friction.breakaway_gap) * falling) * direction
    drag = (towards(drive.plant.damping) + towards(friction.viscous)) * speed
    return float(drive.plant.mass) * acceleration, dry, drag


def _weighted_fit(stack: np.ndarray, given: Signal, sliding: np.ndarray, block: int) -> DynamicsFit:
    """Least squares with weights against outliers; the deviations count what is left in blocks, as it is no noise."""
    size = float(np.sqrt(np.mean(given**2)))
    # a column without any content, such as no viscous friction, says nothing
    scales = np.sqrt(np.mean(stack**2, axis=0))
    scales = np.where(scales > 1e-9 * size, scales, np.inf)
    unit = np.where(np.isfinite(scales), stack / scales, 0.0)
    weights = np.ones(len(given))
    for _ in range(5):
        normal = unit.T @ (unit * weights[:, None]) + 1e-9 * len(given) * np.eye(4)
        solution = np.linalg.solve(normal, unit.T @ (weights * given))
        left = given - unit @ solution
        width = max(1.4826 * float(np.median(np.abs(left))), 1e-9 * size)
        weights = 1.0 / np.maximum(np.abs(left) / (2 * width), 1.0)
    left = np.clip(left, -10 * width, 10 * width)
    inverse = np.linalg.inv(normal)
    covariance = inverse * float(np.mean(left**2)) * _samples_per_independent(left, sliding, block)
    values = solution / scales
    stds = np.sqrt(np.diag(covariance)) / scales
    stds = np.where(np.isfinite(scales), np.maximum(stds, 1e-9 * np.abs(values)), np.inf)
    mean = (values[1] + values[2]) / 2
    together = covariance[1:3, 1:3] / np.outer(scales[1:3], scales[1:3])
    spread = max(float(np.sqrt(max(together.sum(), 0.0))) / 2, 1e-9 * abs(float(mean)))
    one = [DynamicsEstimate(float(value), float(std)) for value, std in zip(values, stds, strict=True)]
    misfit = float(np.sqrt(np.mean(left**2))) / size
    return DynamicsFit(one[0], DynamicsEstimate(float(mean), spread), one[1], one[2], one[3], misfit)


def _samples_per_independent(left: Signal, sliding: np.ndarray, block: int) -> float:
    """How many samples count as one: how much more the means of blocks scatter than those of white noise."""
    whole = np.zeros(len(sliding))
    whole[sliding] = left
    count = len(whole) // block
    if count < 4:
        return float(block)
    held = sliding[: count * block].reshape(count, block).sum(axis=1)
    sums = whole[: count * block].reshape(count, block).sum(axis=1)
    power = float(np.mean(left**2))
    return float(np.clip(np.mean(sums**2) / max(power * np.mean(held), 1e-300), 1.0, block))
