"""The C compiler of this machine, where it has one, and the bench compiled and run by it."""

import os
import re
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

from diffdrive.support.atomic_write import write_text
from experiments.exports.program import ExportError


def compiler() -> list[str] | None:
    """The compiler that `CC` names, with its arguments, or the usual ones; None where there is none."""
    text = os.environ.get("CC", "")
    try:
        named = shlex.split(text)
    except ValueError as problem:
        raise ExportError(f"CC={text}: is no command: {problem}; name a compiler, or unset it") from None
    if named:
        if shutil.which(named[0]) is None:
            raise ExportError(f"CC={shlex.join(named)}: there is no such compiler; name another, or unset it")
        return named
    found = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    return None if found is None else [found]


def replayed(name: str, files: Mapping[str, str | bytes]) -> dict[str, float]:
    """The relative difference of each output, by the bench in C; empty where there is no compiler.

    Raises `ExportError` where the code does not compile, or the bench does not run.
    """
    command = compiler()
    if command is None:
        return {}
    with tempfile.TemporaryDirectory() as folder:
        for file, text in files.items():
            write_text(Path(folder) / file, str(text))
        options = ["-std=c99", "-O2", "-ffp-contract=off", "-o", "bench", f"{name}.c", f"{name}_bench.c", "-lm"]
        made = subprocess.run([*command, *options], cwd=folder, capture_output=True, text=True)
        if made.returncode:
            raise ExportError(f"{command[0]} cannot compile the code: {made.stderr.strip()[-400:]}")
        ran = subprocess.run(
            [str(Path(folder) / "bench"), f"{name}_run.csv"], cwd=folder, capture_output=True, text=True
        )
    found = re.findall(r"^(\w+) +largest .* relative ([-+.\w]+)", ran.stdout, re.MULTILINE)
    if not found:
        raise ExportError(f"the bench does not run: {(ran.stderr or ran.stdout).strip()[-400:]}")
    return {output: float(text) for output, text in found}
