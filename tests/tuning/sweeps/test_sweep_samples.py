"""What varies in a sweep and how it is sampled: distributions against scipy's, parts against the whole, bad input."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.model.presets import paper_drive
from tuning.sweeps.samples import unit_samples
from tuning.sweeps.varied import MAX_SIGMAS, parse_varied

DRIVE = paper_drive()
SHARE = (np.arange(20_000) + 0.5) / 20_000


@pytest.mark.parametrize(
    ("text", "how", "low", "middle", "high", "deviation"),
    [
        ("plant.mass=uniform:-5%..5%", "times", 0.95, 1.0, 1.05, 0.1 / np.sqrt(12)),
        ("plant.mass=uniform:90..110 kg", "is", 90.0, 100.0, 110.0, 20 / np.sqrt(12)),
        ("plant.mass=normal:2%", "times", 0.92, 1.0, 1.08, 0.02),
        ("plant.mass=normal:2 kg", "plus", -8.0, 0.0, 8.0, 2.0),
        ("plant.mass=normal:+5%..3%", "times", 0.93, 1.05, 1.17, 0.03),
        ("plant.mass=lognormal:-10%..3%", "times", 0.9 * np.exp(-0.12), 0.9, 0.9 * np.exp(0.12), 0.027),
        ("plant.mass=triangular:-10%..0%..20%", "times", 0.9, None, 1.2, np.sqrt(0.07 / 18)),
        ("effects.cogging.cosine=normal:2 N", "plus", -8.0, 0.0, 8.0, 2.0),
        ("plant.constant_force=normal:3 N", "plus", -12.0, 0.0, 12.0, 3.0),
        ("load=normal:1 kN", "plus", -4e3, 0.0, 4e3, 1e3),
        ("plant.mass=normal:95..2 kg", "is", 87.0, 95.0, 103.0, 2.0),
        ("plant.mass=lognormal:3%", "times", np.exp(-0.12), 1.0, np.exp(0.12), 0.03),
        ("plant.mass=lognormal:90 kg..3%", "is", 90 * np.exp(-0.12), 90.0, 90 * np.exp(0.12), 2.7),
        ("friction.viscous=loguniform:-50%..+100%", "times", 0.5, 1.0, 2.0, np.log(4.0) / np.sqrt(12)),
        ("load=triangular:0..2..10 kN", "is", 0.0, None, 10e3, np.sqrt((100 + 4 - 20) / 18) * 1e3),
        ("effects.backlash.gap=uniform:0..10 um", "is", 0.0, 5e-6, 1e-5, 1e-5 / np.sqrt(12)),
        ("plant.mass=fixed:+5%", "times", 1.05, 1.05, 1.05, 0.0),
        ("friction.coulomb_screw.negative=fixed:70", "is", 70.0, 70.0, 70.0, 0.0),
    ],
)
def test_a_distribution_is_the_one_that_was_written(text, how, low, middle, high, deviation):
    varied = parse_varied(text, DRIVE)
    values = varied.quantile(SHARE)
    assert varied.mode == how
    assert np.all(np.diff(values) >= 0.0)
    assert values[0] >= low - 1e-9 * abs(low)
    assert values[-1] <= high + 1e-9 * abs(high)
    assert varied.quantile(np.array([0.0, 1.0])) == pytest.approx([low, high])
    if middle is not None:
        assert varied.quantile(np.array([0.5]))[0] == pytest.approx(middle, abs=1e-12)
    spread = np.std(np.log(values)) if "loguniform" in text else np.std(values)
    assert spread == pytest.approx(deviation, rel=0.01, abs=1e-12)


def test_a_normal_quantity_ends_where_it_must():
    values = parse_varied("friction.coulomb_screw=normal:10..10 N", DRIVE).quantile(SHARE)
    assert np.min(values) >= 0.0
    assert stats.kstest(values, stats.truncnorm(-1.0, MAX_SIGMAS, 10.0, 10.0).cdf).statistic < 1e-3


@pytest.mark.parametrize(
    ("text", "value", "most"),
    [
        ("friction.coulomb_screw.negative=normal:50 N", 64.95, 264.95),
        ("friction.coulomb_screw=normal:50 N", 63.43, 263.43),  # the smaller of its two directions
        ("friction.coulomb_screw=normal:50%", 63.43, 3 * 63.43),
        ("effects.compliance.motor_share=normal:40%", 0.4, 1.0),
        ("sensor.noise=normal:20 nm", 0.0, 80e-9),
    ],
)
def test_a_normal_offset_or_factor_ends_where_the_quantity_must(text, value, most):
    varied = parse_varied(text, DRIVE)
    ends = varied.quantile(np.array([0.0, 1.0]))
    assert (value + ends if varied.mode == "plus" else value * ends) == pytest.approx([0.0, most], abs=1e-12)


def test_no_machine_lies_beyond_four_deviations_and_within_they_are_normal():
    values = parse_varied("plant.mass=normal:1 kg", DRIVE).quantile(SHARE)
    assert np.max(np.abs(values)) < MAX_SIGMAS
    assert stats.kstest(values, "norm").statistic < 1e-3


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("plant.mas=normal:2%", "no quantity of this drive; near it are plant.mass"),
        ("weight=normal:2%", "no quantity of this drive; such are plant.mass"),
        ("plant.mass", "no quantity|no distribution"),
        ("load=normal:2%", "zero, to be relative to: give all numbers in N"),
        ("plant.constant_force=lognormal:2%", "zero, to be relative to"),
        ("plant.mass=gauss:3", "'gauss' is no distribution; known: uniform:"),
        ("plant.mass=uniform:3", "is not what uniform takes"),
        ("plant.mass=uniform:5..3", "must rise"),
        ("plant.mass=loguniform:0..3 kg", "above zero"),
        ("plant.mass=normal:-2%", "deviation must be above zero"),
        ("plant.mass=normal:nan%", "plant.mass"),
        ("plant.mass=uniform:5%..7 kg", "mixes percent and kg"),
        ("plant.mass=uniform:95%..105%", r"'95%' needs a sign: .* as -5%\.\.\+5%"),
        ("plant.mass=triangular:-5%..1%..3%", "'1%' needs a sign"),
        ("plant.mass=normal:5%..3%", "needs a sign"),
        ("plant.mass=lognormal:3", "300 % of a logarithm is too wide"),
        ("plant.mass=normal:-60..3 kg", "must be"),
        ("effects.backlash.gap=uniform:0..3 N", "effects.backlash.gap"),
    ],
)
def test_what_cannot_vary_so_is_said(text, says):
    with pytest.raises(DiffdriveError, match=says):
        parse_varied(text, DRIVE)


@pytest.mark.parametrize("method", ["sobol", "latin-hypercube", "random"])
@given(seed=st.integers(0, 2**31), part=st.integers(0, 50))
def test_a_part_is_the_same_wherever_it_is_drawn(method, seed, part):
    one, again = (unit_samples(method, 3, seed, part, 16) for _ in range(2))
    assert np.array_equal(one, again)
    assert np.all((one >= 0.0) & (one <= 1.0))
    assert not np.array_equal(one, unit_samples(method, 3, seed, part + 1, 16))
    assert not np.array_equal(one, unit_samples(method, 3, seed + 1, part, 16))


def test_sobol_points_go_on_from_part_to_part():
    parts = np.concatenate([unit_samples("sobol", 4, 7, part, 64) for part in range(4)])
    assert np.array_equal(parts, unit_samples("sobol", 4, 7, 0, 256))
    assert np.sort(np.floor(256 * parts[:, 2])) == pytest.approx(np.arange(256))  # one point in each slice


def test_a_latin_hypercube_has_one_sample_in_each_slice_of_each_quantity():
    found = unit_samples("latin-hypercube", 3, 1, 5, 32)
    for k in range(3):
        assert np.sort(np.floor(32 * found[:, k])) == pytest.approx(np.arange(32))


@pytest.mark.parametrize("bad", [("halton", 16), ("sobol", 12), ("random", 0)])
def test_other_methods_and_sizes_are_refused(bad):
    with pytest.raises(ParameterError, match="samples"):
        unit_samples(bad[0], 2, 0, 0, bad[1])


@pytest.mark.parametrize("count", [1, 200, 600, 1000])
def test_a_hypercube_hits_each_stratum_once_however_many_are_asked_for(count):
    drawn = unit_samples("latin-hypercube", 3, 5, 1, 1024, count)
    for column in drawn.T:
        assert sorted(np.floor(count * column).astype(int)) == list(range(count))


@pytest.mark.parametrize("method", ["sobol", "random"])
def test_of_other_points_they_are_the_first_ones(method):
    np.testing.assert_array_equal(unit_samples(method, 3, 5, 1, 1024, 200), unit_samples(method, 3, 5, 1, 1024)[:200])
