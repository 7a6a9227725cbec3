"""Where a job may write: into its own folder. Its record may be from elsewhere, so this is checked at each start."""

from collections.abc import Iterator
from pathlib import Path

from experiments.app.command import LOCK, LOOK
from experiments.app.forms import BY_COMMAND
from experiments.app.job import Job

WRITTEN = ("job.json", "log.txt", "exit.json", LOCK, "out")  # by the app, in the folder of a job


def is_linked(folder: Path) -> bool:
    """Whether the folder of a job is a link, or holds one where the app writes; the app itself makes none."""
    return folder.is_symlink() or any((folder / name).is_symlink() for name in WRITTEN)


def refusal(job: Job, workspace: Path) -> str:
    """Why a job may not run, in one line; empty where it may."""
    if job.command != LOOK and job.command not in BY_COMMAND:
        return f"'{job.command[:100]}' is no command of this page; delete this run"
    outputs = [(workspace / one).resolve() for one in _outputs(job.arguments)]
    inside = bool(outputs) and job.out.resolve().is_relative_to(workspace)
    if not inside or not all(one.is_relative_to(job.out.resolve()) for one in outputs):
        return "this run would write outside of its folder; delete it, and ask again"
    if any(one.is_symlink() for one in job.out.rglob("*")):
        return "a link is among the results of this run, and what is written would follow it; delete it, and ask again"
    return ""


def _outputs(arguments: list[str]) -> Iterator[str]:
    """The paths that a command line writes to."""
    options = {"--out", "--drive"} if arguments[0] == "start" else {"--out"}
    if arguments[0] == LOOK:
        yield from arguments[2:]
    for argument, following in zip(arguments, [*arguments[1:], ""], strict=True):
        name, equals, value = argument.partition("=")
        if name in options:
            yield value if equals else following
