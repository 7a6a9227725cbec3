"""The whole guess of an unknown trace: its clock, its columns, their units."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from diffdrive.errors import LogError
from diffdrive.logs.formats.table import Table
from diffdrive.logs.guess.clock import guess_clock
from diffdrive.logs.guess.columns import read_columns
from diffdrive.logs.guess.commands import guess_command, guess_others
from diffdrive.logs.guess.evidence import Balance
from diffdrive.logs.guess.positions import guess_positions
from diffdrive.logs.guess.result import Guess, Question
from diffdrive.logs.guess.scales import Trace, guess_scales
from diffdrive.logs.mapping import ColumnMapping
from diffdrive.logs.select import column_named
from diffdrive.model.data_sheet import NO_SHEET, DataSheet


@dataclass
class TraceGuess:
    """What a trace is, as far as it could be guessed; where `questions` are left, the rest is not to be used.

    `rate` (Hz) is that of the rows. `implied_mass` (kg) is that of inverse dynamics, None where the motion does not
    show it. `balance` is in units of the columns.
    """

    columns: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    sheet: DataSheet = NO_SHEET
    rate: float | None = None
    guesses: list[Guess] = field(default_factory=list)
    questions: list[Question] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    implied_mass: float | None = None
    balance: Balance | None = None


def guess_trace(
    table: Table,
    *,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    sheet: DataSheet = NO_SHEET,
    mass: float | None = None,
    rate: float | None = None,
) -> TraceGuess:
    """Guess what the columns of a trace are, and what their units are; what cannot be guessed is asked.

    Args:
        table: The columns of a file, as `read_table` reads them.
        columns: The column of each channel that the user knows.
        units: Its unit, likewise; force_per_volt and force_per_ampere, too.
        sheet: What the data sheets say.
        mass: The moving mass (kg), by which units are told apart that no header states.
        rate: Rate of the rows (Hz), where no column is a time.

    Raises:
        LogError: A column or channel that is stated does not exist, or nothing of the file can be read.

    Examples:
        >>> found = guess_trace(read_table("trace.csv"), mass=500.0)
        >>> print(*found.guesses, *found.questions, sep="; ")

    """
    given = {channel: column_named(table, channel, name, sheet) for channel, name in (columns or {}).items()}
    units = dict(units or {})
    ColumnMapping(sheet=sheet).overridden(
        given, {key: text for key, text in units.items() if key.startswith("force")}, {}
    )
    found = TraceGuess(sheet=sheet)
    clock, guesses, questions = guess_clock(table, given, units, rate)
    found.guesses += guesses
    found.questions += questions
    if clock is None:
        return found
    found.rate = 1.0 / clock.period
    if clock.column is not None:
        found.columns["time"] = clock.column
    if clock.unit is not None:
        found.units["time"] = clock.unit
    described, recording = read_columns(table, clock.column, clock.times, clock.period)
    for channel, name in given.items():
        if channel != "time" and name not in described:
            raise LogError(f"{table.source}: column '{name}': holds one value throughout, and is no {channel}")
    if not described:
        raise LogError(f"{table.source}: no column changes beside the time; log a motion")
    positions = guess_positions(described, recording, given)
    found.columns |= positions.chosen
    found.guesses += positions.guesses
    found.questions += positions.questions
    if "position" not in found.columns:
        return found
    command, balance, guesses, questions = guess_command(described, recording, found.columns["position"], given, sheet)
    found.guesses += guesses
    found.questions += questions
    if command is None:
        return found
    found.columns["command"] = command
    found.columns |= {channel: name for channel, name in given.items() if channel not in found.columns}
    others, guesses, notes = guess_others(described, recording, found.columns)
    found.columns |= others
    found.guesses += guesses
    scales = guess_scales(Trace(recording, found.columns, described, units, balance, mass), sheet)
    found.sheet, found.implied_mass, found.balance = scales.sheet, scales.implied_mass, balance
    found.units |= scales.units
    found.guesses += scales.guesses
    found.questions += scales.questions
    found.notes += [*scales.notes, *notes]
    for channel in scales.left_out:
        del found.columns[channel]
    for channel in found.columns:
        text = units.get(channel) or described[found.columns[channel]].stated.unit if channel != "time" else None
        if channel not in found.units and text is not None:
            found.units[channel] = text
    found.units |= {key: text for key, text in units.items() if key.startswith("force_per")}
    return found
