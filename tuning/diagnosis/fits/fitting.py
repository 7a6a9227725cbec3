"""The likeliest values of a hypothesis, and its evidence.

Gauss-Newton on the filter's innovations with a prior, in Levenberg's damping; after each step the process force of the
filter is chosen anew. The evidence is Laplace's: the cost at its least, and the volume that the data leave of the
prior.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.effects.stages import Effects
from diffdrive.model.parameters import Drive
from tuning.diagnosis.filter.exposure import Course, Exposure
from tuning.diagnosis.filter.following import LOST, Process, Slopes, Track, answers, followed, slopes
from tuning.diagnosis.filter.second_encoder import Twist, foreseen, unlikelihood
from tuning.diagnosis.fits.curvature import limited, log_volume, solved
from tuning.diagnosis.fits.differences import by_numbers
from tuning.diagnosis.hypotheses.calibration import DELAY, NAMES
from tuning.diagnosis.hypotheses.model import (
    Logged,
    Model,
    Vector,
    exposed,
    exposure_by_machine,
    exposure_slopes,
    machine,
    machine_slopes,
)
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
SETTLING = 3  # passes after the last step: what a passing course gained is no evidence
FAR = 100.0  # of cost: a step that gains more is still on its way


class Fitted(NamedTuple):
    """Where a fit ended."""

    model: Model
    u: Vector
    process: Float[np.ndarray, " 2"]  # N, as in `Process`
    cost: float  # deviance and prior
    track: Track
    acting: Exposure
    linear: Slopes
    own: Drive  # recalibrated
    drive: Drive  # and altered
    jacobian: Float[np.ndarray, "m k"]  # of the residuals, whose sum of squares is what the cost falls by
    residual: Float[np.ndarray, " m"]
    hessian: Float[np.ndarray, "k k"]
    steps: int
    second: float  # -2 log likelihood of what a second encoder saw; 0 without one

    @property
    def evidence(self) -> float:
        """-2 log of the probability of the logs under the hypothesis, up to a constant shared by all."""
        found = self.cost + self.second + log_volume(self.hessian)
        return found if np.isfinite(found) else np.inf


slopes_of = eqx.filter_jit(slopes)


@eqx.filter_jit
def _deviances(
    drive: Drive, acting: Exposure, coupled: Effects, processes: Float[Array, "q 2"], logged: Logged, course: Course
) -> Float[Array, " q"]:
    def one(process: Float[Array, " 2"]) -> Float[Array, ""]:
        given = (logged.noise, logged.lanes, logged.sampling, course)
        return followed(drive, acting, coupled, Process(*process), *given).deviance

    return jax.vmap(one)(processes)


@eqx.filter_jit
def answered(
    track: Track,
    linear: Slopes,
    machine: Float[Array, "p k"],
    exposure: Exposure | None,
    counts: Float[Array, "lanes n"],
    period: float,
) -> Float[Array, "lanes n k"]:
    """Answers of the innovations, over their scatter, to the machine's numbers ([p, k]) and to exposures."""
    forcing = jnp.einsum("lnrp,pk->lnrk", linear.machine, machine)
    off = jnp.zeros((*forcing.shape[:2], forcing.shape[-1]))
    if exposure is not None:
        acts = jnp.stack([exposure.force, exposure.coulomb, exposure.gap, exposure.viscous], axis=-2)
        more = jnp.einsum("lnrc,lncm->lnrm", linear.exposure, acts)
        forcing, off = (forcing + more).at[:, :, 0].add(exposure.shift), exposure.scale
    return answers(track, linear, forcing, off, period) * counts[..., None]


