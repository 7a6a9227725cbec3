"""The files of a target, written as their tools expect them."""

import io
import zipfile

from experiments.exports.fmu import fmu_files
from experiments.exports.hal import hal_files

OUTPUTS = ("force", "friction_estimate", "innovation", "load_estimate", "velocity_estimate")
TOLERANCES = dict.fromkeys(OUTPUTS, 1e-9)


def write_files(files, folder):
    """Texts and bytes by their names, in a folder."""
    for file, content in files.items():
        (folder / file).write_bytes(content if isinstance(content, bytes) else content.encode())


def write_component(program, replay, folder):
    """A HAL component, with the headers of LinuxCNC that its code includes."""
    write_files(hal_files(program, 'a "test"', replay, TOLERANCES), folder)
    for header in ("math", "string"):
        (folder / f"rtapi_{header}.h").write_text(f"#include <{header}.h>\n")


def fmu_contents(program, replay, title="a test"):
    """The files of an FMU by their names in the archive, as bytes."""
    files = fmu_files(program, title, replay, TOLERANCES)
    with zipfile.ZipFile(io.BytesIO(files[f"{program.name}.fmu"])) as archive:
        return {name: archive.read(name) for name in archive.namelist()}
