"""Columns and units that the user states for a trace by hand, and what was guessed of it."""

from collections.abc import Mapping
from typing import Any

from experiments.app.workspace import AppError, Workspace, read_json, write_json

# the channels in the order of the page, what each is, and its units as examples; diffdrive.logs.log.READABLE has them
# with their physics, and would bring JAX's numpy along (a test compares both)
CHANNELS = {
    "time": ("time of the sample", "s, ms"),
    "position": ("measured position", "m, mm, 50 nm, rev"),
    "command": ("force, torque or current set-point", "N, N*m, %, A, -N"),
    "reference": ("set position", "m, mm"),
    "motor_position": ("motor encoder beside a scale", "m, mm, rev, deg"),
    "velocity": ("velocity as the machine reports it", "m/s, mm/s, rpm"),
    "current": ("measured motor current", "A"),
    "load": ("load on the guides", "N, kN"),
    "disturbance": ("known force on the table", "N"),
    "injected": ("test pulses added to the command", "N"),
    "temperature": ("temperature", "degC, K"),
}
NEEDED = ("position", "command")
LONGEST = 60  # characters of a unit


def stated(workspace: Workspace, path: str) -> dict[str, dict[str, str]]:
    """What was stated for a trace, by its path in the workspace; nothing for those that a job wrote."""
    if not path.startswith("files/"):
        return {}
    kept = read_json(workspace.mapping_file(path.removeprefix("files/")))
    if not isinstance(kept, dict):
        return {}
    return {kind: dict(kept.get(kind, {})) for kind in ("column", "unit") if kept.get(kind)}


def keep(workspace: Workspace, name: str, columns: Mapping[str, str], units: Mapping[str, str]) -> None:
    """Keep what was stated; raises `AppError` that names the channel where it cannot be."""
    workspace.file(name)
    chosen = {channel: column for channel, column in columns.items() if column}
    for channel, column in chosen.items():
        other = next((one for one, text in chosen.items() if text == column and one != channel), None)
        if other is not None:
            raise AppError(f"{channel}: column '{column[:60]}' is {other} already; choose another, or none")
    unit = {channel: text.strip() for channel, text in units.items() if text and text.strip()}
    for channel, text in unit.items():
        if len(text) > LONGEST or not text.isprintable():
            raise AppError(f"{channel}: '{text[:20]}...' is no unit")
        if channel not in chosen:
            raise AppError(f"{channel}: has a unit and no column; choose its column")
    missing = [channel for channel in NEEDED if channel not in chosen]
    if chosen and missing:
        raise AppError(f"{', '.join(missing)}: choose the column; without it no command can use this trace")
    write_json(workspace.mapping_file(name), {"column": chosen, "unit": unit})


def forget(workspace: Workspace, name: str) -> None:
    """Go back to what is guessed, and what drive files state."""
    workspace.file(name)
    workspace.mapping_file(name).unlink(missing_ok=True)


def first_choice(kept: Mapping[str, Mapping[str, str]], look: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """The column and the unit of each channel that a form begins with: what was stated, else what was guessed."""
    columns = kept.get("column") or look.get("chosen") or {}
    units = kept.get("unit") or ({} if kept.get("column") else look.get("units")) or {}
    return {channel: (str(columns.get(channel, "")), str(units.get(channel, ""))) for channel in CHANNELS}


def reasons(look: Mapping[str, Any]) -> dict[str, str]:
    """Why a channel was guessed as it was, and what is open, by channel; what belongs to none is under ''."""
    found: dict[str, list[str]] = {}
    for guess in look.get("guesses", []):
        channel = next((name for name in sorted(CHANNELS, key=len, reverse=True) if name in str(guess["what"])), "")
        found.setdefault(channel, []).append(
            f"{guess['what']}: {guess['value']} ({guess['certainty']}: {guess['why']})"
        )
    for question in look.get("questions", []):
        channel = question["channel"] if question["channel"] in CHANNELS else ""
        found.setdefault(channel, []).append(f"open: {question['why']}; for instance {question['example']}")
    return {channel: ". ".join(sentences) for channel, sentences in found.items()}
