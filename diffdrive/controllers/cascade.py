"""The cascade of most CNCs and servo amplifiers: proportional position loop, PI velocity loop inside it.

    set-point (delay, filter) -> kp -> [every n-th sample] -> PI <- velocity (difference, filter)
                                       PI + feed-forward -> limit -> filters -> force command

What a cascade leaves out is None, and costs nothing.
"""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Annotated, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from diffdrive.controllers import filters as series
from diffdrive.controllers.base import (
    CUTOFF_FACTOR,
    FEEDBACK_FACTOR,
    Command,
    CommandPart,
    Controller,
    Encoders,
    Feedforward,
    Reference,
    Tunable,
)
from diffdrive.controllers.counts import COUNT_OPTIONS, COUNTS, POSITION_LOOP_COUNTS
from diffdrive.controllers.feedback import FEEDBACK, FEEDBACK_OPTIONS, feedback_problem, read_feedback
from diffdrive.controllers.filters import FILTER_KEYS, PT1, Filter, Filters
from diffdrive.controllers.kinds import FEEDFORWARD, Keys, Kind, Option, Section, read_feedforward
from diffdrive.controllers.position_loop import Averaged, Held, SetPoint
from diffdrive.errors import ParameterError
from diffdrive.model.actuator import limited
from diffdrive.model.memory import Memory
from diffdrive.model.parameters import LIMIT_ROUNDING, Drive
from diffdrive.model.quantity import is_number, quantity, quantity_table
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.pipeline import Pipeline, filled, pushed
from diffdrive.support.typing import TomlTable


class CascadeState(NamedTuple):
    """Past positions and the velocity loop's integral; None for what the cascade has not."""

    past: Annotated[Pipeline, Memory("m", "measured positions of which the velocity is made, oldest first")]
    integral: Annotated[Scalar, Memory("N", "integral of the velocity loop")]
    started: Annotated[Scalar, Memory("1", "0 before the first sample, then 1")]
    velocity_lag: Annotated[Scalar | None, Memory("m/s", "state of the filter of the velocity")] = None
    set_point: SetPoint | None = None
    held: Held | Averaged | None = None
    filters: Annotated[tuple[PyTree, ...], Memory("N", "state of a filter of the force command")] = ()


