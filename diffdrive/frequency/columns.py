"""A frequency response from the columns of a table: which is which, and in which unit."""

import re
from collections.abc import Mapping

import numpy as np
from jaxtyping import Complex, Float

from diffdrive.errors import LogError
from diffdrive.logs.formats.table import Table
from diffdrive.support.messages import quoted_names, shortened

# names in lower case, without what stands in brackets
NAMES = {
    "frequency": ("frequency", "freq", "f", "omega", "w", "frequenz"),
    "magnitude": ("magnitude", "mag", "amplitude", "ampl", "gain", "betrag", "amplitudengang"),
    "phase": ("phase", "phi", "phasengang"),
    "real": ("real", "re", "real part", "realteil"),
    "imaginary": ("imaginary", "imag", "im", "imaginary part", "imaginärteil"),
    "coherence": ("coherence", "coh", "kohärenz", "koharenz"),
}
UNITS = {
    "frequency": {"hz": 1.0, "khz": 1e3, "rad/s": 1.0 / (2.0 * np.pi)},
    "phase": {"deg": np.pi / 180.0, "°": np.pi / 180.0, "degree": np.pi / 180.0, "degrees": np.pi / 180.0, "rad": 1.0},
}
RATIOS = ("1", "-", "abs", "ratio", "linear")  # of a magnitude; with it dB
_UNIT = re.compile(r"(?P<name>[^\[(]*[^\s\[(])\s*[\[(](?P<unit>[^\])]*)[\])]\s*")


def response_of_table(
    table: Table, columns: Mapping[str, str], units: Mapping[str, str]
) -> tuple[Float[np.ndarray, " f"], Complex[np.ndarray, " f"], Float[np.ndarray, " f"] | None]:
    """Frequency (Hz, 0 and above, rising), value, and coherence where there is one; raises `LogError`."""
    found = _Columns(table, columns, units)
    frequency = found.numbers("frequency") * found.factor("frequency")
    if found.has("magnitude") and found.has("phase"):
        magnitude = found.numbers("magnitude")
        if found.is_in_decibels():
            magnitude = 10.0 ** (magnitude / 20.0)
        elif np.any(magnitude < 0.0):
            row = int(np.argmax(magnitude < 0.0))
            raise found.fail("magnitude", f"{table.where(row)} is below 0, as no ratio is; if it is in dB, say so")
        value = magnitude * np.exp(1j * found.numbers("phase") * found.factor("phase"))
    elif found.has("real") and found.has("imaginary"):
        value = found.numbers("real") + 1j * found.numbers("imaginary")
    else:
        raise LogError(
            f"{table.source}: needs the columns magnitude and phase, or real and imaginary; has "
            f"{quoted_names(list(table.columns), 'magnitude', 'columns')}; name them in `columns`"
        )
    wrong = (frequency < 0.0) | (np.diff(frequency, prepend=-np.inf) <= 0.0)
    if np.any(wrong):
        where = table.where(int(np.argmax(wrong)))
        raise found.fail("frequency", f"{where} is not above the one before; sort by frequency, each once")
    return frequency, value, found.numbers("coherence") if found.has("coherence") else None


class _Columns:
    """Which column is which quantity, and its unit."""

    def __init__(self, table: Table, columns: Mapping[str, str], units: Mapping[str, str]) -> None:
        for what, given in (("columns", columns), ("units", units)):
            if unknown := [name for name in given if name not in NAMES]:
                raise LogError(
                    f"{table.source}: {what}: no quantity is called {unknown[0]!r}; one of {', '.join(NAMES)}"
                )
        self.table, self.stated = table, dict(units)
        self.column: dict[str, str] = {}
        self.unit: dict[str, str] = {}
        for header in table.columns:
            split = _UNIT.fullmatch(header)
            name = (split["name"] if split else header).strip('" ').casefold()
            unit = table.units.get(header) or (split["unit"].strip() if split else "")
            for quantity, names in NAMES.items():
                wanted = columns.get(quantity)
                if header == wanted or (wanted is None and name in names):
                    if quantity in self.column:
                        raise LogError(
                            f"{table.source}: columns '{shortened(self.column[quantity])}' and '{shortened(header)}' "
                            f"may both be the {quantity}; say which, as columns={{'{quantity}': '...'}}"
                        )
                    self.column[quantity], self.unit[quantity] = header, unit
        for quantity, wanted in columns.items():
            if quantity not in self.column:
                raise LogError(
                    f"{table.source}: has no column '{shortened(wanted)}' for the {quantity}; has "
                    f"{quoted_names(list(table.columns), wanted, 'columns')}"
                )

    def has(self, quantity: str) -> bool:
        return quantity in self.column

    def fail(self, quantity: str, problem: str) -> LogError:
        """What is wrong with the column of a quantity."""
        return LogError(f"{self.table.source}: column '{shortened(self.column[quantity])}': {problem}")

    def numbers(self, quantity: str) -> Float[np.ndarray, " f"]:
        """The column of a quantity, every cell of which has a finite number."""
        if quantity not in self.column:
            raise LogError(
                f"{self.table.source}: has no column of the {quantity}; has "
                f"{quoted_names(list(self.table.columns), quantity, 'columns')}; name it in `columns`"
            )
        values = self.table.numbers(self.column[quantity])
        if not np.all(np.isfinite(values)):
            row = int(np.argmax(~np.isfinite(values)))
            raise self.fail(quantity, f"{self.table.where(row)} holds no number; remove this row")
        return values

    def unit_of(self, quantity: str) -> str:
        """The unit that is stated, for the call or in the file; "" where none is."""
        return self.stated.get(quantity, self.unit[quantity]).strip()

    def factor(self, quantity: str) -> float:
        """What one unit of the column is, in Hz or rad."""
        known, unit = UNITS[quantity], self.unit_of(quantity)
        if unit.casefold() not in known:
            raise self.fail(quantity, _unit_problem(quantity, unit, [name for name in known if name != "°"]))
        return float(known[unit.casefold()])

    def is_in_decibels(self) -> bool:
        """Whether the magnitude is in dB, or else a ratio."""
        unit = self.unit_of("magnitude").casefold()
        if unit not in ("db", *RATIOS):
            raise self.fail("magnitude", _unit_problem("magnitude", unit, ["dB", "1"]))
        return unit == "db"


def _unit_problem(quantity: str, unit: str, known: list[str]) -> str:
    said = f"'{shortened(unit)}' is no unit of the {quantity}" if unit else f"does not say the unit of the {quantity}"
    mend = " or ".join([", ".join(known[:-1]), known[-1]])
    return f"{said}: write {mend} behind its name in brackets, or as units={{'{quantity}': '{known[0]}'}}"
