"""One job: a command line, and on the disk how far it has come. Whoever reads the folder knows all of it."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import psutil

from diffdrive.support.atomic_write import write_text
from experiments.app.console import BEGIN, LogText, read_console
from experiments.app.workspace import read_json, write_json

State = Literal[
    "waiting", "running", "stopping", "stopped", "done", "doubtful", "refused", "killed", "failed", "unconfirmed"
]
ALIVE: tuple[State, ...] = ("waiting", "running", "stopping")
OF_CODE: dict[int, State] = {0: "done", 2: "refused", 3: "doubtful", 130: "stopped"}
SAME_START = 1.0  # s: the system counts a process's start in ticks, and its own clock may be set meanwhile


@dataclass(frozen=True)
class Job:
    """A folder with job.json, and beside it log.txt, exit.json and out/."""

    folder: Path

    @property
    def id(self) -> str:
        """The name of its folder."""
        return self.folder.name

    @property
    def out(self) -> Path:
        """The folder of the command's results."""
        return self.folder / "out"

    @property
    def log(self) -> Path:
        """What the command printed."""
        return self.folder / "log.txt"

    @property
    def record(self) -> dict[str, Any]:
        """job.json: arguments with their seal, title, what is wanted, and the process that was started last."""
        record = read_json(self.folder / "job.json")
        return record if isinstance(record, dict) else {}

    def update(self, **changes: object) -> None:
        """Change job.json."""
        write_json(self.folder / "job.json", self.record | changes)

    @property
    def arguments(self) -> list[str]:
        """The command line, without `diffdrive`."""
        kept = self.record.get("arguments")
        return [str(one) for one in kept] if isinstance(kept, list) else []

    @property
    def command(self) -> str:
        """The name of the command."""
        return (self.arguments or [""])[0]

    @property
    def title(self) -> str:
        """What the lists call it."""
        return str(self.record.get("title") or self.id)

    @property
    def ended(self) -> dict[str, Any] | None:
        """exit.json: the code and when; None until the command has ended by itself."""
        ended = read_json(self.folder / "exit.json")
        return ended if isinstance(ended, dict) else None

    def refuse(self, reason: str) -> None:
        """End it before it begins, as a command ends that refuses its arguments."""
        write_text(self.log, f"{BEGIN}{' '.join(self.arguments)}\nerror: {reason}\n")
        write_json(self.folder / "exit.json", {"code": 2, "at": time.time()})

    def process(self) -> psutil.Process | None:
        """The process that works on it; None where it is gone, or where its number is another's by now."""
        started = self.record.get("process")
        if not isinstance(started, dict):
            return None
        try:
            process = psutil.Process(int(started["pid"]))
            same = abs(process.create_time() - float(started["started"])) < SAME_START
            return process if same and process.status() != psutil.STATUS_ZOMBIE else None
        except (psutil.Error, KeyError, TypeError, ValueError):
            return None

    @property
    def state(self) -> State:
        """What is to be said of it now."""
        record, ended = self.record, self.ended
        if ended is not None:
            state = OF_CODE.get(int(ended.get("code", 1)), "failed")
            # a search that was asked to stop ends with its best, and code 3
            return "stopped" if state == "doubtful" and record.get("wanted") == "stop" else state
        if self.process() is not None:
            return "stopping" if record.get("wanted") == "stop" else "running"
        if record.get("wanted") == "stop":
            return "stopped"
        if record.get("wanted") == "confirm":
            return "unconfirmed"
        # between the end of the process and the look at its exit there may have been the one at exit.json
        return "waiting" if "process" not in record else "killed" if self.ended is None else self.state

    @property
    def seconds(self) -> float:
        """How long the last run took, or has taken so far."""
        started = self.record.get("process")
        if not isinstance(started, dict):
            return 0.0
        ended = self.ended
        end = float(ended.get("at", 0.0)) if ended else time.time() if self.process() is not None else None
        return 0.0 if end is None else max(0.0, end - float(started.get("started", end)))

    def console(self) -> LogText:
        """What the last run printed, taken apart."""
        return read_console(self.log)

    def stamp(self) -> tuple[object, ...]:
        """Changes where anything of it that a page shows does, but for the clock."""
        at = [(_time(self.folder / name)) for name in ("job.json", "exit.json", "log.txt", "out", "out/result.json")]
        return (self.id, self.state, *at)


def _time(path: Path) -> tuple[int, int]:
    try:
        stat = path.stat()
    except OSError:
        return (0, 0)
    return stat.st_mtime_ns, stat.st_size
