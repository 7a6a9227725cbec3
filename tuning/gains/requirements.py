"""What a tuned loop must keep: stability margins, command noise, force limit, a true load estimate.

Every requirement is a number that must not be positive: how far it is exceeded, as a share of what is required.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.controllers import Controller
from diffdrive.loop.convergence import convergence_gain, innovation_load_observer
from diffdrive.loop.linearise import OperatingPoint, open_loop
from diffdrive.loop.margins import NEUTRAL_GROWTH, Margins, margins
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import as_arrays
from diffdrive.observers.friction_observer import KalmanObserver
from diffdrive.observers.load_estimator import InnovationLoad
from diffdrive.support.bounds import require_number
from tuning.gains.measured import NAME, MeasuredMachine
from tuning.gains.objective import rms
from tuning.gains.scenarios import EnsembleSignals

MAX_GAIN_MARGIN = -20.0 * float(np.log10(np.finfo(float).eps))  # dB: beside a loop gain of more, 1 is rounding
UNSTABLE = 20.0  # 1/s of growth that counts as much as a margin that is missed altogether
USUAL_MARGINS, NO_LIMIT = "6 to 12 are usual", "None is no limit"


class LoopLimits(NamedTuple):
    """What is required, in SI units; None: no limit."""

    gain_up: float = 2.0  # factors
    gain_down: float = 2.0
    phase: float | None = float(np.radians(30.0))  # above 0: requirements are missed by a share of their limit
    sensitivity: float | None = None  # peak of |1 / (1 + L)|
    command_noise: float | None = 20.0  # N, in every lane
    load_error: float | Float[np.ndarray, " lanes"] | None = None  # N of RMS, in every lane or in each
    settling: float | None = 2.0  # s, in which an eq. (20) estimator, where there is one, forgets an error to 1/e


@dataclass(frozen=True)
class AsGiven:
    """A limit relative to the gains as given: `factor` times what these reach in the scenarios that are tuned on."""

    factor: float

    def __post_init__(self) -> None:
        require_number("AsGiven: factor", self.factor, above=0.0)


@dataclass(frozen=True)
class Requirements:
    """What the tuned loop must keep, at every speed, direction and load; None: no limit.

    Margins are those of the linearised loop, delay and observer included. `command_noise` is the RMS of the command's
    change from sample to sample over the square root of two. `load_error` is the RMS error of the load estimate. Both
    hold in every scenario. A number is in N; `AsGiven(2.0)` is twice the largest noise of the gains as given, and for
    the load error twice theirs, scenario by scenario.

    A default that means nothing for an axis does not apply: a limit of a load estimate where there is none, and
    what is relative to gains with which the loop diverges. Any other value is refused there, since nothing would check
    it.

    Raises:
        ParameterError: No loop can keep it, or it is no number.

    Examples:
        >>> Requirements(phase_margin=35.0, command_noise=20.0)
        >>> Requirements(command_noise=None)  # the margins alone limit it
        >>> Requirements(command_noise=AsGiven(1.0))  # as quiet as it is

    """

    gain_margin: float = 6.0  # dB, up and down
    phase_margin: float = 30.0  # deg
    peak_sensitivity: float | None = None  # largest |1 / (1 + L)|
    command_noise: float | AsGiven | None = AsGiven(2.0)  # N
    load_error: float | AsGiven | None = AsGiven(1.1)  # N
    load_settling: float | None = 2.0  # s, in which an estimator as eq. (20) forgets an error of the load to 1/e

    def __post_init__(self) -> None:
        # beyond the largest gain margin gains are lost in rounding
        require_number("gain_margin", self.gain_margin, "dB", at_least=0.0, at_most=MAX_GAIN_MARGIN, hint=USUAL_MARGINS)
        require_number("phase_margin", self.phase_margin, "degrees", at_least=0.0, at_most=90.0)
        if self.peak_sensitivity is not None:
            require_number("peak_sensitivity", self.peak_sensitivity, at_least=1.0, hint=NO_LIMIT)
        for name, unit in (("command_noise", "N"), ("load_error", "N"), ("load_settling", "s")):
            limit = getattr(self, name)
            if limit is not None and not isinstance(limit, AsGiven):
                require_number(name, limit, unit, above=0.0, hint=NO_LIMIT)

    def states(self, name: str) -> bool:
        """Whether this requirement is one of the caller's: not its default, and not None, which requires nothing."""
        limit = getattr(self, name)
        return limit is not None and limit != getattr(type(self), name)

    def limits(self, command_noise: float | None, load_error: Float[np.ndarray, " lanes"] | float | None) -> LoopLimits:
        """As factors and radians, with these limits of the signals (N): those of `AsGiven` hang on simulations."""
        factor = 10.0 ** (self.gain_margin / 20.0)
        return LoopLimits(
            gain_up=factor, gain_down=factor,
            phase=float(np.radians(self.phase_margin)) if self.phase_margin > 0.0 else None,
            sensitivity=self.peak_sensitivity, command_noise=command_noise, load_error=load_error,
            settling=self.load_settling,
        )  # fmt: skip


class OperatingPoints(NamedTuple):
    """Operating points at which margins are looked at, [p] each, and the machines there."""

    drives: Drive  # every number [p]
    velocity: Float[np.ndarray, " p"]  # m/s
    load: Float[np.ndarray, " p"]  # N


