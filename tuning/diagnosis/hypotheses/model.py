"""A hypothesis about a machine: its nominal drive recalibrated, and none, one or several effects.

All that is free is one vector u in units of its prior: u = 0 is what was expected, the prior costs u^2.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike

from diffdrive.effects.actuator import LoopDelay
from diffdrive.effects.base import Effect, Envelope
from diffdrive.effects.transmission import Transmission
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar
from tuning.diagnosis.filter.derivatives import numbers
from tuning.diagnosis.filter.effect_signals import EffectSignals, Trajectory, altered, effect_signals
from tuning.diagnosis.hypotheses.calibration import NAMES, TOLERANCE, calibrated, fraction_of_delay, tolerated
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.identification.prediction import Lanes

A = TypeVar("A")
Vector = Float[np.ndarray, " k"]


class Logged(NamedTuple):
    """What is to be explained: stretches of logs, which log each is of, and how far their positions scatter."""

    drive: Drive  # nominal
    delay: Scalar  # control periods, nominal
    lanes: Lanes
    owner: tuple[int, ...]  # of each lane, the number of its log
    noise: Scalar  # m
    sampling: Sampling
    starts: Float[Array, " lanes"]  # s, when each begins in its log
    thinning: int = 1  # control periods to one of these samples; delays here are counted in the latter
    loop_samples: int = 1  # of the control to a row, which has the first of them alone
    command_std: Scalar = 0.0  # N, of its slow part, where it had to be told from the noise of its loop

    @property
    def control(self) -> Sampling:
        """The sampling of the machine's controller."""
        return Sampling(self.sampling.rate * self.thinning, -(-self.sampling.plant_steps // self.thinning))

    @property
    def of_snapshots(self) -> bool:
        """Whether each row is the first of several samples of its loop, and the commands of the others are unknown."""
        return self.loop_samples > 1

    @property
    def control_periods(self) -> int:
        """How many of the machine's control a sample lasts."""
        return self.thinning * self.loop_samples

    @property
    def logs(self) -> int:
        """How many logs."""
        return max(self.owner) + 1

    @property
    def constant_load(self) -> float | None:
        """The load (N) where it never changes, else None."""
        loads = np.unique(np.asarray(self.lanes.load)[np.asarray(self.lanes.counts) > 0.0])
        return float(loads[0]) if loads.size == 1 else None

    @property
    def lasts(self) -> Float[np.ndarray, " logs"]:
        """When (s) each log ends."""
        ends = np.asarray(self.starts) + np.asarray(self.lanes.counts).sum(axis=1) * self.sampling.period
        return np.array(
            [max(end for end, owner in zip(ends, self.owner, strict=True) if owner == k) for k in range(self.logs)]
        )


def thinned(lanes: Lanes, thinning: int) -> Lanes:
    """One sample of so many, and the mean of what acted from each to the next.

    The command itself is kept beside its mean: noise in the loop shakes the table, and its bristle creeps.
    """
    if thinning == 1:
        return lanes
    count = lanes.position.shape[1] // thinning

    def blocks(signal: Array) -> Array:
        return signal[:, : count * thinning].reshape(len(signal), count, thinning)

    command, disturbance, load = (blocks(one).mean(axis=2) for one in (lanes.command, lanes.disturbance, lanes.load))
    counts = blocks(lanes.counts).min(axis=2)
    position, asked = blocks(lanes.position)[:, :, 0], blocks(lanes.command)
    forces = lanes._replace(command=command, disturbance=disturbance, load=load)
    return forces._replace(position=position, counts=counts, period_commands=asked)


def counted_in(effect: Effect, periods: float) -> Effect:
    """The effect with its delay, if it is one, in units of so many of its periods."""
    return LoopDelay(effect.delay / periods) if isinstance(effect, LoopDelay) else effect


class Member(NamedTuple):
    """One effect of a hypothesis; `fixed` are parameters that stay at values of their own."""

    candidate: Candidate
    fixed: tuple[tuple[str, float], ...] = ()


@dataclasses.dataclass(frozen=True)
class Model:
    """A hypothesis about the machine of `logged`; `prior` is `calibration.prior_root`."""

    logged: Logged
    members: tuple[Member, ...] = ()
    prior: Float[np.ndarray, "b b"] = dataclasses.field(default_factory=partial(tolerated, TOLERANCE))

    def on(self, logged: Logged) -> "Model":
        """The same about other logs."""
        return dataclasses.replace(self, logged=logged)

    def calibration(self, theta: Vector) -> Vector:
        """The b of the recalibrated drive."""
        return self.prior @ theta[: len(NAMES)]

    @property
    def slots(self) -> list[tuple[int, str, int | None]]:
        """What each number of theta behind the calibration's is: member, parameter, log (None: all)."""
        found: list[tuple[int, str, int | None]] = []
        for index, member in enumerate(self.members):
            for one in member.candidate.parameters:
                logs = range(self.logged.logs) if one.session else [None]
                found += [(index, one.name, log) for log in logs]
        return found

    def mask(self, meant: Callable[[int, str, int | None], bool]) -> Bool[np.ndarray, " k"]:
        """Which numbers of theta are meant, by member, parameter and log; none of the calibration's."""
        return np.array([False] * len(NAMES) + [meant(*slot) for slot in self.slots])

    def of_member(self, index: int) -> Bool[np.ndarray, " k"]:
        """Which numbers of theta are of one member."""
        return self.mask(lambda member, _name, _log: member == index)

    @property
    def size(self) -> int:
        """How many numbers are free."""
        return len(NAMES) + len(self.slots)

    @property
    def added_candidates(self) -> list[Candidate]:
        """The effects with something free; those that the drive file has already come first and have not."""
        return [member.candidate for member in self.members if member.candidate.parameters]

    @property
    def added(self) -> int:
        """How many effects have something free."""
        return len(self.added_candidates)

    @property
    def coupled(self) -> bool:
        """Whether an effect is stepped within the filter."""
        return any(member.candidate.coupled for member in self.members)

    @property
    def screw(self) -> bool:
        """Whether a motor is hidden behind one."""
        return any(issubclass(member.candidate.effect, Transmission) for member in self.members)

    @property
    def screw_found(self) -> bool:
        """Whether that one is no effect of the drive file's."""
        return any(issubclass(one.effect, Transmission) for one in self.added_candidates)

    @property
    def coarse(self) -> bool:
        """Whether the details of an effect that is looked for differ from machine to machine."""
        return any(one.coarse for one in self.added_candidates)

    def values(self, theta: Vector) -> list[dict[str, Vector]]:
        """For each member, its parameters by name: one value for each log."""
        table = [{name: np.full(self.logged.logs, value) for name, value in member.fixed} for member in self.members]
        known = [member.candidate.by_name for member in self.members]
        for number, (index, name, log) in zip(theta[len(NAMES) :], self.slots, strict=True):
            value = known[index][name].value(float(number))
            row = table[index].setdefault(name, np.zeros(self.logged.logs))
            row[slice(None) if log is None else log] = value
        return table

    def effects(self, theta: Vector) -> tuple[Effect, ...]:
        """The effects at theta, each parameter an array over the lanes."""
        return tuple(
            effect_in_lanes(member.candidate.effect, values, self.logged.owner)
            for member, values in zip(self.members, self.values(theta), strict=True)
        )

    def possible(self, theta: Vector) -> bool:
        """Whether a machine can have the effects as they are here; less than no delay corrects the drive file.

        The simulator would refuse any other: a scale that counts backwards, say, whose steep wave fits what it likes.
        """
        for member, values, effect in zip(self.members, self.values(theta), self.effects(theta), strict=True):
            fields = {one.name: one.metadata["quantity"] for one in dataclasses.fields(member.candidate.effect)}
            if member.candidate.effect is LoopDelay or not member.candidate.parameters:
                continue
            if any(fields[one.name].violated_bounds(values[one.name]) for one in member.candidate.parameters):
                return False
            if not member.candidate.plausible(values, self.logged.lasts):
                return False
            if effect.problem(self.logged.drive, Envelope()) is not None:
                return False
        return True

    def apart(self, effects: tuple[A, ...]) -> tuple[tuple[A, ...], tuple[A, ...]]:
        """Those that are stepped along a trajectory, and those that are stepped within the filter."""
        both = list(zip(self.members, effects, strict=True))
        return (
            tuple(effect for member, effect in both if not member.candidate.coupled),
            tuple(effect for member, effect in both if member.candidate.coupled),
        )

    def tangents(self, theta: Vector) -> tuple[tuple[Effect, ...], int]:
        """Derivatives of `effects` with respect to every number behind the calibration's, stacked, and how many."""
        base = self.effects(theta)
        rows = []
        for number, (index, name, log) in zip(theta[len(NAMES) :], self.slots, strict=True):
            parameter = next(p for p in self.members[index].candidate.parameters if p.name == name)
            here = np.array([log is None or log == owner for owner in self.logged.owner], float)
            here *= parameter.slope(float(number))
            zero = jax.tree.map(np.zeros_like, base)
            rows.append(eqx.tree_at(partial(_field, index=index, name=name), zero, here))
        if not rows:
            return base, 0
        return stacked(rows), len(rows)


def _field(effects: tuple[Effect, ...], index: int, name: str) -> np.ndarray:
    """A parameter of one of the effects."""
    return getattr(effects[index], name)


def stacked(trees: Sequence[A]) -> A:
    """Trees of numbers as one tree, the first axis over them; out of hand, since there are few numbers."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *trees)


def effect_in_lanes(effect: type[Effect], values: dict[str, Vector], owner: tuple[int, ...]) -> Effect:
    """An effect whose parameters, given for each log, are arrays over the lanes; those not given at their defaults, and
    those that may be absent at zero.
    """
    rows = list(owner)
    # every parameter has a default
    defaults = {field.name: cast(ArrayLike | None, field.default) for field in dataclasses.fields(effect)}

    def in_lanes(value: ArrayLike | None) -> Float[np.ndarray, " lanes"]:
        each = np.asarray(0.0 if value is None else value, float)
        return each[rows] if each.ndim else np.full(len(rows), each)

    return effect(**{name: in_lanes(values.get(name, default)) for name, default in defaults.items()})


@eqx.filter_jit
def machine(logged: Logged, b: Float[Array, " b"], effects: tuple[Effect, ...]) -> tuple[Drive, Drive]:
    """The drive recalibrated, and with the effects that are other parameters."""
    own = calibrated(logged.drive, b)
    return own, altered(own, effects)


def delay_of(logged: Logged, own: Drive) -> Scalar:
    """That of a recalibrated drive, in samples of the logs."""
    return logged.delay + (fraction_of_delay(own) - fraction_of_delay(logged.drive)) / logged.thinning


def _acts(logged: Logged, own: Drive, effects: tuple[Effect, ...], trajectory: Trajectory) -> EffectSignals:
    """What the effects do along a trajectory."""
    ahead = 0.5 / logged.loop_samples if logged.loop_samples > 1 else 0.0
    delay = delay_of(logged, own)
    return effect_signals(own, effects, delay, logged.lanes, trajectory, logged.sampling, logged.starts, ahead)


signals_along = eqx.filter_jit(_acts)


@eqx.filter_jit
def signals_by_calibration(
    logged: Logged, b: Float[Array, " b"], effects: tuple[Effect, ...], trajectory: Trajectory
) -> EffectSignals:
    """Derivatives of what the effects do, [lanes, n, b], with respect to the calibration."""

    def at(b: Float[Array, " b"]) -> EffectSignals:
        return _acts(logged, calibrated(logged.drive, b), effects, trajectory)

    return jax.vmap(lambda way: _even(jax.jvp(at, (b,), (way,))[1]), out_axes=-1)(jnp.eye(len(b)))


@eqx.filter_jit
def signals_jvp(
    logged: Logged, own: Drive, effects: tuple[Effect, ...], tangents: tuple[Effect, ...], trajectory: Trajectory
) -> EffectSignals:
    """Derivatives of what the effects do, [lanes, n, m], in the directions `tangents`, which are stacked."""

    def at(effects: tuple[Effect, ...]) -> EffectSignals:
        return _acts(logged, own, effects, trajectory)

    return jax.vmap(lambda way: _even(jax.jvp(at, (effects,), (way,))[1]), out_axes=-1)(tangents)


def _even(acts: EffectSignals) -> EffectSignals:
    """Without its ripple: that of a small change moves nothing."""
    return acts._replace(ripple=None)


@eqx.filter_jit
def parameter_jacobian(
    logged: Logged, b: Float[Array, " b"], effects: tuple[Effect, ...], tangents: tuple[Effect, ...] | None
) -> Float[Array, "p k"]:
    """Derivatives of the machine's numbers with respect to b and in the directions `tangents`."""

    def at(b: Float[Array, " b"], effects: tuple[Effect, ...]) -> Float[Array, " p"]:
        return numbers(altered(calibrated(logged.drive, b), effects))

    columns = jax.jacfwd(at)(b, effects)
    if tangents is None:
        return columns
    more = jax.vmap(lambda way: jax.jvp(partial(at, b), (effects,), (way,))[1], out_axes=-1)(tangents)
    return jnp.concatenate([columns, more], axis=-1)
