"""Starting, stopping and continuing jobs. What is to be done stands on the disk; this is who does it."""

import os
import secrets
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import psutil

import experiments
from experiments.app.bounds import is_linked, refusal
from experiments.app.job import ALIVE, Job
from experiments.app.seal import Seal
from experiments.app.workspace import AppError, Workspace, write_json

INTERRUPT = getattr(signal, "CTRL_BREAK_EVENT", signal.SIGINT)  # Windows has no Ctrl-C for another process
# -P: nothing in the workspace, which is its folder, may pass for a module
PROGRAM = (sys.executable, "-P", "-m", "experiments.app.command")
# seconds each; what takes minutes shares the cores with nothing: two at once take as long, and twice the memory
SHORT = ("look", "start", "check", "simulate")
MOST_LOOKS = 2  # at once: a trace of 200 MB takes memory, and a hand drops fifty of them
SLOW_TO_STOP = 20.0  # s: a command ends within 15 s of a signal (docs/how-to/resume.md); later it is killed


class Jobs:
    """The jobs of a workspace; only one app at a time has this."""

    def __init__(self, workspace: Workspace, program: Sequence[str] = PROGRAM, seal: Seal | None = None) -> None:
        """`program` takes the folder of a job, and runs it.

        Jobs that wait begin by themselves if an app with the same `seal` made them; without one, only this one's do.
        """
        self.workspace, self._program = workspace, program
        self._seal = seal or Seal(secrets.token_bytes())
        self._lock = threading.RLock()
        self._children: list[subprocess.Popen[bytes]] = []
        self._looks: list[subprocess.Popen[bytes]] = []  # those of them that look at a file
        self._stop_requested: dict[str, float] = {}  # s, of the monotonic clock, by job and process

    def all(self) -> list[Job]:
        """All jobs, the newest first."""
        found = (one for one in self.workspace.jobs.iterdir() if (one / "job.json").is_file())
        folders = (one for one in found if not is_linked(one))  # else what is kept of it would be kept elsewhere
        return [Job(folder) for folder in sorted(folders, key=lambda folder: folder.name, reverse=True)]

    def get(self, name: str) -> Job:
        """A job by its name; raises `AppError` where there is none."""
        for job in self.all():
            if job.id == name:
                return job
        raise AppError(f"there is no run '{name[:100]}' here; it may have been deleted")

    def create(self, command: str, arguments: list[str], title: str) -> Job:
        """A job that waits to be started, in a folder of its own; `arguments` are without --out.

        Where the same is waiting or running already it is that one: a button pressed twice, or in two tabs.
        """
        with self._lock:
            for other in self.all():
                same = other.command == command and other.record.get("asked") == arguments
                if same and other.state in ("waiting", "running"):
                    return other
            numbers = [int(one.name[:4]) for one in self.workspace.jobs.iterdir() if one.name[:4].isdigit()]
            job = Job(self.workspace.jobs / f"{max(numbers, default=0) + 1:04d}-{command}")
            job.folder.mkdir()
            out = job.out.relative_to(self.workspace.folder).as_posix()
            made = [one.replace("{out}", out) for one in arguments]
            # --out before the logs: after the -- of compare it would be read as well, and here it is the same for all
            full = [command, "--out", out, *made]
            record = {"arguments": full, "asked": arguments, "title": title, "wanted": "run", "at": time.time()}
            record["seal"] = self._seal.of(job.folder, *full)
            try:
                write_json(job.folder / "job.json", record)
            except OSError:  # a full disk: no number without a job
                shutil.rmtree(job.folder, ignore_errors=True)
                raise
        self.tick()
        return job

    def look(self, name: str) -> Job:
        """The job that looks at a file; it begins where the file has not been looked at, and few others are.

        One that waits begins when it is asked for again: whoever shows files asks each second.
        """
        path = self.workspace.file(name)
        job = Job(self.workspace.look_folder(name))
        with self._lock:
            arguments = ["look", f"files/{name}", job.out.relative_to(self.workspace.folder).as_posix()]
            if is_linked(job.folder) or job.arguments != arguments:  # there is none, or one that came with the folder
                _delete(job.folder)
                job.folder.mkdir(parents=True, exist_ok=True)
                write_json(job.folder / "job.json", {"arguments": arguments, "title": path.name, "wanted": "run"})
            self._looks = [child for child in self._looks if child.poll() is None]
            if job.state == "waiting" and len(self._looks) < MOST_LOOKS:
                self._looks += filter(None, [self._launch(job)])
        return job

    def look_again(self, name: str) -> Job:
        """Look at a file once more: it was changed, or the last look was killed."""
        with self._lock:
            job = Job(self.workspace.look_folder(name))
            if job.state not in ALIVE:
                _delete(job.folder)
            return self.look(name)

    def proceed(self, job: Job) -> None:
        """Run a job again in its folder: it continues from what the last run left there."""
        with self._lock:
            self._still_there(job)
            if job.state in ALIVE:
                return
            record = job.record
            record.pop("process", None)
            seal = self._seal.of(job.folder, *job.arguments)  # who asks has its command line before the eyes
            write_json(job.folder / "job.json", record | {"wanted": "run", "seal": seal})
            (job.folder / "exit.json").unlink(missing_ok=True)
        self.tick()

    def stop(self, job: Job) -> None:
        """Ask a job to end as Ctrl-C does; asked again it ends at once, and where it does not, it is killed."""
        with self._lock:
            self._still_there(job)
            if job.state not in ALIVE:  # it has ended since the button was drawn: what it came to stands
                return
            job.update(wanted="stop")
            process = job.process()
            if process is None or job.ended is not None:
                return
            first = self._stop_requested.setdefault(f"{job.id}:{process.pid}", time.monotonic())
            try:
                if time.monotonic() - first > SLOW_TO_STOP:
                    process.kill()
                else:
                    process.send_signal(INTERRUPT)
            except psutil.Error:  # it has ended meanwhile
                return

    @staticmethod
    def _still_there(job: Job) -> None:
        """Raise `AppError` where another tab has deleted it: it is not to come back as half a job."""
        if not (job.folder / "job.json").is_file():
            raise AppError(f"this run was deleted: '{job.id}'")

    def remove(self, job: Job) -> None:
        """Delete a job with its results; raises `AppError` while it runs."""
        with self._lock:
            if job.process() is not None and job.ended is None:
                raise AppError(f"{job.title} is running; stop it first")
            shutil.rmtree(job.folder, ignore_errors=True)

    def tick(self) -> None:
        """Start what waits and may run now; to be called again and again."""
        with self._lock:
            self._children = [child for child in self._children if child.poll() is None]
            waiting = [(job, job.state) for job in reversed(self.all())]
            busy = any(state in ("running", "stopping") and job.command not in SHORT for job, state in waiting)
            for job, state in waiting:
                if state == "waiting" and not self._seal.holds(job.record.get("seal"), job.folder, *job.arguments):
                    job.update(wanted="confirm")
                    continue
                if state != "waiting" or (busy and job.command not in SHORT):
                    continue
                begun = self._launch(job)
                busy = busy or (begun is not None and job.command not in SHORT)

    def _launch(self, job: Job) -> subprocess.Popen[bytes] | None:
        """Start the process of a job; None where it may not run, which then is its result."""
        reason = refusal(job, self.workspace.folder)
        if reason:
            job.refuse(reason)
            return None
        root = str(Path(experiments.__file__).resolve().parents[1])
        path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        # a session of its own: Ctrl-C in the terminal of the app is the app's, which then asks its jobs
        child = subprocess.Popen(
            [*self._program, str(job.folder)],
            cwd=self.workspace.folder, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": path, "PYTHONUNBUFFERED": "1", "PYTHONUTF8": "1"},
            start_new_session=os.name != "nt",
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )  # fmt: skip
        self._children.append(child)
        try:
            started = psutil.Process(child.pid).create_time()
        except psutil.Error:  # it has come to its end already
            started = time.time()
        job.update(process={"pid": child.pid, "started": started})
        return child

    def wait(self, seconds: float) -> None:
        """Wait for the processes that this has started; raises `TimeoutExpired` where one takes longer."""
        for child in self._children:
            child.wait(seconds)

    def leave(self) -> int:
        """Ask all that run to end, since the app ends; how many those are."""
        with self._lock:
            if not self.workspace.is_there():  # with its folder went what was known of them
                return 0
            running = [job for job in self.all() if job.state == "running"]
            for job in running:
                self.stop(job)
            return len(running)


def _delete(folder: Path) -> None:
    """Delete the folder of a job, or the link in its place."""
    if folder.is_symlink():
        folder.unlink()
    shutil.rmtree(folder, ignore_errors=True)
