"""Names of files that a browser sends: kept as they are as far as a file system, and a command line, bears it."""

import unicodedata

LONGEST = 100  # characters, and so at most 400 bytes of a name; file systems take 255 bytes, see MOST_BYTES
MOST_BYTES = 200  # leaves room for the number of a second file of that name, and for endings
ALSO = " ._-()+,@"  # beside letters and digits; no sign that a shell, a URL or an option takes for its own
RESERVED = {"con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(1, 10))}  # of Windows


def safe_name(text: str) -> str:
    """A file name without folders, control characters and a dot before them; the extension stays.

    Examples:
        >>> safe_name("../../lap 1.csv")
        'lap 1.csv'

    """
    last = unicodedata.normalize("NFC", text).replace("\\", "/").rsplit("/", 1)[-1]
    kept = "".join(sign if sign.isalnum() or sign in ALSO else "_" for sign in last).lstrip(". -").rstrip(". ")
    stem, dot, extension = kept.rpartition(".")
    if not dot:
        stem, extension = kept, ""
    ending = dot + extension[:20]
    if stem.split(".")[0].casefold().strip() in RESERVED:
        stem = f"_{stem}"
    stem = (stem or "file")[: LONGEST - len(ending)]
    while len((stem + ending).encode()) > MOST_BYTES:
        stem = stem[:-1]
    return stem + ending


def numbered(name: str, number: int) -> str:
    """The name of the second, third, ... file that is called so: `lap-2.csv`."""
    stem, dot, extension = name.rpartition(".")
    return f"{stem}-{number}{dot}{extension}" if dot else f"{name}-{number}"
