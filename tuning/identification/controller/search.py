"""The law's parameters that agree best with the moments of a log: Levenberg-Marquardt from the best of a grid."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tuning.identification.controller.law import Law, Reading, coefficients
from tuning.identification.controller.signals import interpolation

# What is expected before a log is seen: mean and standard deviation of each parameter. Far wider than any log leaves
# them, so that a parameter of which the log shows nothing has an interval that says so, and no more.
EXPECTED = np.array(
    Law(
        log_kp=np.log(30.0),  # K_v of 1 to 1000 1/s
        kappa=0.0,
        log_gain=0.0,  # where the search starts
        rate=0.0,
        mass=0.0,
        late=0.0,  # a speed differenced backwards or forwards within a row
        window=1.0,  # one to eight samples of a loop with up to 16 to the row: uniform up to two rows
        shift=0.0,  # the instant of the command is unknown within a row on either side
        noise=0.0,
    )
)
SPREAD = np.array(
    Law(
        log_kp=1.8,
        kappa=1.0,  # s
        log_gain=5.0,
        rate=1000.0,  # 1/s: reset times down to a millisecond
        mass=0.1,  # s: mass over velocity gain is the velocity loop's time constant
        late=1.0 / np.sqrt(12.0),
        window=2.0 / np.sqrt(12.0),
        shift=2.0 / np.sqrt(12.0),
        noise=16.0,  # of a velocity differenced over a sixteenth of a row
    )
)
PARAMETERS = {Reading.EVERY_SAMPLE: 6, Reading.SAME_INSTANT: 7, Reading.OWN_INSTANT: 9}  # of `Law`, from the first on
GRID = np.geomspace(0.5, 1000.0, 192)  # 1/s, K_v from which searches start: neighbours 4 % apart
CLOSER = np.linspace(-0.04, 0.04, 17)  # between neighbours
WINDOWS = (0.125, 0.25, 0.5, 1.0, 2.0)  # rows
STARTS = 5
HELD = 1e-3  # how much tighter times within rows are held at first
NONE = 1e-7  # the same of what is not there: no nanosecond of it is left
STEPS = 60
ROUGH = 15  # steps that tell a valley from another
APART = 0.01  # in log K_v: two searches that end closer have ended at one minimum
TINY = 1e-30  # step of a complex derivative, exact to the last digit

LOG_KP, LOG_GAIN, RATE, MASS, LATE, WINDOW = (
    Law._fields.index(name) for name in ("log_kp", "log_gain", "rate", "mass", "late", "window")
)


def weights(law: Law, reading: Reading) -> np.ndarray:
    """Weights of the commands of neighbouring rows: those of the instant at which the other signals were."""
    return np.ones((1, *np.shape(law.log_kp))) if reading is Reading.EVERY_SAMPLE else interpolation(law.shift)


class Curvature(NamedTuple):
    """J'J by the triangle of J = QR, its columns of unit length: what the product would round away is kept.

    The moments of a log without noise are worth 1e17 of what was expected. J'J is then singular to rounding, J is not.
    """

    root: np.ndarray  # R of the unit columns
    scale: np.ndarray  # the columns' lengths

    @classmethod
    def of(cls, jacobian: np.ndarray) -> "Curvature":
        """Of a Jacobian with as many rows as columns, or more."""
        scale = np.linalg.norm(jacobian, axis=0)
        return cls(np.linalg.qr(jacobian / scale, mode="r"), scale)

    @property
    def log_determinant(self) -> float:
        """The logarithm of the determinant of J'J."""
        return 2.0 * float(np.sum(np.log(np.abs(np.diag(self.root)))) + np.sum(np.log(self.scale)))

    @property
    def inverse(self) -> np.ndarray:
        """The inverse of J'J: the covariance, symmetric and positive."""
        half = np.linalg.inv(self.root) / self.scale[:, None]
        return half @ half.T


