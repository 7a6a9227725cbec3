"""Which columns are the reference, the scale and the motor's encoder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from diffdrive.logs.checks.statistics import derivative
from diffdrive.logs.guess.columns import Column, groups_of, may_be_forces, of_kind
from diffdrive.logs.guess.evidence import FEEDBACK, NO_FEEDBACK, Recording
from diffdrive.logs.guess.result import Certainty, Guess, Question
from diffdrive.support.messages import quoted_names

CHANNELS = ("position", "reference", "motor_position")
LEADS = 0.5  # correlation of set minus actual position and speed, from which on one leads: a loop that lags has 0.9
LAG = 0.5  # what the speed leaves of a difference, beside what its sign leaves, where it is a lag and no lost motion
BEYOND_REST = 3.0  # of what is left between two encoders, from which on they differ by the direction of motion
_ROTARY = ("deg", "rev", "rad", "count")


@dataclass
class Positions:
    """The column of each channel of position, why, and what has to be asked."""

    chosen: dict[str, str] = field(default_factory=dict)
    guesses: list[Guess] = field(default_factory=list)
    questions: list[Question] = field(default_factory=list)

    def take(self, channel: str, column: str, certainty: Certainty, why: str) -> None:
        """Choose a column."""
        self.chosen[channel] = column
        self.guesses.append(Guess(channel, f"'{column}'", certainty, why))

    def ask(self, channel: str, why: str, example: str) -> "Positions":
        """Leave a column open."""
        self.questions.append(Question("columns", channel, why, example))
        return self


def guess_positions(columns: dict[str, Column], recording: Recording, given: Mapping[str, str]) -> Positions:
    """The columns of reference, scale and motor encoder; `given` are those that the user states."""
    found = Positions()
    anchor = _anchor(columns, recording, given, found)
    if anchor is None:
        return found
    for channel in CHANNELS:
        if channel in given:
            found.take(channel, given[channel], "stated", "by you")
    exact = _called_as_channels(columns, recording, anchor, given)
    taken = {*given.values(), *exact.values()}
    members = [
        name
        for name in of_kind(columns, "position", "")
        if name not in taken and (name == anchor or recording.slope(name, anchor) is not None)
    ]
    forces = [given["command"]] if "command" in given else may_be_forces(columns, recording, anchor)
    fed_back = {name: _feedback(recording, forces, name) for name in [*members, *taken]}
    called_set = [name for name in members if columns[name].words.role == "set"]
    swapped = [name for name in (*called_set, exact.get("reference", "")) if fed_back.get(name) is True]
    if swapped:
        others = [name for name in (*exact.values(), *members) if name not in swapped]
        return found.ask(
            "position",
            f"'{swapped[0]}' is called a set-point, and the command moves against its noise as against a measured "
            f"position's: columns may be exchanged ({quoted_names([*swapped, *others])}); say which was measured",
            swapped[0],
        )
    for channel, name in exact.items():
        found.take(channel, name, "sure", "its name")
    if "position" in exact:  # a further one, such as a simulation's own, is the motor's only if it is called so
        members = [name for name in members if columns[name].words.role == "set" or _is_motor(columns[name])]
    _sort(columns, recording, members, fed_back, found)
    return found


def _called_as_channels(
    columns: dict[str, Column], recording: Recording, anchor: str, given: Mapping[str, str]
) -> dict[str, str]:
    """The columns that have the very name of a channel, as the reader of logs finds them, and move as the axis does."""
    names = {column.stated.name.strip().casefold(): name for name, column in columns.items()}
    return {
        channel: names[channel]
        for channel in CHANNELS
        if channel in names
        and channel not in given
        and names[channel] not in given.values()
        and recording.slope(names[channel], anchor) is not None
    }


def _anchor(columns: dict[str, Column], recording: Recording, given: Mapping[str, str], found: Positions) -> str | None:
    """A column that moves as the axis does."""
    stated = next((given[channel] for channel in CHANNELS if channel in given), None)
    if stated is not None:
        return stated
    named = groups_of(recording, of_kind(columns, "position"))
    if len(named) == 1:
        return named[0][0]
    if named:
        firsts = [group[0] for group in named]
        found.ask(
            "position", f"the positions {quoted_names(firsts)} do not move alike: of which axis is the log", firsts[0]
        )
        return None
    unnamed = of_kind(columns, "")
    explained = [name for name in unnamed if _is_explained(columns, recording, name)]
    groups = groups_of(recording, explained)
    if len(groups) == 1:
        return groups[0][0]
    if not unnamed:
        found.ask("position", f"none of the columns {quoted_names(list(columns))} is called a position", "COLUMN")
        return None
    why = (
        f"the columns {quoted_names([group[0] for group in groups])} may each be the position, by inertia and friction"
        if groups
        else f"which of the columns {quoted_names(unnamed)} is the position shows neither in their names nor in a "
        "force that moves one of them"
    )
    found.ask("position", why, (groups[0] if groups else unnamed)[0])
    return None


def _is_explained(columns: dict[str, Column], recording: Recording, position: str) -> bool:
    """Whether mass and friction explain some force by this motion."""
    forces = may_be_forces(columns, recording, position)
    return any(recording.balance(position, force) is not None for force in forces if force != position)


def _feedback(recording: Recording, forces: Sequence[str], position: str) -> bool | None:
    """Whether some force moves with the noise of a position; None where that is not clear."""
    strongest = max((abs(recording.feedback(force, position)) for force in forces), default=0.0)
    if strongest > FEEDBACK:
        return True
    return False if strongest < NO_FEEDBACK else None


def _sort(
    columns: dict[str, Column],
    recording: Recording,
    members: Sequence[str],
    fed_back: Mapping[str, bool | None],
    found: Positions,
) -> None:
    """Set-points and measured positions apart."""
    sets = {name: "its name" for name in members if columns[name].words.role == "set"}
    has_set = bool(sets) or "reference" in found.chosen
    actual, still_open = _measured(columns, members, fed_back, has_set)
    measured = [*actual, *(found.chosen[one] for one in ("position", "motor_position") if one in found.chosen)]
    if len(still_open) == 1 and not measured:
        actual[still_open.pop()] = "the only column of this motion" + (" that is no set-point" if has_set else "")
    elif len(still_open) == 1 and not has_set:
        name = still_open.pop()
        if _lead(recording, name, measured[0]) > LEADS:
            sets[name] = f"it leads '{measured[0]}', which is measured"
        else:
            found.ask("reference", _two_readings(name, measured[0]), name)
    elif len(still_open) == 1 and {"position", "reference"} <= found.chosen.keys():
        actual[still_open.pop()] = "it moves with the position"
    elif len(still_open) == 2 and not measured and not has_set:
        lead = _lead(recording, *still_open)
        if abs(lead) > LEADS:
            first, second = still_open if lead > 0 else reversed(still_open)
            sets[first], actual[second] = f"it leads '{second}'", f"it follows '{first}'"
            still_open = []
    if still_open and not (measured and has_set):  # beside those that are known, a further one is left out
        names = quoted_names([*still_open, *measured])
        found.ask("position", f"the columns {names} move alike, and which is measured does not show", still_open[0])
        return
    sure = {name: fed_back[name] is True or why.startswith("its name") for name, why in (sets | actual).items()}
    if "reference" not in found.chosen and len(sets) == 1:
        (name,) = sets
        found.take("reference", name, "sure" if sure[name] else "likely", sets[name])
    elif "reference" not in found.chosen and sets:
        found.ask(
            "reference", f"the columns {quoted_names(list(sets))} are each called a set position", next(iter(sets))
        )
    _encoders(columns, recording, actual, sure, found)


def _measured(
    columns: dict[str, Column], members: Sequence[str], fed_back: Mapping[str, bool | None], has_set: bool
) -> tuple[dict[str, str], list[str]]:
    """Measured positions, each with the reason, and those that may be either."""
    actual, still_open = {}, []
    for name in members:
        words = columns[name].words
        if words.role == "actual":
            actual[name] = "its name"
        elif words.role is None and fed_back[name]:
            actual[name] = "the command moves against its noise"
        elif words.role is None and words.encoder is not None:
            actual[name] = "its name, of an encoder"
        elif words.role is None and words.quantity == "position" and has_set:
            actual[name] = "its name, beside a set-point"
        elif words.role is None:
            still_open.append(name)
    return actual, still_open


def _two_readings(name: str, measured: str) -> str:
    return (
        f"'{name}' moves with '{measured}' and may be the set position or a second encoder (then --column "
        f"motor_position or position)"
    )


def _lead(recording: Recording, name: str, other: str) -> float:
    """Correlation of the difference of two columns of one motion with its speed, if it is a lag; else zero.

    A set-point is ahead by a time, in proportion to the speed. A motor's encoder is ahead of the table by lost motion,
    which has the sign of the speed alone, and is no lead.
    """
    slope = recording.slope(name, other)
    speed = derivative(recording.mean(other), recording.mean_period, 1)
    # loops lag without shrinking a stroke: the slope is a unit, and would take up a part of the lag
    difference = recording.mean(name) / (slope or 1.0) - recording.mean(other)
    if slope is None or np.std(difference) == 0:
        return 0.0
    of_speed, of_sign = (float(np.corrcoef(difference, one)[0, 1]) for one in (speed, np.sign(speed)))
    return of_speed if 1.0 - of_speed**2 < LAG * (1.0 - of_sign**2) else 0.0


def _encoders(
    columns: dict[str, Column],
    recording: Recording,
    actual: Mapping[str, str],
    sure: Mapping[str, bool],
    found: Positions,
) -> None:
    """The scale and the motor's encoder among the measured positions."""
    left = [channel for channel in ("position", "motor_position") if channel not in found.chosen]
    if not actual:
        if "position" in left:
            others = quoted_names(list(found.chosen.values()))
            found.ask("position", f"no column is a measured position beside the set-point ({others})", "COLUMN")
        return
    names = list(actual)
    if len(actual) == 1 and left:
        channel, name = left[0], names[0]
        alone = ", the motor's encoder alone" if channel == "position" and _is_motor(columns[name]) else ""
        found.take(channel, name, "sure" if sure[name] else "likely", actual[name] + alone)
        return
    if len(actual) == 2 and len(left) == 2:
        motor, reason, certainty = _motor_of(columns, recording, (names[0], names[1]))
        if motor is not None:
            found.take("position", next(name for name in actual if name != motor), certainty, f"the scale: {reason}")
            found.take("motor_position", motor, certainty, reason)
            return
    found.ask(
        "position",
        f"{quoted_names(names)} are each a measured position: the scale's at the table is the position, the motor's "
        "encoder is motor_position",
        names[0],
    )


