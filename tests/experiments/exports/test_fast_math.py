"""No compiler may take NaN and infinity for impossible: code that is compiled so is refused, in every target in C."""

import subprocess
from pathlib import Path

import pytest

from experiments.exports.c99 import c_files
from tests.support.export_targets import TOLERANCES, fmu_contents, write_component, write_files
from tests.support.exported import COMPILERS, VARIANTS, replayed_program

pytestmark = pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
FAST = ("-ffast-math", "-ffinite-math-only", "-Ofast")
SOURCES = ("axis_x.c", "axis_x_bench.c", "component.c", "axis_x_fmi3.c")


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """The folder of all sources in C: that of the FMU comes with the controller's."""
    folder = tmp_path_factory.mktemp("sources")
    program, replay = replayed_program(VARIANTS["cascade, all parts"], samples=301)
    contents = fmu_contents(program, replay)
    write_files({Path(name).name: text for name, text in contents.items() if name.startswith("sources/")}, folder)
    write_files(c_files(program, "a test", replay, TOLERANCES), folder)
    write_component(program, replay, folder)
    (folder / "component.c").write_text('#include "axis_x_hal.h"\n')  # as what halcompile makes of a component does
    return folder


def compiled(folder, compiler, source, *flags):
    command = [compiler, "-std=c99", "-I.", "-w", "-fsyntax-only", *flags, source]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("source", SOURCES)
def test_code_in_which_nan_could_be_lost_does_not_compile_and_says_why(sources, compiler, source):
    for flag in FAST:
        refused = compiled(sources, compiler, source, "-O2", flag)
        assert refused.returncode != 0, flag
        assert "NaN and infinity decide what this controller does" in refused.stderr


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("source", SOURCES)
def test_other_ways_to_optimise_are_taken(sources, compiler, source):
    for flags in (["-O3"], ["-Ofast", "-fno-fast-math"], ["-O2", "-ffp-contract=fast"]):
        taken = compiled(sources, compiler, source, *flags)
        assert taken.returncode == 0, taken.stderr


def test_a_program_that_is_compiled_so_itself_may_call_the_code(sources):
    """The header holds no arithmetic: only what computes is refused."""
    (sources / "caller.c").write_text('#include "axis_x.h"\n')
    assert compiled(sources, COMPILERS[0], "caller.c", "-ffast-math").returncode == 0
