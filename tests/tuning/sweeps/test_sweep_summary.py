"""What a sweep says, checked against counting by hand, and its intervals against what they promise."""

import numpy as np
import pyarrow as pa
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from tuning.sweeps.samples import unit_samples
from tuning.sweeps.sensitivity import influences, influences_on_event
from tuning.sweeps.summary import Group, compare, exceedance, first_to_diverge, quantile, worst


def group(errors, diverged=(), controller="one"):
    """`diverged` are machines, or when each of them did (s)."""
    count, at = len(errors), dict.fromkeys(diverged, 0.0) | (diverged if isinstance(diverged, dict) else {})
    table = pa.table(
        {
            "machine": np.arange(100, 100 + count),
            "peak_m": np.asarray(errors, float),
            "diverged": [k in at for k in range(count)],
            "diverged_at_s": pa.array([at.get(k) for k in range(count)], pa.float64()),
        }
    )
    return Group(controller, "motion", table)


def test_a_machine_that_diverged_misses_every_tolerance():
    one = group([3e-6, 0.0, 1e-6, 2e-6], diverged={1})
    assert exceedance(one.error(), 1e3).value == 0.25
    assert quantile(one.error(), 0.99).value == np.inf
    assert quantile(one.error(), 0.5).value == 2e-6


def test_the_worst_are_those_of_the_largest_error_and_those_that_left_first():
    one = group([3e-6, 0.0, np.nan, 1e-6, 2e-6, 1.0], diverged={1: 0.3, 2: 0.1, 5: 0.2})
    assert worst(one, 2) == [100, 104]
    assert worst(one, 9) == [100, 104, 103]
    assert first_to_diverge(one, 2) == [102, 105]
    assert first_to_diverge(group([1.0, 2.0]), 5) == []


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(1e-9, 1e-3), min_size=1, max_size=60), st.sampled_from([0.5, 0.9, 0.95]))
def test_a_quantile_is_the_smallest_error_that_so_many_machines_keep(errors, share):
    told = quantile(np.array(errors), share)
    kept = [one for one in sorted(errors) if np.mean(np.array(errors) <= one) >= share - 1e-12]
    assert told.value == kept[0]
    assert told.low is None or told.low <= told.value
    assert told.high is None or told.high >= told.value


@pytest.mark.parametrize("share", [0.5, 0.95])
def test_the_interval_of_a_quantile_holds_it_as_often_as_it_says(share):
    rng = np.random.default_rng(3)
    held = []
    for _ in range(400):
        told = quantile(rng.random(200), share)
        held.append(told.low is not None and told.high is not None and told.low <= share <= told.high)
    assert np.mean(held) > 0.93


def test_the_interval_of_a_probability_holds_it_as_often_as_it_says():
    rng = np.random.default_rng(4)
    held = [told.low <= 0.1 <= told.high for told in (exceedance(rng.random(150), 0.9) for _ in range(600))]
    assert 0.92 < np.mean(held) < 0.98


def test_two_controllers_are_compared_machine_by_machine():
    one = group([1e-6, 2e-6, 9e-6, 1e-6], diverged={3})
    other = group([2e-6, 4e-6, 3e-6, 1e-6], diverged={3}, controller="other")
    told = compare(one, other)
    assert told.better.value == 0.5  # of two that diverged neither is better
    assert told.ratio == 0.5


def test_all_diverged_have_no_ratio():
    assert np.isnan(compare(group([1.0], diverged={0}), group([1.0])).ratio)


def test_the_shares_of_an_additive_error_are_those_of_its_terms():
    values = np.random.default_rng(1).random((4096, 3))
    errors = 1e-6 * np.exp(2.0 * values[:, 1] - 1.0 * values[:, 0])  # variance 4 : 1 : 0 in the logarithm
    told = influences(["a", "b", "c"], values, errors)
    assert [one.name for one in told] == ["b", "a", "c"]
    assert [one.share for one in told] == pytest.approx([0.8, 0.2, 0.0], abs=0.02)
    assert all(abs(one.share - true) <= one.uncertain for one, true in zip(told, [0.8, 0.2, 0.0], strict=True))
    # log error is linear in b: its mean over the lowest sixth is at b = 1/12, over the highest at 11/12
    assert told[0].high / told[0].low == pytest.approx(np.exp(2.0 * 10.0 / 12.0), rel=0.05)


