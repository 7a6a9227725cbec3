"""Structured Text: accepted by an independent compiler, and the same answers."""

import math
import platform
import signal

import pytest

from experiments.exports.structured_text import st_files
from tests.support.export_targets import TOLERANCES
from tests.support.exported import VARIANTS, replayed_program
from tests.support.matiec import harness, run_by_matiec, with_matiec

BENCH = harness(
    "axis_x_bench", 501,
    end='printf("%g", (double)block.DEVIATION.value); return block.DONE.value && block.PASSED.value ? 0 : 1;',
)  # fmt: skip
NOT_A_NUMBER = harness(
    "axis_x", 12,
    before="block.SCALE_POSITION.value = call == 5 ? NAN : 1e-7 * call;",
    after='printf("%g ", (double)block.FORCE.value); fflush(stdout);',
)  # fmt: skip


def block_and_bench(name, tolerances=TOLERANCES, single=False):
    """Both files of an export in one text."""
    program, replay = replayed_program(VARIANTS[name], samples=501, single=single)
    return "".join(st_files(program, "a test", replay, tolerances).values())


@pytest.mark.long
@with_matiec
@pytest.mark.parametrize("name", VARIANTS)
@pytest.mark.parametrize("single", [False, True], ids=["LREAL", "REAL"])
def test_an_independent_compiler_takes_the_structured_text_and_its_bench_passes(name, single, tmp_path):
    """Also on a controller that stops at floating-point exceptions: there are none."""
    text = block_and_bench(name, {"force": 0.02 if single else 1e-9}, single)
    ran = run_by_matiec(text, BENCH, tmp_path, traps=True)
    assert ran.returncode == 0, ran.stdout


@pytest.mark.long
@with_matiec
@pytest.mark.parametrize("name", ["cascade, all parts", "pd+fc+le"])
def test_a_position_that_is_no_number_is_seen_in_the_command_of_structured_text(name, tmp_path):
    """Also behind a force limit: a full command would be the worst answer."""
    ran = run_by_matiec(block_and_bench(name), NOT_A_NUMBER, tmp_path, traps=False)
    forces = [float(force) for force in ran.stdout.split()]
    assert [math.isnan(force) for force in forces] == [False] * 5 + [True] * 7


@pytest.mark.long
@with_matiec
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can trap floating-point exceptions")
def test_a_position_that_is_no_number_stops_the_task_of_a_controller_that_traps(tmp_path):
    """As the page says; and so a trap in the bench would be seen."""
    ran = run_by_matiec(block_and_bench("cascade, all parts"), NOT_A_NUMBER, tmp_path, traps=True)
    assert ran.returncode == -signal.SIGFPE
    assert len(ran.stdout.split()) == 5


@pytest.mark.long
@with_matiec
@pytest.mark.parametrize("wrong", ["LN(REAL_TO_LREAL(-1.0)) * controller.force", "0.0 * controller.force"])
def test_the_bench_fails_where_the_answers_are_none(wrong, tmp_path):
    text = block_and_bench("pd")
    assert text.count("ABS(controller.force") == 1
    ran = run_by_matiec(text.replace("ABS(controller.force", f"ABS({wrong}"), BENCH, tmp_path, traps=False)
    assert ran.returncode != 0


def test_structured_text_takes_parameters_with_and_without_a_restart():
    program, replay = replayed_program(VARIANTS["cascade, all parts"], samples=301)
    block = st_files(program, "a test", replay, TOLERANCES)["axis_x.st"]
    condition = "IF restart OR update_parameters OR NOT initialised THEN\n"
    parameters, rest = block.split(condition)[1].split("END_IF;", 1)
    start = rest.split("IF restart OR NOT initialised THEN\n")[1].split("END_IF;")[0]
    assert "k_kp := kp;" in parameters
    assert "s_" not in parameters
    assert all(f"s_{one.name}" in start for one in program.states)


@pytest.mark.parametrize("name", VARIANTS)
def test_structured_text_declares_each_name_once(name):
    program, replay = replayed_program(VARIANTS[name], samples=501)
    block = st_files(program, "a *) test", replay, TOLERANCES)["axis_x.st"]
    head = block.split("END_VAR\n\nIF", 1)[0]
    names = [line.split(" : ")[0].strip().lower() for line in head.splitlines() if " : " in line and line[:4] == "    "]
    assert len(names) == len(set(names))
    assert block.count("*)") == block.count("(*")
