"""Which column is the time, in which unit, and the rate of the rows."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.clocks.stamps import seconds_from_text
from diffdrive.logs.column_unit import conversion
from diffdrive.logs.formats.table import Table
from diffdrive.logs.guess.names import words_of
from diffdrive.logs.guess.result import Certainty, Guess, Question
from diffdrive.logs.guess.units import stated_unit
from diffdrive.logs.log import Signal
from diffdrive.support.messages import quoted_names

UNITS = ("s", "ms", "us", "100 ns", "ns")
# Hz, of the rows of a trace: a control traces in cycles of its position loop, 50 Hz at the slowest, to those of its
# current loop, 50 kHz at the fastest. A step that only one unit puts there is in that unit.
SLOWEST, FASTEST = 45.0, 55e3


class Clock(NamedTuple):
    """The time's column and unit (None: none, or as the file says), its stamps [n] in s, and the period (s)."""

    column: str | None
    unit: str | None
    times: Signal
    period: float


def guess_clock(
    table: Table, columns: Mapping[str, str], units: Mapping[str, str], rate: float | None
) -> tuple[Clock | None, list[Guess], list[Question]]:
    """The clock of a trace, or what has to be asked of it; `columns` and `units` are what the user stated."""
    column, why, questions = _column(table, columns)
    if questions:
        return None, [], questions
    if column is None:
        return _counted(table, rate)
    certainty: Certainty = "stated" if "time" in columns else "sure"
    if (parsed := seconds_from_text(table, column)) is not None:
        times, unit, reason = parsed[0], None, "dates or times of day"
    else:
        numbers = table.numbers(column)
        unit = units.get("time") or stated_unit(table, column).unit
        reason = "stated" if "time" in units else "by its header"
        if unit is None:
            step = float(np.median(np.diff(numbers)))
            fitting = [one for one in UNITS if step > 0 and SLOWEST < 1.0 / (_seconds(one) * step) < FASTEST]
            is_named = "time" in columns or words_of(column).quantity == "time"
            if len(fitting) != 1 or (not is_named and step == 1.0):
                return None, [], [_of_unit(column, step, fitting, is_named)]
            unit, reason = fitting[0], f"steps of {step:g}: any other unit makes a rate that no control has"
        times = _seconds(unit) * numbers
    steps = np.diff(times[np.isfinite(times)])
    period = float(np.mean(steps[steps < 1.75 * np.median(steps)])) if len(steps) else 0.0
    if not period > 0.0:
        raise LogError(
            f"{table.source}: column '{column}': does not rise from row to row; name another one as the time"
        )
    unit_text = "" if unit is None else f" in {unit}"
    return (
        Clock(column, unit, times, period),
        [Guess("time", f"'{column}'{unit_text}, {1.0 / period:.6g} Hz", certainty, f"{why}; {reason}")],
        [],
    )


def _seconds(unit: str) -> float:
    return conversion("time", unit, {}).factor


def _column(table: Table, columns: Mapping[str, str]) -> tuple[str | None, str, list[Question]]:
    if "time" in columns:
        return columns["time"], "stated", []
    others = set(table.clocks.values())
    rising = [name for name in table.columns if name not in others and _rises(table, name)]
    named = [name for name in rising if words_of(stated_unit(table, name).name).quantity == "time"]
    by_unit = [name for name in rising if stated_unit(table, name).kinds[:1] == ("time",)]
    for found, why in ((sorted({*named} & {*by_unit}), "name and unit"), (named, "its name"), (by_unit, "its unit")):
        exact = [name for name in found if name.casefold() == "time"]
        if len(exact or found) == 1:
            return (exact or found)[0], f"{why}, and it rises evenly", []
        if found:
            text = f"the columns {quoted_names(found)} may each be the time"
            return None, "", [Question("columns", "time", text, found[0])]
    unnamed = [name for name in rising if words_of(name).quantity is None]
    if len(unnamed) == 1:
        return unnamed[0], "the only column that rises evenly", []
    if unnamed:
        text = f"the columns {quoted_names(unnamed)} rise evenly, and each may be the time"
        return None, "", [Question("columns", "time", text, unnamed[0])]
    return None, "", []


def _rises(table: Table, name: str) -> bool:
    """Whether a column never goes back, and its steps are about as long as one another; or holds dates."""
    try:
        if seconds_from_text(table, name) is not None:
            return True
        values = table.numbers(name)
    except LogError:
        return False
    values = values[np.isfinite(values)]
    steps = np.diff(values)
    if len(steps) < 2 or np.any(steps < 0) or not np.any(steps > 0):
        return False
    # a position of one stroke has slow ends; a clock, also a coarse one, has run half its way in half of its rows
    quarters = np.interp([0.25, 0.5, 0.75], np.linspace(0.0, 1.0, len(values)), (values - values[0]) / np.ptp(values))
    return bool(np.all(np.abs(quarters - [0.25, 0.5, 0.75]) < 0.02))


def _of_unit(column: str, step: float, fitting: list[str], is_named: bool) -> Question:
    if not is_named:
        text = f"'{column}' counts rows, or is a time: say what one step of it is"
        return Question("units", "time", text, "0.5 ms")
    if not fitting:
        return Question("units", "time", f"the time '{column}' has steps of {step:g} of an unknown unit", "ms")
    rates = " or ".join(f"{one} ({1.0 / (_seconds(one) * step):g} Hz)" for one in fitting)
    return Question("units", "time", f"the time '{column}' may be in {rates}", fitting[0])


def _counted(table: Table, rate: float | None) -> tuple[Clock | None, list[Guess], list[Question]]:
    if rate is None:
        return None, [], [Question("rate", "", "no column is a time, and the rate of the rows is not known", "1 kHz")]
    count = max(len(values) for values in table.columns.values())
    guess = Guess("time", f"none, counted at {rate:g} Hz", "stated", "no column is a time")
    return Clock(None, None, np.arange(count) / rate, 1.0 / rate), [guess], []