@dataclass(frozen=True)
class Problem:
    """Least squares of a log's moments, in their standard deviations, and of what was expected."""

    regressors: np.ndarray  # [q, k]
    commands: np.ndarray  # [q, c]
    period: float
    reading: Reading
    log_gain: float = 0.0  # as expected
    held: tuple[int, ...] = ()  # parameters that are as expected

    @property
    def spread(self) -> np.ndarray:
        """Standard deviations of what was expected."""
        spread = SPREAD[: PARAMETERS[self.reading]].copy()
        spread[list(self.held)] *= NONE
        return spread

    def residuals(self, point: np.ndarray, held: float = 1.0) -> np.ndarray:
        """Of the moments and of what was expected; `held` tightens the latter for times within rows."""
        return self._of_points(point[:, None], held)[:, 0]

    def jacobian(self, point: np.ndarray, held: float = 1.0) -> np.ndarray:
        """Derivative of the residuals."""
        return self._of_points(point[:, None] + 1j * TINY * np.eye(len(point)), held).imag / TINY

    def curvature(self, point: np.ndarray, birge: float = 1.0) -> Curvature:
        """Of half the sum of squares, those of the moments scattering more than their noise by that factor."""
        jacobian, free = self.jacobian(point), len(point)
        return Curvature.of(np.concatenate([jacobian[:-free] / np.sqrt(birge), jacobian[-free:]]))

    def _of_points(self, points: np.ndarray, held: float) -> np.ndarray:
        """The residuals at points [p, m] side by side, [q + p, m]."""
        law = Law(*points, *np.zeros((len(Law._fields) - len(points), points.shape[1])))
        theta = coefficients(law, self.period, self.reading)
        equation = self.commands @ weights(law, self.reading) - self.regressors @ theta
        expected = EXPECTED[: len(points)].copy()
        expected[LOG_GAIN] = self.log_gain
        departures = (points - expected[:, None]) / self.spread[:, None]
        departures[LATE:] /= held
        return np.concatenate([equation, departures])

    def minimise(self, start: np.ndarray, *, held: float = 1.0, steps: int = STEPS) -> tuple[np.ndarray, float]:
        """Levenberg-Marquardt: the best point, and its sum of squares."""
        point, damping, value = start, 1e-3, self.residuals(start, held)
        cost = float(value @ value)
        for _ in range(steps):
            jacobian = self.jacobian(point, held)
            hessian = jacobian.T @ jacobian
            step = np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), -jacobian.T @ value)
            step = np.clip(step, -self.spread, self.spread)
            tried = self.residuals(point + step, held)
            new_cost = float(tried @ tried)
            if new_cost <= cost:
                settled = cost - new_cost < 1e-10 * (1.0 + new_cost)
                point, value, cost, damping = point + step, tried, new_cost, damping / 10.0
                if settled:
                    break
            elif damping > 1e12:
                break
            else:
                damping *= 10.0
        return point, cost


class Solution(NamedTuple):
    """A minimum with its sum of squares, and the problem with the gain that the search started from."""

    problem: Problem
    point: np.ndarray
    cost: float


def solve(problem: Problem, starts: Sequence[np.ndarray]) -> list[Solution]:
    """Search from some of `starts_of`: the best point and, where the loops of the cascade may change places, the best
    other minimum.
    """
    if not starts:
        return []
    problem = replace(problem, log_gain=float(starts[0][LOG_GAIN]))
    found = _finished(problem, [_minimise_twice(problem, start) for start in starts])
    best = min(found, key=_cost)
    # Where the following error vanishes on long strokes, u = K (s + kp) (s + rate) / s e but for the delay of the
    # velocity: K_v and the inverse reset time have nearly changed places in another minimum.
    if best[0][RATE] > 0:
        for window in _windows(problem):
            costs, points = _given(problem, best[0][[RATE]], window)
            found += [_minimise_twice(problem, points[0])] if np.isfinite(costs[0]) else []
        found = _finished(problem, found)
        best = min(found, key=_cost)
    others = [one for one in found if abs(one[0][LOG_KP] - best[0][LOG_KP]) > APART]
    return [Solution(problem, *one) for one in [best, *sorted(others, key=_cost)[:1]]]


def _cost(found: tuple[np.ndarray, float]) -> float:
    return found[1]


def _minimise_twice(problem: Problem, start: np.ndarray) -> tuple[np.ndarray, float]:
    """Without what is held, and with the times within rows held at first: from afar they would explain what wrong gains
    do.
    """
    start = np.where(np.isin(np.arange(len(start)), problem.held), 0.0, start)
    held = problem.minimise(start, held=HELD, steps=ROUGH)[0] if problem.reading is Reading.OWN_INSTANT else start
    return problem.minimise(held, steps=ROUGH)


def _finished(problem: Problem, rough: list[tuple[np.ndarray, float]]) -> list[tuple[np.ndarray, float]]:
    """The best of each of the two lowest valleys, to the end; what is far above them needs no more digits."""
    ranked = sorted(rough, key=_cost)
    others = [one for one in ranked if abs(one[0][LOG_KP] - ranked[0][0][LOG_KP]) > APART]
    return [problem.minimise(point) for point, _ in [ranked[0], *others[:1]]]


def _windows(problem: Problem) -> tuple[float, ...]:
    return (0.0,) if problem.reading is Reading.EVERY_SAMPLE else WINDOWS


