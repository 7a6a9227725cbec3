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
TEXTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [page for page in TEXTS if BLOCK.search(page.read_text(encoding="utf-8"))]
LONG = {"README.md", "logs.md", "log-checks.md"}  # the others take more than half a minute of one core
DIFFDRIVE = """#!/bin/sh
exec {python} -W error -c 'import sys; from experiments.cli.main import main; sys.argv[0] = "diffdrive"; main()' "$@"
"""


@pytest.fixture
def empty_folder(tmp_path, monkeypatch):
    """A folder to work in, with `diffdrive` of this checkout on the path."""
    scripts, folder = tmp_path / "scripts", tmp_path / "empty"
    scripts.mkdir()
    folder.mkdir()
    command = scripts / "diffdrive"
    command.write_text(DIFFDRIVE.format(python=shlex.quote(sys.executable)), encoding="utf-8")
    command.chmod(0o755)
    monkeypatch.setenv("PATH", f"{scripts}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.chdir(folder)
    return folder


RUN = """
import re, subprocess, sys
from pathlib import Path
names = {}
for language, text in re.findall(sys.argv[1], Path(sys.argv[2]).read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE):
    if language == "python":
        exec(compile(text, sys.argv[2], "exec"), names)
    else:
        subprocess.run(["bash", "-euo", "pipefail", "-c", text], check=True)
"""


@pytest.mark.skipif(os.name == "nt", reason="the pages' commands are those of a POSIX shell")
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(
            page,
            marks=pytest.mark.long if page.name in LONG else pytest.mark.slow,
            id=page.name,
        )
        for page in PAGES
    ],
)
def test_the_blocks_of_a_page_run_one_after_the_other(page, empty_folder):
    call = [sys.executable, "-W", "error", "-c", RUN, BLOCK.pattern, str(page)]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "warning" not in done.stderr.lower(), done.stderr[-2000:]
