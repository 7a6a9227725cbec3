"""What varies, from what a user gives; quantities that vary together."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import tuning
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.library import PAPER_DRIVE
from diffdrive.model.uncertainty import Deviation
from experiments.cli.sweeps import parse_tolerance, parse_vary
from tuning.identification.estimates import EstimateStatus, ParameterEstimate, left_open
from tuning.identification.workflow import IdentificationResult
from tuning.sweeps.identified import FILE, Distributions, about_identified, read_uncertainty, write_uncertainty
from tuning.sweeps.identity import identity
from tuning.sweeps.samples import correlate, correlation_root, unit_samples
from tuning.sweeps.varying import all_that_varies

DRIVE = read_axis(PAPER_DRIVE).drive
SINE = "sine:amplitude=1mm,frequency=10Hz,duration=0.1s"


def test_a_spread_is_of_all_parameters_that_are_not_varied_already():
    own = {"plant.mass": "normal:2 kg", "friction.viscous.positive": "lognormal:1%"}
    vary, none = all_that_varies(DRIVE, own, "3%", None)
    assert "friction.coulomb_screw" in vary
    assert "friction.viscous" not in vary  # one direction is: both would be told twice
    assert "friction.viscous.negative" in vary  # the other is left
    assert "plant.constant_force" not in vary  # it is zero: no share of it
    assert vary.items() > own.items()
    assert set(vary.values()) == {"normal:2 kg", "lognormal:1%", "lognormal:3%"}
    assert not none


def test_without_anything_else_parameters_vary_a_little():
    assert set(all_that_varies(DRIVE, {}, None, None).vary.values()) == {"lognormal:2%"}
    own = {"load": "uniform:0..5 kN"}
    assert all_that_varies(DRIVE, own, None, None).vary == own
    for share in ("0.05", 0.05, "5%"):
        assert set(all_that_varies(DRIVE, {}, share, None).vary.values()) == {"lognormal:5%"}
    with pytest.raises(ParameterError, match=r"spread 3: give a share above 0 and up to 100%, as 3% or 0\.03"):
        all_that_varies(DRIVE, {}, 3, None)


IDENTIFIED = Distributions(
    {"plant.mass": "lognormal:101 kg..0.4%", "plant.constant_force": "normal:3 N..0.5 N"},
    {"plant.mass": {"plant.constant_force": -0.9}},
)


def test_an_identification_says_what_varies_and_how_it_hangs_together(tmp_path):
    path = tmp_path / "uncertainty.toml"
    path.write_text(
        '[vary]\n"plant.mass" = "lognormal:101 kg..0.4%"\n"plant.constant_force" = "normal:3 N..0.5 N"\n'
        '[correlation."plant.mass"]\n"plant.constant_force" = -0.9\n'
    )
    assert read_uncertainty(path) == IDENTIFIED
    assert all_that_varies(DRIVE, {}, None, IDENTIFIED) == IDENTIFIED
    # what is given for itself goes before it, and hangs on nothing
    own = {"plant.constant_force": "normal:1 N"}
    vary, together = all_that_varies(DRIVE, own, None, IDENTIFIED)
    assert vary == own | {"plant.mass": "lognormal:101 kg..0.4%"}
    assert together == {"plant.mass": {}}


def identified_axis():
    """The axis of a fit of three parameters, two of which hang together."""
    estimates = [
        ParameterEstimate("plant.mass", "kg", 100.0, 101.1, 100.0, 102.0, 50.0, 200.0, EstimateStatus.FITTED),
        ParameterEstimate("plant.constant_force", "N", 0.0, 3.3, 2.0, 4.0, -9.0, 9.0, EstimateStatus.FITTED),
        ParameterEstimate("friction.viscous", "N*s/m", 1e3, 1e3, 1e3, 1e3, 1e3, 1e3, EstimateStatus.FIXED),
    ]
    covariance = np.array([[0.25, -0.225, 0.0], [-0.225, 0.25, 0.0], [0.0, 0.0, 0.0]])
    axis = read_axis(PAPER_DRIVE).replace({one.path: one.value for one in estimates[:2]})
    return replace(axis, uncertainty=left_open(estimates, covariance))


def result_of(axis):
    result = object.__new__(IdentificationResult)
    vars(result).update(axis=axis)
    return result


def planned(axis, **options):
    """The plan and the notes of a sweep, of which nothing is run."""
    began = []

    def started(plan, notes):
        began.append((plan, notes))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tuning.sweep(axis, SINE, settle=0.0, samples=8, started=started, **options)
    return began[0]


def test_what_was_fitted_is_left_open_relative_to_its_value_or_in_its_unit():
    known = identified_axis().uncertainty
    assert known.names == ("plant.mass", "plant.constant_force")
    assert known.deviations == (Deviation(0.5 / 101.1), Deviation(0.5, is_relative=False))
    assert known.correlations == {"plant.mass": {"plant.constant_force": pytest.approx(-0.9)}}
    assert left_open([], np.zeros((0, 0))) is None


@pytest.mark.long
def test_a_result_of_identify_and_its_file_say_the_same(tmp_path):
    axis = identified_axis()
    left = about_identified(axis)
    assert left.vary == {
        "plant.mass": f"lognormal:101.1 kg..{0.5 / 101.1!r}",
        "plant.constant_force": "normal:3.3 N..0.5 N",
    }
    write_uncertainty(tmp_path, axis)
    assert read_uncertainty(tmp_path / FILE) == left
    of_all = (result_of(axis), tmp_path / FILE, str(tmp_path / FILE))
    began = [planned(read_axis(PAPER_DRIVE), identified=identified) for identified in of_all]
    assert len({identity(plan) for plan, _ in began}) == 1
    plan, notes = began[0]
    assert plan.correlation == left.correlation
    assert list(plan.units) == list(left.vary)
    assert not any("[uncertainty]" in note for note in notes)


def test_an_axis_that_says_how_well_it_is_known_varies_as_its_identification_left_it(tmp_path):
    """To the last bit, from a drive file, too: machines are all that could differ."""
    axis = identified_axis()
    axis.write(tmp_path / "identified.toml")
    expected, _ = planned(axis, identified=result_of(axis))
    for own in (axis, read_axis(tmp_path / "identified.toml")):
        plan, notes = planned(own)
        drives, loads, values, _ = plan.machines(np.arange(8))
        wanted, no_loads, same, _ = expected.machines(np.arange(8))
        assert [np.asarray(x).tolist() for x in jax.tree.leaves((drives, loads))] == [
            np.asarray(x).tolist() for x in jax.tree.leaves((wanted, no_loads))
        ]
        assert {name: value.tolist() for name, value in values.items()} == {
            name: value.tolist() for name, value in same.items()
        }
        assert notes[0].endswith("varies by the [uncertainty] of its drive file: plant.mass, plant.constant_force.")


@pytest.mark.long
def test_a_sweep_of_an_identified_axis_is_that_with_its_identification():
    axis = identified_axis()
    own, given = (tuning.sweep(axis, SINE, settle=0.0, samples=8, **options) for options in (
        {}, {"identified": result_of(axis)}
    ))  # fmt: skip
    assert own.frame.equals(given.frame)


def test_what_is_given_goes_before_what_the_axis_says_of_itself():
    axis = identified_axis()
    plan, notes = planned(axis, vary={"plant.mass": "lognormal:5%", "load": "uniform:0..1 kN"}, spread="3%")
    texts = dict(one.text.split("=") for one in plan.varied)
    assert texts["plant.mass"] == "lognormal:5%"
    assert texts["plant.constant_force"] == "normal:0.5"
    assert texts["friction.viscous"] == "lognormal:3%"
    assert notes[0].endswith("drive file: plant.constant_force.")
    machine = replace(axis, uncertainty=None)  # that of the machines counts, not that of the controller's model
    plan, notes = planned(axis, machine=machine)
    assert {one.text.partition("=")[2] for one in plan.varied} == {"lognormal:2%"}
    assert not notes


def test_one_direction_given_leaves_the_other_as_it_was_identified():
    sides = {"friction.viscous.positive": "lognormal:1800..4%", "friction.viscous.negative": "lognormal:1700..4%"}
    identified = Distributions(sides, {})
    own = {"friction.viscous.positive": "lognormal:9%"}
    assert all_that_varies(DRIVE, own, None, identified).vary == sides | own
    both = {"friction.viscous": "lognormal:9%"}
    assert all_that_varies(DRIVE, both, None, identified).vary == both


@pytest.mark.parametrize(
    "text", ["mass = 3", "[vary\n", "vary = 3", "\xff", "correlation = 3\n[vary]\n", "[vary]\n[correlation.a]\nb = []"]
)
def test_another_file_is_no_uncertainty(tmp_path, text):
    path = tmp_path / "odd.toml"
    path.write_text(text, encoding="latin-1")
    says = {"[vary\n": "not a TOML file: .*line 1", "\xff": "line 1 holds the byte 0xff"}.get(
        text, r"is no uncertainty\.toml of an identification: " + ("it has no table" if "vary" not in text else "")
    )
    with pytest.raises(ParameterError, match=rf"odd\.toml: {says}"):
        read_uncertainty(path)
    with pytest.raises(ParameterError, match="no such file"):
        read_uncertainty(tmp_path / "absent.toml")


def test_options_are_read_into_what_python_takes():
    assert parse_tolerance(None) is None
    assert parse_tolerance("2um") == pytest.approx(2e-6)
    for bad in ("0", "3 N", "2", "0.000002"):
        with pytest.raises(DiffdriveError, match="--tolerance"):
            parse_tolerance(bad)
    assert parse_vary(["load = uniform:0..1", "plant.mass"]) == {"load": "uniform:0..1", "plant.mass": ""}
    with pytest.raises(ParameterError, match="--vary: load is given more than once"):
        parse_vary(["load=uniform:0..1", "load =uniform:0..2"])


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
