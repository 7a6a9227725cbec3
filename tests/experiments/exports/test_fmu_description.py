"""What an FMU says of its variables: the unit of each by base units, and which of them may be set when."""

from dataclasses import replace
from xml.etree import ElementTree

import pytest

from diffdrive.model.data_sheet import DataSheet
from diffdrive.model.motor_units import axis_unit
from experiments.exports.fmu import fmu_files
from experiments.exports.fmu_units import units_of
from experiments.exports.trace import program_of
from tests.support.export_targets import TOLERANCES, fmu_contents, run_with_fmpy, write_files
from tests.support.exported import COMPILERS, VARIANTS, replayed_program

NO_COMPILER = "experiments.exports.fmu.compiler"


def described(program, replay):
    return ElementTree.fromstring(fmu_contents(program, replay)["modelDescription.xml"])


def base_units(root):
    """The attributes of each unit's base unit; None for a unit without one."""
    units = {}
    for unit in root.iterfind("UnitDefinitions/Unit"):
        base = unit.find("BaseUnit")
        units[unit.get("name")] = None if base is None else dict(base.attrib)
    return units


@pytest.fixture
def no_library(monkeypatch):
    monkeypatch.setattr(NO_COMPILER, lambda: None)


@pytest.mark.usefixtures("no_library")
@pytest.mark.parametrize("name", ["cascade, all parts", "pd+fc+ls", "dobvsc"])
@pytest.mark.parametrize("kind", ["linear", "rotary"])
def test_every_variable_has_a_unit_that_is_defined(name, kind):
    program, replay = replayed_program(VARIANTS[name], samples=301)
    root = described(program.in_units(lambda unit: axis_unit(unit, DataSheet(kind=kind))), replay)
    units = base_units(root)
    used = {one.get("unit") for one in root.iterfind("ModelVariables/Float64")}
    assert used | {"s"} == set(units)
    assert units["1"] == {} if "1" in units else True
    assert {unit for unit, base in units.items() if base is None} <= {"dB"}
    force = root.find("ModelVariables/Float64[@name='force']").get("unit")
    metres = "1" if kind == "linear" else "2"
    assert units[force] == {"kg": "1", "m": metres, "s": "-2"}


EXPECTED = {
    "A": {"A": "1"},
    "K": {"K": "1"},
    "V": {"kg": "1", "m": "2", "s": "-3", "A": "-1"},
    "N*m/A": {"kg": "1", "m": "2", "s": "-2", "A": "-1"},
    "V*s/rad": {"kg": "1", "m": "2", "s": "-2", "A": "-1", "rad": "-1"},
    "W/K": {"kg": "1", "m": "2", "s": "-3", "K": "-1"},
    "degC": {"K": "1", "offset": "273.15"},
    "um": {"m": "1", "factor": "1e-06"},
    "1": {},
    "dB": None,
    "of_my_own": None,
}


def test_a_unit_is_the_product_of_base_units_that_it_is():
    """Also those of a motor, which a controller of one's own may state."""
    program = program_of(VARIANTS["pd"].controller, 1e-4, "axis_x")
    found = units_of(replace(program, parameters=tuple(program.parameters[0]._replace(unit=one) for one in EXPECTED)))
    for unit, expected in EXPECTED.items():
        base = found[unit]
        if expected is None:
            assert base is None
        else:
            assert {key: float(text) for key, text in base.items()} == pytest.approx(
                {key: float(text) for key, text in expected.items()}
            )


@pytest.mark.usefixtures("no_library")
def test_an_output_is_calculated_and_has_no_start():
    """One that is exact could be set before the start by its master, and this one follows from the first step."""
    program, replay = replayed_program(VARIANTS["pd+fc+ls"], samples=301)
    root = described(program, replay)
    outputs = root.findall("ModelVariables/Float64[@causality='output']")
    assert len(outputs) == len(program.outputs) == 5
    assert {(one.get("initial"), one.get("start")) for one in outputs} == {("calculated", None)}
    references = [one.get("valueReference") for one in outputs]
    assert [one.get("valueReference") for one in root.iterfind("ModelStructure/Output")] == references
    assert [one.get("valueReference") for one in root.iterfind("ModelStructure/InitialUnknown")] == references


SET = """
def settable():
    found = []
    for variable in description.modelVariables:
        try:
            one.setFloat64([variable.valueReference], [float(variable.start or 0.0)])
            found.append(variable.name)
        except Exception:
            pass
    return " ".join(found)

print(settable())
one.enterInitializationMode()
print(settable())
print(*one.getFloat64([v.valueReference for v in description.modelVariables if v.causality == "output"]))
one.exitInitializationMode()
print(settable())
one.doStep(0.0, 1e-3)
print(settable())
"""


@pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
def test_what_may_be_set_is_what_the_description_says(tmp_path):
    """Before the start inputs and all parameters, afterwards inputs and what is tunable, and never an output."""
    pytest.importorskip("fmpy", reason="FMPy is not installed")
    program, replay = replayed_program(VARIANTS["pd+fc"], samples=301)
    write_files(fmu_files(program, "a test", replay, TOLERANCES), tmp_path)
    ran = run_with_fmpy(SET, tmp_path / "axis_x.fmu")
    instantiated, initialising, values, initialised, stepped = (line.split() for line in ran.stdout.splitlines())
    always = [one.name for one in (*program.inputs, *program.parameters)]
    assert instantiated == initialising == always
    assert initialised == stepped == always
    assert [float(value) for value in values] == [0.0] * len(program.outputs)
