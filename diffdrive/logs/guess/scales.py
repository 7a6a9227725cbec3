"""What one unit of each column is: as files state it, by columns of one motion, by the lead, and by the moving mass."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from diffdrive.logs.checks.dynamics import NOMINAL_STD
from diffdrive.logs.checks.explanation import FAULT_COST
from diffdrive.logs.checks.ranges import LINEAR
from diffdrive.logs.checks.ratios import SCALE_ERROR, UNIT_ERROR
from diffdrive.logs.checks.statistics import top_speed
from diffdrive.logs.column_unit import conversion
from diffdrive.logs.guess.columns import Column
from diffdrive.logs.guess.evidence import Balance, Recording
from diffdrive.logs.guess.result import Certainty, Guess, Question
from diffdrive.model.data_sheet import DataSheet
from diffdrive.model.motor_units import MissingKeysError, to_axis_si

LENGTHS = ("m", "mm", "um", "nm")  # what a header may leave unsaid: whoever logs in inches says so
ANGLES = ("deg", "rev", "rad")
FORCES = ("N", "kN", "N*m", "%", "0.1 %", "A")
CURRENTS = ("A", "%", "0.1 %")
SPEEDS = ("m/s", "mm/s", "m/min", "mm/min", "um/s", "rpm", "rev/s", "deg/s", "rad/s")
POSITIONS = ("position", "reference", "motor_position")
# a radian of the motor as a metre: what is left of an angle's unit is its radians
_RADIANS = DataSheet(lead=2.0 * math.pi)
_KEY_EXAMPLES = {
    "lead": "10 mm", "rated_torque": "5 N*m", "torque_constant": "1.2 N*m/A", "encoder_counts": "10000",
    "rated_current": "4 A",
}  # fmt: skip
NONE_FITS = 0.5 * 2.0**2  # nats: a stated mass is right within a factor of two, two standard deviations


class Reading(NamedTuple):
    """One unit that a column may have, and what it is in SI."""

    unit: str
    factor: float


@dataclass
class Scales:
    """Units by channel, the data sheet with what the trace adds to it, why, and what has to be asked."""

    sheet: DataSheet
    units: dict[str, str] = field(default_factory=dict)
    guesses: list[Guess] = field(default_factory=list)
    questions: list[Question] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)  # channels that are better not read
    implied_mass: float | None = None  # kg, by inverse dynamics with these units
    by_mass: str = ""  # why units that no header states are believed

    def ask(self, argument: str, channel: str, why: str, example: str) -> None:
        """Leave something open, once."""
        question = Question(argument, channel, why, example)
        if (argument, channel) not in {(one.argument, one.channel) for one in self.questions}:
            self.questions.append(question)

    def take(self, channel: str, unit: str, certainty: Certainty, why: str) -> None:
        """Choose a unit, with its sign."""
        self.units[channel] = unit
        self.guesses.append(Guess(f"unit of the {channel}", unit, certainty, why))


class Trace(NamedTuple):
    """What is known when units are looked for: columns by channel, what their headers and the user state."""

    recording: Recording
    chosen: Mapping[str, str]  # column by channel
    columns: Mapping[str, Column]
    given: Mapping[str, str]  # units by channel, by the user
    balance: Balance | None
    mass: float | None

    def stated(self, channel: str) -> str | None:
        """The unit of a channel that the user states, or else the file."""
        name = self.chosen.get(channel)
        return self.given.get(channel) or (None if name is None else self.columns[name].stated.unit)

    def slope(self, channel: str) -> float | None:
        """Units of a channel of the motion per unit of the position, or per unit of its speed."""
        name, position = self.chosen.get(channel), self.chosen["position"]
        if name is None:
            return None
        if channel == "velocity":
            return self.recording.slope_of_velocity(name, position)
        return 1.0 if channel == "position" else self.recording.slope(name, position)


def guess_scales(trace: Trace, sheet: DataSheet) -> Scales:
    """What one unit of each column is, or what has to be asked."""
    found = Scales(sheet)
    motor = _per_unit(trace, _RADIANS, of_motor=True)
    table = _per_unit(trace, DataSheet(kind=sheet.kind), of_motor=False)
    if table is not None and motor is not None and not sheet.is_rotary:
        _compare_lead(trace, found, table, motor)
    found.sheet = _with_plain_lead(found.sheet)
    lengths = _of_position(trace, found, table)
    forces = _of_command(trace, found)
    if found.questions or not lengths or not forces:
        return found
    chosen = _by_mass(trace, found, lengths, forces)
    if chosen is None:
        return found
    length, force = chosen
    if trace.balance is not None:
        found.implied_mass = _implied(trace.balance, length, force)
    _signed_command(trace, found, force)
    if "position" not in found.units:
        _say_position(trace, found, length, len(lengths) > 1)
    for channel in ("reference", "motor_position", "velocity"):
        if channel in trace.chosen:
            _follow(trace, found, channel, length.factor)
    return found


def _per_unit(trace: Trace, sheet: DataSheet, *, of_motor: bool) -> float | None:
    """What a unit of the position is (m, or rad) by the channels of the motion whose unit is stated.

    Those in angles of the motor, or those in lengths (of a rotary axis: angles) of the table.
    """
    for channel in (*POSITIONS, "velocity"):
        text, slope = trace.stated(channel), trace.slope(channel)
        if text is None or slope is None or (of_motor and _is_of_table(channel, text)):
            continue
        try:
            return abs(conversion(channel, text, {}, sheet).factor * slope)
        except ValueError:
            continue
    return None


def _is_of_table(channel: str, text: str) -> bool:
    """Whether a unit is of a length, for which no lead is needed."""
    try:
        conversion(channel, text, {})
    except ValueError:
        return False
    return True


def _compare_lead(trace: Trace, found: Scales, table: float, motor: float) -> None:
    """The lead by an angle and a length of one motion; asks where the user states another one."""
    per_turn = 2.0 * math.pi * table / motor
    lead = found.sheet.lead
    if lead is None:
        rounded = float(f"{1e3 * per_turn:.3g}") * 1e-3
        per_turn = rounded if abs(rounded / per_turn - 1.0) < 2e-3 else float(f"{per_turn:.4g}")
        found.sheet = replace(found.sheet, lead=per_turn * found.sheet.gear_ratio)
        found.guesses.append(
            Guess("lead", f"{1e3 * per_turn:g} mm per turn of the motor", "sure", "columns in angles and in lengths")
        )
        return
    ratio = lead / per_turn / found.sheet.gear_ratio
    if abs(ratio - 1.0) > SCALE_ERROR:
        found.ask(
            "gear_ratio",
            "",
            f"the trace shows {1e3 * per_turn:.4g} mm per turn of the motor, and a lead of {1e3 * lead:g} mm with a "
            f"gear ratio of {found.sheet.gear_ratio:g} is stated: give the motor's turns per turn of the screw, or "
            "correct the lead",
            f"{ratio * found.sheet.gear_ratio:.4g}",
        )


def _with_plain_lead(sheet: DataSheet) -> DataSheet:
    return sheet if sheet.lead is None else replace(sheet, lead=float(f"{sheet.lead:.10g}"))


def _of_position(trace: Trace, found: Scales, table: float | None) -> list[Reading]:
    """What the position's unit may be."""
    text = trace.stated("position")
    if text is not None:
        reading = _read(found, "position", text, f"the position '{trace.chosen['position']}' is in {text}")
        return [] if reading is None else [reading]
    rotary = found.sheet.travel_per_radian is not None
    names = [*(() if found.sheet.is_rotary else LENGTHS), *(ANGLES if rotary else ())]
    readings = [Reading(name, conversion("position", name, {}, found.sheet).factor) for name in names]
    if table is not None:  # another channel of this motion states its unit
        near = min(readings, key=lambda one: abs(math.log(one.factor / table)))
        if abs(math.log(near.factor / table)) < math.log(UNIT_ERROR):
            found.take("position", near.unit, "sure", "another column of this motion states its unit")
            return [near]
    if found.sheet.is_rotary:
        return readings
    travel = float(np.ptp(trace.recording.columns[trace.chosen["position"]]))
    speed = top_speed(trace.recording.mean(trace.chosen["position"]), trace.recording.mean_period)
    return [
        one
        for one in readings
        if LINEAR.smallest < travel * one.factor < LINEAR.longest and speed * one.factor < LINEAR.fastest
    ]


