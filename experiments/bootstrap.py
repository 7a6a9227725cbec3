"""Sets this project up on a machine that has only Python (3.11 to 3.14) and pip, and runs it.

    python3 experiments/bootstrap.py demo              the main job: diffdrive demo --out results/demo
    python3 experiments/bootstrap.py test              the tests, with pytest
    python3 experiments/bootstrap.py docs              the documentation, built into site/ (open site/index.html)
    python3 experiments/bootstrap.py run simulate ...  any other diffdrive command; `run --help` lists them
    python3 experiments/bootstrap.py which             only shows which Pythons were found, the best first

What follows is passed on: `demo --quick`, `test -k plant`. On Windows write `py` for `python3`. The first call picks
the newest working Python, makes the folder .venv and installs into it (some 240 MB to fetch); later calls start at
once. Nothing outside this folder changes but pip's cache; to start over delete .venv. Exit code: the job's, or 3.
"""

from __future__ import annotations

import glob
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

OLDEST, END = (3, 11), (3, 15)
NAMES = [f"python3.{minor}" for minor in range(END[1] - 1, OLDEST[1] - 1, -1)] + ["python3", "python"]
START = time.monotonic()
ROOT = Path(__file__).resolve().parents[1]
PROJECT = hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest()
VENV = ROOT / ".venv"
PARALLEL_TESTS = ["-n", "auto", "--maxprocesses", "8", "--dist", "loadfile"]  # of one file in one process: they share
STAMP = VENV / "diffdrive-setup.json"
SCRIPTS, EXE = (VENV / "Scripts", ".exe") if os.name == "nt" else (VENV / "bin", "")
VENV_PYTHON, VENV_DIFFDRIVE = SCRIPTS / f"python{EXE}", SCRIPTS / f"diffdrive{EXE}"
CAPTURED: dict[str, Any] = {
    "stdin": subprocess.DEVNULL,
    "stdout": subprocess.PIPE,
    "stderr": subprocess.STDOUT,
    "cwd": str(ROOT),
}

PROBE = """import json, platform, sys, sysconfig
print(json.dumps([list(sys.version_info), sys.implementation.name, sys.maxsize > 2**32, sys._base_executable,
                  platform.machine(), bool(sysconfig.get_config_var("Py_GIL_DISABLED"))]))"""

NO_PYTHON = """No Python of this machine could set this project up. It takes a 64-bit CPython 3.11 to 3.14, best 3.13,
on Linux (glibc; x86-64 or ARM), macOS (Apple silicon) or Windows (x86-64). Install one and run the same command again:
  Debian, Ubuntu   sudo apt install python3 python3-venv python3-pip
  macOS            brew install python@3.13, or the installer of python.org
  Windows          winget install Python.Python.3.13"""

# what a failing pip says -> what to do; any other failure may be one of this Python, so the next older one is tried
REMEDIES = {
    r"CERTIFICATE_VERIFY_FAILED": "A certificate was refused: for a company's own one set PIP_CERT=/path/to/file.pem.",
    r"Retry\(total=0|ProxyError|NewConnectionError|NameResolutionError|ReadTimeout|build dependencies did not run": (
        "The packages could not be fetched. Offline? Behind a proxy set HTTPS_PROXY, for a mirror PIP_INDEX_URL."
    ),
    r"No space left on device": "The disk is full: the set-up needs about 1.5 GB.",
}


class Python(NamedTuple):
    """One interpreter that can run this project."""

    version: tuple[int, ...]
    name: str
    machine: str
    path: str


class SetupError(Exception):
    """The set-up cannot go on; its text tells the user why and what to do."""


def log(text: str) -> None:
    """Print one line of progress with the seconds since the start; standard output is left to the job."""
    print(f"[{time.monotonic() - START:5.1f} s] {text}", file=sys.stderr, flush=True)


def environment() -> dict[str, str]:
    """The caller's environment without what would leak another Python's packages or folders into .venv."""
    leaks = {"PYTHONHOME", "PYTHONPATH", "VIRTUAL_ENV", "__PYVENV_LAUNCHER__", "PIP_TARGET", "PIP_PREFIX"}
    variables = {name: value for name, value in os.environ.items() if name not in leaks}
    return {**variables, "PIP_USER": "0", "PIP_NO_INPUT": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}


