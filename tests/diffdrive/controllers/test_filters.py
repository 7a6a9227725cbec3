"""The filters against python-control, their promises, and differences."""

import re

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from diffdrive.controllers import PT1, PT2, Notch, SecondOrder, filters
from diffdrive.errors import ParameterError
from diffdrive.model.quantity import check, quantities, with_nodes
from diffdrive.numerics.arrays import in_precision_of

RATE = 8_000.0
PERIOD = 1.0 / RATE
FREQUENCY = np.geomspace(1.0, 0.499 * RATE, 200)
ALL = {
    "pt1": PT1(2e-4),
    "pt1 faster than a period": PT1(2e-5),
    "pt2": PT2(1_200.0, 0.6),
    "second order": SecondOrder(700.0, 0.05, 1_100.0, 0.5),
    "lead of second order": SecondOrder(500.0, 0.8, 300.0, 1.5),
    "notch": Notch(900.0, 250.0, 25.0),
    "complete notch": Notch(60.0, 15.0),
    "wide notch": Notch(2_000.0, 1_500.0),
}


def warped(frequency):
    """rad/s, at which the bilinear transform puts it where it is stated."""
    return 2.0 * RATE * np.tan(np.pi * frequency / RATE)


def by_python_control(one):
    """The filter sampled by python-control."""
    if isinstance(one, PT1):
        return control.sample_system(control.tf([1.0], [one.time, 1.0]), PERIOD, "bilinear")
    if isinstance(one, SecondOrder):
        z, w = warped(one.numerator_frequency), warped(one.frequency)
        above, below = [1.0 / z**2, 2.0 * one.numerator_damping / z, 1.0], [1.0 / w**2, 2.0 * one.damping / w, 1.0]
        return control.sample_system(control.tf(above, below), PERIOD, "bilinear")
    w = 2.0 * np.pi * one.frequency
    if isinstance(one, PT2):
        whole = control.tf([w**2], [1.0, 2.0 * one.damping * w, w**2])
    else:
        depth = 0.0 if one.depth is None else 10.0 ** (-one.depth / 20.0)
        # the damping that gives the width in the frequencies of the sampled filter
        damping = np.tan(np.pi * one.width / RATE) / np.sin(2.0 * np.pi * one.frequency / RATE)
        whole = control.tf([1.0, 2.0 * depth * damping * w, w**2], [1.0, 2.0 * damping * w, w**2])
    return control.sample_system(whole, PERIOD, "bilinear", prewarp_frequency=w)


def continuous(one, frequency):
    """The response that its docstring states."""
    s = 2j * np.pi * frequency
    if isinstance(one, PT1):
        return 1.0 / (one.time * s + 1.0)
    w = 2.0 * np.pi * one.frequency
    if isinstance(one, PT2):
        return w**2 / (s**2 + 2.0 * one.damping * w * s + w**2)
    if isinstance(one, SecondOrder):
        z = 2.0 * np.pi * one.numerator_frequency
        return ((s / z) ** 2 + 2.0 * one.numerator_damping * s / z + 1.0) / (
            (s / w) ** 2 + 2.0 * one.damping * s / w + 1.0
        )
    damping = one.width / (2.0 * one.frequency)
    depth = 0.0 if one.depth is None else 10.0 ** (-one.depth / 20.0)
    return (s**2 + 2.0 * depth * damping * w * s + w**2) / (s**2 + 2.0 * damping * w * s + w**2)


def response(one, frequency, period=PERIOD):
    """The response of what is stepped: of its own matrices."""
    rest, rebuild = ravel_pytree(one.init(jnp.zeros(())))

    def step(state, value):
        state, value = one.step(rebuild(state), value, period)
        return ravel_pytree(state)[0], value

    a, c = jax.jacfwd(step)(rest, jnp.zeros(()))
    b, d = jax.jacfwd(step, argnums=1)(rest, jnp.zeros(()))
    return control.ss(a, b[:, None], c[None], d, period)(np.exp(2j * np.pi * frequency * period))


def filtered(one, values, period=PERIOD):
    def body(state, value):
        return one.step(state, value, period)

    return jax.lax.scan(body, one.init(jnp.zeros_like(values[0])), values)[1]


@pytest.mark.parametrize("name", ALL)
def test_a_filter_is_that_of_python_control(name):
    np.testing.assert_allclose(response(ALL[name], FREQUENCY), by_python_control(ALL[name])(
        np.exp(2j * np.pi * FREQUENCY * PERIOD)), rtol=0, atol=1e-9)  # fmt: skip


@pytest.mark.parametrize("name", ALL)
def test_a_signal_through_a_filter_is_that_of_python_control(name):
    values = np.random.default_rng(0).normal(size=150)
    expected = control.forced_response(by_python_control(ALL[name]), U=values).outputs
    np.testing.assert_allclose(filtered(ALL[name], jnp.asarray(values)), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("one", [PT1(1e-3), PT2(150.0), SecondOrder(90.0, 0.1, 150.0, 0.5), Notch(150.0, 40.0, 20.0)])
def test_far_below_the_rate_a_filter_is_the_continuous_one(one):
    """To the square of the share of the rate: frequencies move by (pi f / rate)^2 / 3, which is 1.2e-3 at 150 Hz."""
    frequency = np.geomspace(1.0, 150.0, 50)
    np.testing.assert_allclose(response(one, frequency), continuous(one, frequency), rtol=2.4e-3)


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3, 0.45])
def test_a_notch_lies_where_it_is_stated_as_wide_and_as_deep(share):
    frequency, width = share * RATE, 0.04 * RATE * min(share, 0.5 - share) / 0.1
    middle = abs(response(Notch(frequency, width, 26.0), np.array([frequency]))[0])
    assert 20.0 * np.log10(middle) == pytest.approx(-26.0, abs=1e-6)
    complete = Notch(frequency, width)
    assert abs(response(complete, np.array([frequency]))[0]) < 1e-9
    below = np.linspace(max(1.0, frequency - 2.0 * width), frequency, 1_001)
    above = np.linspace(frequency, min(0.4999 * RATE, frequency + 2.0 * width), 1_001)
    falling, rising = (np.abs(response(complete, side)) for side in (below, above))
    edges = np.interp(-np.sqrt(0.5), -falling, below), np.interp(np.sqrt(0.5), rising, above)
    assert edges[1] - edges[0] == pytest.approx(width, rel=1e-3)


