"""The C code of every controller compiles without a warning, and answers what the simulator answers."""

import ctypes
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments.exports.c99 import c_files
from experiments.exports.compiled import compiler
from experiments.exports.program import ExportError
from experiments.exports.trace import program_of
from tests.support.export_targets import TOLERANCES, write_files
from tests.support.exported import (
    COMPILERS,
    STRICT,
    VARIANTS,
    compiled_differences,
    replayed_program,
    with_random_gains,
)

pytestmark = pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
FAST = ("pd", "cascade, all parts", "cascade, long lines", "pd+fc+ls")
# Of the largest value. The simulator fuses products and sums where the processor can, the code does not; the observers
# make of such a rounding what is seen here, and without fusing both are equal (`test_without_fused_...`).
FUSED = 1e-9


@pytest.mark.parametrize("name", [pytest.param(one, marks=() if one in FAST else pytest.mark.long) for one in VARIANTS])
def test_the_code_answers_what_the_simulator_answers(name, tmp_path):
    program, replay = replayed_program(VARIANTS[name])
    differences, code = compiled_differences(program, replay, tmp_path, COMPILERS[0])
    assert code == 0
    assert max(differences.values()) < FUSED


@pytest.mark.long
@pytest.mark.parametrize("name", VARIANTS)
@pytest.mark.parametrize("seed", [1, 2])
def test_so_it_does_with_other_gains(name, seed, tmp_path):
    axis = VARIANTS[name]
    differences, _ = compiled_differences(
        *replayed_program(axis, with_random_gains(axis, seed)), tmp_path, COMPILERS[-1]
    )
    assert max(differences.values()) < FUSED


