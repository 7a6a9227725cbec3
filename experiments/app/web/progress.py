"""The page of one run: how far it is, what it found, and its files; it can be stopped, and go on."""

from typing import Any
from urllib.parse import quote

from nicegui import ui

from experiments.app.console import LogText
from experiments.app.forms import BY_COMMAND, follow_up
from experiments.app.job import ALIVE, Job, State
from experiments.app.jobs import Jobs
from experiments.app.result import MOST_ROWS, JobResult, read_result
from experiments.app.web.layout import (
    ask_to_delete,
    duration,
    guarded,
    page,
    quiet_button,
    section,
    size,
    state_chip,
    watching,
)
from experiments.app.workspace import AppError
from experiments.reports.readable import heading, shown, titled

NEXT = {  # of a command: what its drive file, or its answer, leads to
    "start": (("check", "Check"), ("identify", "Identify"), ("diagnose", "Diagnose")),
    "check": (("identify", "Identify"), ("diagnose", "Diagnose")),
    "identify": (("diagnose", "Diagnose"),),
}
IDENTIFIED = "identified.toml"  # what the commands after `identify` begin with
AGAIN: dict[State, str] = {  # a refusal, too: room was made on the disk, or the drive file was mended
    "stopped": "Continue", "killed": "Continue", "failed": "Continue", "refused": "Try again", "unconfirmed": "Start",
}  # fmt: skip
SAYS: dict[State, str] = {
    "waiting": "Another run takes the processor; this one begins after it.",
    "stopping": "It ends within 15 s, and writes what it has. Stop it again to end it at once.",
    "stopped": "It was stopped. What was found so far stays; it goes on from there.",
    "killed": "Its process was ended from outside, or ran out of memory. It goes on from what it had kept.",
    "failed": "Something unexpected happened. What it printed is in the log; its results so far stay.",
    "unconfirmed": "It came with the folder: you have not asked for it here. Start runs the command line below.",
}


def progress(jobs: Jobs, name: str, results: str) -> None:
    """The page at /run/NAME; `results` is the address below which the files of all runs are."""
    workspace = jobs.workspace
    try:
        job = jobs.get(name)
    except AppError as problem:
        with page("Run"):
            ui.label(str(problem)).classes("dd-bad")
        return
    with page(job.title):
        head = ui.column().classes("w-full")
        moving = ui.column().classes("w-full")
        body = ui.column().classes("w-full").style("gap: 28px")
    shown: dict[str, object] = {}
    clock: list[ui.label] = []

    def refresh() -> None:
        if not workspace.is_there():
            raise AppError(workspace.gone)
        if not (job.folder / "job.json").is_file():
            for place in (head, moving, body):
                place.clear()
            with head:
                ui.label("This run was deleted.").classes("dd-bad")
            shown.clear()
            return
        state, console = job.state, job.console()
        result = read_result(job) if state not in ("waiting", "running") else None
        # each is drawn again only where it has changed: what has the focus, or is being pressed, must stay
        if shown.get("head") != (state, console.error):
            clock[:] = [_show_head(head, jobs, job, state, console)]
        clock[0].set_text(duration(job.seconds) if job.seconds else "")
        is_said = state == "stopped" and result is not None and bool(result.headline)  # under So far
        if shown.get("moving") != (state, console, is_said):
            _show_moving(moving, state, console, is_said)
        if shown.get("body") != (state, result):
            body.clear()
            if result is not None:
                with body:
                    _show_result(jobs, job, f"{results}/{quote(job.id)}", state, result, console)
        shown.update({"head": (state, console.error), "moving": (state, console, is_said), "body": (state, result)})

    look = watching(workspace, refresh)
    look()
    ui.timer(1.0, look)


def _show_head(place: ui.column, jobs: Jobs, job: Job, state: State, console: LogText) -> ui.label:
    """The state, and what can be done; returns the label for the time it has taken."""

    def delete() -> None:
        jobs.remove(job)
        ui.navigate.to("/")

    place.clear()
    with place:
        with ui.row().classes("items-center").style("min-height: 36px"):
            state_chip(job, state)
            clock = ui.label().classes("dd-quiet")
            if state in ALIVE:
                stop = guarded(jobs.workspace, lambda: jobs.stop(job))
                text = "Stop at once" if state == "stopping" else "Stop"
                quiet_button(text, icon="stop", on_click=stop).props("outline no-caps")
        if state in SAYS:
            ui.label(SAYS[state]).classes("dd-quiet dd-says")
        if state == "refused":
            _show_refusal(job, console)
        if state not in ALIVE:  # not in the row of Stop: who presses that once more is not to continue what it ended
            with ui.row().classes("items-center"):
                if state in AGAIN:
                    again = guarded(jobs.workspace, lambda: jobs.proceed(job))
                    ui.button(AGAIN[state], icon="play_arrow", on_click=again).props("no-caps")
                question = f"Delete the run {job.id} with its results?"
                quiet_button(
                    "Delete", icon="delete", on_click=lambda: ask_to_delete(question, delete, jobs.workspace)
                ).props("flat no-caps")
    return clock


def _show_moving(place: ui.column, state: State, console: LogText, is_said: bool) -> None:
    """How far it is; nothing in it can be pressed. What it found so far, unless the result says it."""
    place.clear()
    if state not in ("running", "stopping", "stopped", "killed"):
        return
    with place:
        _show_stages(state, console)
        for line in console.text.splitlines():
            if line.startswith("So far, ") and not is_said:
                ui.label(line).classes("dd-says")


