"""Filters of one signal, as control units and amplifiers have them: PT1, PT2, general second order, notch.

Each is the bilinear transform of its continuous transfer function, s -> c (z - 1) / (z + 1). That maps the whole
imaginary axis onto the unit circle, so a notch stays as deep as it is; it only shifts frequencies. A filter of second
order is there for what it does at its frequencies, so each of them is prewarped: it lies where it is stated, and the
width of a notch is the one stated. A PT1 is there for its lag, so it is not prewarped: under a ramp it lags by exactly
its time constant.

The second order is computed as a state-variable filter with trapezoidal integrators. Its gain at standstill is one to
rounding, in single precision, too, where the usual direct form is off by 1e-3 for a notch at 50 Hz sampled at 20 kHz.
"""

import abc
from collections.abc import Mapping
from typing import Annotated, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from diffdrive.controllers.kinds import Keys, Section
from diffdrive.model.memory import Memory
from diffdrive.model.quantity import quantities, quantity, quantity_table
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.exponential import exp_neg
from diffdrive.numerics.trigonometry import cosine_sine
from diffdrive.support.messages import short_repr
from diffdrive.support.typing import TomlTable

HIGHEST = 0.499  # of the control rate; a search that goes beyond finds no slope there
NEPERS_PER_DECIBEL = float(np.log(10.0) / 20.0)
# factors by which a search may move them: a resonance is nearer than its neighbour, everything else spans a decade
FREQUENCY_FACTOR, CORNER_FACTOR, SHAPE_FACTOR, DEPTH_FACTOR = 1.5, 10.0, 5.0, 3.0


class Filter(eqx.Module):
    """A filter of one signal, computed once a sample."""

    kind: ClassVar[str]  # in a drive file
    factors: ClassVar[Mapping[str, float]]  # of its parameters that may be tuned: by how much a search may move each

    @abc.abstractmethod
    def init(self, value: Scalar) -> PyTree:
        """The state after a long time at a constant `value`."""

    @abc.abstractmethod
    def step(self, state: PyTree, value: Scalar, period: float) -> tuple[PyTree, Scalar]:
        """The state a `period` (s) later, and the filtered value."""


class PT1(Filter):
    """First-order lag, 1 / (T s + 1)."""

    time: Scalar = quantity("s", "time constant", above=0.0)

    kind: ClassVar[str] = "pt1"
    factors: ClassVar[Mapping[str, float]] = {"time": CORNER_FACTOR}

    def init(self, value: Scalar) -> Scalar:
        return value

    def step(self, state: Scalar, value: Scalar, period: float) -> tuple[Scalar, Scalar]:
        rise = (value - state) * (period / (2.0 * self.time + period))
        filtered = state + rise
        return filtered + rise, filtered


class SecondOrderState(NamedTuple):
    """Of the two integrators: band-pass and low-pass of the signal, in its unit."""

    band: Annotated[Scalar, Memory("", "filter of second order: band-pass of its signal")]
    low: Annotated[Scalar, Memory("", "filter of second order: low-pass of its signal")]


class _SecondOrderFilter(Filter):
    """What those of second order share: their states."""

    def init(self, value: Scalar) -> SecondOrderState:
        return SecondOrderState(0.0 * value, value)


class PT2(_SecondOrderFilter):
    """Low-pass of second order, w^2 / (s^2 + 2 D w s + w^2) with w = 2 pi `frequency`."""

    frequency: Scalar = quantity("Hz", "natural frequency", above=0.0)
    damping: Scalar = quantity("1", "damping D; 0.7 has no peak", above=0.0, default=0.7)

    kind: ClassVar[str] = "pt2"
    factors: ClassVar[Mapping[str, float]] = {"frequency": CORNER_FACTOR, "damping": SHAPE_FACTOR}

    def step(self, state: SecondOrderState, value: Scalar, period: float) -> tuple[SecondOrderState, Scalar]:
        state, _, low = _parts(state, value, _warped(self.frequency, period), 2.0 * self.damping)
        return state, low


class SecondOrder(_SecondOrderFilter):
    """General second order, ((s/z)^2 + 2 E s/z + 1) / ((s/w)^2 + 2 D s/w + 1); z, E are those of the numerator."""

    numerator_frequency: Scalar = quantity("Hz", "frequency of the numerator: attenuated most", above=0.0)
    numerator_damping: Scalar = quantity("1", "damping of the numerator; 0: nothing passes there", at_least=0.0)
    frequency: Scalar = quantity("Hz", "frequency of the denominator", above=0.0)
    damping: Scalar = quantity("1", "damping of the denominator", above=0.0)

    kind: ClassVar[str] = "second_order"
    factors: ClassVar[Mapping[str, float]] = {
        "numerator_frequency": FREQUENCY_FACTOR, "numerator_damping": SHAPE_FACTOR,
        "frequency": FREQUENCY_FACTOR, "damping": SHAPE_FACTOR,
    }  # fmt: skip

    def step(self, state: SecondOrderState, value: Scalar, period: float) -> tuple[SecondOrderState, Scalar]:
        warped = _warped(self.frequency, period)
        ratio = warped / _warped(self.numerator_frequency, period)
        high = ratio * ratio
        state, band, low = _parts(state, value, warped, 2.0 * self.damping)
        passed = 2.0 * (self.numerator_damping * ratio - self.damping * high)
        return state, high * value + passed * band + (1.0 - high) * low


