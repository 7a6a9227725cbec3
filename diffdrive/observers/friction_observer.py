"""The friction observer: a Kalman filter on the drive's own model (paper, section 3.1), with its load estimator.

Once a control period an observer takes the force that acted since the last one and the position measured now, and
returns its estimates: friction to cancel, load, velocity.
"""

import abc
import dataclasses
from typing import Annotated, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from diffdrive.model.friction import LuGreCoefficients, friction_force, lugre_coefficients
from diffdrive.model.memory import Memory
from diffdrive.model.parameters import Friction, Plant
from diffdrive.model.quantity import quantity, quantity_table
from diffdrive.model.transition import state_matrices, transition
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.once import once
from diffdrive.observers import kalman
from diffdrive.observers.load_estimator import FixedLoad, InnovationLoad
from diffdrive.support.typing import TomlTable


class ObserverEstimate(NamedTuple):
    """The estimates of an observer at each sample; None where it makes none."""

    friction: Scalar  # N, without the damping B_S v
    load: Scalar | None = None  # N
    velocity: Scalar | None = None  # m/s
    innovation: Scalar | None = None  # m, measured minus predicted position


_ESTIMATED = ("position", "velocity", "bristle deflection", "load")
_UNITS = ("m", "m/s", "m", "N")
_COVARIANCE_UNITS = (("m^2", "m^2/s", "m^2", "N*m"), ("m^2/s^2", "m^2/s", "N*m/s"), ("m^2", "N*m"), ("N^2",))


def _covariance(name: str, other: str) -> str:
    return f"variance of the estimated {name}" if name == other else f"covariance of the estimated {name} and {other}"


_OF_X = tuple(Memory(unit, f"estimated {name}") for name, unit in zip(_ESTIMATED[:3], _UNITS, strict=False))
_OF_COVARIANCE = tuple(
    tuple(
        Memory(unit, _covariance(name, other))
        for other, unit in zip(_ESTIMATED[row:], _COVARIANCE_UNITS[row], strict=True)
    )
    for row, name in enumerate(_ESTIMATED)
)


class ObserverState(NamedTuple):
    """Estimated [x, v, z], its covariance and the estimated load (N)."""

    x: Annotated[kalman.Vector, _OF_X]
    covariance: Annotated[kalman.Triangle, _OF_COVARIANCE]
    load: Annotated[Scalar, Memory("N", "load on the guides, estimated or assumed")]


class FrictionObserver(eqx.Module):
    """Interface of every friction observer: a filter on the drive's own model."""

    plant: eqx.AbstractVar[Plant]
    friction: eqx.AbstractVar[Friction]

    @property
    @abc.abstractmethod
    def suffix(self) -> str:
        """The suffix of the controller's kind, after pd+fc."""

    @abc.abstractmethod
    def tables(self) -> TomlTable:
        """Its tables [controller.observer] and [controller.load_estimator] of a drive file."""

    @property
    @abc.abstractmethod
    def gains(self) -> dict[str, str]:
        """Paths of its tunable parameters, by the gain's name in the controller."""

    @abc.abstractmethod
    def init(self, position: Scalar) -> PyTree:
        """State of the observer for a table at rest at `position` (m)."""

    def moving(
        self, state: PyTree, position: Scalar, velocity: Scalar, bristle: Scalar | None, load: Scalar | None
    ) -> PyTree:
        """As `Controller.moving`."""
        return state

    def is_dynamic(self, state: PyTree) -> PyTree:
        """As `Controller.is_dynamic`."""
        return True

    @abc.abstractmethod
    def step(self, state: PyTree, force: Scalar, position: Scalar, period: float) -> tuple[PyTree, ObserverEstimate]:
        """One period: `force` (N) acted over it, `position` (m) was measured at its end."""


def _moving(
    state: ObserverState,
    friction: Friction,
    position: Scalar,
    velocity: Scalar,
    bristle: Scalar | None,
    load: Scalar | None,
) -> ObserverState:
    """The state with the estimates of a steady motion; a bristle that is not known is that of this friction."""
    if load is not None:
        state = state._replace(load=load)
    if bristle is None:
        coefficients = lugre_coefficients(friction, velocity, velocity, state.load)
        bristle = jnp.sign(velocity) * coefficients.level / coefficients.stiffness
    return state._replace(x=(position, velocity, bristle))