@pytest.mark.parametrize("method", ["sobol", "latin-hypercube", "random"])
@pytest.mark.parametrize("machines", [512, 1024, 4096])
def test_what_has_no_influence_is_given_none_however_the_machines_were_drawn(method, machines):
    """Fourteen quantities, of which three matter; noise beside them, as a scale makes it."""
    inert, sums = [], []
    for seed in range(12):
        values = unit_samples(method, 14, seed, 0, machines)
        noise = 0.05 * np.random.default_rng(seed).standard_normal(machines)
        error = np.exp(2.0 * values[:, 0] - values[:, 1] + 0.7 * np.abs(values[:, 2] - 0.5) + noise)
        names = [str(k) for k in range(14)]
        told = {one.name: one for one in influences(names, values, error, seed)}
        inert += [told[name] for name in names[3:]]
        sums.append(sum(one.share for one in told.values()))
        # variances of a uniform number, of one that rises and falls again, and of the noise
        total = (4.0 + 1.0 + 0.49 / 4.0) / 12.0 + 0.05**2
        for name, part in (("0", 4.0), ("1", 1.0), ("2", 0.49 / 4.0)):
            off = abs(told[name].share - part / 12.0 / total)
            assert off < max(1.5 * told[name].uncertain, 0.01)
    assert np.mean([one.share > one.uncertain for one in inert]) < 0.1
    assert max(one.share for one in inert) < 30.0 / machines
    assert max(sums) < 1.0 + 4.0 / np.sqrt(machines)  # random points are correlated by so much


def test_an_influence_without_direction_is_found_too():
    values = np.random.default_rng(2).random((4096, 2))
    told = influences(["a", "b"], values, np.exp(np.abs(values[:, 0] - 0.5)))
    assert told[0].name == "a"
    assert told[0].share > 0.95
    assert told[0].low == pytest.approx(told[0].high, rel=0.02)


def test_machines_without_an_error_do_not_hide_what_drives_it():
    values = np.random.default_rng(5).random((1024, 2))
    errors = np.where(values[:, 0] > 0.9, np.inf, np.exp(values[:, 0]))
    told = influences(["a", "b"], values, errors)
    assert told[0].name == "a"
    assert np.isfinite([one.share for one in told]).all()


@pytest.mark.parametrize("errors", [np.ones(500), np.ones(20) + np.arange(20), np.full(500, np.inf)])
def test_without_spread_or_machines_there_are_no_influences(errors):
    values = np.random.default_rng(6).random((len(errors), 1))
    assert influences(["a"], values, errors) == []


@pytest.mark.parametrize("machines", [4_000, 200_000])  # of which every order cannot be counted
def test_what_few_machines_have_in_common_is_found(machines):
    """Six of thousands, all of them light: most resamples hold none of them, and shares have no interval."""
    rng = np.random.default_rng(4)
    values = rng.random((machines, 3))
    happened = np.zeros(len(values), bool)
    happened[np.argsort(values[:, 1])[[0, 1, 2, 4, 7, 9]]] = True
    found = {one.name: one for one in influences_on_event(["load", "mass", "viscous"], values, happened)}
    assert found["mass"].chance < 1e-3
    assert found["mass"].low > found["mass"].high == 0.0
    assert min(found["load"].chance, found["viscous"].chance) > 0.01


def test_what_does_not_vary_has_no_influence():
    values = np.random.default_rng(7).random((500, 2))
    values[:, 1] = 3.0
    assert [one.name for one in influences(["a", "fixed"], values, np.exp(values[:, 0]))] == ["a"]


@pytest.mark.long
@pytest.mark.parametrize("method", ["random", "sobol"])
def test_the_interval_of_a_share_is_that_of_random_machines_and_wide_for_evenly_spread_ones(method):
    weight = np.array([3.0, 2.0, 1.0] + [0.0] * 11)
    true, names = weight**2 / np.sum(weight**2), [str(k) for k in range(14)]
    off, wide = [], []
    for seed in range(40):
        drawn = unit_samples(method, 14, seed, 0, 1024)
        normal = scipy.stats.norm.ppf(np.clip(drawn, 1e-9, 1.0 - 1e-9))
        told = {one.name: one for one in influences(names, drawn, np.exp(0.1 * normal @ weight), seed)}
        off.append([told[name].share - true[k] for k, name in enumerate(names[:3])])
        wide.append([told[name].uncertain for name in names[:3]])
    held = np.mean(np.abs(off) <= wide)
    assert 0.88 < held < 0.99 if method == "random" else held == 1.0
    if method == "sobol":
        assert np.all(1.96 * np.std(off, axis=0) < np.mean(wide, axis=0) / 3.0)
