"""The first page: drop files, ask a question, see what runs."""

from collections.abc import Sequence
from functools import partial
from typing import Any
from urllib.parse import quote

from nicegui import ui

from experiments.app.drive_files import drive_file, drive_files
from experiments.app.forms import BY_COMMAND, FORMS, Field, Form, arguments
from experiments.app.job import Job, State
from experiments.app.jobs import Jobs
from experiments.app.mapping import stated
from experiments.app.result import read_result
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
from experiments.app.web.routes import known_endings
from experiments.app.workspace import DRIVE_FILE, AppError, Workspace, read_json

EVERY = 1.0  # s, between two looks at the disk


def home(jobs: Jobs, do: str) -> None:
    """The page at /."""
    workspace = jobs.workspace
    with page("diffdrive", home=True):
        with section("Files"):
            _drop_zone()
            files = ui.column().classes("w-full gap-0")
            _new_drive(jobs)
        with section("Questions"):
            selects = _forms(jobs, do)
        with section("Runs"):
            runs = ui.column().classes("w-full gap-0")
    shown: dict[str, object] = {}
    doing: dict[str, ui.label] = {}

    def refresh() -> None:
        if not workspace.is_there():
            raise AppError(workspace.gone)
        names = workspace.names()
        looks = [jobs.look(name) for name in names]
        states = [(job, job.state) for job in jobs.all()]
        now = {
            "files": [(name, look.stamp()) for name, look in zip(names, looks, strict=True)],
            "runs": [(job.id, state) for job, state in states],
        }
        if shown.get("files") != now["files"]:
            _show_files(files, jobs, looks, names)
        # drawn again only where a state has changed: a link that has the focus, or is being pressed, must stay
        if shown.get("runs") != now["runs"]:
            doing.clear()
            doing.update(_show_runs(runs, states))
        for job, _ in states:
            if job.id in doing:
                doing[job.id].set_text(_doing(job))
        if shown != now:
            unread = {f"files/{name}" for name, look in zip(names, looks, strict=True) if look.state != "done"}
            _refresh_choices(workspace, selects, unread)
        shown.update(now)

    look = watching(workspace, refresh)
    look()
    ui.timer(EVERY, look)


def _drop_zone() -> None:
    accept = ",".join(known_endings())
    ui.html(
        f'<label class="dd-drop"><input type="file" multiple accept="{accept}" aria-label="Choose files">'
        "Drop traces and a drive file here, or click to choose<br>"
        f'<span class="dd-quiet">{accept.replace(",", " ")}</span></label>',
        sanitize=False,  # nothing in it is of a user
    ).classes("w-full")
    ui.html('<div id="dd-sending"></div>', sanitize=False).classes("w-full")


def _new_drive(jobs: Jobs) -> None:
    def make(name: str) -> None:
        given = jobs.workspace.add(f"{name}{DRIVE_FILE}", drive_file(name))
        ui.navigate.to(f"/file/{quote(given)}")

    with quiet_button("New drive file", icon="note_add").props("outline no-caps").classes("self-start"), ui.menu():
        for name, title in drive_files().items():
            with ui.menu_item(on_click=guarded(jobs.workspace, lambda name=name: make(name))):
                ui.label(f"{name}: {title}" if title else name)


def _show_files(place: ui.column, jobs: Jobs, looks: list[Job], names: list[str]) -> None:
    place.clear()
    with place:
        if not names:
            ui.label("No files yet. Without a drive file begin with a trace, and with Start below.").classes("dd-quiet")
        for name, look in zip(names, looks, strict=True):
            with ui.element("div").classes("dd-row"):
                ui.link(name, f"/file/{quote(name)}").classes("dd-grow dd-wrap")
                ui.label(size(jobs.workspace.file(name).stat().st_size)).classes("dd-quiet")
                question = f"Delete {name}? Runs that used it keep their results, but cannot go on."
                delete = partial(jobs.workspace.remove, name)
                quiet_button(
                    icon="delete", on_click=partial(ask_to_delete, question, delete, jobs.workspace)
                ).props(f'flat dense aria-label="Delete {name}"')  # fmt: skip
                kind = "dd-bad" if look.console().error else "dd-quiet"
                ui.label(_about(look, name)).classes(f"{kind} dd-wrap dd-line")


def _about(look: Job, name: str) -> str:
    """What is known of a file, in a line."""
    console, found = look.console(), read_json(look.out / "look.json") or {}
    if look.state == "waiting":
        return "waits to be read"
    if look.state == "running":
        return "is read ..." if not found else "columns are guessed ..."
    if console.error:
        return console.error
    if look.state in ("failed", "killed"):
        return "could not be read: the reading was ended; open it to try again"
    if name.casefold().endswith(DRIVE_FILE):
        return "drive file"
    questions = len([one for one in found.get("questions", []) if one.get("argument") != "mass"])
    open_ones = f", {questions} open: choose columns" if questions else ""
    return f"{len(found.get('columns', []))} columns, {found.get('rows', 0):,} rows{open_ones}"


