"""The table [provenance] of a drive file: what the axis is, where its numbers are from, what of it is measured.

It is about the numbers of its own file. A program that finds other numbers says in the file that it writes where those
are from, so that an axis does not carry the table on.
"""

from dataclasses import dataclass, fields

from diffdrive.errors import DriveFileError
from diffdrive.support.messages import short_repr, suggestion

# by key, in the order in which they are printed
MEANINGS = {
    "title": "what the axis is, in one line: what `diffdrive axes` prints",
    "source": "where its numbers are from: a publication, a data sheet, an identification",
    "measured": "what of them is measured, by whom and how",
    "assumed": "what of them is typical, or a guess",
}


@dataclass(frozen=True)
class Provenance:
    """Where the numbers of a drive file are from; "" for what it does not say.

    Examples:
        >>> axes()["emps"].provenance.source

    """

    title: str = ""  # what the axis is, in one line
    source: str = ""  # a publication, a data sheet, an identification
    measured: str = ""  # what is measured, by whom and how
    assumed: str = ""  # what is typical, or a guess

    @classmethod
    def of(cls, table: object, file: str) -> "Provenance":
        """From the table of a drive file. Raises `DriveFileError`, which names the `file`, for what is none."""
        if not isinstance(table, dict):
            raise DriveFileError(f"{file}: [provenance] must be a table, got {short_repr(table)}")
        known = [field.name for field in fields(cls)]
        for key, text in table.items():
            if key not in known:
                raise DriveFileError(f"{file}: [provenance] {key}: unknown key; {suggestion(key, known)}")
            if not isinstance(text, str) or not text.strip() or not text.isprintable():
                raise DriveFileError(
                    f"{file}: [provenance] {key}: must be a text of one line in quotation marks, got {short_repr(text)}"
                )
        return cls(**table)
