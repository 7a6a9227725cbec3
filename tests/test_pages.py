"""What the pages tell a reader to type runs as it is printed, in an empty folder, without a warning."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```", re.DOTALL | re.MULTILINE)
COMMAND = """#!/bin/sh
exec {python} -W error -c 'import sys; from experiments.cli.main import main; sys.argv[0] = "diffdrive"; main()' "$@"
"""
LONG = pytest.mark.slow  # more than half a minute of one core


@pytest.fixture
def shell(tmp_path, monkeypatch):
    """An empty folder to work in, and `diffdrive` of this checkout on the path."""
    scripts, folder = tmp_path / "scripts", tmp_path / "empty"
    scripts.mkdir()
    folder.mkdir()
    command = scripts / "diffdrive"
    command.write_text(COMMAND.format(python=shlex.quote(sys.executable)), encoding="utf-8")
    command.chmod(0o755)
    monkeypatch.setenv("PATH", f"{scripts}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.chdir(folder)


def typed(text):
    """Run what a shell is given; it must end well and warn of nothing."""
    done = subprocess.run(["bash", "-euo", "pipefail", "-c", text], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "warning" not in done.stderr.lower(), done.stderr[-2000:]


@pytest.mark.skipif(os.name == "nt", reason="the pages' commands are those of a POSIX shell")
@pytest.mark.parametrize(
    "page",
    [
        "README.md",
        pytest.param("docs/method/sweeps.md", marks=LONG),
    ],
)
def test_the_blocks_of_a_page_run(page, shell, capsys):
    names = {}
    for kind, text in BLOCK.findall((ROOT / page).read_text(encoding="utf-8")):
        if kind == "python":
            exec(compile(text, page, "exec"), names)
        else:
            typed(text)
    assert "um" in capsys.readouterr().out or not names
