"""What all pages have: the head, the words for states, and one line in the place of an unexpected failure."""

import contextlib
import time
import traceback
from collections.abc import Callable, Iterator
from functools import wraps
from typing import Any, Literal

from nicegui import ui

from diffdrive.support.atomic_write import NO_SPACE
from experiments.app.job import Job, State
from experiments.app.workspace import AppError, Workspace

WORDS: dict[State, tuple[str, str, str]] = {  # of a state: the word, its icon, its class
    "waiting": ("waits", "hourglass_empty", "dd-quiet"),
    "running": ("runs", "autorenew", "dd-blue"),
    "stopping": ("is stopping", "pause_circle", "dd-warn"),
    "stopped": ("stopped", "pause_circle", "dd-warn"),
    "done": ("done", "check_circle", "dd-good"),
    "doubtful": ("done, see what it says", "error", "dd-warn"),
    "refused": ("refused", "block", "dd-bad"),
    "killed": ("interrupted", "power_off", "dd-warn"),
    "failed": ("failed", "report", "dd-bad"),
    "unconfirmed": ("waits for you", "help", "dd-warn"),
}
MOST_LOG = 5 << 20  # bytes of app-log.txt, beyond which it begins again


@contextlib.contextmanager
def page(title: str, home: bool = False) -> Iterator[None]:
    """The frame of a page; its title distinguishes tabs."""
    ui.page_title(title if home else f"{title} - diffdrive")
    ui.colors(primary="#1f5fae", positive="#1c6b2a", negative="#a61b1b")  # white on each is legible
    ui.add_head_html('<link rel="stylesheet" href="/static/app.css"><script src="/static/drop.js" defer></script>')
    # no <main>: the framework has one around it
    with ui.element("div").classes("dd-page column no-wrap"):
        with ui.row().classes("items-center no-wrap"):
            if not home:
                ui.link("diffdrive", "/").classes("text-lg")
                ui.label("/").classes("dd-quiet")
            heading(1, title)
        yield


def heading(level: int, text: str) -> None:
    """A heading; its text is text."""
    with ui.element(f"h{level}"):
        ui.label(text).style("display: inline")


@contextlib.contextmanager
def section(title: str) -> Iterator[None]:
    """A part of a page under its heading."""
    with ui.element("section").classes("dd-section column"):
        heading(2, title)
        yield


def quiet_button(text: str = "", **options: Any) -> ui.button:
    """A button whose colour is that of links: the framework's blue is too dark for a line on a dark page."""
    return ui.button(text, color=None, **options).classes("dd-blue")


def state_chip(job: Job, state: State | None = None) -> None:
    """What is to be said of a job."""
    word, icon, kind = WORDS[state or job.state]
    with ui.row().classes("items-center no-wrap gap-1"):
        ui.icon(icon).classes(kind).props("aria-hidden=true")
        ui.label(word)


def duration(seconds: float) -> str:
    """Seconds as a reader takes them."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"


def size(count: int) -> str:
    """Bytes as a reader takes them."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= factor:
            return f"{count / factor:.3g} {unit}"
    return f"{count} B"


def guarded(workspace: Workspace, action: Callable[..., Any]) -> Callable[..., None]:
    """An action of a button: what can be expected to fail is said in its one line, all else is kept in the log."""

    @wraps(action)
    def run(*arguments: Any) -> None:
        try:
            action(*arguments)
        except AppError as problem:
            say(str(problem))
        except Exception as problem:
            say(note_failure(workspace, problem))

    return run


def watching(workspace: Workspace, look: Callable[[], None]) -> Callable[[], None]:
    """A look that is repeated: what fails is said once, until it succeeds or fails in another way."""
    said: list[str] = []
    shown: list[ui.notification] = []

    def take_back() -> None:
        for notification in shown:
            notification.dismiss()
        shown.clear()
        said.clear()

    def run() -> None:
        try:
            look()
            take_back()
        except Exception as problem:
            text = str(problem) if isinstance(problem, AppError) else note_failure(workspace, problem)
            if [text] != said:
                take_back()
                said[:] = [text]
                shown.append(
                    ui.notification(text, type="negative", multi_line=True, close_button="Close", timeout=None)
                )

    return run


def ask_to_delete(question: str, delete: Callable[[], object], workspace: Workspace) -> None:
    """Open a dialog; what is deleted is not to be had back."""
    with ui.dialog().props('aria-label="Delete"') as dialog, ui.card():
        ui.label(question).classes("dd-wrap")
        with ui.row():
            act = guarded(workspace, lambda: (dialog.close(), delete()))
            ui.button("Delete", on_click=act).props("no-caps color=negative")
            quiet_button("Keep", on_click=dialog.close).props("no-caps flat")
    dialog.open()


def say(text: str, kind: Literal["positive", "negative"] = "negative") -> None:
    """A message that stays until it is dismissed, or ten seconds where it is no error."""
    ui.notify(text, type=kind, multi_line=True, close_button="Close", timeout=0 if kind == "negative" else 10_000)


def note_failure(workspace: Workspace, problem: BaseException) -> str:
    """Keep a failure with its traceback in app-log.txt, and return the one line that the page shows of it."""
    path = workspace.folder / "app-log.txt"
    if isinstance(problem, OSError) and not workspace.is_there():
        return workspace.gone
    if isinstance(problem, OSError) and problem.errno in NO_SPACE:
        return "no room is left on the disk: make some; what was done so far stays"
    with contextlib.suppress(OSError):
        mode = "a" if not path.exists() or path.stat().st_size < MOST_LOG else "w"
        with path.open(mode, encoding="utf-8", errors="replace") as file:
            file.write(time.strftime("%Y-%m-%d %H:%M:%S\n"))
            file.writelines(traceback.format_exception(problem))
    return f"Something unexpected happened; {path} has it."
