"""What a log is called: its file without the extension, and the folder before it where two would be called alike."""

from pathlib import PurePath

TEXT = (".csv", ".tsv", ".txt", ".dat", ".asc")
MAT = (".mat",)
PARQUET = (".parquet", ".pq")
EXTENSIONS = (*TEXT, *MAT, *PARQUET)


def means(name: str, log: str | PurePath) -> bool:
    """Whether `name`, such as "lap2", "lap2.csv" or "monday/lap2", means a log, given by its file or its own name."""
    wanted, parts = _parts(name), _parts(log)
    return bool(wanted) and parts[-len(wanted) :] == wanted


def _parts(log: str | PurePath) -> tuple[str, ...]:
    path = PurePath(log)
    return path.with_suffix("").parts if path.suffix.lower() in EXTENSIONS else path.parts
