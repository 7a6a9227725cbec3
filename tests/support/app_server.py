"""`diffdrive app` as a process."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


class AppServer:
    """The app in a folder; it may be killed, and started again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.start()

    def start(self):
        self.process = subprocess.Popen(
            [sys.executable, "-c", "from experiments.cli.main import main; main()", "app", "--folder",
             str(self.folder), "--no-show"],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env=os.environ | {"PYTHONPATH": str(ROOT), "XDG_STATE_HOME": str(self.folder.parent / "state")}, cwd=ROOT,
        )  # fmt: skip
        line = self.process.stdout.readline()
        assert line.startswith("diffdrive app: http://127.0.0.1:"), line + self.process.stdout.read()
        self.url = line.split()[2]
        self.base = self.url.partition("/?")[0]

    def kill(self):
        self.process.kill()
        self.process.communicate()

    def end(self):
        """As Ctrl-C does; what it printed."""
        self.process.terminate()
        return self.process.communicate(timeout=60)[0]
