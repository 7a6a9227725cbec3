"""Which column is the command, and what else the trace holds: velocity, measured current, load, temperature."""

from collections.abc import Mapping, Sequence

from diffdrive.logs.guess.columns import Column, may_be_forces, of_kind
from diffdrive.logs.guess.evidence import Balance, Recording
from diffdrive.logs.guess.result import Certainty, Guess, Question
from diffdrive.logs.log import READABLE
from diffdrive.model.data_sheet import DataSheet
from diffdrive.support.messages import quoted_names

_RANKS = {"set": 0, None: 1, "actual": 2}  # the set-point before the current loop, else what comes nearest to it
_AT_THE_TABLE = ("N", "kN", "N*m", "Nm")  # units for which no data sheet of the motor is needed, or its lead alone


def guess_command(
    columns: dict[str, Column], recording: Recording, position: str, given: Mapping[str, str], sheet: DataSheet
) -> tuple[str | None, Balance | None, list[Guess], list[Question]]:
    """The command's column, what inverse dynamics makes of it, and why, or what has to be asked."""
    if "command" in given:
        balance = recording.balance(position, given["command"])
        return given["command"], balance, [Guess("command", f"'{given['command']}'", "stated", "by you")], []
    taken = {*given.values(), position}
    candidates = [name for name in may_be_forces(columns, recording, position) if name not in taken]
    balances = {name: recording.balance(position, name) for name in candidates}
    called = [name for name in candidates if columns[name].kind == "force"]
    if not called:
        candidates = [name for name in candidates if balances[name] is not None]
    if not candidates:
        why = f"none of the columns {quoted_names(list(columns))} is called a force, torque or current"
        why += ", and mass and friction explain none by the motion"
        return None, None, [], [Question("columns", "command", why, "COLUMN")]
    best = min(_RANKS[columns[name].words.role] for name in candidates if _is_ranked(columns[name]))
    ranked = [name for name in candidates if _RANKS.get(columns[name].words.role) == best]
    name = _one_of(columns, recording, ranked, balances, sheet)
    if name is None:
        why = f"the columns {quoted_names(ranked)} may each be the command"
        return None, None, [], [Question("columns", "command", why, ranked[0])]
    reasons = ["its name" if called else "mass and friction explain it by the motion, and no other column"]
    if called and balances[name] is not None:
        reasons.append("mass and friction explain it by the motion")
    if best == _RANKS["actual"]:
        reasons.append("measured, for want of a set-point: it lags behind that by the current loop")
    certainty: Certainty = "sure" if called and balances[name] is not None else "likely"
    return name, balances[name], [Guess("command", f"'{name}'", certainty, "; ".join(reasons))], []


def _is_ranked(column: Column) -> bool:
    return column.words.role in _RANKS


def _one_of(
    columns: dict[str, Column],
    recording: Recording,
    names: Sequence[str],
    balances: Mapping[str, Balance | None],
    sheet: DataSheet,
) -> str | None:
    """The one that the motion explains; of one signal in several units the one that needs least to be read."""
    explained = [name for name in names if balances[name] is not None] or list(names)
    if any(recording.slope(name, explained[0]) is None for name in explained):
        return None
    known = {"%": sheet.rated_torque, "A": sheet.torque_per_ampere}

    def needs(name: str) -> int:
        unit = columns[name].stated.unit
        if unit in _AT_THE_TABLE:
            return 0
        return 2 if unit is None or known.get(unit) is None else 1

    return min(explained, key=needs)


def guess_others(
    columns: dict[str, Column], recording: Recording, chosen: Mapping[str, str]
) -> tuple[dict[str, str], list[Guess], list[str]]:
    """Velocity, measured current, load, temperature, as far as they are plain: column by channel, why, and notes."""
    taken = {*chosen.values()}
    found: dict[str, str] = {}
    guesses, notes = [], []
    speeds = [
        name
        for name in of_kind(columns, "velocity", "")
        if name not in taken and columns[name].words.role != "set"
        and recording.slope_of_velocity(name, chosen["position"]) is not None
    ]  # fmt: skip
    if "velocity" not in chosen and len(speeds) == 1:
        found["velocity"] = speeds[0]
        guesses.append(Guess("velocity", f"'{speeds[0]}'", "sure", "it is the slope of the position"))
    elif "velocity" not in chosen and speeds:
        notes.append(f"velocity: left out, {quoted_names(speeds)} are each the slope of the position")
    plain = {
        "current": [
            name
            for name in of_kind(columns, "force")
            if columns[name].words.role == "actual" and columns[name].stated.kinds[-1:] == ("current",)
        ],
        "load": [name for name in of_kind(columns, "load") if columns[name].stated.unit in ("N", "kN")],
        "temperature": [name for name in of_kind(columns, "temperature") if columns[name].stated.unit is not None],
    }
    for channel, names in plain.items():
        names = [name for name in names if name not in taken and name not in found.values()]
        if channel not in chosen and len(names) == 1:
            found[channel] = names[0]
            guesses.append(Guess(channel, f"'{names[0]}'", "sure", "its name and unit"))
    for channel in ("disturbance", "injected"):
        for name in columns:
            if channel not in chosen and name not in taken and columns[name].stated.name.casefold() == channel:
                found[channel] = name
                guesses.append(Guess(channel, f"'{name}'", "likely", f"its name: {READABLE[channel].meaning}"))
    unused = [name for name in columns if name not in taken and name not in found.values()]
    if unused:
        notes.append(f"not used: {quoted_names(unused)}")
    return found, guesses, notes
