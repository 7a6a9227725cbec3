"""The parameters of a drive: plant, friction, actuator, sensor, as pytrees in SI units."""

import dataclasses
import math
from collections.abc import Iterable

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from diffdrive.errors import ParameterError
from diffdrive.model.quantity import Directional, check, quantity
from diffdrive.numerics.arrays import Scalar
from diffdrive.support.messages import short_repr

LONGEST_SUBSTEP, SUBSTEP_ERROR = 20e-6, 1e-10  # s, and the position error of the plant's integrator there, m
# s: the integrator is of second order, and here its error is the rounding of a position of a metre
FINEST_SUBSTEP = LONGEST_SUBSTEP * float(np.sqrt(np.finfo(float).eps / SUBSTEP_ERROR))
LIMIT_ROUNDING = 0.01  # of the force limit, in the smooth variant
# Hz: the control rates that there are, and a decade below the slowest; beyond, its momentum is lost in rounding
SLOWEST_CURRENT_LOOP, FASTEST_CURRENT_LOOP = 1.0, 1e6
ROUNDING = 1e-6  # largest rounding error of a smoothed limit, as a share of its width


class Plant(eqx.Module):
    """M_S a + B_S v = u + constant_force - F(v, z)  (paper, eq. (7), and a constant force beside it)."""

    mass: Scalar = quantity("kg", "moving mass, motor and screw inertia included", above=0.0)
    damping: Directional = quantity("N*s/m", "viscous damping of the system", at_least=0.0, per_direction=True)
    constant_force: Scalar = quantity("N", "inclined axis, counterbalance or amplifier offset", default=0.0)


class Friction(eqx.Module):
    """LuGre friction with load-dependent Coulomb friction, per direction (paper, eqs. (4) to (6))."""

    coulomb_screw: Directional = quantity("N", "Coulomb friction of the screw, F_BC", at_least=0.0, per_direction=True)
    load_coefficient: Directional = quantity(
        "1", "Coulomb friction coefficient of the guides, mu_LC", at_least=0.0, per_direction=True
    )
    initial_load: Scalar = quantity("N", "load on the guides from preload and table, W_LI", at_least=0.0)
    breakaway_gap: Directional = quantity(
        "N",
        "breakaway minus Coulomb friction, F_S - F_C; negative where friction rises from standstill",
        per_direction=True,
    )
    stribeck_velocity: Directional = quantity("m/s", "Stribeck velocity, v_s", above=0.0, per_direction=True)
    viscous: Directional = quantity("N*s/m", "viscous friction, mu_v", at_least=0.0, per_direction=True)
    bristle_stiffness: Directional = quantity("N/m", "bristle stiffness, sigma_0", above=0.0, per_direction=True)
    bristle_damping: Directional = quantity("N*s/m", "bristle damping, sigma_1", at_least=0.0, per_direction=True)
    stribeck_exponent: Scalar | None = quantity(
        "1",
        "exponent d of the Stribeck curve, exp(-(abs(v) / v_s)^d); absent: 1",
        at_least=0.1,
        at_most=4.0,
        default=None,
    )

    @property
    def exponent(self) -> Scalar:
        """The exponent of the Stribeck curve; the paper's is 1."""
        return 1.0 if self.stribeck_exponent is None else self.stribeck_exponent

    def coulomb_at(self, load: Scalar | np.ndarray) -> Directional:
        """Coulomb friction F_C (N) in each direction under an applied load (N; eq. (6))."""
        normal_force = self.initial_load + load
        return self.coulomb_screw + self.load_coefficient.map(lambda coefficient: coefficient * normal_force)

    def breakaway_at(self, load: Scalar | np.ndarray) -> Directional:
        """Breakaway friction F_S (N) in each direction under an applied load (N)."""
        return self.coulomb_at(load) + self.breakaway_gap