class Tuning(eqx.Module):
    """Q = diag(position, velocity, bristle) and R of the filter."""

    position: Scalar = quantity("m^2", "process noise of the position, Q[0]", at_least=0.0, default=1e-15)
    velocity: Scalar = quantity("m^2/s^2", "process noise of the velocity, Q[1]", at_least=0.0, default=1e-10)
    bristle: Scalar = quantity("m^2", "process noise of the bristle, Q[2]", at_least=0.0, default=1e-12)
    measurement: Scalar = quantity(
        "m^2", "measurement noise, R; resolution^2 / 12 where nothing else is known", above=0.0, default=8.3e-16
    )

    @property
    def process(self) -> kalman.Vector:
        """The diagonal of Q."""
        return (self.position, self.velocity, self.bristle)


def estimated_friction(friction: Friction, x: kalman.Vector, load: Scalar) -> Scalar:
    """Fhat = [0, s1 + mu_v, s0 (1 - s1 |v| / g)] Xhat (paper, eq. (18))."""
    _, velocity, deflection = x
    return friction_force(lugre_coefficients(friction, velocity, deflection, load), velocity, deflection)


# paths of the filter's noise covariances: Q of each state, and R
NOISE_GAINS = {
    "Q_position": "tuning.position",
    "Q_velocity": "tuning.velocity",
    "Q_bristle": "tuning.bristle",
    "R": "tuning.measurement",
}


class KalmanObserver(FrictionObserver):
    """The paper's observer: state-dependent Ad, Bd at the estimated velocity, and a load estimator on top."""

    plant: Plant
    friction: Friction
    tuning: Tuning = Tuning()
    load_estimator: FixedLoad | InnovationLoad = FixedLoad()

    @property
    def suffix(self) -> str:
        return self.load_estimator.suffix

    def tables(self) -> TomlTable:
        return {"observer": quantity_table(self.tuning), "load_estimator": quantity_table(self.load_estimator)}

    @property
    def gains(self) -> dict[str, str]:
        estimator = {name: f"load_estimator.{path}" for name, path in self.load_estimator.gains.items()}
        return NOISE_GAINS | estimator

    def init(self, position: Scalar) -> ObserverState:
        zero = jnp.zeros_like(position)
        x = (position, zero, zero)
        variances = jax.tree.map(lambda q: q + zero, (*self.tuning.process,))
        return ObserverState(x, kalman.diagonal(variances), self.load_estimator.init() + zero)

    def moving(
        self, state: ObserverState, position: Scalar, velocity: Scalar, bristle: Scalar | None, load: Scalar | None
    ) -> ObserverState:
        estimated_load = load if self.load_estimator.estimates_load else None
        return _moving(state, self.friction, position, velocity, bristle, estimated_load)

    def is_dynamic(self, state: ObserverState) -> PyTree:
        is_dynamic = jax.tree.map(lambda _: True, state)
        return is_dynamic._replace(covariance=False, load=self.load_estimator.estimates_load)

    def step(
        self, state: ObserverState, force: Scalar, position: Scalar, period: float
    ) -> tuple[ObserverState, ObserverEstimate]:
        _, velocity, deflection = state.x
        coefficients = once(lugre_coefficients(self.friction, velocity, deflection, state.load))
        ad, bd = state_matrices(self.plant, coefficients, velocity, period)
        total_force = force + self.plant.constant_force
        predicted = tuple(p + b * total_force for p, b in zip(kalman.matvec(ad, state.x), bd, strict=True))
        covariance = kalman.predict_covariance(state.covariance, ad, self.tuning.process)
        predicted, covariance = once((predicted, covariance))

        gain = kalman.kalman_gain(covariance, self.tuning.measurement)
        innovation = position - predicted[0]
        updated = tuple(p + g * innovation for p, g in zip(predicted, gain, strict=True))
        covariance = kalman.update_covariance(covariance, gain, self.tuning.measurement)

        predicted_friction = estimated_friction(self.friction, predicted, state.load)
        # without this barrier the compiler computes a value again for each of its readers (docs/method/numerics.md)
        updated, covariance, predicted_friction = once((updated, covariance, predicted_friction))
        updated_friction = once(estimated_friction(self.friction, updated, state.load))
        load = self.load_estimator.step(state.load, velocity, predicted_friction, updated_friction)
        state = once(ObserverState(updated, covariance, load))
        estimated_load = load if self.load_estimator.estimates_load else None  # an assumption is no estimate
        return state, ObserverEstimate(updated_friction, estimated_load, updated[1], innovation)