def starts_of(problem: Problem) -> list[np.ndarray]:
    """Of the K_v and windows of a grid, with the best other parameters, the local minima with a positive gain; none
    where no positive gain agrees with the moments.
    """
    found: list[tuple[float, np.ndarray]] = []
    for window in _windows(problem):
        costs, points = _given(problem, GRID, window)
        around = np.concatenate([[np.inf], costs, [np.inf]])
        minima = np.isfinite(costs) & (costs <= np.minimum(around[:-2], around[2:]))
        found += [(float(costs[k]), points[k]) for k in np.flatnonzero(minima)]
    found = sorted(found, key=lambda one: one[0])[:STARTS]
    starts = [_closer(problem, float(start[LOG_KP]), float(start[WINDOW : WINDOW + 1].sum())) for _, start in found]
    return starts + (_read_off(problem) if problem.reading is Reading.EVERY_SAMPLE else [])


def _read_off(problem: Problem) -> list[np.ndarray]:
    """The gains as coefficients that no law binds say them, if they are positive.

    Of exact logs they are right to some digits, also where the grid has no valley of its own: K_v near the inverse
    reset time is a double root of the others.
    """
    error, _, speed, _, acceleration, lag, summed_lag = _least(problem.regressors[None], problem.commands[:, 0])[0]
    if not (lag > 0 and error > 0):
        return []
    return [np.array([np.log(error / lag), -speed / error, np.log(lag), summed_lag / lag, acceleration / lag, 0.0])]


def _closer(problem: Problem, log_kp: float, window: float) -> np.ndarray:
    """The best between two neighbours of the grid: exact logs have valleys narrower than its steps."""
    costs, points = _given(problem, np.exp(log_kp + CLOSER), window)
    return points[int(np.argmin(costs))]


def _given(problem: Problem, kps: np.ndarray, window: float) -> tuple[np.ndarray, np.ndarray]:
    """The misfit with each K_v and this window, and the other parameters; infinite where no gain is positive.

    They are linear where each loop is let to have a kappa of its own. That of the integral is the sharper one, by
    orders of magnitude; with little integral it is the one at which the error follows the speed.
    """

    def columns(**changed: float) -> np.ndarray:
        law = Law(np.log(kps), 0.0, 0.0, 0.0, 0.0, window=window)._replace(**changed)
        return (problem.regressors @ coefficients(law, problem.period, problem.reading)).T

    command = problem.commands @ weights(Law(0.0, 0.0, 0.0, 0.0, 0.0), problem.reading)
    alone = columns()
    by_kappa, by_rate, by_mass = (columns(**{name: 1.0}) - alone for name in ("kappa", "rate", "mass"))
    both = columns(kappa=1.0, rate=1.0) - alone - by_kappa - by_rate
    free = np.stack([alone, by_rate, by_mass, by_kappa, both], axis=2)  # [kps, q, 5]
    misfit = command - np.einsum("bqp,bp->bq", free, found := _least(free, command))
    positive = found[:, 0] > 0
    costs = np.where(positive, np.sum(misfit**2, axis=1), np.inf)
    error, speed = problem.regressors[:, 0], problem.regressors[:, 2]
    best = np.full(len(kps), np.inf)
    points = np.zeros((len(kps), len(Law._fields)))
    with np.errstate(divide="ignore", invalid="ignore"):
        kappas = (
            found[:, 4] / found[:, 1],
            found[:, 3] / found[:, 0],
            np.full(len(kps), error @ speed / (speed @ speed)),
        )
    for kappa in kappas:
        own = np.where(np.isfinite(kappa), kappa, 0.0)[:, None, None]
        bound = np.concatenate([free[:, :, [0]] + own * free[:, :, [3]], free[:, :, [1]] + own * free[:, :, [4]]], 2)
        bound = np.concatenate([bound, free[:, :, [2]]], axis=2)
        linear = _least(bound, command)
        left = np.sum((command - np.einsum("bqp,bp->bq", bound, linear)) ** 2, axis=1)
        better = np.isfinite(kappa) & (linear[:, 0] > 0) & (left < best)
        best = np.where(better, left, best)
        gain = np.where(linear[:, 0] > 0, linear[:, 0], 1.0)
        found_here = [np.log(kps), own[:, 0, 0], np.log(gain), linear[:, 1] / gain, linear[:, 2] / gain]
        points[better, :5] = np.stack(found_here, axis=1)[better]
    points[:, WINDOW] = window
    return np.where(np.isfinite(best), costs, np.inf), points[:, : PARAMETERS[problem.reading]]


def _least(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Least squares of one target on each set of columns [b, q, p]: [b, p]."""
    scale = np.linalg.norm(columns, axis=1)
    scale = np.where(scale > 0, scale, 1.0)
    return np.einsum("bpq,q->bp", np.linalg.pinv(columns / scale[:, None, :], rcond=1e-10), target) / scale
