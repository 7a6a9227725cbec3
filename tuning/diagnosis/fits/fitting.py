"""The likeliest values of a hypothesis, and its evidence.

Gauss-Newton on the filter's innovations with a prior, in Levenberg's damping; after each step the process force of the
filter is chosen anew. The evidence is Laplace's: the cost at its least, and the volume that the data leave of the
prior.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tuning.diagnosis.filter.derivatives import StepJacobians
from tuning.diagnosis.filter.effect_signals import Trajectory
from tuning.diagnosis.filter.ekf import ProcessNoise, compiled_filter
from tuning.diagnosis.filter.second_encoder import Twist, predicted_twist, twist_deviance
from tuning.diagnosis.fits.curvature import limited, solved
from tuning.diagnosis.fits.differences import by_numbers
from tuning.diagnosis.fits.fitted import Fitted, Point, compiled_step_jacobians, deviances_under, innovation_jvp
from tuning.diagnosis.hypotheses.calibration import DELAY, NAMES
from tuning.diagnosis.hypotheses.model import (
    Logged,
    Model,
    Vector,
    machine,
    parameter_jacobian,
    signals_along,
    signals_by_calibration,
    signals_jvp,
)
from tuning.diagnosis.levels import LOST
from tuning.store.store import Store, digest

LEAST, MOST = 1e-3, 1e3  # N, of process force
USUAL = 5.8e-6  # kg m, mass times noise, down to which that least hides in the noise: 100 kg behind a scale of 0.1 um
BEGIN = np.array([1e2, 1.0])
MISSED = 0.03  # N, of a force that the model lacks
NEAR = np.array(  # times the last process forces are tried after a step
    [(1, 1), (0.1, 0.1), (0.3, 0.3), (3, 3), (0.3, 1), (1, 0.1), (1, 3)], float
)
MOST_STEPS, TRIALS = 25, 6
SUDDEN, SIZES = 0.3, 14  # N, where nothing lasting is missing, and how many: what an integrator's error looks like
BOLDNESS = 10.0  # far from the truth the filter blames the model, and forgives it too much
DAMPING = 0.1  # of a step's curvature in units of the prior's
ENOUGH = 0.5  # of cost, that a step must gain
SETTLING = 3  # passes after the last step: what a passing trajectory gained is no evidence
FAR = 100.0  # of cost: a step that gains more is still on its way


class Fitter:
    """Fits hypotheses about the same logs."""

    def __init__(self, logged: Logged, twist: Twist | None = None, store: Store | None = None) -> None:
        """With a `store`, finished searches are kept there, and those that it has are not searched again."""
        self.logged, self.twist, self.store = logged, twist, store
        self.counts = np.asarray(logged.lanes.counts)
        self.given = (logged.noise, logged.lanes, logged.sampling)
        fine = float(logged.drive.plant.mass) * float(logged.noise) / USUAL
        # in decades: a least that followed the noise would change with every log
        self.least = LEAST * min(1.0, 10.0 ** round(np.log10(fine)))
        # what is not known of the command is a force that any model lacks
        self.floor = np.array([max(self.least, float(logged.command_std)), self.least])

    @property
    def first(self) -> Float[np.ndarray, "w 2"]:
        """Process forces (N) where nothing is known of them."""
        lasting = np.geomspace(self.floor[0], MOST, 7)
        return np.array([(one, share * one) for one in lasting for share in (1e-2, 0.3, 3.0)])

    def quiet(self, process_noise: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "w 2"]:
        """These process forces (N) with any small sudden one: it matters, and the cost is rough in it."""
        sudden = np.geomspace(self.least, SUDDEN, SIZES)
        return np.stack([np.full(SIZES, process_noise[0]), sudden], axis=1)

    def at(self, model: Model, theta: Vector, process_noise: np.ndarray, trajectory: Trajectory) -> Point:
        """The hypothesis at theta."""
        effects = model.effects(theta)
        loose, coupled = model.apart(effects)
        recalibrated_drive, drive = machine(self.logged, jnp.asarray(model.calibration(theta)), effects)
        signals = signals_along(self.logged, recalibrated_drive, loose, trajectory)
        filtered = compiled_filter(
            drive, signals, coupled, ProcessNoise(*jnp.asarray(process_noise)), *self.given, trajectory
        )
        cost = float(filtered.deviance) + float(theta @ theta)
        cost = cost if np.isfinite(cost) else np.inf
        return Point(theta, process_noise, recalibrated_drive, drive, signals, trajectory, filtered, cost)

    def with_process(self, point: Point, model: Model, processes: np.ndarray) -> Point:
        """The same point under the likeliest of these process forces, its effects along its own trajectory."""
        processes = np.clip(processes, self.floor, MOST)
        filled = np.pad(processes, ((0, -len(processes) % len(NEAR)), (0, 0)), mode="edge")  # one program for all
        loose, coupled = model.apart(model.effects(point.theta))
        signals = signals_along(self.logged, point.recalibrated_drive, loose, point.next_trajectory)
        parts = [jnp.asarray(some) for some in np.split(filled, len(filled) // len(NEAR))]
        found = np.concatenate(
            [deviances_under(point.drive, signals, coupled, some, self.logged, point.next_trajectory) for some in parts]
        )
        found = found[: len(processes)]
        best = processes[int(np.argmin(np.where(np.isfinite(found), found, np.inf)))]
        return self.at(model, point.theta, best, point.next_trajectory)

    def slopes(self, point: Point) -> StepJacobians:
        """What small changes do to the table over each period."""
        return compiled_step_jacobians(
            point.drive, point.signals, point.filtered, self.logged.lanes, self.logged.sampling
        )

    def residuals(self, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Residuals, and the weights of those of their Jacobian."""
        filtered = point.filtered
        unit = 1.0 / np.sqrt(float(filtered.noise_scale_sq))
        residual = (np.asarray(filtered.normalised_innovation) * self.counts).ravel()
        kept = unit * (np.abs(residual) < LOST)  # where the filter was lost, no small change would have told it
        return kept * residual, kept

    def jacobian(
        self,
        model: Model,
        point: Point,
        step_jacobians: StepJacobians | None = None,
        free: Vector | bool = True,
        near: np.ndarray | None = None,
    ) -> np.ndarray:
        """Of the residuals, [m, k]; what is not `free` may be left out. `near` is that of a point nearby, if known."""
        logged, filtered, (residual, kept) = self.logged, point.filtered, self.residuals(point)
        if model.coupled:
            moves = np.r_[model.prior.any(axis=0), np.ones(len(model.slots), bool)]
            wanted = np.flatnonzero(moves & (np.broadcast_to(free, model.size) != 0))
            found = by_numbers(model, point.theta, point.process_noise, filtered, point.trajectory, wanted, near)
            return kept[:, None] * found
        step_jacobians = self.slopes(point) if step_jacobians is None else step_jacobians
        effects, b = model.effects(point.theta), jnp.asarray(model.calibration(point.theta))
        tangents, count = model.tangents(point.theta)
        columns = parameter_jacobian(logged, b, effects, tangents if count else None)
        columns = columns.at[:, : len(NAMES)].set(columns[:, : len(NAMES)] @ model.prior)
        bend = None
        if count or model.prior[NAMES.index(DELAY)].any():  # else nothing acts but the command, as it is
            first = signals_by_calibration(logged, b, effects, point.trajectory)
            bend = jax.tree.map(lambda a: a @ model.prior, first)
        if count:
            then = signals_jvp(logged, point.recalibrated_drive, effects, tangents, point.trajectory)
            bend = jax.tree.map(lambda a, c: jnp.concatenate([a, c], axis=-1), bend, then)
        found = np.asarray(
            innovation_jvp(filtered, step_jacobians, columns, bend, logged.lanes.counts, logged.sampling.period)
        )
        return kept[:, None] * found.reshape(residual.size, -1)

    def step(
        self, model: Model, point: Point, damping: float, free: Vector, jacobian: np.ndarray
    ) -> tuple[Point, float]:
        """One damped step under the point's process force; the point itself where none gains."""
        residual, jacobian = self.residuals(point)[0], jacobian * free
        hessian, slope = jacobian.T @ jacobian + np.eye(model.size), jacobian.T @ residual + free * point.theta
        for _ in range(TRIALS):
            step = -limited(solved(hessian + damping * np.eye(model.size), slope))
            ahead = self.at(model, point.theta + step, point.process_noise, point.next_trajectory)
            if ahead.cost < point.cost:
                return ahead, max(0.1 * damping, 1e-3)
            damping = 10.0 * damping
        return point, damping

    def _updated(self, jacobian: np.ndarray, before: Point, ahead: Point) -> np.ndarray:
        """The Jacobian after a step, by the secant along it (Broyden 1965)."""
        step = ahead.theta - before.theta
        off = self.residuals(ahead)[0] - self.residuals(before)[0] - jacobian @ step
        return jacobian + np.outer(off, step) / (step @ step)

    def fit(
        self,
        model: Model,
        theta: Vector,
        process_noise: np.ndarray | None,
        trajectory: Trajectory,
        most: int = MOST_STEPS,
        free: Vector | None = None,
    ) -> Fitted:
        """From `theta`; effects are first stepped along `trajectory`, `free` are ones for what may move."""
        point, steps = self.minimise(model, theta, process_noise, trajectory, most, free)
        settled = self.settled(model, point.theta, point.process_noise, point.next_trajectory)
        return self._linearised(model, settled, steps)

    def refit(self, start: Point | Fitted, model: Model, most: int = MOST_STEPS, free: Vector | None = None) -> Fitted:
        """`fit` from where another ended, or from a point."""
        return self.fit(model, start.theta, start.process_noise, start.filtered.trajectory, most, free)

    def again(self, fitted: Fitted, process_noise: np.ndarray | None = None) -> Point:
        """The hypothesis of a fit along its last trajectory, with its own process noise or another."""
        noise = fitted.process_noise if process_noise is None else process_noise
        return self.at(fitted.model, fitted.theta, noise, fitted.filtered.trajectory)

    def settled(self, model: Model, theta: Vector, process_noise: np.ndarray, trajectory: Trajectory) -> Point:
        """The hypothesis at theta, its effects along its own trajectory, after `SETTLING` passes from the given."""
        point = self.at(model, theta, process_noise, trajectory)
        for _ in range(SETTLING - 1):
            point = self.at(model, theta, process_noise, point.next_trajectory)
        return point

    def under(self, fitted: Fitted, process_noise: Float[np.ndarray, " 2"]) -> Fitted:
        """The same hypothesis with the same numbers, in a filter that may invent other forces (N)."""
        return self._linearised(fitted.model, self.again(fitted, process_noise), fitted.steps)

    def _linearised(self, model: Model, point: Point, steps: int) -> Fitted:
        step_jacobians, residual = self.slopes(point), self.residuals(point)[0]
        jacobian = self.jacobian(model, point, step_jacobians)
        hessian = jacobian.T @ jacobian + np.eye(model.size)
        return Fitted(
            model, point.theta, point.process_noise, point.cost, point.filtered, point.signals, step_jacobians,
            point.recalibrated_drive, point.drive, jacobian, residual, hessian, steps, self._second(model, point),
        )  # fmt: skip

    def _second(self, model: Model, point: Point) -> float:
        """What the second encoder says of a point."""
        if self.twist is None:
            return 0.0
        expected = predicted_twist(model.effects(point.theta), point.filtered)
        return twist_deviance(self.twist, expected, self.logged.sampling.period)

    def minimise(
        self,
        model: Model,
        theta: Vector,
        process_noise: np.ndarray | None,
        trajectory: Trajectory,
        most: int,
        free: Vector | None = None,
    ) -> tuple[Point, int]:
        """Where `fit` ends, and after how many steps: at the least, and on from there if quite another noise gains."""
        free = np.ones(model.size) if free is None else free
        if self.store is None:
            return self._searched(model, theta, process_noise, trajectory, most, free)
        key = digest("sought", self.logged, model, theta, process_noise, trajectory, most, free)
        kept = self.store.read(key)
        if kept is not None:
            along = Trajectory(*(jnp.asarray(kept[name]) for name in Trajectory._fields))
            return self.at(model, kept["u"], kept["process"], along), int(kept["steps"])
        point, steps = self._searched(model, theta, process_noise, trajectory, most, free)
        ended = {"u": point.theta, "process": point.process_noise, "steps": np.array(steps)}
        self.store.write(key, ended | {name: np.asarray(one) for name, one in point.trajectory._asdict().items()})
        return point, steps

    def _searched(
        self,
        model: Model,
        theta: Vector,
        process_noise: np.ndarray | None,
        trajectory: Trajectory,
        most: int,
        free: Vector,
    ) -> tuple[Point, int]:
        point = self.at(model, theta, BEGIN if process_noise is None else process_noise, trajectory)
        if process_noise is None:
            point = self.with_process(point, model, self.first)
        point, steps = self._down(model, point, most, free, BOLDNESS)
        if steps == most:
            return point, steps
        lasts = point.process_noise[0] > max(MISSED, self.floor[0])
        other = self.with_process(point, model, self.first if lasts else self.quiet(point.process_noise))
        if point.cost - other.cost < ENOUGH:
            return point, steps
        point, more = self._down(model, other, most - steps, free, 1.0)
        return point, steps + more

    def _down(self, model: Model, point: Point, most: int, free: Vector, boldness: float) -> tuple[Point, int]:
        """To where no step gains any more, in at most so many, and how many it took.

        As long as there is much to gain the filter's process force is taken as so many times smaller.
        """
        damping, idle = DAMPING, 0
        carried = jacobian = None  # carried: updated by a secant, where a new one would be dear
        settled = False  # the process force, as far as the last step could tell
        for steps in range(most):
            if idle == 2:
                return point, steps
            trusting = point if boldness == 1.0 else self._trusting(model, point, boldness)
            jacobian = self.jacobian(model, trusting, free=free, near=jacobian) if carried is None else carried
            ahead, damping = self.step(model, trusting, damping, free, jacobian)
            stale, carried = carried is not None, None
            if ahead is not trusting:
                if model.coupled:
                    carried = self._updated(jacobian, trusting, ahead)
                if settled and boldness == 1.0 and point.cost - ahead.cost > ENOUGH:
                    settled = False  # looked for every other time
                else:
                    begun = ahead.process_noise
                    ahead = self.with_process(ahead, model, begun * NEAR)
                    settled = bool(np.all(ahead.process_noise == begun))
            gained = point.cost - ahead.cost
            if gained > 0.0:
                point = ahead
            if gained >= ENOUGH:
                idle = 0
                if boldness == 1.0 and gained > FAR:
                    boldness, carried = BOLDNESS, None
                continue
            damping = DAMPING
            if stale:  # nothing can be said before the Jacobian is known again
                carried = None
            elif boldness > 1.0:  # nor under the filter's own process force, where it is another one
                boldness, carried = 1.0, None
            else:
                idle = idle + 1 if gained > 0.0 else 2
        return point, most

    def _trusting(self, model: Model, point: Point, boldness: float) -> Point:
        """The same hypothesis in a filter that has less of a process force to blame."""
        return self.at(
            model, point.theta, np.maximum(point.process_noise / boldness, self.floor), point.next_trajectory
        )
