"""Time stamps that are no seconds in floating point: dates, times of day, and counters of many digits."""

import re

import numpy as np

_TIME_OF_DAY = re.compile(r"\d{2}:\d{2}(:\d{2}([.,]\d+)?)?")
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}[T ].*")
_ZONE = re.compile(r"\s*(Z|[-+]\d{2}:?\d{2})$")
_EXACT = 2**53  # above this a float64 no longer holds every whole number


def text_seconds(cells: np.ndarray) -> tuple[np.ndarray, str] | None:
    """Seconds since the first stamp of dates (ISO 8601) or times of day, and a note; None if they are neither."""
    texts = [str(cell).strip() for cell in cells]
    is_time_of_day = _TIME_OF_DAY.fullmatch(texts[0])
    if not is_time_of_day and not _DATE.fullmatch(texts[0]):
        return None
    day = "1970-01-01T" if is_time_of_day else ""
    try:
        plain = [day + _ZONE.sub("", text).replace(",", ".") if text else "NaT" for text in texts]
        stamps = np.array(plain, dtype="datetime64[ns]")
    except ValueError:
        return None
    since = stamps - stamps[0]
    seconds = np.where(np.isnat(since), np.nan, since.astype(np.int64) * 1e-9)
    return seconds, f"time is counted from its first stamp, {texts[0]}"


def integer_seconds(counts: np.ndarray) -> tuple[np.ndarray, str] | None:
    """Counts since the first one, and a note, where a float64 would round them; None where it would not."""
    if len(counts) == 0 or int(counts.max()) < _EXACT:
        return None
    begin = int(counts[0])
    # as Python integers: a difference of unsigned ones would wrap
    return np.array([int(count) - begin for count in counts], dtype=np.float64), f"time is counted from {begin}"