class Notch(_SecondOrderFilter):
    """Band-stop, (s^2 + 2 E w s + w^2) / (s^2 + 2 D w s + w^2) with w = 2 pi `frequency`.

    D = `width` / (2 `frequency`), and E / D is the gain at `frequency`, -`depth` in dB.
    """

    frequency: Scalar = quantity("Hz", "frequency that is suppressed", above=0.0)
    width: Scalar = quantity("Hz", "bandwidth: between the -3 dB points of a complete notch", above=0.0)
    depth: Scalar | None = quantity("dB", "attenuation at the frequency; absent: complete", above=0.0, default=None)

    kind: ClassVar[str] = "notch"
    factors: ClassVar[Mapping[str, float]] = {
        "frequency": FREQUENCY_FACTOR, "width": SHAPE_FACTOR, "depth": DEPTH_FACTOR,
    }  # fmt: skip

    def step(self, state: SecondOrderState, value: Scalar, period: float) -> tuple[SecondOrderState, Scalar]:
        warped, wide = _warped(self.frequency, period), _warped(self.width, period)
        # tan b - tan a = tan(b - a) (1 + tan a tan b), and the product of both edges is the square of the middle
        twice_damping = wide * (1.0 + warped * warped) / warped
        state, band, _ = _parts(state, value, warped, twice_damping)
        removed = 1.0 if self.depth is None else 1.0 - exp_neg(NEPERS_PER_DECIBEL * self.depth)
        return state, value - removed * twice_damping * band


def _warped(frequency: Scalar, period: float) -> Scalar:
    """tan(pi f T): the frequency on the axis of the bilinear transform."""
    cosine, sine = cosine_sine(jnp.pi * jnp.minimum(frequency * period, HIGHEST))
    return sine / cosine


def _parts(
    state: SecondOrderState, value: Scalar, warped: Scalar, twice_damping: Scalar
) -> tuple[SecondOrderState, Scalar, Scalar]:
    """The next state, and p / (p^2 + 2 D p + 1) and 1 / (p^2 + 2 D p + 1) of the value, with p = s / w."""
    share = 1.0 / (1.0 + warped * (warped + twice_damping))
    band = share * state.band + (share * warped) * (value - state.low)
    low = state.low + warped * band
    return SecondOrderState(2.0 * band - state.band, 2.0 * low - state.low), band, low


Filters = tuple[Filter, ...]
FILTERS: dict[str, type[Filter]] = {one.kind: one for one in (PT1, PT2, SecondOrder, Notch)}
FILTER_KEYS = tuple(Keys("controller.filters", one, kind=name) for name, one in FILTERS.items())


def settled(filters: Filters, value: Scalar) -> tuple[PyTree, ...]:
    """The states of filters in series after a long time at a constant `value`."""
    return tuple(one.init(value) for one in filters)


def apply(
    filters: Filters, states: tuple[PyTree, ...], value: Scalar, period: float
) -> tuple[tuple[PyTree, ...], Scalar]:
    """The states a `period` (s) later, and the value through all filters in series."""
    ahead = []
    for one, state in zip(filters, states, strict=True):
        state, value = one.step(state, value, period)
        ahead.append(state)
    return tuple(ahead), value


def rate_problem(filters: Filters, rate: float) -> str | None:
    """Why filters cannot run at a control `rate` (Hz): a frequency that no sampled signal has. Traced ones pass."""
    for place, one in enumerate(filters, 1):
        for name, declared, value in quantities(one):
            if declared.unit != "Hz" or isinstance(value, jax.core.Tracer):
                continue
            if np.any(np.asarray(value) >= HIGHEST * rate):
                highest = float(np.max(np.asarray(value)))
                return f"filters.{place}.{name}: {highest:g} Hz is not below half the control rate of {rate:g} Hz"
    return None


def read_filters(section: Section, key: str) -> Filters:
    """The filters that the tables below `key` specify, in their order."""
    filters = []
    for table in section.subsections(key):
        kind = table.take("kind")
        if not isinstance(kind, str) or kind not in FILTERS:
            raise table.fail("kind", f"unknown filter {short_repr(kind)}; known: {', '.join(FILTERS)}")
        filters.append(table.build(FILTERS[kind]))
        table.done()
    return tuple(filters)


def filter_tables(filters: Filters) -> list[TomlTable]:
    """The tables from which `read_filters` reads these."""
    return [{"kind": one.kind} | quantity_table(one) for one in filters]
