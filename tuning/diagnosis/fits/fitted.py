"""A hypothesis at some values of its parameters, where a fit ended, and the programs by which both are computed."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.effects.stages import Effects
from diffdrive.model.parameters import Drive
from tuning.diagnosis.filter.derivatives import StepJacobians, innovations_of_forcings, step_jacobians_along
from tuning.diagnosis.filter.effect_signals import EffectSignals, Trajectory
from tuning.diagnosis.filter.ekf import EkfResult, ProcessNoise, compiled_filter
from tuning.diagnosis.fits.curvature import log_volume
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.model import Logged, Model, Vector


class Point(NamedTuple):
    """A hypothesis at some values of its parameters."""

    theta: Vector
    process_noise: Float[np.ndarray, " 2"]
    recalibrated_drive: Drive
    drive: Drive
    signals: EffectSignals
    trajectory: Trajectory  # that effects were stepped along
    filtered: EkfResult
    cost: float

    @property
    def next_trajectory(self) -> Trajectory:
        """Half way from that trajectory to the one that came of it."""
        return jax.tree.map(lambda a, b: 0.5 * (a + b), self.trajectory, self.filtered.trajectory)


class Fitted(NamedTuple):
    """Where a fit ended."""

    model: Model
    theta: Vector
    process_noise: Float[np.ndarray, " 2"]  # N, as in `ProcessNoise`
    cost: float  # deviance and prior
    filtered: EkfResult
    signals: EffectSignals
    step_jacobians: StepJacobians
    recalibrated_drive: Drive  # recalibrated
    drive: Drive  # and altered
    jacobian: Float[np.ndarray, "m k"]  # of the residuals, whose sum of squares is what the cost falls by
    residual: Float[np.ndarray, " m"]
    hessian: Float[np.ndarray, "k k"]
    steps: int
    second_encoder_deviance: float  # -2 log likelihood of what a second encoder saw; 0 without one

    @property
    def evidence(self) -> float:
        """-2 log of the probability of the logs under the hypothesis, up to a constant shared by all."""
        found = self.cost + self.second_encoder_deviance + log_volume(self.hessian)
        return found if np.isfinite(found) else np.inf


def last_candidate(fitted: Fitted) -> Candidate:
    """The effect that was added last."""
    return fitted.model.members[-1].candidate


compiled_step_jacobians = eqx.filter_jit(step_jacobians_along)


@eqx.filter_jit
def deviances_under(
    drive: Drive,
    signals: EffectSignals,
    coupled: Effects,
    processes: Float[Array, "q 2"],
    logged: Logged,
    trajectory: Trajectory,
) -> Float[Array, " q"]:
    """-2 log likelihood under each of several process forces (N)."""

    def one(process_noise: Float[Array, " 2"]) -> Float[Array, ""]:
        given = (logged.noise, logged.lanes, logged.sampling, trajectory)
        return compiled_filter(drive, signals, coupled, ProcessNoise(*process_noise), *given).deviance

    return jax.vmap(one)(processes)


@eqx.filter_jit
def innovation_jvp(
    filtered: EkfResult,
    step_jacobians: StepJacobians,
    machine: Float[Array, "p k"],
    signals: EffectSignals | None,
    counts: Float[Array, "lanes n"],
    period: float,
) -> Float[Array, "lanes n k"]:
    """Answers of the innovations, over their scatter, to changes of the machine's numbers ([p, k]) and of what acts."""
    forcing = jnp.einsum("lnrp,pk->lnrk", step_jacobians.machine, machine)
    off = jnp.zeros((*forcing.shape[:2], forcing.shape[-1]))
    if signals is not None:
        acts = jnp.stack([signals.force, signals.coulomb, signals.gap, signals.viscous], axis=-2)
        more = jnp.einsum("lnrc,lncm->lnrm", step_jacobians.signals, acts)
        forcing, off = (forcing + more).at[:, :, 0].add(signals.shift), signals.scale
    return innovations_of_forcings(filtered, step_jacobians, forcing, off, period) * counts[..., None]


def residual_jvp(
    fitted: Fitted, signals: EffectSignals, machine: Float[Array, "p k"] | None = None
) -> Float[np.ndarray, "m k"]:
    """Answers of a fit's residuals to changes of what acts ([lanes, n, k] each) and of the machine's numbers; zero
    where the filter was lost.
    """
    lanes, period = fitted.model.logged.lanes, fitted.model.logged.sampling.period
    if machine is None:
        machine = jnp.zeros((fitted.step_jacobians.machine.shape[-1], signals.force.shape[-1]))
    changes = innovation_jvp(fitted.filtered, fitted.step_jacobians, machine, signals, lanes.counts, period)
    return of_residuals(fitted, np.asarray(changes))


def of_residuals(fitted: Fitted, changes: Float[np.ndarray, "lanes n k"]) -> Float[np.ndarray, "m k"]:
    """Changes of the innovations over their scatter as changes of the residuals; zero where the filter was lost."""
    found = changes.reshape(fitted.residual.size, -1) / np.sqrt(float(fitted.filtered.noise_scale_sq))
    return np.where(fitted.residual[:, None] != 0.0, found, 0.0)