def _of_command(trace: Trace, found: Scales) -> list[Reading]:
    """What the command's unit may be; a unit that is stated counts with its sign."""
    text, name = trace.stated("command"), trace.chosen["command"]
    if text is not None:
        reading = _read(found, "command", text, f"the command '{name}' is in {text}", trace.given)
        return [] if reading is None else [reading]
    names = CURRENTS if trace.columns[name].words.quantity == "current" else FORCES
    readings = []
    for unit in names:
        try:
            readings.append(Reading(unit, conversion("command", unit, {}, found.sheet).factor))
        except ValueError:  # which the data sheet says too little to read
            continue
    if not readings:
        why = f"the command '{name}' may be in {' or '.join(names)}, and states no unit"
        found.ask("units", "command", why, names[0])
    return readings


def _read(found: Scales, channel: str, text: str, what: str, given: Mapping[str, str] | None = None) -> Reading | None:
    """A unit that is stated, in SI; asks for the numbers of the data sheet that it takes."""
    force_per = {"V": "force_per_volt", "A": "force_per_ampere"}
    known = {source: float(given[key]) for source, key in force_per.items() if given and key in given}
    try:
        return Reading(text, conversion(channel, text, known, found.sheet).factor)
    except ValueError as problem:
        if channel == "command" and "force_per_volt" in str(problem):
            found.ask("units", "force_per_volt", f"{what}, and how many N one volt makes is not known", "35.2")
            return None
        for key in _missing_keys(channel, text, found.sheet):
            or_kind = " (or --kind rotary)" if key == "lead" and channel == "position" else ""
            or_current = " (or rated torque and current)" if key == "torque_constant" else ""
            found.ask(
                key, "", f"{what}, which takes the {key.replace('_', ' ')}{or_kind}{or_current}", _KEY_EXAMPLES[key]
            )
        if not found.questions:
            found.ask("units", channel, f"{what}, which is no unit of the {channel}: {problem}", "mm")
        return None


