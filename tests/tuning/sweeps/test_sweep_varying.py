"""What varies, from what a user gives; quantities that vary together."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from diffdrive.errors import DiffdriveError, ParameterError
from experiments.studies.demo import PAPER_DRIVE
from tuning.sweeps.samples import correlate, correlation_root, unit_samples
from tuning.sweeps.varying import tolerance_of, varied_texts


def test_a_spread_is_of_all_parameters_that_are_not_varied_already():
    texts, none = varied_texts(
        PAPER_DRIVE, ["plant.mass=normal:2 kg", "friction.viscous.positive=lognormal:1%"], "3%", None
    )
    names = [text.partition("=")[0] for text in texts]
    assert len(set(names)) == len(names)
    assert "friction.coulomb_screw" in names
    assert "friction.viscous" not in names  # one direction is: both would be told twice
    assert "friction.viscous.negative" in names  # the other is left
    assert "plant.constant_force" not in names  # it is zero: no share of it
    assert texts[-1].endswith("=lognormal:3%")
    assert not none


def test_without_anything_else_parameters_vary_a_little():
    texts, _ = varied_texts(PAPER_DRIVE, [], None, None)
    assert all(text.endswith("lognormal:2%") for text in texts)
    assert varied_texts(PAPER_DRIVE, ["load=uniform:0..5 kN"], None, None)[0] == ("load=uniform:0..5 kN",)
    assert varied_texts(PAPER_DRIVE, [], "0.05", None)[0][0].endswith("lognormal:5%")


def test_an_identification_says_what_varies_and_how_it_hangs_together(tmp_path):
    path = tmp_path / "uncertainty.toml"
    path.write_text(
        '[vary]\n"plant.mass" = "lognormal:101 kg..0.4%"\n"plant.constant_force" = "normal:3 N..0.5 N"\n'
        '[correlation."plant.mass"]\n"plant.constant_force" = -0.9\n'
    )
    texts, together = varied_texts(PAPER_DRIVE, [], None, path)
    assert texts == ("plant.mass=lognormal:101 kg..0.4%", "plant.constant_force=normal:3 N..0.5 N")
    assert together == {"plant.mass": {"plant.constant_force": -0.9}}
    # what is given for itself goes before it, and hangs on nothing
    own = "plant.constant_force=normal:1 N"
    texts, together = varied_texts(PAPER_DRIVE, [own], None, path)
    assert texts == (own, "plant.mass=lognormal:101 kg..0.4%")
    assert together == {"plant.mass": {}}


def test_one_direction_given_leaves_the_other_as_it_was_identified(tmp_path):
    path = tmp_path / "uncertainty.toml"
    path.write_text(
        '[vary]\n"friction.viscous.positive" = "lognormal:1800..4%"\n'
        '"friction.viscous.negative" = "lognormal:1700..4%"\n'
    )
    own = "friction.viscous.positive=lognormal:9%"
    assert varied_texts(PAPER_DRIVE, [own], None, path)[0] == (own, "friction.viscous.negative=lognormal:1700..4%")
    both = "friction.viscous=lognormal:9%"
    assert varied_texts(PAPER_DRIVE, [both], None, path)[0] == (both,)


@pytest.mark.parametrize(
    "text", ["mass = 3", "[vary\n", "vary = 3", "\xff", "correlation = 3\n[vary]\n", "[vary]\n[correlation.a]\nb = []"]
)
def test_another_file_is_no_uncertainty(tmp_path, text):
    path = tmp_path / "odd.toml"
    path.write_text(text, encoding="latin-1")
    says = {"[vary\n": "not a TOML file: .*line 1", "\xff": "line 1 holds the byte 0xff"}.get(
        text, r"is no uncertainty\.toml"
    )
    with pytest.raises(ParameterError, match=rf"odd\.toml: {says}"):
        varied_texts(PAPER_DRIVE, [], None, path)
    with pytest.raises(ParameterError, match="no such file"):
        varied_texts(PAPER_DRIVE, [], None, tmp_path / "absent.toml")


def test_tolerances_are_lengths_above_zero():
    assert tolerance_of(None) is None
    assert tolerance_of("2um") == pytest.approx(2e-6)
    for bad in ("0", "-1um", "3 N", "2", "0.000002"):
        with pytest.raises(DiffdriveError, match="--tolerance"):
            tolerance_of(bad)


TOGETHER = {"a": {"b": 0.8, "c": -0.3}, "b": {"c": 0.1}}


@pytest.mark.parametrize("method", ["sobol", "latin-hypercube", "random"])
def test_quantities_that_hang_together_do_so_and_each_is_uniform_for_itself(method):
    root = correlation_root(TOGETHER, ["a", "b", "c"])
    drawn = correlate(unit_samples(method, 3, 1, 0, 8192), root)
    normal = scipy.stats.norm.ppf(drawn)
    assert np.corrcoef(normal.T) == pytest.approx(np.array([[1, 0.8, -0.3], [0.8, 1, 0.1], [-0.3, 0.1, 1]]), abs=0.03)
    for column in drawn.T:
        assert scipy.stats.kstest(column, "uniform").statistic < 0.02


def test_quantities_that_are_one_are_one():
    root = correlation_root({"a": {"b": 1.0}}, ["a", "b"])
    drawn = correlate(unit_samples("random", 2, 1, 0, 256), root)
    assert drawn[:, 0] == pytest.approx(drawn[:, 1], abs=1e-9)
    ends = correlate(np.array([[0.0, 0.0], [1.0, 1.0], [0.5, 0.5]]), root)
    assert np.isfinite(ends).all()
    assert ends[2] == pytest.approx([0.5, 0.5])


def test_nothing_hangs_together_by_itself():
    assert correlation_root({}, ["a"]) is None


@given(hnp.arrays(float, (6, 3), elements=st.floats(-1.0, 1.0)), st.floats(1e-9, 1e-2))
def test_what_hangs_together_but_for_a_little_is_taken_though_its_numbers_were_rounded(along, apart):
    """An identification that holds the sum of two parameters and hardly either: rounded, the matrix is not positive."""
    covariance = along @ along.T + apart * np.eye(6)
    deviation = np.sqrt(np.diag(covariance))
    matrix = covariance / np.outer(deviation, deviation)
    names = list("abcdef")
    rounded = {
        one: {other: round(float(matrix[i, j]), 3) for j, other in enumerate(names) if j > i}
        for i, one in enumerate(names)
    }
    root = correlation_root(rounded, names)
    np.testing.assert_allclose(root @ root.T, matrix, atol=0.01)


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ({"a": {"d": 0.1}}, "d is not varied"),
        ({"a": {"b": 1.2}}, "from -1 to 1"),
        ({"a": {"b": float("nan")}}, "from -1 to 1"),
        ({"a": {"b": 0.2}, "b": {"a": 0.3}}, "one number"),
        ({"a": {"b": 0.9, "c": 0.9}, "b": {"c": -0.9}}, "not positive"),
    ],
)
def test_impossible_correlations_are_refused(bad, says):
    with pytest.raises(ParameterError, match=says):
        correlation_root(bad, ["a", "b", "c"])
