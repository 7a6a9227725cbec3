"""Reads MAT files, v4 to v7.3, and writes v5: variables, nested structures, dSPACE recordings, Simulink logs.

A column is called by its path: 'qm', 'rig.axis.position', 'dspace.Y.pos', 'out.label', 'data(2)' for a matrix's second
column, 'data(1,2)' for an element of matrices in time. Single values and texts are no columns.
"""

import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import scipy.io
from pymatreader import read_mat as read_variables

from diffdrive.errors import LogError
from diffdrive.logs.formats.arrays import ALONE, TEXT, signals
from diffdrive.logs.formats.table import Table, skipped_note, skipped_text
from diffdrive.support.atomic_write import atomic_write

Column = tuple[str, np.ndarray | str, str | None]  # path, values or why it has none, unit


def read_mat(path: Path) -> Table:
    """The arrays of a MAT file as columns; raises `LogError` if it is none, is cut off, or holds no arrays."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # objects of classes, which are no signals
            contents = read_variables(path)
    except Exception as error:  # the libraries raise a dozen kinds on a damaged file
        text = (str(error) or type(error).__name__).splitlines()[0]
        raise LogError(
            f"{path}: cannot be read as a MAT file, it is another format or cut off ({text}); export or copy it again"
        ) from None
    variables = {name: value for name, value in contents.items() if not name.startswith(("__", "#"))}
    found = list(_columns("", variables))
    columns = {name: values for name, values, _ in found if not isinstance(values, str)}
    skipped = {name: values for name, values, _ in found if isinstance(values, str)}
    if not columns:
        raise LogError(
            f"{path}: holds no arrays of numbers ({skipped_text(skipped) or 'it is empty'}); export signals as arrays "
            "or as structure with time, not as timeseries or Dataset objects"
        )
    stated = variables.get("units")
    units = {name: unit for name, _, unit in found if unit}
    if isinstance(stated, dict):
        units |= {name: unit for name, unit in stated.items() if name in columns and isinstance(unit, str)}
    notes = skipped_note({name: why for name, why in skipped.items() if why not in (ALONE, TEXT)})
    return Table(str(path), columns, units, notes=notes, skipped=skipped)


def write_mat(path: Path, columns: dict[str, np.ndarray], units: dict[str, str]) -> None:
    """Write columns as variables of a v5 file, beside a structure `units`."""
    with atomic_write(path) as file:
        scipy.io.savemat(file, {**columns, "units": units}, oned_as="column", do_compression=True)


def _columns(path: str, value: object) -> Iterator[Column]:
    if isinstance(value, dict):
        yield from _structure(path, value)
    elif isinstance(value, list) and value and all(isinstance(item, str) for item in value):
        yield path, TEXT, None
    elif isinstance(value, list):
        for k, item in enumerate(value):
            yield from _columns(f"{path}({k + 1})", item)
    else:
        for name, values in signals(path, value):
            yield name, values, None


def _structure(path: str, fields: dict[str, object]) -> Iterator[Column]:
    clocks, recorded, logged = fields.get("X"), fields.get("Y"), fields.get("signals")
    if isinstance(clocks, dict) and isinstance(recorded, dict) and "Data" in recorded:
        yield from _dspace(path, clocks, recorded)
    elif isinstance(logged, dict) and "values" in logged:
        yield from _simulink(path, fields.get("time"), logged)
    else:
        for name, value in fields.items():
            yield from _columns(f"{path}.{name}" if path else name, value)


def _dspace(path: str, clocks: dict[str, object], recorded: dict[str, object]) -> Iterator[Column]:
    """A ControlDesk recording: X(i).Data are the clocks, Y(i).Name and Y(i).Data the signals."""
    for k, data in enumerate(_as_list(clocks.get("Data", []))):
        for column, values in signals(f"{path}.X.time" if k == 0 else f"{path}.X({k + 1}).time", data):
            yield column, values, None
    recordings, names = _as_list(recorded["Data"]), _as_list(recorded.get("Name", []))
    units = _as_list(recorded.get("Unit", []))
    for k, data in enumerate(recordings):
        name, unit = _text(names, k), _text(units, k)
        for column, array in signals(f"{path}.Y.{f'({k + 1})' if name is None else name}", data):
            yield column, array, unit


def _simulink(path: str, time: object, logged: dict[str, object]) -> Iterator[Column]:
    """'Structure with time': time, signals(i).values and signals(i).label."""
    for name, column in signals(f"{path}.time", time):
        yield name, column, None
    count = np.size(time)  # type: ignore[arg-type]  # 1 of whatever is no array
    values, labels = _as_list(logged["values"]), _as_list(logged.get("label", []))
    for k, data in enumerate(values):
        label = _text(labels, k) or f"signals({k + 1})"
        for name, column in signals(f"{path}.{label}", data, count):
            yield name, column, None


def _as_list(value: object) -> list[object]:
    """A structure array of one element comes without its list."""
    return value if isinstance(value, list) else [value]


def _text(values: list[object], k: int) -> str | None:
    """The text at k; None where there is none."""
    value = values[k] if k < len(values) else None
    return value if isinstance(value, str) else None
