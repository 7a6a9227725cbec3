"""[uncertainty] of a drive file: what it says of an axis, and what it may not say."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffdrive.axis_file.drive_file import axis_tables, parse_axis, read_axis
from diffdrive.errors import DriveFileError, ParameterError
from diffdrive.model.uncertainty import Deviation, Uncertainty
from diffdrive.paper import paper_axis

AXIS = paper_axis()
TABLES = axis_tables(AXIS)
KNOWN = Uncertainty.of(
    {
        "plant.mass": Deviation(0.1 / 3.0),
        "friction.viscous.negative": Deviation(1e-9 / 7.0),
        "plant.constant_force": Deviation(2.0 / 3.0, is_relative=False),
    },
    {"plant.mass": {"plant.constant_force": -0.7 / 0.9}, "friction.viscous.negative": {"plant.mass": 0.1}},
)


def read(text, **tables):
    return parse_axis(TABLES | tables | tomllib.loads(text), "drive.toml").uncertainty


def test_it_is_written_and_read_to_the_last_bit(tmp_path):
    path = tmp_path / "drive.toml"
    replace(AXIS, uncertainty=KNOWN).write(path)
    again = read_axis(path)
    assert again.uncertainty == KNOWN
    assert again.drive == read_axis_without(path).drive
    again.write(path)
    assert read_axis(path).uncertainty == KNOWN


def read_axis_without(path):
    tables = tomllib.loads(path.read_text())
    del tables["uncertainty"]
    return parse_axis(tables)


@given(st.floats(1e-12, 1.0), st.floats(1e-12, 1e12), st.floats(-1.0, 1.0))
def test_every_number_reads_back(relative, absolute, correlated):
    deviations = {"friction.coulomb_screw": Deviation(relative), "plant.damping": Deviation(absolute, False)}
    known = Uncertainty.of(deviations, {"plant.damping": {"friction.coulomb_screw": correlated}})
    assert parse_axis(axis_tables(replace(AXIS, uncertainty=known))).uncertainty == known


def test_an_axis_without_it_has_none_and_writes_none():
    assert AXIS.uncertainty is None
    assert "uncertainty" not in TABLES
    assert read("[uncertainty]") is None


def test_deviations_are_shares_or_have_units_and_pairs_that_are_not_stated_are_independent():
    known = read(
        """
        [uncertainty]
        "plant.mass" = "0.5 %"
        "friction.bristle_stiffness" = "12%"
        "plant.constant_force" = "2 kN"
        "plant.damping.positive" = 3
        [uncertainty.correlation."plant.mass"]
        "plant.constant_force" = -0.9
        """
    )
    assert dict(zip(known.names, known.deviations, strict=True)) == {
        "plant.mass": (0.005, True),
        "friction.bristle_stiffness": (0.12, True),
        "plant.constant_force": (2000.0, False),
        "plant.damping.positive": (3.0, False),
    }
    expected = np.eye(4)
    expected[0, 2] = expected[2, 0] = -0.9
    assert np.array(known.correlation).tolist() == expected.tolist()


def test_it_stays_with_an_axis_whose_parameters_change():
    axis = replace(AXIS, uncertainty=KNOWN).replace({"plant.mass": 130.0})
    assert axis.uncertainty == KNOWN


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('"plant.masse" = "1 %"', r"\[uncertainty\] plant\.masse: is no parameter .*did you mean 'plant\.mass'"),
        ('"sensor.noise" = "1 %"', r"\[uncertainty\] sensor\.noise: is no parameter of \[plant\] or \[friction\]"),
        ('plant.mass = "1 %"', r'\[uncertainty\] plant: put quotation marks .*"plant\.NAME"'),
        ('"plant.mass" = "x %"', r'\[uncertainty\] plant\.mass: cannot read .*write for example "3 %"'),
        ('"plant.mass" = "-1 %"', r"\[uncertainty\] plant\.mass: must be above zero and finite"),
        ('"plant.mass" = 0', r"\[uncertainty\] plant\.mass: must be above zero and finite.*leave out what is known"),
        ('"plant.mass" = nan', r"\[uncertainty\] plant\.mass: must be above zero and finite"),
        ('"plant.mass" = inf', r"\[uncertainty\] plant\.mass: must be above zero and finite"),
        ('"plant.mass" = "nan %"', r"\[uncertainty\] plant\.mass: must be above zero and finite"),
        ('"plant.mass" = "101 %"', r"\[uncertainty\] plant\.mass: 101 % of a value is too wide"),
        ('"plant.mass" = "2 m"', r"\[uncertainty\] plant\.mass: '2 m' has the wrong unit"),
        ('"plant.mass" = true', r"\[uncertainty\] plant\.mass: must be a number in kg"),
        ('"plant.constant_force" = "1 %"', r"constant_force: is relative to a value that is not above zero; .* in N"),
        (
            '"friction.viscous" = "1 %"\n"friction.viscous.positive" = "1 %"',
            r"\[uncertainty\] friction\.viscous: stands for both directions",
        ),
        ("correlation = 3", r"\[uncertainty\.correlation\] must be a table"),
        (
            '"plant.mass" = 1\ncorrelation = {"plant.mass" = 2}',
            r'\[uncertainty\.correlation\."plant\.mass"\] must be a',
        ),
        (
            '"plant.mass" = 1\ncorrelation = {"plant.mass" = {"plant.damping" = 0.1}}',
            r"\[uncertainty\] correlation: plant\.damping has no standard deviation: state one, too",
        ),
        (
            '"plant.mass" = 1\n"plant.damping" = 1\ncorrelation = {"plant.mass" = {"plant.damping" = "x"}}',
            r'\[uncertainty\.correlation\."plant\.mass"\] plant\.damping: cannot read',
        ),
        (
            '"plant.mass" = 1\n"plant.damping" = 1\ncorrelation = {"plant.mass" = {"plant.damping" = 1.1}}',
            r"\[uncertainty\] correlation: of plant\.mass and plant\.damping is 1\.1: one number from -1 to 1",
        ),
        (
            '"plant.mass" = 1\n"plant.damping" = 1\n'
            'correlation = {"plant.mass" = {"plant.damping" = 0.1}, "plant.damping" = {"plant.mass" = 0.2}}',
            r"\[uncertainty\] correlation: of plant\.damping and plant\.mass is 0\.2: one number",
        ),
        (
            '"plant.mass" = 1\n"plant.damping" = 1\n"friction.viscous" = 1\ncorrelation = {"plant.mass" = '
            '{"plant.damping" = 0.9, "friction.viscous" = 0.9}, "plant.damping" = {"friction.viscous" = -0.9}}',
            r"\[uncertainty\] correlation: no quantities can be correlated like that",
        ),
    ],
)
def test_what_it_may_not_say(text, says):
    with pytest.raises(DriveFileError, match=rf"drive\.toml: .*{says}"):
        read(f"[uncertainty]\n{text}")


def test_correlations_that_no_parameters_have_are_refused_in_python_too():
    with pytest.raises(ParameterError, match="one number from -1 to 1"):
        Uncertainty.of({"a": Deviation(0.1), "b": Deviation(0.1)}, {"a": {"b": 2.0}})
    assert Uncertainty.of({}).names == ()


def test_an_axis_that_lacks_the_parameter_cannot_be_written(tmp_path):
    known = Uncertainty.of({"plant.masse": Deviation(0.1)})
    with pytest.raises(DriveFileError, match=r"\[uncertainty\] plant\.masse"):
        replace(AXIS, uncertainty=known).write(tmp_path / "drive.toml")