def _forms(jobs: Jobs, do: str) -> list[tuple[ui.select, Field]]:
    """A tab for each command; returns what chooses files."""
    selects: list[tuple[ui.select, Field]] = []
    kept = jobs.workspace.form("page").get("tab", "")
    first = next((one for one in (do, kept) if one in BY_COMMAND), FORMS[0].command)
    with ui.tabs().props("no-caps align=left dense").classes("w-full dd-tabs") as tabs:
        for form in FORMS:
            ui.tab(form.command, label=form.title)
    tabs.set_value(first)
    tabs.on_value_change(guarded(jobs.workspace, lambda event: jobs.workspace.keep_form("page", {"tab": event.value})))
    with ui.tab_panels(tabs, value=first, animated=False).classes("w-full").style("background: transparent"):
        for form in FORMS:
            with ui.tab_panel(form.command).style("padding: 12px 0"):
                selects += _form(jobs, form)
    return selects


def _form(jobs: Jobs, form: Form) -> list[tuple[ui.select, Field]]:
    workspace = jobs.workspace
    values = dict(workspace.form(form.command))
    selects: list[tuple[ui.select, Field]] = []

    def keep(name: str, value: object) -> None:
        values[name] = value
        workspace.keep_form(form.command, values)

    def run() -> None:
        made = arguments(form, values, workspace.path, lambda path: stated(workspace, path))
        first = next((str(one) for one in made[::-1] if "/" in one and not one.startswith("-")), "")
        job = jobs.create(form.command, made, f"{form.title}: {first.rpartition('/')[2]}")
        ui.navigate.to(f"/run/{job.id}")

    ui.label(form.answers).classes("dd-quiet")
    with ui.element("div").classes("dd-fields"):
        for field in form.fields:
            selects += _input(workspace, field, values, keep)
    if form.more:
        with ui.expansion("More").classes("w-full").props("dense"), ui.element("div").classes("dd-fields"):
            for field in form.more:
                selects += _input(workspace, field, values, keep)
    ui.button(form.title, icon="play_arrow", on_click=guarded(workspace, run)).props(
        f"no-caps data-run={form.command}"
    ).classes("q-mt-sm")
    return selects


def _input(workspace: Workspace, field: Field, values: dict[str, Any], keep: Any) -> list[tuple[ui.select, Field]]:
    value = values.get(field.name, field.default)
    on_change = guarded(workspace, lambda event: keep(field.name, event.value))
    if field.kind == "flag":
        ui.checkbox(field.label, value=bool(value), on_change=on_change)
        return []
    if field.kind == "choice":
        ui.select(list(field.choices), label=field.label, value=value, on_change=on_change)
        return []
    if field.kind == "text":
        ui.input(field.label, value=str(value or ""), on_change=on_change).props(f'hint="{field.help}"')
        return []
    several = field.kind == "traces"
    options = _choices(workspace, field)
    known = [one for one in value if one in options] if isinstance(value, list) else []
    chosen: Any = known if several else value if value in options else None
    select = ui.select(
        options, label=field.label + ("" if field.required else " (optional)"), value=chosen, multiple=several,
        clearable=not field.required, on_change=on_change,
    ).props("use-chips" if several else "")  # fmt: skip
    if field.help:
        select.props(f'hint="{field.help}"')
    return [(select, field)]


def _choices(workspace: Workspace, field: Field) -> dict[str, str]:
    """Paths in the workspace, and what a list calls them."""
    paths = workspace.drive_files() if field.kind == "drive" else workspace.traces()
    return {path: _called(path) for path in paths}


def _called(path: str) -> str:
    parts = path.split("/")
    return parts[-1] if parts[0] == "files" else f"{parts[-1]}, of run {parts[1]}"


def _refresh_choices(workspace: Workspace, selects: list[tuple[ui.select, Field]], unread: set[str]) -> None:
    """New files are offered; where there is one alone that can be read, it is chosen."""
    for select, field in selects:
        options = _choices(workspace, field)
        if options == select.options:
            continue
        value: Any = select.value
        several = field.kind == "traces"
        kept = [one for one in value or [] if one in options] if several else value if value in options else None
        select.set_options(options, value=kept)
    for select, field in selects:
        only = [one for one in select.options if one not in unread]
        if field.required and field.obvious and len(only) == 1 and not select.value:
            select.set_value(only if field.kind == "traces" else only[0])


def _show_runs(place: ui.column, states: Sequence[tuple[Job, State]]) -> dict[str, ui.label]:
    """The list of runs; returns the labels that say how far those are which run."""
    doing: dict[str, ui.label] = {}
    place.clear()
    with place:
        if not states:
            ui.label("Nothing has run yet.").classes("dd-quiet")
        for job, state in states:
            with ui.element("div").classes("dd-row"):
                ui.link(job.title, f"/run/{job.id}").classes("dd-grow dd-wrap")
                ui.label(job.id).classes("dd-quiet")
                state_chip(job, state)
                if state in ("running", "stopping"):
                    doing[job.id] = ui.label().classes("dd-quiet dd-line")
                elif state in ("done", "doubtful"):
                    ui.label(read_result(job).headline[:200]).classes("dd-quiet dd-wrap dd-line")
    return doing


def _doing(job: Job) -> str:
    stages = job.console().stages
    doing = f"{stages[-1].name}, {stages[-1].done} of {stages[-1].most}" if stages else "begins"
    return f"{doing}; {duration(job.seconds)}"
