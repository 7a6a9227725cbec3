"""Reads HDF5: data sets in any group as columns 'group/name', tables of fields as 'group/name/field'."""

from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.formats.arrays import ALONE, TEXT, signals
from diffdrive.logs.formats.optional import first_line, unreadable
from diffdrive.logs.formats.table import Table, skipped_note, skipped_text
from diffdrive.support.resources import format_count, require_memory

IN_MEMORY = 24.0  # bytes for each number: as the library reads it, as an array, as a signal
_UNITS = ("unit", "units", "Unit", "Units")  # attributes that state a unit


def read_hdf5(path: Path) -> Table:
    """The data sets of an HDF5 file; raises `LogError` if it is none, is cut off, or holds no arrays of numbers.

    Links are not followed, be it into this file, whose data are read where they stand, or into others.
    """
    try:
        with h5py.File(path, "r") as file:
            return _table(path, file)
    except LogError:
        raise
    except (OSError, RuntimeError, ValueError, KeyError, TypeError) as error:
        raise unreadable(path, "HDF5", first_line(error)) from None


def _table(path: Path, file: h5py.File) -> Table:
    skipped: dict[str, str] = {}
    found = list(_datasets(file, skipped))
    cells = sum(_size(data) for _, data in found)
    remedy = "cut it into several, or leave data sets out"
    require_memory(LogError, f"{path}: reading {format_count(cells)} numbers", IN_MEMORY * cells, remedy)
    columns, units = dict[str, np.ndarray](), dict[str, str]()
    for name, data in found:
        unit = _unit(data)
        for column, values in _columns(name, data):
            if isinstance(values, str):
                skipped[column] = values
                continue
            columns[column] = values
            if unit is not None:
                units[column] = unit
    if not columns:
        raise LogError(
            f"{path}: holds no arrays of numbers ({skipped_text(skipped) or 'it is empty'}); write each signal "
            "as a data set of one dimension"
        )
    notes = skipped_note({name: why for name, why in skipped.items() if why not in (ALONE, TEXT)})
    return Table(str(path), columns, units, notes=notes, skipped=skipped)


def _datasets(file: h5py.File, skipped: dict[str, str]) -> Iterator[tuple[str, h5py.Dataset]]:
    """The data sets with their paths, each once, though hard links may run in circles; other links are skipped."""
    groups: list[tuple[str, h5py.Group]] = [("", file)]
    seen = {h5py.h5o.get_info(file.id).addr}
    while groups:
        path, group = groups.pop()
        below = []
        for key in group:
            name = f"{path}{key}"
            link = group.get(key, getlink=True)
            if isinstance(link, h5py.ExternalLink | h5py.SoftLink):
                other = isinstance(link, h5py.ExternalLink)
                skipped[name] = "is a link into another file" if other else f"is a link to '{link.path}'"
                continue
            item = group[key]
            address = h5py.h5o.get_info(item.id).addr
            if address in seen:
                continue
            seen.add(address)
            if isinstance(item, h5py.Group):
                below.append((f"{name}/", item))
            elif isinstance(item, h5py.Dataset):
                if item.external or item.is_virtual:
                    skipped[name] = "keeps its values in another file"
                else:
                    yield name, item
        groups += reversed(below)


def _size(data: h5py.Dataset) -> int:
    """Numbers in a data set, which may be declared far larger than the file."""
    fields = data.dtype.fields
    inner = sum(int(np.prod(kind[0].shape)) for kind in fields.values()) if fields else int(np.prod(data.dtype.shape))
    return inner * int(data.size or 0)


def _columns(name: str, data: h5py.Dataset) -> Iterator[tuple[str, np.ndarray | str]]:
    """A data set as columns, or why it is none."""
    if data.shape is None:
        yield name, "is empty"
        return
    if data.dtype.kind == "O":
        is_text = h5py.check_string_dtype(data.dtype) is not None
        yield name, TEXT if is_text else "holds references or lists in place of numbers"
        return
    if data.dtype.names and data.dtype.names[:1] != ("r",) and data.ndim != 1:
        yield name, ALONE if data.ndim == 0 else f"is a table of {data.ndim} dimensions"
        return
    try:
        values = data[()]
    except OSError as error:  # a compression that is not installed, or damage
        yield name, f"cannot be read ({first_line(error)})"
        return
    if not isinstance(values, np.ndarray) or not values.dtype.names:
        yield from signals(name, values)
        return
    for key in values.dtype.names:
        yield from signals(f"{name}/{key}", values[key], len(values))


def _unit(data: h5py.Dataset) -> str | None:
    """The unit that an attribute states."""
    for key in _UNITS:
        value = data.attrs.get(key)
        if isinstance(value, np.ndarray) and value.size == 1:
            value = value.reshape(())[()]
        text = value.decode(errors="replace") if isinstance(value, bytes) else value
        if isinstance(text, str) and text.strip():
            return text.strip()
    return None