class Actuator(eqx.Module):
    """Force limit, delay and current loop between the command and the force on the table.

    The delay is `delay_samples` control periods (static: the length of the pipeline) and `delay_fraction` of one.
    """

    force_limit: Scalar | None = quantity(
        "N", "largest force in either direction; absent: unlimited", above=0.0, default=None
    )
    limit_rounding: Scalar | None = quantity(
        "N",
        "width over which the smooth variant rounds the limit; absent: the exact, hard limit",
        above=0.0,
        default=None,
    )
    delay_samples: int = eqx.field(static=True, default=0)
    delay_fraction: Scalar | None = quantity(
        "1",
        "further delay as a share of the control period; whole periods belong into delay_samples",
        at_least=0.0,
        at_most=1.0,
        default=None,
    )
    current_loop_frequency: Scalar | None = quantity(
        "Hz",
        "current loop, closed: corner of a first order, natural frequency of a second; absent: the delay alone",
        at_least=SLOWEST_CURRENT_LOOP,
        at_most=FASTEST_CURRENT_LOOP,
        default=None,
    )
    current_loop_damping: Scalar | None = quantity(
        "1", "damping of a current loop of second order; absent: of first order", above=0.0, below=1.0, default=None
    )

    @property
    def pipelines(self) -> tuple[tuple[str, int], ...]:
        """Delay lines: the name of each, and its length in samples."""
        return (("actuator.delay_samples", self.delay_samples),)

    def smoothed(self) -> "Actuator":
        """The smooth variant: the corners of the limit rounded."""
        if self.force_limit is None:
            return self
        return dataclasses.replace(self, limit_rounding=LIMIT_ROUNDING * self.force_limit)


class Sensor(eqx.Module):
    """An encoder: white noise, then quantisation. In metres at the table, whatever it is mounted on."""

    resolution: Scalar | None = quantity(
        "m", "step of the measured position; absent: no quantisation", above=0.0, default=None
    )
    noise: Scalar = quantity(
        "m", "standard deviation of the white noise before the quantiser", at_least=0.0, default=0.0
    )

    def smoothed(self) -> "Sensor":
        """The smooth variant: no quantiser."""
        return Sensor(resolution=None, noise=self.noise)


class Drive(eqx.Module):
    """The machine: everything between the force command and the measured position."""

    plant: Plant
    friction: Friction
    actuator: Actuator = Actuator()
    sensor: Sensor = Sensor()  # scale at the table
    effects: tuple[PyTree, ...] = ()  # of the catalogue (diffdrive.effects)
    motor_encoder: Sensor | None = None  # beside the scale, before the screw; read as table travel

    @property
    def has_noise(self) -> bool:
        """Whether the readings of an encoder scatter."""
        encoders = (self.sensor, self.motor_encoder)
        return any(encoder is not None and float(encoder.noise) > 0 for encoder in encoders)


class Sampling(eqx.Module):
    """Control rate, and plant substeps in each control period (`None`: as many as keep a substep within 20 us).

    At that substep the integrator's position error is 0.1 nm or less on the paper's drive at 10 kHz, and of that order
    on others (docs/method/numerics.md). No substep may be shorter than `FINEST_SUBSTEP`.
    """

    rate: float = eqx.field(static=True, default=10_000.0)
    substeps: int | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        if not (isinstance(self.rate, int | float | np.number) and 10.0 <= self.rate <= 1e6):
            raise ParameterError(f"sampling.rate must lie between 10 and 1e6 Hz, got {short_repr(self.rate)}")
        is_whole = isinstance(self.substeps, int) and not isinstance(self.substeps, bool)
        if self.substeps is None:
            return
        if not (is_whole and self.substeps >= 1):
            raise ParameterError(
                f"sampling.substeps must be a whole number of at least 1, got {short_repr(self.substeps)}"
            )
        most = math.ceil(self.period / FINEST_SUBSTEP)
        if self.substeps > most:
            raise ParameterError(
                f"sampling.substeps must be at most {most} at {self.rate:g} Hz, got {short_repr(self.substeps)}: finer "
                "substeps gain nothing, since their error is below the last digit of a position"
            )

    @property
    def period(self) -> float:
        """Seconds from one control step to the next."""
        return 1.0 / self.rate

    @property
    def plant_steps(self) -> int:
        """Substeps of the plant in one control period."""
        return self.substeps or int(np.ceil(round(self.period / LONGEST_SUBSTEP, 6)))