class Cascade(Controller):
    """u = kv (kp e + ff v_ref - v) + ki int(kp e + ff v_ref - v) + motion feed-forward.

    The velocity is the backward difference over `velocity_samples` samples, (y[k] - y[k-n]) / (n T). Each loop uses the
    scale or the motor encoder. With a `reset_time`, ki is kv over it. The limit is that of the PI and the feed-forward:
    the integral does not grow into it. The `filters` follow it, in series. Delay and filter of the set-point act on the
    position loop alone, so that it waits for what the speed feed-forward does. Where the position loop runs each n-th
    sample, its set-point is held.
    """

    kp: Scalar = quantity("1/s", "Kv factor of the position loop", at_least=0.0)
    kv: Scalar = quantity("N*s/m", "velocity gain, not the Kv factor", at_least=0.0)
    ki: Scalar = quantity("N/m", "integral gain of the velocity loop", at_least=0.0, default=0.0)
    velocity_feedforward: Scalar = quantity(
        "1", "share of the reference velocity fed forward", at_least=0.0, default=0.0
    )
    feedforward: Feedforward | None = None
    velocity_samples: int = eqx.field(static=True, default=1)
    position_feedback: str = eqx.field(static=True, default="scale")
    velocity_feedback: str = eqx.field(static=True, default="scale")
    reset_time: Scalar | None = quantity(
        "s", "reset time T_n of the velocity loop, in the place of ki = kv / T_n", above=0.0, default=None
    )
    force_feedforward: Scalar | None = quantity(
        "1", "share of the feed-forward of inertia and damping; absent: all of it", at_least=0.0, default=None
    )
    force_limit: Scalar | None = quantity(
        "N", "largest force of the velocity loop, before the filters; absent: unlimited", above=0.0, default=None
    )
    limit_rounding: Scalar | None = quantity(
        "N",
        "width over which the smooth variant rounds the limit; absent: the exact, hard limit",
        above=0.0,
        default=None,
    )
    velocity_filter_time: Scalar | None = quantity(
        "s", "time constant of a first-order filter of the velocity; absent: none", above=0.0, default=None
    )
    reference_filter_time: Scalar | None = quantity(
        "s",
        "time constant of a first-order filter of the position loop's set-point; absent: none",
        above=0.0,
        default=None,
    )
    reference_delay_samples: int = eqx.field(static=True, default=0)
    position_every: int = eqx.field(static=True, default=1)
    filters: Filters = ()

    def __check_init__(self) -> None:
        for name, count in COUNTS.items():
            problem = count.problem(getattr(self, name))
            if problem is not None:
                raise ParameterError(f"{name} {problem}")
        for name in FEEDBACK:
            problem = feedback_problem(getattr(self, name))
            if problem is not None:
                raise ParameterError(f"{name} {problem}")
        if self.reset_time is not None and _is_stated(self.ki):
            raise ParameterError("reset_time: stands in the place of ki: give either, not both")
        if self.force_feedforward is not None and self.feedforward is None:
            raise ParameterError("force_feedforward: is a share of the feed-forward of inertia and damping: add that")

    @property
    def kind(self) -> str:
        return "cascade"

    @property
    def tunables(self) -> Mapping[str, Tunable]:
        integral = "ki" if self.reset_time is None else "reset_time"
        found = {
            name: Tunable(name, FEEDBACK_FACTOR, enters_linearly=self.is_linear and name != "reset_time")
            for name in ("kp", "kv", integral)
        }
        times = ("velocity_filter_time", "reference_filter_time")
        found |= {name: Tunable(name, CUTOFF_FACTOR) for name in times if getattr(self, name) is not None}
        return found | {
            f"filter{place}_{name}": Tunable(f"filters.{place}.{name}", factor)
            for place, one in enumerate(self.filters, 1)
            for name, factor in one.factors.items()
            if getattr(one, name) is not None
        }

    @property
    def has_friction_observer(self) -> bool:
        return False

    @property
    def is_linear(self) -> bool:
        return self.force_limit is None

    @property
    def has_integral(self) -> bool:
        """Whether its velocity loop integrates."""
        return self.reset_time is not None or float(self.ki) != 0

    @property
    def is_memoryless(self) -> bool:
        remembers = (self.velocity_filter_time, self.reference_filter_time)
        plain = not self.filters and self.position_every == 1 and remembers == (None, None)
        return plain and not self.has_integral

    @property
    def feedback_encoders(self) -> frozenset[str]:
        return frozenset({self.position_feedback, self.velocity_feedback})

    @property
    def command_parts(self) -> tuple[CommandPart, ...]:
        if not self.has_integral or self.reset_time is not None:
            return CommandPart("kp"), CommandPart("kv")
        # the gains of both loops are multiplied with one another
        return CommandPart("kp"), CommandPart("ki"), CommandPart("kv", without=("kp", "ki"))

    def table(self) -> TomlTable:
        options = {"feedforward": self.feedforward is not None, "velocity_samples": self.velocity_samples}
        feedback = {name: getattr(self, name) for name in FEEDBACK} if "motor" in self.feedback_encoders else {}
        stated = {name: getattr(self, name) for name in self._counts_above_least}
        tables = {"filters": series.filter_tables(self.filters)} if self.filters else {}
        values = quantity_table(self)
        if self.reset_time is not None:
            del values["ki"]
        return options | feedback | stated | values | tables

    @property
    def _counts_above_least(self) -> tuple[str, ...]:
        """Those of delay and cycle of the position loop that it has."""
        return tuple(name for name, count in POSITION_LOOP_COUNTS.items() if getattr(self, name) != count.least)

    def with_filter(self, one: Filter) -> "Cascade":
        return replace(self, filters=(*self.filters, one))

    def with_model(self, drive: Drive) -> "Cascade":
        return self if self.feedforward is None else replace(self, feedforward=Feedforward.of(drive.plant))

    def rate_problem(self, rate: float) -> str | None:
        return series.rate_problem(self.filters, rate)

    @property
    def pipelines(self) -> tuple[tuple[str, int], ...]:
        """The positions that the velocity is computed from, the set-points that wait, and the cycle that is held."""
        names = ("velocity_samples", *self._counts_above_least)
        return tuple((f"controller.{name}", getattr(self, name)) for name in names)

    def smoothed(self) -> "Cascade":
        """The smooth variant: the corners of the limit rounded, and what is held over a cycle averaged over it."""
        if self.force_limit is None and self.position_every == 1:
            return self
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        if self.force_limit is not None:
            values["limit_rounding"] = LIMIT_ROUNDING * self.force_limit
        return (type(self) if self.position_every == 1 else _AveragingCascade)(**values)

    def init(self, position: Scalar) -> CascadeState:
        zero = jnp.zeros_like(position)
        return CascadeState(
            filled(position, self.velocity_samples),
            zero,
            zero,
            velocity_lag=None if self.velocity_filter_time is None else zero,
            set_point=SetPoint.at(position, self.reference_delay_samples, self.reference_filter_time),
            held=None if self.position_every == 1 else self._hold_at(zero),
            filters=series.settled(self.filters, zero),
        )

    def moving(
        self,
        state: CascadeState,
        position: Scalar,
        velocity: Scalar,
        bristle: Scalar | None = None,
        load: Scalar | None = None,
    ) -> CascadeState:
        return state if state.velocity_lag is None else state._replace(velocity_lag=velocity + 0.0 * state.integral)

    def following_error(self, velocity: Scalar, period: float) -> Scalar | None:
        # with an integral, or without any force, the velocity loop is at its set-point: kp e + ff v = v
        moves = self.kp > 0
        error = jnp.where(moves, (1.0 - self.velocity_feedforward) * velocity / jnp.where(moves, self.kp, 1.0), 0.0)
        lag = 0.0 if self.reference_filter_time is None else self.reference_filter_time
        return error + (self.reference_delay_samples * period + lag) * velocity

    def is_dynamic(self, state: CascadeState) -> PyTree:
        dynamic = jax.tree.map(lambda _: True, state)
        # what the set-point went through is not fed back
        return dynamic._replace(started=False, set_point=jax.tree.map(lambda _: False, state.set_point))

    def step(
        self, state: CascadeState, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[CascadeState, Command]:
        return self.step_from_encoders(state, reference, Encoders(position, position), applied, period)

    def step_from_encoders(
        self, state: CascadeState, reference: Reference, encoders: Encoders, applied: Scalar, period: float
    ) -> tuple[CascadeState, Command]:
        position, differenced = encoders.at(self.position_feedback), encoders.at(self.velocity_feedback)
        # before the first sample the table stood where it is first measured
        history = jax.tree.map(lambda p: state.started * p + (1.0 - state.started) * differenced, state.past)
        oldest_position, history = pushed(history, differenced)
        velocity = (differenced - oldest_position) / (self.velocity_samples * period)
        velocity_lag, set_point, held, filters = state.velocity_lag, state.set_point, state.held, state.filters
        if velocity_lag is not None and self.velocity_filter_time is not None:
            velocity_lag, velocity = PT1(self.velocity_filter_time).step(velocity_lag, velocity, period)
        aim = reference.position
        if set_point is not None:
            set_point, aim = set_point.step(state.started, aim, self.reference_filter_time, period)
        velocity_reference = self.kp * (aim - position) + self.velocity_feedforward * reference.velocity
        if held is not None:
            held, velocity_reference = self._hold(held, state.started, velocity_reference)
        ki = self.ki if self.reset_time is None else self.kv / self.reset_time
        integral = state.integral + ki * period * (velocity_reference - velocity)
        force = self.kv * (velocity_reference - velocity) + integral
        if self.feedforward is not None:
            motion_force = self.feedforward.force(reference)
            force = force + (motion_force if self.force_feedforward is None else self.force_feedforward * motion_force)
        if self.force_limit is not None:
            integral = self._without_windup(state.integral, integral, force)
            force = limited(force, self.force_limit, self.limit_rounding)
        if filters:
            filters, force = series.apply(self.filters, filters, force, period)
        ahead = CascadeState(history, integral, jnp.ones_like(position), velocity_lag, set_point, held, filters)
        return ahead, Command(force)

    def _hold_at(self, value: Scalar) -> PyTree:
        """The state of the hold after a long time at this velocity set-point (m/s)."""
        return Held.at(value)

    def _hold(self, state: PyTree, started: Scalar, value: Scalar) -> tuple[PyTree, Scalar]:
        """The velocity set-point that holds (m/s), a new one where the position loop is due."""
        return state.step(value, self.position_every)

    def _without_windup(self, before: Scalar, integral: Scalar, force: Scalar) -> Scalar:
        """The integral (N); as it was `before` where the force is at its limit and it would push further."""
        assert self.force_limit is not None
        pushes = (integral - before) * force > 0.0
        beyond = jnp.abs(force) - self.force_limit
        if self.limit_rounding is None:
            return jnp.where(pushes & (beyond > 0.0), before, integral)
        share = jnp.where(pushes, jax.nn.sigmoid(-beyond / self.limit_rounding), 1.0)
        return before + share * (integral - before)


class _AveragingCascade(Cascade):
    """The smooth variant of a cascade whose position loop runs each n-th sample: it averages in place of holding."""

    def _hold_at(self, value: Scalar) -> PyTree:
        return Averaged.at(value, self.position_every)

    def _hold(self, state: PyTree, started: Scalar, value: Scalar) -> tuple[PyTree, Scalar]:
        return state.step(started, value, self.position_every)


def _is_stated(gain: Scalar) -> bool:
    """Whether a gain is a number other than zero; what is traced is not looked at."""
    return is_number(gain) and not isinstance(gain, jax.core.Tracer) and bool(np.any(np.asarray(gain) != 0))


FILTERS = Option(
    "filters", "", "array of tables", "none",
    "filters of the force command in series, `[[controller.filters]]` each: `kind` is pt1, pt2, second_order or notch",
)  # fmt: skip


def _build(section: Section, drive: Drive) -> Cascade:
    # the loop of most CNCs has no feed-forward of force unless the file says so
    feedforward, values = read_feedforward(section, drive, default=False), {}
    for name, count in COUNTS.items():
        values[name] = section.take(name, count.least)
        problem = count.problem(values[name])
        if problem is not None:
            raise section.fail(name, problem)
    filters = series.read_filters(section, "filters")
    values |= read_feedback(section, drive)
    return section.build(Cascade, feedforward=feedforward, filters=filters, **values)


KIND = Kind(
    "cascade",
    "proportional position loop over a PI velocity loop",
    _build,
    (Keys("controller", Cascade), *FILTER_KEYS),
    (FEEDFORWARD, *COUNT_OPTIONS, *FEEDBACK_OPTIONS, FILTERS),
    example=lambda drive: Cascade(kp=50.0, kv=1e5, ki=1e6, velocity_feedforward=1.0),
)
