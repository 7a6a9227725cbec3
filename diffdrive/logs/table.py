"""What a file holds before anybody asks what it means: named columns of one length or several."""

import re
from dataclasses import dataclass, field

import numpy as np

from diffdrive.errors import LogError

NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?\s*")
MISSING = ("", "nan", "na", "n/a", "#n/a", "null", "none", "-nan", "inf", "-inf", "+inf", "infinity", "-infinity")


@dataclass(frozen=True)
class Table:
    """Columns by name, one-dimensional: numbers, or text where some cell is no number; `source` names the file.

    `units` are those that the file itself states, by column; `lines` the line of each row in a text file.
    """

    source: str
    columns: dict[str, np.ndarray]
    units: dict[str, str] = field(default_factory=dict)
    lines: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    def where(self, row: int) -> str:
        """Row `row` as an engineer finds it in the file: its line, or its number counted from 1."""
        return f"row {row + 1}" if self.lines is None else f"line {self.lines[row]}"

    def numbers(self, name: str) -> np.ndarray:
        """A column as float64, NaN where a cell is empty; raises `LogError` naming the first cell that is no number."""
        values = self.columns[name]
        if values.dtype.kind in "fiub":
            return values.astype(np.float64)
        cells = [str(cell).strip() for cell in values]
        bad = next((k for k, cell in enumerate(cells) if not _numeric(cell)), None)
        if bad is None:
            return np.array([_value(cell) for cell in cells])
        raise LogError(
            f"{self.source}: {self.where(bad)}, column '{name}': '{cells[bad]}' is not a number; "
            "correct or empty this cell"
        )


def _numeric(cell: str) -> bool:
    return cell.casefold() in MISSING or NUMBER.fullmatch(cell) is not None


def _value(cell: str) -> float:
    return np.nan if cell.casefold() in MISSING else float(cell.replace("D", "E").replace("d", "e"))
