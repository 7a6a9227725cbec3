"""The process of a job: `python -m experiments.app.command FOLDER` runs the command line that its job.json holds.

The very command runs, with the same arguments, in the workspace. Around it: one run at a time, a log, its exit code.
"""

import contextlib
import os
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from experiments.app.console import BEGIN
from experiments.app.job import Job
from experiments.app.workspace import write_json

LOOK = "look"
LOCK = ".running.lock"
OFTEN = 1.0  # s: lines of progress; a page shows the last one only, and is looked at, unlike the log of a batch job
FAULT = 1


def main() -> None:
    """Run the job; the process ends with the code of the command."""
    job = Job(Path(sys.argv[1]).resolve())
    lock = FileLock(job.folder / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:  # two tabs, or two apps: the first one goes on
        return
    with job.log.open("a", encoding="utf-8", errors="replace", buffering=1) as log:
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
        sys.stdout = sys.stderr = log
        log.write(f"{BEGIN}{' '.join(job.arguments)}\n")
        code = FAULT
        try:
            code = _code_of(job)
        finally:
            log.flush()
            write_json(job.folder / "exit.json", {"code": code, "at": time.time()})
    sys.exit(code)


def _code_of(job: Job) -> int:
    """The exit code of the job's command; what nobody expected is in the log, and its code is that of a fault."""
    sys.argv = ["diffdrive", *job.arguments]
    try:
        with _often():
            if job.command == LOOK:
                from experiments.app.look import look_at

                look_at(*map(Path, job.arguments[1:]))
            else:
                from experiments.cli.main import main as command_line

                command_line()
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else 0 if ended.code is None else FAULT
    except KeyboardInterrupt:
        return 130
    except BaseException:
        traceback.print_exc()
        return FAULT
    return 0


@contextlib.contextmanager
def _often() -> Iterator[None]:
    from experiments.reports import progress

    before, progress.SELDOM = progress.SELDOM, OFTEN
    try:
        yield
    finally:
        progress.SELDOM = before


if __name__ == "__main__":
    main()