def operating_points(drives: Sequence[Drive], speeds: Sequence[float], loads: Sequence[float]) -> OperatingPoints:
    """Every machine at every speed (m/s, both directions; 0 is standstill) under every load (N)."""
    velocities = sorted({sign * speed for speed in speeds for sign in (1.0, -1.0)})
    grid = [(drive, v, w) for drive in drives for v in velocities for w in dict.fromkeys(loads)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(as_arrays(smooth(drive)) for drive, _, _ in grid))
    return OperatingPoints(stacked, np.array([v for _, v, _ in grid]), np.array([w for *_, w in grid], float))


class Constraints(eqx.Module):
    """Limits, and where they are looked at. Every number is an array, so that another limit is no other program."""

    limits: LoopLimits = eqx.field(converter=as_arrays)
    points: OperatingPoints
    sampling: Sampling = eqx.field(static=True)
    measured: tuple[MeasuredMachine, ...] = ()

    def margins(self, controller: Controller) -> Margins:
        """The margins at every operating point, [p] each; `controller` is the smooth variant."""

        def margins_at(drive: Drive, velocity: Array, load: Array) -> Margins:
            return margins(open_loop(drive, controller, self.sampling, OperatingPoint(velocity, load)))

        return jax.vmap(margins_at)(
            self.points.drives, jnp.asarray(self.points.velocity), jnp.asarray(self.points.load)
        )

    def loop_constraints(self, controller: Controller) -> dict[str, Float[Array, " p"]]:
        """Requirements on the loop alone, by name: no simulation is needed."""
        found = self.margins(controller)
        constraints: dict[str, Float[Array, " p"]] = {
            "stability": jnp.asarray((found.growth - NEUTRAL_GROWTH) / UNSTABLE),
            **self._margin_constraints(found),
            **self._measured_constraints(controller),
        }
        observer = innovation_load_observer(controller)
        if observer is not None and self.limits.settling is not None:
            constraints["load estimator"] = self._settling(observer)
        return constraints

    def _margin_constraints(self, found: Margins) -> dict[str, Float[Array, " p"]]:
        """Required margins, by name.

        An unstable loop has no margins: it misses them by as much as a loop at the brink of instability. Where it is
        the measured loop that turns about -1, it crosses the real axis beyond -1, and its gain must fall by that factor
        and by the margin: so what it misses goes on smoothly from that of a stable loop, which crosses short of -1.
        """
        limits, stable = self.limits, found.growth < NEUTRAL_GROWTH
        beyond = jnp.isinf(found.growth) & jnp.isfinite(found.gain_down)
        excess = limits.gain_up * jnp.where(beyond, found.gain_down, 1.0) - 1.0
        constraints: dict[str, Float[Array, " p"]] = {
            "gain margin up": jnp.where(stable, limits.gain_up / found.gain_up - 1.0, excess),
            "gain margin down": jnp.where(stable, limits.gain_down / found.gain_down - 1.0, limits.gain_down - 1.0),
        }
        if limits.phase is not None:
            missed = jnp.where(jnp.isinf(found.phase), -1.0, 1.0 - found.phase / limits.phase)
            constraints["phase margin"] = jnp.where(stable, missed, 1.0)
        if limits.sensitivity is not None:
            constraints["peak sensitivity"] = jnp.where(stable, 1.0 - limits.sensitivity / found.sensitivity, 1.0)
        return constraints

    def _measured_constraints(self, controller: Controller) -> dict[str, Float[Array, " m"]]:
        """The same margins of the loops with a measured plant, by name; [m], one for each that was measured."""
        several = [self._margin_constraints(machine.margins(controller, self.sampling)) for machine in self.measured]
        return {NAME + name: jnp.stack([one[name] for one in several]) for name in (several[0] if several else ())}

    def _settling(self, observer: KalmanObserver) -> Float[Array, " p"]:
        """Eq. (20) must forget an error within `settling` wherever it is at work (and G be positive for that)."""
        estimator, mu = observer.load_estimator, observer.friction.load_coefficient
        velocity, load = jnp.asarray(self.points.velocity), jnp.asarray(self.points.load)
        assert isinstance(estimator, InnovationLoad)
        assert self.limits.settling is not None
        at_work = jnp.abs(velocity) > estimator.min_speed
        sliding = jnp.where(at_work, velocity, 1.0)
        found = jax.vmap(lambda v, w: convergence_gain(observer, v, self.sampling.period, w))(sliding, load)
        per_step = estimator.gain * jnp.where(velocity >= 0, mu.positive, mu.negative) * found
        return jnp.where(at_work, 1.0 - per_step * self.limits.settling / self.sampling.period, -1.0)

    def limited_signals(self, signals: EnsembleSignals) -> dict[str, Float[Array, "lanes n"]]:
        """Signals whose RMS is limited, by name, in units of their limits; linear in the signals."""
        limits, found = self.limits, {}
        if limits.command_noise is not None:
            found["command noise"] = signals.command_change / limits.command_noise
        if limits.load_error is not None:
            found["load error"] = signals.require_load_error("requirements") / jnp.reshape(limits.load_error, (-1, 1))
        return found

    def signal_constraints(self, signals: EnsembleSignals) -> dict[str, Float[Array, " lanes"]]:
        """Requirements on the simulated signals, by name."""
        constraints = {name: rms(signal) - 1.0 for name, signal in self.limited_signals(signals).items()}
        if signals.force_excess is not None:
            constraints["force limit"] = rms(signals.force_excess)  # N: any is too much
        return constraints