def _missing_keys(channel: str, text: str, sheet: DataSheet) -> Iterator[str]:
    """The keys of [axis] without which a unit cannot be read."""
    unit = text.strip().lstrip("-")
    number = unit if unit[:1].isdigit() else f"1 {unit}"
    try:
        to_axis_si(number, {"command": "N", "velocity": "m/s"}.get(channel, "m"), sheet)
    except MissingKeysError as problem:
        yield from (key for key in _KEY_EXAMPLES if key in problem.keys)
    except ValueError:
        return


def _by_mass(
    trace: Trace, found: Scales, lengths: list[Reading], forces: list[Reading]
) -> tuple[Reading, Reading] | None:
    """The units with which inverse dynamics gives the moving mass; asks where several do, or none."""
    pairs = [(length, force) for length in lengths for force in forces]
    if len(pairs) == 1:
        return pairs[0]
    what = " and ".join(
        f"the unit of the {channel} '{trace.chosen[channel]}'"
        for channel, several in (("position", len(lengths) > 1), ("command", len(forces) > 1))
        if several
    )
    open_channels = [
        (channel, several) for channel, several in (("position", lengths), ("command", forces)) if len(several) > 1
    ]
    if trace.balance is None or not trace.balance.fit.mass.is_determined:
        for channel, several in open_channels:
            names = " or ".join(one.unit for one in several)
            why = f"the {channel} '{trace.chosen[channel]}' may be in {names}, and the motion does not decide"
            found.ask("units", channel, why, several[0].unit)
        return None
    if trace.mass is None:
        found.ask("mass", "", f"{what}: not stated, and the moving mass, which would decide, is not known", "500 kg")
        return None
    spread = math.hypot(NOMINAL_STD, trace.balance.fit.mass.std / abs(trace.balance.fit.mass.value))
    costs = [0.5 * (math.log(_implied(trace.balance, *pair) / trace.mass) / spread) ** 2 for pair in pairs]
    ranked = sorted(zip(costs, pairs, strict=True))  # the likeliest first
    best = ranked[0][0]
    rivals = [pair for cost, pair in ranked if cost < best + FAULT_COST]
    unit = "kg m^2" if found.sheet.is_rotary else "kg"
    implied = ", ".join(
        f"{length.unit} and {force.unit} make {_implied(trace.balance, length, force):.3g} {unit}"
        for length, force in (rivals if best < NONE_FITS else rivals[:1])
    )
    if best < NONE_FITS and len(rivals) == 1:
        length, force = rivals[0]
        shown = f"{_implied(trace.balance, length, force):.4g} {unit}"
        found.by_mass = f"no other makes the moving mass that is stated, {trace.mass:g} {unit}: the trace shows {shown}"
        if len(lengths) > 1:
            found.take("position", length.unit, "likely", found.by_mass)
        return length, force
    no = "" if best < NONE_FITS else "no unit that is known here fits: "
    why = f"is not stated; {no}{implied}, and {trace.mass:g} {unit} is stated"
    for channel, side in (("position", 0), ("command", 1)):
        readings = dict.fromkeys(pair[side].unit for pair in rivals)
        is_open = any(channel == one for one, _ in open_channels)
        if is_open and (len(readings) > 1 or best >= NONE_FITS):
            example = next(iter(readings)) if best < NONE_FITS else ("mm", "N")[side]
            found.ask("units", channel, f"the unit of the {channel} '{trace.chosen[channel]}' {why}", example)
            why = "neither"
    return None