def require_compatible(effects: Iterable[PyTree]) -> None:
    """Raise `ParameterError` where a machine cannot have all of these effects: one twice, or two of one thing."""
    names: set[str] = set()
    holders: dict[str, str] = {}
    for effect in effects:
        if effect.name in names:
            raise ParameterError(f"effects.{effect.name}: stands there twice: a drive has each effect once")
        names.add(effect.name)
        if effect.exclusive is None:
            continue
        if effect.exclusive in holders:
            raise ParameterError(
                f"effects.{effect.name}: a machine has one {effect.exclusive}, and effects.{holders[effect.exclusive]} "
                "is one, too: keep either"
            )
        holders[effect.exclusive] = effect.name


def friction_problem(friction: Friction, load: Scalar | np.ndarray) -> str | None:
    """Why no machine has this friction under a load (N); None where one may. Traced values are skipped.

    Both levels are positive, or both are zero: then there is no Coulomb friction.
    """
    levels, breakaways = friction.coulomb_at(load), friction.breakaway_at(load)
    for side in ("positive", "negative"):
        level, breakaway = getattr(levels, side), getattr(breakaways, side)
        if any(isinstance(value, jax.core.Tracer) for value in (level, breakaway)):
            continue
        level, breakaway = np.asarray(level), np.asarray(breakaway)
        if not np.all(level >= 0.0):
            return f"the Coulomb friction in the {side} direction is {np.min(level):g} N: it must not be negative"
        if not np.all((breakaway > 0.0) | ((breakaway == 0.0) & (level == 0.0))):
            return (
                f"the breakaway friction in the {side} direction is {np.min(breakaway):g} N: it must be above 0, or 0 "
                "beside a Coulomb friction of 0"
            )
    return None


def require_coulomb_friction(drive: Drive, what: str) -> None:
    """Raise `ParameterError` where `what` needs Coulomb friction to begin from, and the drive has none."""
    level = drive.friction.coulomb_at(0.0)
    if not (float(level.positive) > 0.0 and float(level.negative) > 0.0):
        raise ParameterError(
            f"friction.coulomb_screw: {what} looks for friction about the drive file's, which has no Coulomb friction: "
            "give a small coulomb_screw, such as 0.1 N"
        )


def check_drive(drive: Drive) -> None:
    """`check`, and the conditions that concern several parameters."""
    check(drive)
    require_compatible(drive.effects)
    delay = drive.actuator.delay_samples
    if not isinstance(delay, int) or delay < 0:
        raise ParameterError(
            f"actuator.delay_samples must be a whole number of samples, 0 or more, got {short_repr(delay)}"
        )
    if drive.actuator.current_loop_damping is not None and drive.actuator.current_loop_frequency is None:
        raise ParameterError("actuator.current_loop_damping: give current_loop_frequency, too, or neither")
    limit, width = drive.actuator.force_limit, drive.actuator.limit_rounding
    # the rounded limit is a difference of numbers as large as the limit
    if (
        limit is not None
        and width is not None
        and not any(isinstance(x, jax.core.Tracer) for x in (limit, width))
        and np.any(np.finfo(float).eps * np.asarray(limit) > ROUNDING * np.asarray(width))
    ):
        raise ParameterError(
            f"actuator.limit_rounding of {np.min(width):g} N is lost in the rounding of the force limit of "
            f"{np.max(limit):g} N: check the units of both, or leave out limit_rounding"
        )
    if problem := friction_problem(drive.friction, 0.0):
        raise ParameterError(f"friction: {problem} (coulomb_screw + load_coefficient * initial_load + breakaway_gap)")