def run_quietly(command: Sequence[object], timeout: float | None = None) -> tuple[int, str]:
    """Run a command without a word; its exit code and all that it printed. One that cannot start counts as 127."""
    try:
        finished = subprocess.run([*map(str, command)], **CAPTURED, timeout=timeout, env=environment(), check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return 127, str(error)
    return finished.returncode, finished.stdout.decode("utf-8", "replace")


def pythons_on_path(folders: str) -> list[str]:
    """What is named like a Python in these folders: all, as an earlier one may be a dead shim; not macOS's own 3.9."""
    found = [shutil.which(name, path=folder) for folder in folders.split(os.pathsep) if folder for name in NAMES]
    return [path for path in found if path and (sys.platform != "darwin" or path != "/usr/bin/python3")]


def candidate_paths() -> list[str]:
    """What may be an interpreter: on PATH, the running one, and what pyenv, uv and the installers keep off PATH."""
    pyenv = os.environ.get("PYENV_ROOT") or "~/.pyenv"
    patterns = [f"{pyenv}/versions/*/bin/python", f"{pyenv}/pyenv-win/versions/*/python.exe"]
    patterns += ["~/.local/share/uv/python/*/bin/python3", "~/AppData/Roaming/uv/python/*/python.exe"]
    patterns += ["/Library/Frameworks/Python.framework/Versions/3.*/bin/python3"]
    off_path = [path for pattern in patterns for path in sorted(glob.glob(os.path.expanduser(pattern)))]
    launcher = run_quietly(["py", "-0p"], timeout=30)[1] if os.name == "nt" else ""
    off_path += re.findall(r"([A-Za-z]:\\.*?python[\d.]*\.exe)\s*$", launcher, re.MULTILINE)
    folders = [os.environ.get("PATH", os.defpath), "/usr/local/bin", "/opt/homebrew/bin"]
    return [*pythons_on_path(os.pathsep.join(folders)), sys.executable, *off_path]


def probe(path: str) -> Python | None:
    """Run the interpreter and ask what it is; None unless it works and is one this project runs on."""
    code, text = run_quietly([path, "-c", PROBE], timeout=60)
    try:
        version, name, is_64_bit, base, machine, without_gil = json.loads(text.strip().splitlines()[-1])
    except (ValueError, IndexError, TypeError):
        return None
    good = code == 0 and name == "cpython" and is_64_bit and not without_gil and version[3] == "final"
    if not good or not OLDEST <= tuple(version[:2]) < END:
        return None
    return Python(tuple(version[:3]), "Python {}.{}.{}".format(*version), machine, base or path)


def usable_pythons(paths: list[str]) -> list[Python]:
    """Those of the paths that are interpreters fit for this project, each once, the newest first."""
    by_path = {os.path.realpath(python.path): python for python in map(probe, dict.fromkeys(paths)) if python}
    return sorted(by_path.values(), key=lambda python: python.version, reverse=True)


def read_stamp() -> dict[str, Any]:
    """What an earlier call noted about .venv; empty where nothing was."""
    try:
        return dict(json.loads(STAMP.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return {}


def write_stamp(**content: object) -> None:
    """Note the state of .venv; `ready` is written last, so an interrupted set-up is seen by the next call."""
    STAMP.write_text(json.dumps({**content, "root": str(ROOT)}), encoding="utf-8")


def clear_venv() -> None:
    """An empty .venv with our mark; an earlier one of ours goes, one that somebody else made is moved aside."""
    if VENV.exists() and os.listdir(str(VENV)) and not STAMP.exists():
        aside = ROOT / f".venv-old-{time.strftime('%Y%m%d-%H%M%S')}"
        log(f"the .venv here was not made by this script: it is now {aside.name}")
        VENV.rename(aside)
    VENV.mkdir(exist_ok=True)
    write_stamp(ready=False)
    for path in set(VENV.iterdir()) - {STAMP}:
        shutil.rmtree(str(path)) if path.is_dir() and not path.is_symlink() else path.unlink()


def make_venv(python: Python) -> bool:
    """An empty virtual environment with pip in .venv, also where Debian left out ensurepip."""
    ways = [
        [["venv", VENV]],
        [["venv", "--without-pip", VENV], ["pip", "--python", VENV_PYTHON, "install", "--quiet", "pip"]],
        [["virtualenv", VENV]],
    ]
    for way in ways:
        clear_venv()
        if all(run_quietly([python.path, "-m", *arguments])[0] == 0 for arguments in way):
            return run_quietly([VENV_PYTHON, "-m", "pip", "--version"])[0] == 0
    return False


def install(extras: list[str]) -> str:
    """Install the project into .venv; empty when that went well, else the end of what pip said."""
    before, python = read_stamp(), probe(str(VENV_PYTHON))
    write_stamp(ready=False)
    options = ["--quiet", "--only-binary", ":all:", "--editable", f".[{','.join(extras)}]" if extras else "."]
    code, text = run_quietly([VENV_PYTHON, "-m", "pip", "install", *options])
    if code == 0:
        code, text = run_quietly([VENV_PYTHON, "-c", "import jax.numpy"])
    if code == 0 and python:
        write_stamp(ready=True, project=PROJECT, python=python.version, extras=extras)
        return ""
    tail = "\n".join(f"    {line[:200]}" for line in text.strip().splitlines()[-15:])
    for pattern, remedy in REMEDIES.items():
        if re.search(pattern, text):
            write_stamp(**before)  # pip fetches first and installs then: nothing has changed
            raise SetupError(f"{tail}\nThe installation failed; the end of its output is above.\n{remedy}")
    return tail or "    (pip said nothing)"


def build(extras: list[str]) -> None:
    """Make .venv again with the newest Python that can; each one that cannot is named."""
    failed, tails = set(), []
    for python in usable_pythons(candidate_paths()):
        kind = (python.version[:2], python.machine)
        if kind in failed:
            continue
        log(f"making .venv with {python.name} ({python.path})")
        if not make_venv(python):
            log(f"{python.name} cannot make a virtual environment (no python3-venv?): trying the next")
            continue
        log("installing, this takes some minutes")
        tail = install(extras)
        if not tail:
            return log(".venv is ready")
        failed.add(kind)
        tails.append(f"With {python.name} the installation failed:\n{tail}")
        log(f"{python.name} on {python.machine} gets no installation: trying the next older one")
    raise SetupError("\n".join([*tails, NO_PYTHON]))


def prepare(extras: list[str]) -> None:
    """Bring .venv to the state that the job needs: as it is, updated in place, or new."""
    stamp = read_stamp()
    python = probe(str(VENV_PYTHON)) if stamp.get("ready") and stamp["root"] == str(ROOT) else None
    usable = python and list(python.version) == stamp["python"] and VENV_DIFFDRIVE.exists()
    current = usable and stamp["project"] == PROJECT and set(extras) <= set(stamp["extras"])
    if usable and not current:
        log("updating .venv")
        current = not install(sorted({*extras, *stamp["extras"]}))
    if not current:
        build(extras)
    if tuple(read_stamp()["python"]) < (3, 12):
        log("note: on Python 3.11 jax is older than 0.12 and slower; for full speed install 3.12+, delete .venv")


def main(arguments: list[str]) -> int:
    """Set up and run one job; its exit code."""
    verb, rest = (arguments or [""])[0], arguments[1:]
    jobs: dict[str, tuple[list[str], list[Any], Path]] = {
        "demo": ([], [VENV_DIFFDRIVE, "demo", "--out", "results/demo"], ROOT),
        "test": (["test"], [VENV_PYTHON, "-m", "pytest", *PARALLEL_TESTS], ROOT),
        "docs": (["docs"], [VENV_PYTHON, "-m", "mkdocs", "build", "--strict"], ROOT),
        "run": ([], [VENV_DIFFDRIVE], Path.cwd()),
    }
    if verb not in jobs:
        found = (
            [f"{python.name} {python.path}" for python in usable_pythons(candidate_paths())]
            if verb == "which"
            else [__doc__]
        )
        print("\n".join(found or [NO_PYTHON]))
        return 0 if verb in ("which", "-h", "--help", "help") else 2
    extras, job, folder = jobs[verb]
    env = {**environment(), "PATH": os.pathsep.join([str(SCRIPTS), os.environ.get("PATH", os.defpath)])}
    try:
        prepare(extras)
        log("running " + " ".join([job[0].name, *job[1:], *rest]))
        code = subprocess.call([str(job[0]), *job[1:], *rest], cwd=str(folder), env=env)
    except (SetupError, OSError, KeyboardInterrupt) as error:
        print(f"\n{str(error) or 'interrupted'}", file=sys.stderr)
        return 130 if isinstance(error, KeyboardInterrupt) else 3
    return code if code >= 0 else 128 - code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