@pytest.mark.long
def test_without_fused_products_both_are_equal_to_a_few_units_of_the_last_place():
    """Over 50,000 steps, for every kind with gains at random; a process of its own, since the flag is read once."""
    ran = subprocess.run(
        [sys.executable, "-m", "experiments.benchmarks.exported", "--no-time", "--seeds", "1"],
        capture_output=True, text=True, cwd=Path(__file__).resolve().parents[3],
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr


@pytest.mark.parametrize("name", [pytest.param(one, marks=() if one in FAST else pytest.mark.long) for one in VARIANTS])
def test_single_precision_compiles_and_is_as_far_off_as_the_simulator_is_in_it(name, tmp_path):
    axis = VARIANTS[name]
    program, replay = replayed_program(axis, single=True)
    differences, _ = compiled_differences(program, replay, tmp_path, COMPILERS[0])
    # the error of a position, half a step of a float at 4 mm, times what a metre of error is worth in this loop
    gains = {one: float(gain) for one, gain in axis.gains.items()}
    assert differences["force"] < 0.02, gains


@pytest.mark.parametrize("name", ["cascade, all parts", "cascade, long lines", "pd+fc+le"])
def test_sanitizers_find_nothing(name, tmp_path):
    checks = "address,undefined,float-divide-by-zero,float-cast-overflow"
    flags = ("-O1", "-g", f"-fsanitize={checks}", "-fno-sanitize-recover=all", "-ffp-contract=off")
    program, replay = replayed_program(VARIANTS[name])
    _, code = compiled_differences(program, replay, tmp_path, COMPILERS[0], flags)
    assert code == 0
    # nor where a position is missing, or absurd: the command is as good as its inputs, but nothing is undefined
    for wrong in (np.nan, np.inf, 1e300):
        broken = np.where(np.arange(2001) == 150, wrong, replay.inputs["scale_position"])
        inputs = replay.inputs | {"scale_position": broken}
        _, code = compiled_differences(program, replay._replace(inputs=inputs), tmp_path, COMPILERS[0], flags)
        assert code == 1  # the bench tells it, and no sanitizer ended it


@pytest.mark.parametrize("name", VARIANTS)
def test_each_parameter_and_each_number_that_is_kept_has_a_comment(name):
    program, replay = replayed_program(VARIANTS[name], samples=501)
    header = c_files(program, "a test", replay, dict.fromkeys(replay.outputs, 1e-9))["axis_x.h"]
    for struct, entries in (("parameters", program.parameters), ("state", program.states)):
        (body,) = re.findall(rf"typedef struct {{\n([^}}]*)}} axis_x_{struct};", header)
        told = dict(re.findall(r"^    \w+ (\w+)(?:\[\d+\])?; /\* (.+) \*/$", body, re.MULTILINE))
        assert list(told) == [one.name for one in entries]
        assert all(one.meaning.split(",")[0] in told[one.name] for one in entries)


def test_the_bench_tells_another_law(tmp_path):
    """A gain that is one part in a million larger is beyond what rounding does."""
    axis = VARIANTS["pd"]
    _, replay = replayed_program(axis)
    other = program_of(axis.with_gains(kp=axis.gains["kp"] * (1 + 1e-6)).controller, 1 / axis.rate, "axis_x")
    differences, code = compiled_differences(other, replay, tmp_path, COMPILERS[0])
    assert code == 1
    assert differences["force"] > FUSED


def test_the_bench_fails_where_one_answer_is_no_number(tmp_path):
    """Also where the next one is a number again."""
    program, replay = replayed_program(VARIANTS["pd"])
    replay.outputs["force"] = np.where(np.arange(len(replay.outputs["force"])) == 7, np.nan, replay.outputs["force"])
    differences, code = compiled_differences(program, replay, tmp_path, COMPILERS[0])
    assert code == 1
    assert np.isnan(differences["force"])


@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler on this machine")
def test_a_program_in_cpp_may_include_the_header(tmp_path):
    program, replay = replayed_program(VARIANTS["pd"], samples=501)
    write_files(c_files(program, "a test", replay, TOLERANCES), tmp_path)
    (tmp_path / "main.cpp").write_text(
        '#include "axis_x.h"\nint main() { axis_x_controller c; axis_x_set_parameters(&c, &axis_x_drive_file); }\n'
    )
    subprocess.run([COMPILERS[0], *STRICT, "-c", "axis_x.c"], cwd=tmp_path, check=True)
    subprocess.run(["g++", "-Wall", "-Wextra", "-Werror", "main.cpp", "axis_x.o", "-lm"], cwd=tmp_path, check=True)


def test_the_compiler_may_have_arguments(monkeypatch):
    monkeypatch.setenv("CC", f"{COMPILERS[0]} -m64")
    assert compiler() == [COMPILERS[0], "-m64"]
    monkeypatch.setenv("CC", "")
    assert compiler() is not None
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(ExportError, match="no such compiler"):
        compiler()
    monkeypatch.setenv("CC", '"')
    with pytest.raises(ExportError, match="is no command"):
        compiler()


@pytest.fixture
def library(tmp_path):
    """The cascade with all parts as a library."""
    axis = VARIANTS["cascade, all parts"]
    program, replay = replayed_program(axis, samples=301)
    write_files(c_files(program, "a test", replay, TOLERANCES), tmp_path)
    options = [*STRICT, "-O1", "-shared", "-fPIC", "-o", "axis.so", "axis_x.c", "-lm"]
    subprocess.run([COMPILERS[0], *options], cwd=tmp_path, check=True)
    return program, replay, ctypes.CDLL(str(tmp_path / "axis.so"))


def stepped(library, replay, program, at=-1, factor=1.0):
    """The forces of a replay in which the gain kv is multiplied before one step."""
    parameters = (ctypes.c_double * len(program.parameters))(*(one.value for one in program.parameters))
    controller, force = (ctypes.c_double * 200)(), ctypes.c_double()
    library.axis_x_set_parameters(controller, parameters)
    library.axis_x_reset(controller, ctypes.c_double(replay.inputs["reference_position"][0]))
    place = [one.name for one in program.parameters].index("kv")
    forces = []
    for step, row in enumerate(zip(*replay.inputs.values(), strict=True)):
        if step == at:
            parameters[place] *= factor
            library.axis_x_set_parameters(controller, parameters)
        library.axis_x_step(controller, (ctypes.c_double * len(row))(*row), ctypes.byref(force))
        forces.append(force.value)
    return np.array(forces)


def test_parameters_may_be_set_while_it_runs(library):
    """The state stays: the same gain again changes nothing, another one only what comes later."""
    program, replay, code = library
    plain = stepped(code, replay, program)
    assert np.array_equal(stepped(code, replay, program, at=100), plain)
    other = stepped(code, replay, program, at=100, factor=1.1)
    assert np.array_equal(other[:100], plain[:100])
    assert not np.array_equal(other[100:], plain[100:])


def test_parameters_that_make_no_number_are_refused_and_change_nothing(library):
    """A reset time of 0 makes an infinite gain: taken, the command would be NaN until a reset."""
    program, _, code = library
    code.axis_x_set_parameters.restype = ctypes.c_bool
    values = np.array([one.value for one in program.parameters])
    controller = (ctypes.c_double * 200)()
    assert code.axis_x_set_parameters(controller, values.ctypes.data_as(ctypes.c_void_p))
    before = bytes(controller)
    place = [one.name for one in program.parameters].index("reset_time")
    for wrong in (0.0, np.nan):
        values[place] = wrong
        assert not code.axis_x_set_parameters(controller, values.ctypes.data_as(ctypes.c_void_p))
        assert bytes(controller) == before


def test_a_position_that_is_no_number_is_seen_in_the_command(library):
    program, replay, code = library
    broken = np.where(np.arange(301) == 150, np.nan, replay.inputs["scale_position"])
    forces = stepped(code, replay._replace(inputs=replay.inputs | {"scale_position": broken}), program)
    assert np.all(np.isfinite(forces[:150]))
    assert np.all(np.isnan(forces[150:]))
