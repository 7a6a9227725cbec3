"""Text files as editors and shells write them, in any of their encodings: for logs, motions and TOML."""

import codecs
import tomllib
from pathlib import Path

from diffdrive.errors import DiffdriveError
from diffdrive.support.typing import TomlTable

# the longer marks first: UTF-32 begins as UTF-16 does
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
    (codecs.BOM_UTF8, "utf-8-sig"),
)


def detect_encoding(raw: bytes) -> str:
    """The encoding that a byte-order mark names; UTF-8 without one."""
    return next((name for mark, name in _MARKS if raw.startswith(mark)), "utf-8")


def decode_text(raw: bytes) -> str:
    """The text of a file, by its byte-order mark, else as UTF-8, else as Latin-1.

    With a byte-order mark, bytes that cannot be decoded are replaced.
    """
    encoding = detect_encoding(raw)
    if encoding != "utf-8":
        return raw.decode(encoding, errors="replace")
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def parse_toml(raw: bytes, where: str, error: type[DiffdriveError]) -> TomlTable:
    """The tables of a TOML file in UTF-8, with or without a byte-order mark, or in UTF-16 or UTF-32 with one.

    Raises `error`, one line that names the file (`where`), the line and the remedy.
    """
    encoding = detect_encoding(raw)
    try:
        return tomllib.loads(raw.decode(encoding))
    except UnicodeDecodeError as problem:
        raise error(_missing_mark_message(raw, where) or _decoding_message(raw, where, encoding, problem)) from None
    except RecursionError:
        raise error(f"{where}: not a TOML file: tables or lists are nested too deeply; a drive needs four") from None
    except ValueError as problem:  # beside syntax: a whole number of more digits than Python reads
        raise error(_missing_mark_message(raw, where) or f"{where}: not a TOML file: {problem}") from None


def read_toml(path: Path, error: type[DiffdriveError], origin: str) -> TomlTable:
    """The tables of a TOML file; raises `error`. `origin` tells the user how to get a file that does not exist."""
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise error(f"{path}: no such file; {origin}") from None
    except IsADirectoryError:
        raise error(f"{path}: is a folder, not a file") from None
    except OSError as problem:
        raise error(f"{path}: cannot be read: {problem.strerror}") from None
    return parse_toml(raw, str(path), error)


def _missing_mark_message(raw: bytes, where: str) -> str | None:
    """The message for a text with zero bytes but without a byte-order mark; None for other texts."""
    unmarked = b"\x00" in raw[:4] and detect_encoding(raw) == "utf-8"
    return f"{where}: is UTF-16 without a byte-order mark, or binary: save it as UTF-8" if unmarked else None


def _decoding_message(raw: bytes, where: str, encoding: str, problem: UnicodeDecodeError) -> str:
    if encoding != "utf-8":
        return f"{where}: is cut off or no text: its byte-order mark says {encoding.upper()}; save it as UTF-8"
    line = raw.count(b"\n", 0, problem.start) + 1
    byte = raw[problem.start : problem.start + 1]
    return (
        f"{where}: line {line} holds the byte 0x{byte.hex()} ('{byte.decode('latin-1')}' in Latin-1), which is no "
        "UTF-8: save the file as UTF-8"
    )
