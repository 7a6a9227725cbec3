"""Time stamps that are no seconds in floating point: dates, times of day, and counters of many digits."""

import re

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.formats.table import MISSING, Table, is_number_of_any_style

FORMS = "seconds or counts, 9:00:00.000, 2024-03-26 12:00:00.000 or 26.03.2024 12:00:00.000"
_CLOCK = r"(?P<hour>\d{1,2})(?P<rest>:\d{2}(:\d{2}([.,]\d+)?)?)"
_TIME_OF_DAY = re.compile(_CLOCK)
_ISO = re.compile(rf"(?P<date>\d{{4}}-\d{{2}}-\d{{2}})[T ]{_CLOCK}\s*(Z|[-+]\d{{2}}:?\d{{2}})?")
_DAY_FIRST = re.compile(rf"(?P<day>\d{{1,2}})\.(?P<month>\d{{1,2}})\.(?P<year>\d{{4}})[T ]\s*{_CLOCK}")
_FORMS = (_TIME_OF_DAY, _ISO, _DAY_FIRST)
_EXACT = 2**53  # above this a float64 no longer holds every whole number
_ROWS_TRIED = 3  # rows: where none of the first is readable, the column has another form


def parse_dates(table: Table, column: str) -> np.ndarray | None:
    """A column of dates or times of day as datetime64, NaT where a cell is empty; None if it holds something else.

    Raises `LogError` for a cell that is none among others that are, and for a column of which no cell can be read.
    """
    values = table.columns[column]
    if values.dtype.kind != "O":
        return None
    texts = [str(cell).strip() for cell in values]
    filled = [k for k, text in enumerate(texts) if text.casefold() not in MISSING]
    form = next((form for form in _FORMS if filled and form.fullmatch(texts[filled[0]])), None)
    if form is None:
        _require_numbers(table, column, texts, filled[:_ROWS_TRIED])
        return None
    stamps = {k: _iso_stamp(form, texts[k]) for k in filled}
    try:
        return np.array([stamps.get(k, "NaT") for k in range(len(texts))], dtype="datetime64[ns]")
    except ValueError:
        bad = next(k for k in filled if not _is_date(stamps[k]))
    raise LogError(
        f"{table.source}: {table.where(bad)}, column '{column}': '{texts[bad]}' is no time like "
        f"'{texts[filled[0]]}'; correct or empty this cell"
    )


def seconds_from_text(table: Table, column: str) -> tuple[np.ndarray, str] | None:
    """Seconds since the first stamp of a column of dates or times of day, and a note; None if it holds neither."""
    stamps = parse_dates(table, column)
    if stamps is None:
        return None
    first = int(np.argmin(np.isnat(stamps)))
    since = stamps - stamps[first]
    seconds = np.where(np.isnat(since), np.nan, since.astype(np.int64) * 1e-9)
    return seconds, f"time is counted from its first stamp, {str(table.columns[column][first]).strip()}"


def counts_from_first(counts: np.ndarray) -> tuple[np.ndarray, str] | None:
    """Counts since the first one, and a note, where a float64 would round them; None where it would not."""
    if len(counts) == 0 or int(counts.max()) < _EXACT:
        return None
    first = int(counts[0])
    # as Python integers: a difference of unsigned ones would wrap
    return np.array([int(count) - first for count in counts], dtype=np.float64), f"time is counted from {first}"


def _iso_stamp(form: re.Pattern[str], text: str) -> str:
    """A stamp of this form as numpy reads it; one of another form becomes what numpy refuses."""
    match = form.fullmatch(text)
    if match is None:
        return "another form"
    date = match.groupdict().get("date", "1970-01-01")
    if form is _DAY_FIRST:
        date = f"{match['year']}-{int(match['month']):02}-{int(match['day']):02}"
    return f"{date}T{int(match['hour']):02}{match['rest'].replace(',', '.')}"


def _is_date(stamp: str) -> bool:
    try:
        np.datetime64(stamp, "ns")
    except ValueError:  # no such day or hour, too
        return False
    return True


def _require_numbers(table: Table, column: str, texts: list[str], rows: list[int]) -> None:
    """Raise `LogError` where none of these rows is a number: not one cell is wrong, but the form of all."""
    if rows and not any(is_number_of_any_style(texts[k]) for k in rows):
        raise LogError(
            f"{table.source}: {table.where(rows[0])}, column '{column}': '{texts[rows[0]]}' is no time that can be "
            f"read; export it as {FORMS}"
        )