def _implied(balance: Balance, length: Reading, force: Reading) -> float:
    """The moving mass (kg) that these units make of the balance."""
    return abs(balance.fit.mass.value * force.factor / length.factor)


def _signed_command(trace: Trace, found: Scales, force: Reading) -> None:
    """The command's unit with the sign that the motion shows."""
    name = trace.chosen["command"]
    if "command" in trace.given:
        found.take("command", force.unit, "stated", "by you")
        if trace.balance is not None and trace.balance.sign * force.factor < 0:
            found.notes.append(f"the command '{name}' in {force.unit} pushes against the motion: its sign is reversed")
        return
    if trace.balance is None:
        found.ask(
            "units",
            "command",
            f"the sign of the command '{name}' does not show: mass and friction do not explain it by the motion, which "
            "takes strokes in both directions; state its unit, with a minus where it is reversed",
            force.unit,
        )
        return
    unit = force.unit if trace.balance.sign > 0 else f"-{force.unit}"
    is_stated = trace.columns[name].stated.unit is not None
    sign = (
        "friction and inertia have the right sign"
        if trace.balance.sign > 0
        else ("reversed, for otherwise friction and inertia would be negative")
    )
    found.take(
        "command", unit, "sure" if is_stated else "likely", f"{'by its header' if is_stated else found.by_mass}; {sign}"
    )


def _say_position(trace: Trace, found: Scales, length: Reading, several: bool) -> None:
    if "position" in trace.given:
        found.take("position", length.unit, "stated", "by you")
    elif trace.stated("position") is not None:
        found.take("position", length.unit, "sure", "by its header")
    else:
        found.take("position", length.unit, "likely", "no other makes an axis's travel and speed")


def _follow(trace: Trace, found: Scales, channel: str, position: float) -> None:
    """The unit of a channel of the motion: as stated where the position agrees, else what the position makes of it."""
    slope, text = trace.slope(channel), trace.stated(channel)
    if channel in trace.given:
        found.take(channel, trace.given[channel], "stated", "by you")
        return
    if slope is None:
        found.left_out.append(channel)
        found.notes.append(f"{channel}: left out, '{trace.chosen[channel]}' does not go with the position")
        return
    wanted = position / abs(slope)
    tolerance = math.log(UNIT_ERROR if channel == "reference" else 1.0 + SCALE_ERROR)
    minus = "-" if slope < 0 else ""
    names = (text,) if text is not None else (SPEEDS if channel == "velocity" else (*LENGTHS, *ANGLES))
    for unit in names:
        try:
            factor = conversion(channel, unit, {}, found.sheet).factor
        except ValueError:
            continue
        if abs(math.log(factor / wanted)) < tolerance:
            why = "by its header, and the position agrees" if text is not None else "so it goes with the position"
            found.take(channel, f"{minus}{unit}", "sure", why + (", reversed" if minus else ""))
            return
    if text is not None:
        found.left_out.append(channel)
        found.notes.append(
            f"{channel}: left out, one unit of '{trace.chosen[channel]}' is {wanted:.4g} SI by the position, and its "
            f"header says {text}"
        )
        return
    si = ("rad" if found.sheet.is_rotary else "m") + ("/s" if channel == "velocity" else "")
    found.take(
        channel, f"{minus}{wanted:.6g} {si}", "likely", "no unit that is known here: so it goes with the position"
    )
