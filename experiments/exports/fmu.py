"""An FMU of FMI 3.0 for co-simulation: sources, and the library of this machine where it has a C compiler."""

import io
import platform
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping
from pathlib import Path

from diffdrive.support.atomic_write import write_text
from experiments.exports.c99 import c_code
from experiments.exports.compiled import compiler
from experiments.exports.fmu_units import units_of
from experiments.exports.program import ExportError, Program
from experiments.exports.replay import Replay
from experiments.exports.templates import rendered
from experiments.reports.report import version_of

SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("windows", ".dll")}
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}  # as the standard calls them
OLDEST = (1980, 1, 1, 0, 0, 0)  # that a zip file can state: the same FMU is the same bytes


def fmu_files(
    program: Program, title: str, replay: Replay, tolerances: Mapping[str, float]
) -> Mapping[str, str | bytes]:
    """The files by their names: the FMU, and a bench in Python with the run that it replays."""
    values = {"program": program, "tolerances": tolerances, "version": version_of("diffdrive")}
    return {
        f"{program.name}.fmu": fmu(program, title),
        f"{program.name}_fmu_bench.py": rendered("fmu_bench.py.jinja", **values),
        f"{program.name}_run.csv": replay.as_csv(),
    }


def fmu(program: Program, title: str) -> bytes:
    """The FMU, with a library for this machine where it has a C compiler."""
    if program.single:
        raise ExportError("an FMU computes in double precision: export it so, or as c99")
    unsigned = "\0".join(_texts(program, title, "").values())  # gains, period and version with it
    files = _texts(program, title, "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, unsigned)) + "}")
    library = _library(program, files)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        contents = {name: text.encode("utf-8") for name, text in files.items()} | library
        for name, content in contents.items():
            archive.writestr(zipfile.ZipInfo(name, OLDEST), content, zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def _texts(program: Program, title: str, token: str) -> Mapping[str, str]:
    """The files of the archive but the library."""
    values = {"code": c_code(program), "program": program, "title": title, "version": version_of("diffdrive")}
    values |= {"token": token, "units": units_of(program)}
    templates = {
        "modelDescription.xml": "modelDescription.xml.jinja",
        "sources/buildDescription.xml": "buildDescription.xml.jinja",
        f"sources/{program.name}.h": "c99.h.jinja",
        f"sources/{program.name}.c": "c99.c.jinja",
        f"sources/{program.name}_fmi3.c": "fmi3.c.jinja",
    }
    return {file: rendered(template, **values) for file, template in templates.items()}


def _library(program: Program, files: Mapping[str, str]) -> dict[str, bytes]:
    """The compiled library by its place in the archive; nothing without a compiler."""
    command = compiler()
    if command is None:
        return {}
    system, ending = SYSTEMS.get(sys.platform, (sys.platform, ".so"))
    machine = platform.machine().lower()
    with tempfile.TemporaryDirectory() as folder:
        for name, text in files.items():
            if name.startswith("sources/"):
                write_text(Path(folder) / Path(name).name, text)
        library = Path(folder) / f"{program.name}{ending}"
        sources = [f"{program.name}.c", f"{program.name}_fmi3.c"]
        options = ["-std=c99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden", "-ffp-contract=off"]
        made = subprocess.run(
            [*command, *options, "-o", library.name, *sources, "-lm"], cwd=folder, capture_output=True, text=True
        )
        if made.returncode:
            raise ExportError(f"{command[0]} cannot compile the FMU: {made.stderr.strip()[-400:]}")
        return {f"binaries/{MACHINES.get(machine, machine)}-{system}/{library.name}": library.read_bytes()}