class LoadStateTuning(eqx.Module):
    """Q and R of the four-state filter; the load is a random walk of variance `load` per control step.

    The defaults, for 10 kHz, settle within a second at every speed from 1 to 100 mm/s (docs/method/load-estimation.md).
    """

    position: Scalar = quantity("m^2", "process noise of the position", at_least=0.0, default=1e-16)
    velocity: Scalar = quantity("m^2/s^2", "process noise of the velocity", at_least=0.0, default=1e-11)
    bristle: Scalar = quantity("m^2", "process noise of the bristle", at_least=0.0, default=1e-15)
    load: Scalar = quantity("N^2", "process noise of the load, per control step", above=0.0, default=1000.0)
    measurement: Scalar = quantity("m^2", "measurement noise, R", above=0.0, default=8.3e-16)

    @property
    def process(self) -> kalman.Vector:
        """The diagonal of Q."""
        return (self.position, self.velocity, self.bristle, self.load)


class LoadStateObserver(FrictionObserver):
    """The load as a fourth state of the filter, so that its correction has the right sign at every speed.

    The paper's eq. (20) corrects the load by the change of the friction estimate, whose sign depends on speed, Q and R
    (`convergence.convergence_gain`). Here the filter's own covariance between load and position gives the
    correction: sliding at v, one newton of load bends the bristle by dz/dt = (r z / g) mu_LC, a direction that keeps
    its sign from creep to traverse and vanishes in stick, where the load is not observable.
    """

    plant: Plant
    friction: Friction
    tuning: LoadStateTuning = LoadStateTuning()
    initial_load: Scalar = quantity("N", "load estimate at the start", default=0.0)
    floor: Scalar | None = quantity("N", "smallest load estimate; 'none': no floor", default=0.0, optional=True)

    @property
    def suffix(self) -> str:
        return "+ls"

    def tables(self) -> TomlTable:
        return {"observer": quantity_table(self.tuning), "load_estimator": quantity_table(self)}

    @property
    def gains(self) -> dict[str, str]:
        return NOISE_GAINS | {"Q_load": "tuning.load"}

    def smoothed(self) -> "LoadStateObserver":
        """The smooth variant: no floor."""
        return dataclasses.replace(self, floor=None)

    def init(self, position: Scalar) -> ObserverState:
        zero = jnp.zeros_like(position)
        variances = jax.tree.map(lambda q: q + zero, self.tuning.process)
        return ObserverState((position, zero, zero), kalman.diagonal(variances), self.initial_load + zero)

    def moving(
        self, state: ObserverState, position: Scalar, velocity: Scalar, bristle: Scalar | None, load: Scalar | None
    ) -> ObserverState:
        return _moving(state, self.friction, position, velocity, bristle, load)

    def is_dynamic(self, state: ObserverState) -> PyTree:
        return jax.tree.map(lambda _: True, state)._replace(covariance=False)

    def step(
        self, state: ObserverState, force: Scalar, position: Scalar, period: float
    ) -> tuple[ObserverState, ObserverEstimate]:
        friction = self.friction
        _, velocity, deflection = state.x
        coefficients = lugre_coefficients(friction, velocity, deflection, state.load)
        ad, bd = state_matrices(self.plant, coefficients, velocity, period)
        column = self._load_column(coefficients, velocity, deflection, period)
        total_force = force + self.plant.constant_force
        predicted = tuple(p + b * total_force for p, b in zip(kalman.matvec(ad, state.x), bd, strict=True))
        ad4 = (*((*row, c) for row, c in zip(ad, column, strict=True)), (0.0, 0.0, 0.0, 1.0))
        covariance = kalman.predict_covariance(state.covariance, ad4, self.tuning.process)
        predicted, covariance = once((predicted, covariance))

        gain = kalman.kalman_gain(covariance, self.tuning.measurement)
        innovation = position - predicted[0]
        updated = tuple(p + g * innovation for p, g in zip(predicted, gain[:3], strict=True))
        load = state.load + gain[3] * innovation
        load = load if self.floor is None else jnp.maximum(load, self.floor)
        covariance = kalman.update_covariance(covariance, gain, self.tuning.measurement)
        updated_friction = estimated_friction(friction, updated, load)
        state = once(ObserverState(updated, covariance, load))
        return state, ObserverEstimate(updated_friction, load, updated[1], innovation)

    def _load_column(
        self, coefficients: LuGreCoefficients, velocity: Scalar, deflection: Scalar, period: float
    ) -> kalman.Vector:
        """d[x, v, z]/dW over one period: the bristle is pushed by (r z / g) mu_LC per newton of load."""
        deflection_rate = (
            coefficients.rate * deflection / coefficients.level * self.friction.load_coefficient.towards(velocity)
        )
        source = (-coefficients.damping * deflection_rate / self.plant.mass, deflection_rate)
        _, integral, double = transition(self.plant, coefficients, velocity, period)
        return (kalman.dot(double[0], source), *kalman.matvec(integral, source))