def _show_refusal(job: Job, console: LogText) -> None:
    """The one line of it, and where to change what it names."""
    ui.label(console.error or "It was refused; the log says why.").classes("dd-bad dd-says")
    if "--" in console.error:
        ui.label("Options in it are fields of the question, or columns and units of the trace.").classes("dd-quiet")
    with ui.row().classes("items-center"):
        if job.command in BY_COMMAND:
            quiet_button("Change the question", on_click=lambda: ui.navigate.to(f"/?do={job.command}")).props(
                "outline no-caps"
            )
        names = [one.removeprefix("files/") for one in job.arguments if one.startswith("files/")]
        for name in dict.fromkeys(names):
            ui.link(f"Open {name}", f"/file/{quote(name)}")


def _show_stages(state: State, console: LogText) -> None:
    if state == "running" and not console.stages:
        with ui.row().classes("items-center"):
            ui.spinner(size="sm")
            ui.label("The traces are read, and programs compiled.")
    for stage in console.stages:
        with ui.element("div").classes("dd-row"):
            ui.label(stage.name).classes("dd-grow")
            bar = ui.linear_progress(stage.share, show_value=False, size="8px").style("flex: 2 1 12rem")
            bar.props(f'aria-label="{stage.done} of {stage.most}"')
            ui.label("done" if stage.share >= 1.0 else f"{stage.done} of {stage.most}").style("min-width: 5rem")


def _show_result(jobs: Jobs, job: Job, base: str, state: State, result: JobResult, console: LogText) -> None:
    if state in ("done", "doubtful", "stopped") and result.headline:
        with section("Result" if state != "stopped" else "So far"):
            ui.label(result.headline).classes("dd-says first")
            others = [sentence for sentence in result.says if sentence != result.headline]
            if result.report and others:  # the report has them with their figures
                with ui.expansion("In words").classes("w-full").props("dense"):
                    _say_all(others)
            else:
                _say_all(others)
    if state in ("done", "doubtful") and job.command in NEXT:
        with ui.row().classes("items-center"):
            ui.label("Next:").classes("dd-quiet")
            for command, title in NEXT[job.command]:
                go = guarded(jobs.workspace, lambda command=command: _follow(jobs, job, command))
                quiet_button(title, on_click=go).props("outline no-caps")
    if result.report:
        with section("Report"):
            ui.link("Open it in a tab of its own", f"{base}/out/{result.report}", new_tab=True)
            ui.element("iframe").classes("dd-report").props(
                f'src="{base}/out/{result.report}" sandbox="allow-scripts allow-downloads" title="report"'
            )
    elif result.numbers or result.tables or result.figures:
        _show_tables(result)
        _show_numbers(result)
        with section("Figures") if result.figures else ui.element("div"):
            for figure in result.figures:
                ui.html(
                    f'<img class="dd-figure" loading="lazy" alt="{quote(figure)}" src="{base}/out/{quote(figure)}">',
                    sanitize=False,  # a file's name is quoted
                )
    if result.files:
        with section("Files"):
            for name, count in result.files:
                with ui.element("div").classes("dd-row"):
                    ui.link(name, f"{base}/out/{quote(name)}?download").classes("dd-grow dd-wrap")
                    ui.label(size(count)).classes("dd-quiet")
    with section("Log"):
        ui.label(f"diffdrive {' '.join(job.arguments)}").classes("dd-code")
        with ui.expansion("What it printed").classes("w-full").props("dense"):
            ui.label(console.text).classes("dd-log")
            ui.link("The full log", f"{base}/log")


def _say_all(sentences: list[str]) -> None:
    for sentence in sentences:
        ui.label(sentence).classes("dd-says q-pb-xs")


def _show_numbers(result: JobResult) -> None:
    for name, numbers in result.numbers.items():
        with section(titled(name.replace("_", " "))), ui.element("div").classes("dd-scroll"), ui.element("table"):
            for words, text in numbers:
                with ui.element("tr"):
                    for one in (words, text):
                        with ui.element("td"):
                            ui.label(one)


def _follow(jobs: Jobs, job: Job, command: str) -> None:
    """Open the question that comes next, with the traces of this run, and the drive file that it found."""
    found = job.out / IDENTIFIED
    here = found.relative_to(jobs.workspace.folder).as_posix() if found.is_file() else ""
    values = follow_up(job.arguments, here)
    jobs.workspace.keep_form(command, jobs.workspace.form(command) | values)
    ui.navigate.to(f"/?do={command}")


def _show_tables(result: JobResult) -> None:
    for name, table in result.tables.items():
        rows: list[list[Any]] = list(table.get("rows", []))
        with section(titled(name.replace("_", " "))), ui.element("div").classes("dd-scroll"):
            with ui.element("table"):
                with ui.element("tr"):
                    for column in table.get("columns", []):
                        with ui.element("th"):
                            ui.label(", ".join(part for part in heading(str(column)) if part))
                for row in rows[:MOST_ROWS]:
                    with ui.element("tr"):
                        for cell in row:
                            with ui.element("td"):
                                ui.label(shown(cell))
            if len(rows) > MOST_ROWS:
                ui.label(f"and {len(rows) - MOST_ROWS} more, in {name}.csv").classes("dd-quiet")
