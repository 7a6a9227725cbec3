"""Does the load estimator of eq. (20) converge, at which speeds, and how fast?

At constant speed, let the observer's Coulomb friction be wrong by one newton. The filter settles into a state with a
constant innovation, and eq. (20) integrates the change of the friction estimate that this innovation causes, G newtons
per newton of error. The error of the load then decays as (1 - K_w mu_LC G)^k: for G <= 0 it does not decay at all.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.controllers import Controller, FrictionCompensation
from diffdrive.errors import LoadEstimatorError
from diffdrive.model.friction import lugre_coefficients, resolvable, steady_friction, stribeck_level
from diffdrive.model.parameters import Friction
from diffdrive.model.transition import state_matrices
from diffdrive.motion.motion import Motion
from diffdrive.numerics.arrays import Scalar, as_arrays, require_double_precision
from diffdrive.observers import kalman
from diffdrive.observers.friction_observer import KalmanObserver, estimated_friction
from diffdrive.observers.load_estimator import InnovationLoad


def steady_covariance(ad: Array, process: Array, measurement: Scalar) -> Array:
    """Predicted covariance at which the filter settles: the stabilising solution of the discrete Riccati equation.

    Structure-preserving doubling (Anderson 1978; Chu, Fan & Lin 2005): 2^k steps of the filter in k iterations, hence
    differentiable, unlike a library's Schur method.
    """
    size = len(process)
    # scaled by the noise, so that metres^2 of 1e-18 do not meet rounding of order one
    scale = jnp.sqrt(process + measurement)
    a = (ad * scale[None, :] / scale[:, None]).T
    g = jnp.zeros((size, size)).at[0, 0].set(scale[0] ** 2 / measurement)
    h = jnp.diag(process / scale**2)

    def double(carry: tuple[Array, Array, Array], _: None) -> tuple[tuple[Array, Array, Array], None]:
        a, g, h = carry
        inverse = jnp.linalg.inv(jnp.eye(size) + g @ h)
        next_a = a @ inverse @ a
        return (next_a, g + a @ inverse @ g @ a.T, h + a.T @ h @ inverse @ a), None

    (_, _, h), _ = jax.lax.scan(double, (a, g, h), None, length=30)
    return h * scale[:, None] * scale[None, :]


def convergence_gain(observer: KalmanObserver, velocity: Scalar, period: float, load: Scalar = 0.0) -> Float[Array, ""]:
    """G of eq. (20): newtons of Fhat[k+1|k+1] - Fhat[k+1|k] per newton of Coulomb error, sliding at `velocity` (m/s).

    Dimensionless, signed with the direction of motion; differentiable. `load` (N) is the load slid under.
    """
    plant, friction, tuning = observer.plant, resolvable(observer.friction), observer.tuning
    level = stribeck_level(friction, velocity, load)
    deflection = jnp.sign(velocity) * level / lugre_coefficients(friction, velocity, velocity, load).stiffness
    force = (
        steady_friction(friction, velocity, load) + plant.damping.towards(velocity) * velocity
    )  # the force that slides it
    rows, _ = state_matrices(plant, lugre_coefficients(friction, velocity, deflection, load), velocity, period)
    ad = jnp.stack([jnp.stack([jnp.asarray(entry, jnp.float64) for entry in row]) for row in rows])
    covariance = steady_covariance(ad, jnp.stack(as_arrays(tuning.process)), tuning.measurement)
    gain = covariance[:, 0] / (covariance[0, 0] + tuning.measurement)

    def one_step(state: Array, error: Scalar) -> tuple[Array, Scalar]:
        """The observer in the frame that moves with the table; `error` (N) is missing in its Coulomb friction."""
        mismatched = _with_coulomb(friction, -error)
        x = tuple(state)
        ad, bd = state_matrices(plant, lugre_coefficients(mismatched, x[1], x[2], load), x[1], period)
        predicted = jnp.stack([p + b * force for p, b in zip(kalman.matvec(ad, x), bd, strict=True)])
        predicted = predicted.at[0].add(-velocity * period)
        updated = predicted - gain * predicted[0]
        change = estimated_friction(mismatched, tuple(updated), load) - estimated_friction(
            mismatched, tuple(predicted), load
        )
        return updated, change

    settled = jnp.stack([jnp.zeros_like(level), velocity + jnp.zeros_like(level), deflection])
    (by_state, by_error), (change_by_state, change_by_error) = jax.jacfwd(one_step, argnums=(0, 1))(settled, 0.0)
    shift = jnp.linalg.solve(jnp.eye(3) - by_state, by_error)
    return jnp.sign(velocity) * (change_by_state @ shift + change_by_error)


def _with_coulomb(friction: Friction, extra: Scalar) -> Friction:
    """The same friction with `extra` newtons of Coulomb friction in both directions."""
    return eqx.tree_at(
        lambda f: f.coulomb_screw, friction, jax.tree.map(lambda level: level + extra, friction.coulomb_screw)
    )


@eqx.filter_jit
def _gains(observer: KalmanObserver, velocities: Array, period: float, load: Scalar) -> Float[Array, " n"]:
    return jax.vmap(lambda v: convergence_gain(observer, v, period, load))(velocities)


def convergence_gains(
    observer: KalmanObserver, velocities: Sequence[float] | np.ndarray, period: float, load: float = 0.0
) -> Float[np.ndarray, " n"]:
    """`convergence_gain` at each of `velocities` (m/s, none of them zero)."""
    require_double_precision()
    velocities = np.asarray(velocities, float)
    if not np.all(np.isfinite(velocities)) or np.any(velocities == 0):
        raise LoadEstimatorError(
            "the convergence gain needs finite velocities other than zero: in stick the load is not observable"
        )
    return np.asarray(_gains(as_arrays(observer), jnp.asarray(velocities), period, as_arrays(load)))


def time_constants(
    observer: KalmanObserver, velocities: Sequence[float] | np.ndarray, period: float, load: float = 0.0
) -> Float[np.ndarray, " n"]:
    """Time constant (s) of the load error at each velocity; infinite where it does not decay."""
    estimator = observer.load_estimator
    if not isinstance(estimator, InnovationLoad):
        raise LoadEstimatorError("this observer has no eq. (20) load estimator (InnovationLoad)")
    velocities = np.asarray(velocities, float)
    gains = convergence_gains(observer, velocities, period, load)
    load_coefficient = observer.friction.load_coefficient
    per_step = (
        float(estimator.gain)
        * np.where(velocities >= 0, float(load_coefficient.positive), float(load_coefficient.negative))
        * gains
    )
    converges = (per_step > 0) & (per_step < 2)
    remaining = np.abs(1 - np.where(converges, per_step, 0.5))
    with np.errstate(divide="ignore"):  # a gain so small that the error does not decay
        return np.where(converges, -period / np.log(np.maximum(remaining, 1e-300)), np.inf)


def innovation_load_observer(controller: Controller) -> KalmanObserver | None:
    """The observer with an eq. (20) estimator in this controller, if there is one; its numbers may be traced."""
    observer = controller.observer if isinstance(controller, FrictionCompensation) else None
    if isinstance(observer, KalmanObserver) and isinstance(observer.load_estimator, InnovationLoad):
        return observer
    return None


def active_innovation_load_observer(controller: Controller) -> KalmanObserver | None:
    """The observer with an eq. (20) estimator in this controller, if there is one and it is switched on."""
    observer = innovation_load_observer(controller)
    if observer is None or not isinstance(observer.load_estimator, InnovationLoad):
        return None
    return observer if float(observer.load_estimator.gain) > 0 else None


def divergent_speeds(
    observer: KalmanObserver,
    speeds: Sequence[float] | np.ndarray,
    period: float,
    loads: Sequence[float] = (0.0,),
) -> list[float]:
    """Those of `speeds` (m/s) above the estimator's `min_speed` at which eq. (20) fails to converge.

    It must converge in both directions and under each of `loads` (N), since G's change of sign moves with the load.
    """
    gate = float(observer.load_estimator.min_speed) if isinstance(observer.load_estimator, InnovationLoad) else np.inf
    moving_speeds = np.asarray([v for v in speeds if v > gate])
    if not len(moving_speeds):
        return []
    times = [time_constants(observer, sign * moving_speeds, period, load) for sign in (1.0, -1.0) for load in loads]
    return [
        float(v) for v, converges in zip(moving_speeds, np.isfinite(times).all(axis=0), strict=True) if not converges
    ]


def _divergence_message(speeds: Sequence[float]) -> str:
    listed = ", ".join(f"{1e3 * v:.3g}" for v in speeds)
    return (
        f"the eq. (20) load estimator does not converge at {listed} mm/s: its gain G is not positive there (see "
        'docs/method/load-estimation.md). Use LoadStateObserver (drive file: kind = "pd+fc+ls"), raise its min_speed '
        "above these, or choose Q and R with G > 0"
    )


def convergence_warnings(controller: Controller, motion: Motion, load: np.ndarray, period: float) -> list[str]:
    """Warnings about this controller's eq. (20) estimator on this motion under this load (N).

    It must converge at the motion's working speeds under its lowest and highest load, and not cruise at its gate.
    """
    observer = active_innovation_load_observer(controller)
    if observer is None:
        return []
    deciles = np.round(np.quantile(np.abs(motion.velocity), np.linspace(0.1, 1.0, 10)), 6)
    gate = float(observer.load_estimator.min_speed)  # type: ignore[union-attr]
    warnings = []
    if gate > 0 and int(np.sum(np.abs(deciles - gate) < 0.05 * gate)) >= 2:
        warnings.append(
            f"the motion cruises at the load estimator's min_speed of {1e3 * gate:g} mm/s: noise then decides which "
            "corrections pass the gate, and the load estimate drifts; set min_speed well below or above the speeds of "
            "the motion"
        )
    extremes = sorted({float(np.min(load)), float(np.max(load))})
    divergent = divergent_speeds(observer, np.unique(deciles), period, extremes)
    return warnings + ([_divergence_message(divergent)] if divergent else [])