def test_a_pt2_has_the_stated_gain_and_phase_at_its_frequency():
    for share in (0.05, 0.4):
        at = response(PT2(share * RATE, 0.7), np.array([share * RATE]))[0]
        assert at == pytest.approx(1.0 / 1.4j, rel=1e-9)


@pytest.mark.parametrize("time", [1e-5, 3e-4, 5e-3])
def test_a_pt1_lags_a_ramp_by_its_time_constant(time):
    ramp = 2.0 * PERIOD * np.arange(2_000)
    assert float(filtered(PT1(time), jnp.asarray(ramp))[-1]) == pytest.approx(ramp[-1] - 2.0 * time, abs=1e-9)


@pytest.mark.parametrize("name", ALL)
def test_a_constant_passes_unchanged_in_single_precision_too(name):
    for value, tolerance in ((jnp.asarray(7.25), 1e-12), (jnp.asarray(7.25, jnp.float32), 2e-6)):
        one = in_precision_of(value, jax.tree.map(jnp.asarray, ALL[name]))
        state = one.init(value)
        for _ in range(3):
            state, passed = one.step(state, value, PERIOD)
            assert passed.dtype == value.dtype
            assert float(passed) == pytest.approx(7.25, rel=tolerance)


def test_the_gain_at_standstill_does_not_hang_on_the_precision():
    low = in_precision_of(jnp.zeros((), jnp.float32), jax.tree.map(jnp.asarray, Notch(50.0, 10.0, 20.0)))
    passed = filtered(low, jnp.ones(20_000, jnp.float32), 5e-5)
    assert passed.dtype == jnp.float32
    assert float(passed[-1]) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("name", ALL)
def test_the_derivatives_of_a_filter_are_those_of_differences(name):
    one, values = ALL[name], jnp.asarray(np.random.default_rng(1).normal(size=60))

    @jax.jit
    def last(parameters):
        return filtered(with_nodes(one, parameters), values)[-1]

    at = {path: value for path, _, value in quantities(one) if value is not None}
    slopes = jax.jit(jax.grad(last))(at)
    scale = max(abs(float(slope) * at[path]) for path, slope in slopes.items())
    for path, value in at.items():
        up, down = (float(last(at | {path: factor * value})) for factor in (1.0 + 1e-5, 1.0 - 1e-5))
        assert float(slopes[path]) * value == pytest.approx((up - down) / 2e-5, rel=1e-5, abs=1e-6 * scale)


def test_filters_in_series_are_one_after_the_other():
    series = (ALL["notch"], ALL["pt2"], ALL["pt1"])
    values = jnp.asarray(np.random.default_rng(2).normal(size=80))

    def body(states, value):
        return filters.apply(series, states, value, PERIOD)

    both = jax.lax.scan(body, filters.settled(series, jnp.zeros(())), values)[1]
    for one in series:
        values = filtered(one, values)
    np.testing.assert_allclose(both, values, rtol=0, atol=1e-12)


def test_what_no_filter_can_be_is_refused():
    for one, says in (
        (PT1(0.0), r"time must be above 0 s"),
        (PT2(-1.0), r"frequency must be above 0 Hz"),
        (Notch(100.0, 0.0), r"width must be above 0 Hz"),
        (Notch(100.0, 10.0, -3.0), r"depth must be above 0 dB"),
        (SecondOrder(100.0, -0.1, 100.0, 0.5), r"numerator_damping must be at least 0"),
    ):
        with pytest.raises(ParameterError, match=says):
            check(one)


@pytest.mark.parametrize(
    ("one", "says"),
    [
        (Notch(4_000.0, 10.0), r"filters\.2\.frequency: 4000 Hz is not below half the control rate of 8000 Hz"),
        (Notch(400.0, 5_000.0), r"filters\.2\.width: 5000 Hz"),
        (SecondOrder(4_500.0, 0.1, 100.0, 0.5), r"filters\.2\.numerator_frequency: 4500 Hz"),
    ],
)
def test_a_frequency_that_no_sampled_signal_has_is_a_problem(one, says):
    assert filters.rate_problem((ALL["pt1"], ALL["notch"]), RATE) is None
    found = filters.rate_problem((ALL["pt1"], one), RATE)
    assert found is not None
    assert re.match(says, found)


def test_a_search_that_goes_beyond_half_the_rate_finds_no_slope():
    values = jnp.asarray(np.random.default_rng(3).normal(size=20))
    slope = jax.grad(lambda f: filtered(Notch(f, 100.0), values)[-1])(0.6 * RATE)
    assert float(slope) == 0.0
