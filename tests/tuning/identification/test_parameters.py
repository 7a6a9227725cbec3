"""What is identified has one name wherever it is named: its path in an axis."""

import dataclasses
from types import SimpleNamespace

import pytest

from diffdrive.errors import ParameterError
from diffdrive.model.presets import paper_drive
from diffdrive.model.quantity import quantities
from tests.support.sound_log import DRIVE
from tuning.identification.estimates import EstimateStatus, ParameterEstimate, reported_parameters
from tuning.identification.parameters import BOUNDABLE, PARAMETERS, axis_path, parameter_at, parameter_called
from tuning.identification.unknowns import Unknowns, free_paths, unknowns_of
from tuning.identification.workflow import IdentificationResult

DRIVE_PATHS = {path: declared.unit for path, declared, _ in quantities(paper_drive())}
UNKNOWNS = unknowns_of(paper_drive(), 0.0)


def test_every_path_is_one_of_a_drive_in_its_unit_unless_it_is_said_to_be_none():
    for parameter in PARAMETERS:
        assert DRIVE_PATHS.get(parameter.path) == (parameter.unit if parameter.in_drive else None)


def test_every_unknown_stands_for_a_parameter_and_no_parameter_lacks_one():
    assert {parameter.unknown for parameter in PARAMETERS} == {field.name for field in dataclasses.fields(Unknowns)}
    rows = reported_parameters(paper_drive(), UNKNOWNS, frozenset())
    assert {axis_path(path) for path in free_paths(UNKNOWNS) if "." in path} <= {row.path for row in rows}


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda parameter: parameter.name)
def test_a_parameter_is_called_by_its_path_or_its_name(parameter):
    for text in (parameter.path, parameter.name):
        assert parameter_called(text, BOUNDABLE, "no") is parameter
    assert parameter_at(f"{parameter.path}.positive") is parameter_at(parameter.path) is parameter
    with pytest.raises(ParameterError, match=f"no; did you mean '{parameter.name}'"):
        parameter_called(f"plants.{parameter.name}", BOUNDABLE, "no")


def test_what_a_result_names_it_takes():
    gap = ParameterEstimate(
        "friction.breakaway_gap.positive", "N", 30.0, 30.0, 30.0, 30.0, 1.0, 90.0, EstimateStatus.UNDETERMINED
    )
    stiffness = ParameterEstimate(
        "friction.bristle_stiffness", "N/m", 3e7, 3e7, 2e7, 4e7, 1e7, 9e7, EstimateStatus.FITTED
    )
    estimates, none = (gap, stiffness), SimpleNamespace()
    result = IdentificationResult(DRIVE, estimates, none, none, none, (), DRIVE, none)
    assert result.undetermined == ("friction.breakaway_gap.positive",)
    assert [result.estimate(path) for path in result.undetermined] == [gap]
    assert result.estimate("breakaway_gap.positive") is gap
    assert result.estimate("friction.bristle_stiffness.negative") is stiffness  # the same in both directions
    with pytest.raises(ParameterError, match=r"breakaway.positive: is not identified; known: friction.breakaway_gap"):
        result.estimate("breakaway.positive")