class Point(NamedTuple):
    """A hypothesis at some values of its parameters."""

    u: Vector
    process: Float[np.ndarray, " 2"]
    own: Drive
    drive: Drive
    acting: Exposure
    course: Course  # that effects were stepped along
    track: Track
    cost: float

    @property
    def onward(self) -> Course:
        """Half way from that course to the one that came of it."""
        return jax.tree.map(lambda a, b: 0.5 * (a + b), self.course, self.track.course)


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

    @property
    def first(self) -> Float[np.ndarray, "w 2"]:
        """Process forces (N) where nothing is known of them."""
        lasting = np.geomspace(self.least, MOST, 7)
        return np.array([(one, share * one) for one in lasting for share in (1e-2, 0.3, 3.0)])

    def quiet(self, process: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "w 2"]:
        """These process forces (N) with any small sudden one: it matters, and the cost is rough in it."""
        sudden = np.geomspace(self.least, SUDDEN, SIZES)
        return np.stack([np.full(SIZES, process[0]), sudden], axis=1)

    def at(self, model: Model, u: Vector, process: np.ndarray, course: Course) -> Point:
        """The hypothesis at u."""
        effects = model.effects(u)
        loose, coupled = model.apart(effects)
        own, drive = machine(self.logged, jnp.asarray(model.calibration(u)), effects)
        acting = exposed(self.logged, own, loose, course)
        track = followed(drive, acting, coupled, Process(*jnp.asarray(process)), *self.given, course)
        cost = float(track.deviance) + float(u @ u)
        return Point(u, process, own, drive, acting, course, track, cost if np.isfinite(cost) else np.inf)

    def with_process(self, point: Point, model: Model, processes: np.ndarray) -> Point:
        """The same point under the likeliest of these process forces, its effects along its own track."""
        processes = np.clip(processes, self.least, MOST)
        filled = np.pad(processes, ((0, -len(processes) % len(NEAR)), (0, 0)), mode="edge")  # one program for all
        loose, coupled = model.apart(model.effects(point.u))
        acting = exposed(self.logged, point.own, loose, point.onward)
        parts = [jnp.asarray(some) for some in np.split(filled, len(filled) // len(NEAR))]
        found = np.concatenate(
            [_deviances(point.drive, acting, coupled, some, self.logged, point.onward) for some in parts]
        )
        found = found[: len(processes)]
        best = processes[int(np.argmin(np.where(np.isfinite(found), found, np.inf)))]
        return self.at(model, point.u, best, point.onward)

    def slopes(self, point: Point) -> Slopes:
        """What small changes do to the table over each period."""
        return slopes_of(point.drive, point.acting, point.track, self.logged.lanes, self.logged.sampling)

    def residuals(self, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Residuals, and the weights of those of their Jacobian."""
        track = point.track
        unit = 1.0 / np.sqrt(float(track.size))
        residual = (np.asarray(track.innovation) / np.asarray(track.scatter) * self.counts).ravel()
        kept = unit * (np.abs(residual) < LOST)  # where the filter was lost, no small change would have told it
        return kept * residual, kept

    def jacobian(
        self, model: Model, point: Point, linear: Slopes | None = None, free: Vector | bool = True
    ) -> np.ndarray:
        """Of the residuals, [m, k]; what is not `free` may be left out."""
        logged, track, (residual, kept) = self.logged, point.track, self.residuals(point)
        if model.coupled:
            moves = np.r_[model.prior.any(axis=0), np.ones(len(model.slots), bool)]
            wanted = np.flatnonzero(moves & (np.broadcast_to(free, model.size) != 0))
            found = by_numbers(model, point.u, point.process, track, point.course, wanted)
            return kept[:, None] * found
        linear = self.slopes(point) if linear is None else linear
        effects, b = model.effects(point.u), jnp.asarray(model.calibration(point.u))
        tangents, count = model.tangents(point.u)
        columns = machine_slopes(logged, b, effects, tangents if count else None)
        columns = columns.at[:, : len(NAMES)].set(columns[:, : len(NAMES)] @ model.prior)
        bend = None
        if count or model.prior[NAMES.index(DELAY)].any():  # else nothing acts but the command, as it is
            first = exposure_by_machine(logged, b, effects, point.course)
            bend = jax.tree.map(lambda a: a @ model.prior, first)
        if count:
            then = exposure_slopes(logged, point.own, effects, tangents, point.course)
            bend = jax.tree.map(lambda a, c: jnp.concatenate([a, c], axis=-1), bend, then)
        found = np.asarray(answered(track, linear, columns, bend, logged.lanes.counts, logged.sampling.period))
        return kept[:, None] * found.reshape(residual.size, -1)

    def step(
        self, model: Model, point: Point, damping: float, free: Vector, jacobian: np.ndarray
    ) -> tuple[Point, float]:
        """One damped step under the point's process force; the point itself where none gains."""
        residual, jacobian = self.residuals(point)[0], jacobian * free
        hessian, slope = jacobian.T @ jacobian + np.eye(model.size), jacobian.T @ residual + free * point.u
        for _ in range(TRIALS):
            step = -limited(solved(hessian + damping * np.eye(model.size), slope))
            ahead = self.at(model, point.u + step, point.process, point.onward)
            if ahead.cost < point.cost:
                return ahead, max(0.1 * damping, 1e-3)
            damping = 10.0 * damping
        return point, damping

    def _updated(self, jacobian: np.ndarray, before: Point, ahead: Point) -> np.ndarray:
        """The Jacobian after a step, by the secant along it (Broyden 1965)."""
        step = ahead.u - before.u
        off = self.residuals(ahead)[0] - self.residuals(before)[0] - jacobian @ step
        return jacobian + np.outer(off, step) / (step @ step)

    def fit(
        self,
        model: Model,
        u: Vector,
        process: np.ndarray | None,
        course: Course,
        most: int = MOST_STEPS,
        free: Vector | None = None,
    ) -> Fitted:
        """From `u`; `course` is where the effects are first stepped along, `free` are ones for what may move."""
        point, steps = self.sought(model, u, process, course, most, free)
        for _ in range(SETTLING):
            point = self.at(model, point.u, point.process, point.onward)
        return self._linearised(model, point, steps)

    def under(self, fitted: Fitted, process: Float[np.ndarray, " 2"]) -> Fitted:
        """The same hypothesis with the same numbers, in a filter that may invent other forces (N)."""
        point = self.at(fitted.model, fitted.u, process, fitted.track.course)
        return self._linearised(fitted.model, point, fitted.steps)

    def _linearised(self, model: Model, point: Point, steps: int) -> Fitted:
        linear, residual = self.slopes(point), self.residuals(point)[0]
        jacobian = self.jacobian(model, point, linear)
        hessian = jacobian.T @ jacobian + np.eye(model.size)
        return Fitted(
            model, point.u, point.process, point.cost, point.track, point.acting, linear, point.own, point.drive,
            jacobian, residual, hessian, steps, self._second(model, point),
        )  # fmt: skip

    def _second(self, model: Model, point: Point) -> float:
        """What the second encoder says of a point."""
        if self.twist is None:
            return 0.0
        expected = foreseen(model.effects(point.u), point.track)
        return unlikelihood(self.twist, expected, self.logged.sampling.period)

    def sought(
        self, model: Model, u: Vector, process: np.ndarray | None, course: Course, most: int, free: Vector | None = None
    ) -> tuple[Point, int]:
        """Where `fit` ends, and after how many steps: at the least, and on from there if quite another noise gains."""
        free = np.ones(model.size) if free is None else free
        if self.store is None:
            return self._searched(model, u, process, course, most, free)
        key = digest("sought", self.logged, model, u, process, course, most, free)
        kept = self.store.read(key)
        if kept is not None:
            along = Course(*(jnp.asarray(kept[name]) for name in Course._fields))
            return self.at(model, kept["u"], kept["process"], along), int(kept["steps"])
        point, steps = self._searched(model, u, process, course, most, free)
        ended = {"u": point.u, "process": point.process, "steps": np.array(steps)}
        self.store.write(key, ended | {name: np.asarray(one) for name, one in point.course._asdict().items()})
        return point, steps

    def _searched(
        self, model: Model, u: Vector, process: np.ndarray | None, course: Course, most: int, free: Vector
    ) -> tuple[Point, int]:
        point = self.at(model, u, BEGIN if process is None else process, course)
        if process is None:
            point = self.with_process(point, model, self.first)
        point, steps = self._down(model, point, most, free, BOLDNESS)
        if steps == most:
            return point, steps
        lasts = point.process[0] >= MISSED
        other = self.with_process(point, model, self.first if lasts else self.quiet(point.process))
        if point.cost - other.cost < ENOUGH:
            return point, steps
        point, more = self._down(model, other, most - steps, free, 1.0)
        return point, steps + more

    def _down(self, model: Model, point: Point, most: int, free: Vector, boldness: float) -> tuple[Point, int]:
        """To where no step gains any more, in at most so many, and how many it took.

        As long as there is much to gain the filter's process force is taken as so many times smaller.
        """
        damping, idle = DAMPING, 0
        carried = None  # the Jacobian, where a new one would be dear
        settled = False  # the process force, as far as the last step could tell
        for steps in range(most):
            if idle == 2:
                return point, steps
            trusting = point if boldness == 1.0 else self._trusting(model, point, boldness)
            jacobian = self.jacobian(model, trusting, free=free) if carried is None else carried
            ahead, damping = self.step(model, trusting, damping, free, jacobian)
            stale, carried = carried is not None, None
            if ahead is not trusting:
                if model.coupled:
                    carried = self._updated(jacobian, trusting, ahead)
                if settled and boldness == 1.0 and point.cost - ahead.cost > ENOUGH:
                    settled = False  # looked for every other time
                else:
                    begun = ahead.process
                    ahead = self.with_process(ahead, model, begun * NEAR)
                    settled = bool(np.all(ahead.process == begun))
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
        return self.at(model, point.u, np.maximum(point.process / boldness, self.least), point.onward)
