"""The files of a target, written as their tools expect them."""

import io
import subprocess
import sys
import zipfile

from experiments.exports.fmu import fmu_files
from experiments.exports.hal import hal_files

OUTPUTS = ("force", "friction_estimate", "innovation", "load_estimate", "velocity_estimate")
TOLERANCES = dict.fromkeys(OUTPUTS, 1e-9)
OPENED = """
import sys
from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Slave
description, folder = read_model_description(sys.argv[1]), extract(sys.argv[1])
one = FMU3Slave(guid=description.guid, unzipDirectory=folder, modelIdentifier="axis_x", instanceName="one")
one.instantiate()
"""


def write_files(files, folder):
    """Texts and bytes by their names, in a folder."""
    for file, content in files.items():
        (folder / file).write_bytes(content if isinstance(content, bytes) else content.encode())


def write_component(program, replay, folder, *, own_headers=True):
    """A HAL component, with headers in the place of LinuxCNC's that its code includes."""
    write_files(hal_files(program, 'a "test"', replay, TOLERANCES), folder)
    for header in ("math", "string") if own_headers else ():
        (folder / f"rtapi_{header}.h").write_text(f"#include <{header}.h>\n")


def fmu_contents(program, replay, title="a test"):
    """The files of an FMU by their names in the archive, as bytes."""
    files = fmu_files(program, title, replay, TOLERANCES)
    with zipfile.ZipFile(io.BytesIO(files[f"{program.name}.fmu"])) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def run_with_fmpy(script, fmu, *arguments):
    """A script in a process of its own, which may crash; `one` is an instance of the FMU, with its `description`."""
    command = [sys.executable, "-c", OPENED + script, str(fmu), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)
