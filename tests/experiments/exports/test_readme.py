"""The readme of an export does what it says, and its fingerprint is that of the law and of its numbers."""

import re
import subprocess
import sys
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from diffdrive.model.data_sheet import DataSheet
from diffdrive.paper import paper_axis
from experiments.exports.fingerprint import fingerprint_of
from experiments.exports.targets import TARGETS, Target, register
from experiments.exports.trace import program_of
from experiments.exports.workflow import export
from tests.support.exported import COMPILERS, VARIANTS, lap

PERIOD = 1e-4
BUILT_IN = ("c99", "structured-text", "fmu", "hal")
FINGERPRINT = r"(?<![-\w])([0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4})(?![-\w])"  # and no part of the token of an FMU


def exported(target, folder, axis=None, **options):
    axis = paper_axis("pd+fc") if axis is None else axis
    result = export(axis, lap(axis, 501), folder, target=target, name="axis_x", **options)
    return result, (folder / "axis_x_readme.txt").read_text()


def texts(folder):
    """Every text of an export by its name, those within an FMU as well; neither the readme nor numbers alone."""
    found = {file.name: file.read_text() for file in folder.iterdir() if file.suffix not in (".fmu", ".csv", ".txt")}
    for file in folder.glob("*.fmu"):
        with zipfile.ZipFile(file) as archive:
            found |= {name: archive.read(name).decode() for name in archive.namelist() if "binaries" not in name}
    return {name: text for name, text in found.items() if "buildDescription" not in name}


@pytest.mark.parametrize("target", BUILT_IN)
def test_the_readme_names_every_file_every_signal_and_the_fingerprint_of_the_code(target, tmp_path):
    axis = paper_axis("pd+fc")
    result, readme = exported(target, tmp_path, axis)
    program = program_of(axis.controller, 1.0 / axis.rate, "axis_x")
    assert all(re.search(rf"^  {re.escape(file)}  +\w", readme, re.M) for file in result.files if "readme" not in file)
    for signal in (*program.inputs, *(one for one, _ in program.outputs)):
        assert re.search(rf"^  {signal.name} +{re.escape(signal.unit)} +{re.escape(signal.meaning)}$", readme, re.M)
    assert "  controller      pd+fc\n" in readme
    assert "  rate            10000 Hz" in readme
    assert f"  fingerprint     {result.fingerprint}\n" in readme
    assert {name: re.findall(FINGERPRINT, text) for name, text in texts(tmp_path).items()} == {
        name: [result.fingerprint] for name in texts(tmp_path)
    }
    assert readme.isascii()
    assert max(map(len, readme.splitlines())) < 160


@pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
def test_the_commands_of_the_readme_of_c_run_and_print_what_it_promises(tmp_path):
    _, readme = exported("c99", tmp_path)
    (command,) = re.findall(r"^  (cc .*)$", readme, re.M)
    ran = subprocess.run(command.replace("cc ", f"{COMPILERS[0]} ", 1), shell=True, cwd=tmp_path, capture_output=True)
    printed = ran.stdout.decode().splitlines()
    assert ran.returncode == 0
    (first,) = re.findall(r'It prints "(.*?)"', readme)
    assert printed[0].startswith(first)
    said = dict(re.findall(r"^  (\w+) +([\d.e+-]+)$", readme.split("the bench printed:")[1].split("START")[0], re.M))
    borne = dict(re.findall(r"^  (\w+) +([\d.e+-]+)$", readme.split("at most:")[1].split("On the")[0], re.M))
    relative = {line.split()[0]: float(line.split("relative ")[1]) for line in printed[1:]}
    assert set(relative) == set(said) == set(borne)
    assert all(relative[name] <= float(borne[name]) for name in borne)


@pytest.mark.skipif(not COMPILERS, reason="no C compiler on this machine")
def test_the_command_of_the_readme_of_an_fmu_runs(tmp_path):
    pytest.importorskip("fmpy", reason="FMPy is not installed")
    _, readme = exported("fmu", tmp_path)
    (script,) = re.findall(r"^  pip install fmpy && python (\S+)$", readme, re.M)
    ran = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert all("relative difference" in line for line in ran.stdout.splitlines())


def test_the_readme_has_the_units_of_a_rotary_axis_and_the_notes_of_the_export(tmp_path):
    axis = replace(paper_axis("pd"), sheet=DataSheet(kind="rotary"))
    result, readme = exported("structured-text", tmp_path, axis, precision="single")
    assert re.search(r"^  force +N\*m +force command$", readme, re.M)
    assert result.notes
    assert all(" ".join(note.split()) in " ".join(readme.split()) for note in result.notes)


def test_a_target_of_ones_own_has_a_readme_too(tmp_path):
    own = register(Target("listing", "names alone", lambda program, *_: {"a.txt": program.name}, "print {}".format))
    try:
        _, readme = exported("listing", tmp_path)
    finally:
        TARGETS.remove(own.name)
    assert "  a.txt\n" in readme
    assert "  print axis_x\n" in readme


def test_the_fingerprint_is_the_same_for_every_target_and_name(tmp_path):
    assert len({exported(target, tmp_path / target)[0].fingerprint for target in BUILT_IN}) == 1
    controller = VARIANTS["cascade, all parts"].controller
    assert fingerprint_of(program_of(controller, PERIOD, "a")) == fingerprint_of(program_of(controller, PERIOD, "b"))


def test_another_law_or_another_number_has_another_fingerprint():
    """A gain in its last bit; what is no parameter, but decides what is computed; the period; the precision."""
    axis = VARIANTS["cascade"]
    controller = axis.controller
    found = [
        fingerprint_of(program_of(controller, PERIOD, "axis")),
        fingerprint_of(program_of(replace(controller, kp=np.nextafter(controller.kp, np.inf)), PERIOD, "axis")),
        fingerprint_of(program_of(replace(controller, velocity_samples=2), PERIOD, "axis")),
        fingerprint_of(program_of(replace(controller, position_every=2), PERIOD, "axis")),
        fingerprint_of(program_of(controller, 2.0 * PERIOD, "axis")),
        fingerprint_of(program_of(controller, PERIOD, "axis", single=True)),
    ]
    assert len(set(found)) == len(found)
    assert len({fingerprint_of(program_of(one.controller, PERIOD, "axis")) for one in VARIANTS.values()}) == len(
        VARIANTS
    )


AGAIN = """
import diffdrive as dd
from experiments.exports.fingerprint import fingerprint_of
from experiments.exports.trace import program_of
dd.configure()
print(fingerprint_of(program_of(dd.paper_axis("pd+fc+ls").controller, 1e-4, "axis")))
"""


def test_another_process_finds_the_same_fingerprint():
    here = fingerprint_of(program_of(paper_axis("pd+fc+ls").controller, PERIOD, "axis"))
    ran = subprocess.run([sys.executable, "-c", AGAIN], capture_output=True, text=True, timeout=120)
    assert ran.stdout.strip() == here, ran.stderr
