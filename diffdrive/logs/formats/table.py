"""The columns of a file before their meaning is known: named arrays of one length or several."""

import re
from dataclasses import dataclass, field

import numpy as np

from diffdrive.errors import LogError
from diffdrive.support.messages import shortened

FEW = 5  # columns that are named one by one
NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?\s*")
# one to three digits, then groups of three: 1.004 may mean 1004, but 0.004 and 1.5 are no thousands
GROUPED = re.compile(r"\s*[-+]?(?!0+[.,])\d{1,3}(\.\d{3})+(,\d*)?\s*|\s*[-+]?(?!0+[.,])\d{1,3}(,\d{3})+(\.\d*)?\s*")
MISSING = ("", "nan", "na", "n/a", "#n/a", "null", "none", "-nan", "inf", "-inf", "+inf", "infinity", "-infinity")


@dataclass(frozen=True)
class Table:
    """Columns by name, one-dimensional: numbers, or text where some cell is no number; `source` names the file.

    `units` are those that the file itself states, by column; `lines` the line of each row in a text file, `decimal` its
    decimal sign; `clocks` the column of each column's own time stamps, where a file has several clocks;
    `skipped` what the file holds beside its columns, and why each is no column.
    """

    source: str
    columns: dict[str, np.ndarray]
    units: dict[str, str] = field(default_factory=dict)
    lines: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    decimal: str = "."
    clocks: dict[str, str] = field(default_factory=dict)
    skipped: dict[str, str] = field(default_factory=dict)

    def where(self, row: int) -> str:
        """Row `row` as an engineer finds it in the file: its line, or its number counted from 1."""
        return f"row {row + 1}" if self.lines is None else f"line {self.lines[row]}"

    def numbers(self, name: str) -> np.ndarray:
        """A column as float64, NaN where a cell is empty; raises `LogError` naming the first cell that is no number."""
        values = self.columns[name]
        if values.dtype.kind in "fiub":
            return values.astype(np.float64)
        cells = [str(cell).strip() for cell in values]
        bad = next((k for k, cell in enumerate(cells) if not is_number(cell, self.decimal)), None)
        if bad is None:
            return np.array([_value(cell) for cell in cells])
        raise LogError(
            f"{self.source}: {self.where(bad)}, column '{shortened(name)}': '{shortened(cells[bad])}' is "
            f"{_why_not_a_number(cells[bad], self.decimal)}"
        )


def skipped_note(skipped: dict[str, str]) -> tuple[str, ...]:
    """A note on what looks like a signal and is none; no note where there is none."""
    if not skipped:
        return ()
    return (f"left out, since a signal is one number in each row: {skipped_text(skipped)}",)


def skipped_text(skipped: dict[str, str]) -> str:
    """The first of what was skipped, with the reasons, and how many more there are."""
    named = [f"'{shortened(name)}' {shortened(why)}" for name, why in list(skipped.items())[:FEW]]
    return ", ".join(named) + (f" and {len(skipped) - FEW} more" if len(skipped) > FEW else "")


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number with this decimal sign, or stands for a missing one."""
    if cell.casefold() in MISSING:
        return True
    return _is_written_as_number(cell, decimal) and bool(np.isfinite(_value(cell)))  # and not of 400 digits


def _is_written_as_number(cell: str, decimal: str) -> bool:
    """Whether a cell is written as a number."""
    # a point beside a decimal comma separates thousands, or is a decimal sign too: nobody can say which
    return not (decimal == "," and "." in cell) and NUMBER.fullmatch(cell.replace(decimal, ".")) is not None


def is_number_of_any_style(cell: str) -> bool:
    """Whether a cell is a number with a decimal point or comma, or with thousands in groups."""
    return NUMBER.fullmatch(cell.replace(",", ".")) is not None or GROUPED.fullmatch(cell) is not None


def _why_not_a_number(cell: str, decimal: str) -> str:
    if _is_written_as_number(cell, decimal):
        return "larger than any double-precision number; correct or empty this cell"
    if not is_number_of_any_style(cell):
        return "not a number; correct or empty this cell"
    return (
        f"not a number where the decimal sign is '{decimal}'; remove the thousands separators, and write decimals with "
        "one sign"
    )


def _value(cell: str) -> float:
    return np.nan if cell.casefold() in MISSING else float(re.sub("[dD]", "e", cell.replace(",", ".")))
