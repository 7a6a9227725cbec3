"""The page of one file: a trace with its columns, curves and mapping; a drive file to edit."""

from collections.abc import Mapping
from typing import Any

from nicegui import ui

from diffdrive.support.atomic_write import write_text
from experiments.app import mapping
from experiments.app.jobs import Jobs
from experiments.app.preview import drawings
from experiments.app.web.layout import guarded, page, quiet_button, say, section, watching
from experiments.app.workspace import DRIVE_FILE, AppError, read_json

STATED = "You stated these; every command takes them."
GUESSED = "This is the guess. Commands read the columns by themselves; what you save here goes first."
NONE = ""  # in the place of a column: this channel is not in the trace
MOST_TEXT = 200_000  # bytes of a drive file that is edited here; a real one has some thousand, the socket takes 1e6


def inspect(jobs: Jobs, name: str) -> None:
    """The page at /file/NAME."""
    workspace = jobs.workspace
    with page(name[:100]):
        try:
            workspace.file(name)
            if name.casefold().endswith(DRIVE_FILE):
                _edit(jobs, name)
            else:
                _trace(jobs, name)
        except AppError as problem:
            ui.label(str(problem)).classes("dd-bad")


def _trace(jobs: Jobs, name: str) -> None:
    place = ui.column().classes("w-full").style("gap: 28px")
    shown: list[object] = []

    def refresh() -> None:
        look = jobs.look(name)
        stamp = [look.state, look.stamp()]
        if shown == stamp:
            return
        shown[:] = stamp
        found = read_json(look.out / "look.json") or {}
        console = look.console()
        place.clear()
        with place:
            if look.state in ("waiting", "running"):
                with ui.row().classes("items-center"):
                    ui.spinner(size="sm")
                    ui.label("The columns are guessed ..." if found else "The file is read ...")
            elif console.error:
                ui.label(console.error).classes("dd-bad dd-says")
            elif look.state != "done":
                ui.label("The file could not be looked at: the reading was ended, or ran out of memory.").classes(
                    "dd-bad"
                )
            if look.state not in ("waiting", "running", "done"):
                again = guarded(jobs.workspace, lambda: jobs.look_again(name))
                quiet_button("Read it again", icon="refresh", on_click=again).props("outline no-caps")
            if found.get("columns"):
                _columns(jobs, name, found)

    look = watching(jobs.workspace, refresh)
    look()
    ui.timer(1.0, look)


def _columns(jobs: Jobs, name: str, found: Mapping[str, Any]) -> None:
    with section("Columns and units"):
        if found.get("guessing"):
            ui.label("In a moment a guess stands here.").classes("dd-quiet")
        else:
            _mapping(jobs, name, found)
    with section(f"What the file holds: {found.get('rows', 0):,} rows"):
        for note in found.get("notes", []):
            ui.label(str(note)).classes("dd-quiet dd-says")
        with ui.element("div").classes("dd-scroll"), ui.element("table"):
            with ui.element("tr"):
                for text in ("column", "unit in the file", "first rows"):
                    with ui.element("th"):
                        ui.label(text)
            for column in found["columns"]:
                with ui.element("tr"):
                    for text in (column["name"], column["unit"] or "", ", ".join(column["first"])):
                        with ui.element("td"):
                            ui.label(str(text))


def _mapping(jobs: Jobs, name: str, found: Mapping[str, Any]) -> None:
    workspace = jobs.workspace
    kept = mapping.stated(workspace, f"files/{name}")
    first = mapping.first_choice(kept, found)
    why = mapping.reasons(found)
    curves = {column["name"]: column["curve"] for column in found["columns"]}
    columns = {channel: column for channel, (column, _) in first.items()}
    units = {channel: unit for channel, (_, unit) in first.items()}
    whose = ui.label(STATED if kept else GUESSED).classes("dd-quiet")
    with ui.element("div").classes("dd-mapping"):
        with ui.element("div").classes("dd-preview"):
            preview = ui.html("", sanitize=False).classes("w-full")  # its names are escaped by `drawings`
        fields = ui.column().classes("w-full")

    def draw() -> None:
        chosen = [(channel, columns[channel]) for channel in ("position", "reference", "command") if columns[channel]]
        preview.set_content(
            drawings([(f"{channel}, {column}", curves.get(column) or []) for channel, column in chosen])
        )

    def choose(channel: str, column: str | None) -> None:
        columns[channel] = column or NONE
        draw()

    def save() -> None:
        mapping.keep(workspace, name, columns, units)
        whose.set_text(STATED)
        back.set_visibility(True)
        say(f"Kept. The commands take these columns of {name}.", "positive")

    def forget() -> None:
        mapping.forget(workspace, name)
        ui.navigate.reload()

    options = {NONE: "not in this trace", **{column: column for column in curves}}
    with fields, ui.element("div").classes("dd-map"):
        for channel, (meaning, example) in mapping.CHANNELS.items():
            ui.label(channel).classes("name").tooltip(meaning)
            ui.select(
                options, value=columns[channel] if columns[channel] in options else NONE, with_input=len(curves) > 12,
                on_change=guarded(workspace, lambda event, channel=channel: choose(channel, event.value)),
            ).props(f'dense options-dense aria-label="column of {channel}"')  # fmt: skip
            ui.input(
                value=units[channel], placeholder=example,
                on_change=guarded(workspace, lambda event, channel=channel: units.update({channel: event.value or ""})),
            ).props(f'dense aria-label="unit of {channel}"')  # fmt: skip
            ui.label(why.get(channel, meaning)).classes("why")
    with fields:
        ui.label(why.get("", "")).classes("dd-quiet dd-says")
    with fields, ui.row():
        ui.button("Save columns", icon="save", on_click=guarded(workspace, save)).props("no-caps")
        back = quiet_button("Back to the guess", on_click=guarded(workspace, forget)).props("outline no-caps")
        back.set_visibility(bool(kept))
    draw()


def _edit(jobs: Jobs, name: str) -> None:
    """The text of a drive file; what another tab has written meanwhile is not overwritten."""
    workspace = jobs.workspace
    path = workspace.file(name)
    if path.stat().st_size > MOST_TEXT:
        raise AppError(f"{name}: is larger than any drive file")
    read = path.read_bytes()
    try:
        text = read.decode("utf-8")
    except UnicodeDecodeError:
        raise AppError(f"{name}: is no text in UTF-8; export it again") from None
    before = [read]
    verdict = ui.label("").classes("dd-says")

    def refresh() -> None:
        look = jobs.look(name)
        error = look.console().error
        if look.state in ("waiting", "running"):
            verdict.set_text("is read ...")
        else:
            says = (read_json(look.out / "look.json") or {}).get("says", [])
            verdict.set_text(error or ("It can be read: " + " ".join(says) if says else ""))
        verdict.classes(add="dd-bad" if error else "dd-quiet", remove="dd-quiet" if error else "dd-bad")

    def save() -> None:
        if workspace.file(name).read_bytes() != before[0]:
            raise AppError(
                f"{name} was changed elsewhere since this page was opened: copy your text, then reload the page"
            )
        write_text(path, area.value or "")
        before[0] = path.read_bytes()
        jobs.look_again(name)
        say(f"Saved {name}.", "positive")

    area = ui.textarea(value=text).props('outlined autogrow input-class="dd-code" aria-label="text of the drive file"')
    area.classes("w-full")
    with ui.row():
        ui.button("Save", icon="save", on_click=guarded(workspace, save)).props("no-caps")
    look = watching(workspace, refresh)
    look()
    ui.timer(1.0, look)
