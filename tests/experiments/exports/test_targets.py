"""FMU and HAL: accepted by an independent compiler or tool, and the same answers."""

import os
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from diffdrive import motion
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.errors import ParameterError
from diffdrive.model.data_sheet import DataSheet
from diffdrive.paper import paper_axis
from experiments.exports.fmu import fmu_files
from experiments.exports.hal import hal_files
from experiments.exports.program import ExportError
from experiments.exports.targets import TARGETS
from experiments.exports.trace import program_of
from experiments.exports.workflow import export
from tests.support.export_targets import TOLERANCES, fmu_contents, run_with_fmpy, write_component, write_files
from tests.support.exported import COMPILERS, VARIANTS, has, lap, replayed_program


@pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
@pytest.mark.parametrize("name", ["cascade, motor", pytest.param("pd+fc+ls", marks=pytest.mark.long)])
def test_the_fmu_is_valid_and_replays_the_run(name, tmp_path):
    validation = pytest.importorskip("fmpy.validation", reason="FMPy is not installed")
    program, replay = replayed_program(VARIANTS[name], samples=501)
    files = fmu_files(program, 'a <"&> test', replay, TOLERANCES)
    write_files(files, tmp_path)
    assert validation.validate_fmu(str(tmp_path / "axis_x.fmu")) == []
    ran = subprocess.run([sys.executable, str(tmp_path / "axis_x_fmu_bench.py")], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert files["axis_x.fmu"] == fmu_files(program, 'a <"&> test', replay, TOLERANCES)["axis_x.fmu"]


def token_of(contents):
    return re.search('instantiationToken="(.*?)"', contents["modelDescription.xml"].decode())[1]


def test_the_token_of_an_fmu_is_that_of_its_gains(monkeypatch):
    monkeypatch.setattr("experiments.exports.fmu.compiler", lambda: None)
    axis = VARIANTS["pd"]
    _, replay = replayed_program(axis, samples=501)
    other = axis.with_gains(kp=2.0 * axis.gains["kp"])
    programs = [program_of(one.controller, 1.0 / axis.rate, "axis_x") for one in (axis, axis, other)]
    first, again, changed = (token_of(fmu_contents(one, replay)) for one in programs)
    assert first == again != changed


def test_a_title_that_no_xml_holds_leaves_the_description_readable(monkeypatch):
    monkeypatch.setattr("experiments.exports.fmu.compiler", lambda: None)
    program, replay = replayed_program(VARIANTS["pd"], samples=501)
    contents = fmu_contents(program, replay, 'a "\x01" <test> \ud800')
    root = ElementTree.fromstring(contents["modelDescription.xml"])
    assert root.get("description") == 'a "?" <test> ?'


def test_an_fmu_without_a_compiler_has_its_sources(monkeypatch):
    monkeypatch.setattr("experiments.exports.fmu.compiler", lambda: None)
    program, replay = replayed_program(VARIANTS["pd"], samples=501)
    assert {
        "modelDescription.xml",
        "sources/axis_x.c",
        "sources/axis_x_fmi3.c",
        "sources/buildDescription.xml",
    } <= set(fmu_contents(program, replay))


@pytest.mark.long
@pytest.mark.skipif(not has("halcompile"), reason="no halcompile (linuxcnc-uspace-dev) on this machine")
@pytest.mark.parametrize("name", ["cascade, all parts", "pd+fc+le"])
def test_the_hal_component_builds(name, tmp_path):
    program, replay = replayed_program(VARIANTS[name], samples=501)
    write_component(program, replay, tmp_path, own_headers=False)
    made = subprocess.run(["halcompile", "--compile", "axis_x.comp"], cwd=tmp_path, capture_output=True, text=True)
    assert made.returncode == 0, made.stdout + made.stderr
    assert (tmp_path / "axis_x.so").exists()


PERIOD_HARNESS = """
#include "axis_x_hal.h"
int main(void)
{
    const long periods[] = {99857, 100000, 1000000, 25000, 0};
    int right = 0;
    for (int i = 0; i < 5; ++i) {
        right |= axis_x_is_period(periods[i]) << i;
    }
    return right;
}
"""


@pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
def test_a_component_in_a_thread_of_another_period_gives_no_force(tmp_path):
    """The servo thread of most configurations has 1 ms: gains for 10 kHz would run in it without a word."""
    program, replay = replayed_program(VARIANTS["pd"], samples=301)
    write_component(program, replay, tmp_path)
    (tmp_path / "harness.c").write_text(PERIOD_HARNESS)
    subprocess.run([COMPILERS[0], "-I.", "-w", "-o", "harness", "harness.c", "-lm"], cwd=tmp_path, check=True)
    assert subprocess.run([tmp_path / "harness"]).returncode == 0b00011
    component = (tmp_path / "axis_x.comp").read_text()
    assert "pin out bit wrong_period" in component
    assert "option period no" not in component
    bench = (tmp_path / "axis_x_hal_bench.py").read_text()
    assert "period1=100000 " in bench.replace('"', " ")


STEP = """
one.enterInitializationMode()
one.exitInitializationMode()
try:
    one.doStep(0.0, float(sys.argv[2]))
except Exception:
    sys.exit(3)
"""


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    pytest.importorskip("fmpy", reason="FMPy is not installed")
    folder = tmp_path_factory.mktemp("fmu")
    program, replay = replayed_program(VARIANTS["pd"], samples=301)
    write_files(fmu_files(program, "a test", replay, TOLERANCES), folder)
    return folder / "axis_x.fmu"


@pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
@pytest.mark.parametrize(("step", "code"), [("1e-3", 0), ("inf", 3), ("nan", 3), ("-1e-3", 3)])
def test_a_step_of_an_fmu_that_has_no_end_is_refused(fmu, step, code):
    assert run_with_fmpy(STEP, fmu, step).returncode == code


STEPS = """
one.enterInitializationMode()
one.exitInitializationMode()
one.doStep(0.0, 1e-3)
one.doStep(1e-3 * (1 + 1e-9), 1e-3)
try:
    one.doStep(float(sys.argv[2]), 1e-3)
except Exception:
    sys.exit(3)
"""


@pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
@pytest.mark.parametrize(("now", "code"), [("2e-3", 0), ("0.0", 3), ("-5.0", 3), ("1.0", 3)])
def test_a_step_of_an_fmu_begins_where_the_last_one_ended(fmu, now, code):
    """Back in time there is no state; over a gap the controller would run on with old inputs, and wind up."""
    assert run_with_fmpy(STEPS, fmu, now).returncode == code


FAR = """
references = {variable.name: variable.valueReference for variable in description.modelVariables}
one.enterInitializationMode()
one.exitInitializationMode()
one.setFloat64([references["reference_position"], references["scale_position"]], [0.1, 0.1])
for step in range(5):
    one.doStep(step * 1e-4, 1e-4)
    print(*one.getFloat64([references["force"]]))
"""


@pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
def test_an_fmu_starts_at_rest_where_it_is_measured(fmu):
    """From a position that nobody stated, as 0, the first force would be that of an infinite speed."""
    assert [float(force) for force in run_with_fmpy(FAR, fmu).stdout.split()] == [0.0] * 5


FAR_HARNESS = """
#include "axis_x_hal.h"
#include <stdio.h>
int main(void)
{
    static axis_x_instance held;
    double parameter_values[AXIS_X_PARAMETERS], out[OUTPUTS] = {0.0};
    double in[] = {0.1, 0.0, 0.0, 0.1, 0.0};
    memcpy(parameter_values, &axis_x_drive_file, sizeof parameter_values);
    for (int call = 0; call < 3; ++call) {
        axis_x_period(&held, parameter_values, false, in, out);
        printf("%g ", out[0]);
    }
    in[0] = in[3] = -0.2; /* moved while the amplifier was off */
    axis_x_period(&held, parameter_values, true, in, out);
    printf("%g ", out[0]);
    parameter_values[0] = NAN;
    axis_x_period(&held, parameter_values, false, in, out);
    printf("%g ", out[0]);
    return held.is_refused ? 0 : 1;
}
"""


@pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
def test_a_component_starts_at_rest_where_it_is_measured(tmp_path):
    program, replay = replayed_program(VARIANTS["pd"], samples=301)
    write_component(program, replay, tmp_path)
    (tmp_path / "harness.c").write_text(FAR_HARNESS)
    options = ["-I.", "-w", f"-DOUTPUTS={len(program.outputs)}", "-o", "harness", "harness.c", "-lm"]
    subprocess.run([COMPILERS[0], *options], cwd=tmp_path, check=True)
    ran = subprocess.run([tmp_path / "harness"], capture_output=True, text=True, check=True)
    assert [float(force) for force in ran.stdout.split()] == [0.0] * 5  # refused parameters change nothing


def test_a_replay_begins_where_the_motion_does(tmp_path):
    """The memory of a controller holds its first 500 samples: at rest they would prove nothing."""
    axis = VARIANTS["pd"]
    stroke = motion.triangular(speed=0.01, stroke=1e-3, rounding=0.02, duration=0.1, rate=axis.rate)
    rest = np.full(1_000, stroke.position[0])
    late = motion.from_array(
        np.arange(len(rest) + len(stroke.time)) / axis.rate, np.concatenate([rest, stroke.position])
    )
    result = export(axis, late, tmp_path, target="structured-text", name="late")
    assert result.steps < len(late.time) - 900
    bench = (tmp_path / "late_bench.st").read_text()
    force = re.search(r"run_expected_force : [^\[]*\[[^\[]*\[([^\]]*)\]", bench)[1]
    assert np.count_nonzero([float(one) for one in force.split(",")]) > 400


REFUSED = """
references = {variable.name: variable.valueReference for variable in description.modelVariables}
one.enterInitializationMode()
one.exitInitializationMode()
one.setFloat64([references["reset_time"]], [0.0])
try:
    one.doStep(0.0, 1e-3)
except Exception:
    sys.exit(3)
"""


@pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
def test_an_fmu_refuses_parameters_that_make_no_number(tmp_path):
    pytest.importorskip("fmpy", reason="FMPy is not installed")
    program, replay = replayed_program(VARIANTS["cascade, all parts"], samples=301)
    write_files(fmu_files(program, "a test", replay, TOLERANCES), tmp_path)
    assert run_with_fmpy(REFUSED, tmp_path / "axis_x.fmu").returncode == 3


@pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
def test_the_bench_of_an_fmu_fails_where_one_answer_is_no_number(tmp_path):
    pytest.importorskip("fmpy", reason="FMPy is not installed")
    program, replay = replayed_program(VARIANTS["pd"], samples=301)
    replay.outputs["force"] = np.where(np.arange(len(replay.outputs["force"])) == 7, np.nan, replay.outputs["force"])
    write_files(fmu_files(program, "a test", replay, TOLERANCES), tmp_path)
    ran = subprocess.run([sys.executable, str(tmp_path / "axis_x_fmu_bench.py")], capture_output=True, text=True)
    assert ran.returncode == 1
    assert "relative difference nan" in ran.stdout


@pytest.mark.parametrize(("answers", "code"), [("right", 0), ("nan", 1), ("0.0", 1), ("", 1)])
def test_the_bench_of_a_component_tells_right_answers_from_others(answers, code, tmp_path, monkeypatch):
    """With a program in the place of LinuxCNC's that gives these answers."""
    program, replay = replayed_program(VARIANTS["pd"], samples=301)
    write_component(program, replay, tmp_path)
    forces = replay.outputs["force"]
    given = {"right": "".join(f"{one:f}\n" for one in forces), "": ""}
    (tmp_path / "answers").write_text(given.get(answers, f"{answers}\n" * len(forces)))
    (tmp_path / "halrun").write_text(f"#!/bin/sh\ncp {tmp_path}/answers sample.txt\n")
    (tmp_path / "halrun").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    bench = [sys.executable, str(tmp_path / "axis_x_hal_bench.py")]
    assert subprocess.run(bench).returncode == code
    (tmp_path / "halrun").write_text("#!/bin/sh\nexit 1\n")
    assert subprocess.run(bench).returncode == 2


def test_a_name_that_is_too_long_for_hal_is_refused_with_the_length_that_is_not():
    axis = VARIANTS["pd+fc+ls"]
    program, replay = replayed_program(axis, samples=501)
    object.__setattr__(program, "name", "an_axis_of_a_long_name")
    with pytest.raises(ExportError, match=r"may have 1\d letters"):
        hal_files(program, "a test", replay, TOLERANCES)


@pytest.mark.parametrize("name", ["gantry", "pid", "PID"])
def test_no_component_of_linuxcnc_is_replaced(name, tmp_path):
    axis = VARIANTS["pd"]
    with pytest.raises(ExportError, match="has a component of this name"):
        export(axis, lap(axis, 501), tmp_path, target="hal", name=name)


@pytest.mark.parametrize("target", TARGETS)
def test_every_target_writes_what_it_says(target, tmp_path):
    axis = paper_axis("pd")
    result = export(axis, lap(axis, 501), tmp_path / "code", target=target)
    assert {path.name for path in (tmp_path / "code").iterdir()} == set(result.files)
    assert result.status.ok
    assert result.files[0] in result.summary()
    saved = result.save(tmp_path / "code")
    assert saved.name == "export.json"


@pytest.mark.parametrize("target", ["c99", "structured-text", "hal"])
def test_a_rotary_axis_has_radians_and_newton_metres(target, tmp_path):
    axis = replace(paper_axis("pd"), sheet=DataSheet(kind="rotary"))
    export(axis, lap(axis, 501), tmp_path, target=target, name="table")
    head = (tmp_path / f"table.{ {'c99': 'h', 'structured-text': 'st', 'hal': 'comp'}[target] }").read_text()
    assert "rad/s: reference velocity" in head
    assert "N*m: force command" in head
    assert "N*m*s/rad: derivative gain" in head
    assert not re.search(r"[ \"](m|N|m/s|N/m|N\*s/m): ", head)


@pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
def test_the_fmu_of_a_rotary_axis_is_valid(tmp_path):
    validation = pytest.importorskip("fmpy.validation", reason="FMPy is not installed")
    axis = replace(paper_axis("pd+fc"), sheet=DataSheet(kind="rotary"))
    export(axis, lap(axis, 501), tmp_path, target="fmu", name="table")
    assert validation.validate_fmu(str(tmp_path / "table.fmu")) == []
    with zipfile.ZipFile(tmp_path / "table.fmu") as archive:
        description = archive.read("modelDescription.xml").decode()
    assert '<BaseUnit rad="1"/>' in description
    assert (
        'name="scale_position" valueReference="4" causality="input" variability="continuous" unit="rad"' in description
    )


def test_a_command_that_only_the_amplifier_limits_is_noted(tmp_path):
    axis = read_axis("cnc")
    assert any("9425 N" in note for note in export(axis, lap(axis, 501), tmp_path, target="structured-text").notes)
    limited = axis.with_controller(replace(axis.controller, force_limit=5e3))
    assert not any("limit" in note for note in export(limited, lap(axis, 501), tmp_path, target="c99").notes)
    observed = VARIANTS["pd+fc"].replace({"actuator.force_limit": 5e4})
    [note] = [one for one in export(observed, lap(observed, 501), tmp_path, target="c99").notes if "limit" in one]
    assert "[controller]" not in note  # which takes no limit with this kind
    assert "integral" not in note  # which this kind has not


def test_an_axis_that_its_friction_does_not_hold_is_noted(tmp_path):
    axis = read_axis("vertical")
    stroke = lap(axis, 501)
    assert not any("brake" in note for note in export(axis, stroke, tmp_path, target="structured-text").notes)
    hanging = axis.replace({"plant.constant_force": -1520.0})
    assert any("-1520 N" in note for note in export(hanging, stroke, tmp_path, target="structured-text").notes)


def test_what_is_not_known_is_refused(tmp_path):
    axis = paper_axis("pd")
    with pytest.raises(ParameterError, match="c99"):
        export(axis, lap(axis, 501), tmp_path, target="pascal")
    with pytest.raises(ParameterError, match="precision"):
        export(axis, lap(axis, 501), tmp_path, precision="half")
    with pytest.raises(ExportError, match="double"):
        export(axis, lap(axis, 501), tmp_path, target="fmu", precision="single")
    assert not list(tmp_path.iterdir())