def _is_motor(column: Column) -> bool:
    return column.words.encoder == "motor" or _is_rotary(column)


def _is_rotary(column: Column) -> bool:
    unit = column.stated.unit
    return unit is not None and unit.split()[-1].lstrip("-") in _ROTARY


def _motor_of(
    columns: dict[str, Column], recording: Recording, pair: tuple[str, str]
) -> tuple[str | None, str, Certainty]:
    """The motor's encoder of two measured positions, by names, by units, or by lost motion; None where none says."""
    for says, reason in (
        (lambda one: one.words.encoder == "motor", "by their names"),
        (_is_rotary, "one is an angle, the other a length"),
    ):
        motors = [name for name in pair if says(columns[name])]
        if len(motors) == 1:
            return motors[0], reason, "sure"
    scales = [name for name in pair if columns[name].words.encoder == "scale"]
    if len(scales) == 1:
        return next(name for name in pair if name not in scales), "the other one is called a scale", "likely"
    first, second = pair
    slope = recording.slope(first, second)
    speed = derivative(recording.mean(second), recording.mean_period, 1)
    difference = recording.mean(first) / (slope or 1.0) - recording.mean(second)
    moving = np.abs(speed) > 0.1 * float(np.quantile(np.abs(speed), 0.999))
    forwards, backwards = difference[moving & (speed > 0)], difference[moving & (speed < 0)]
    if min(len(forwards), len(backwards)) == 0:
        return None, "", "likely"
    lost = float(np.mean(forwards) - np.mean(backwards))
    rest = float(np.hypot(np.std(forwards), np.std(backwards)))
    if abs(lost) < BEYOND_REST * rest:
        return None, "", "likely"
    return first if lost > 0 else second, "lost motion: the motor is ahead of the table in either direction", "likely"
