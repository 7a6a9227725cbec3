"""Writes v7.3 MAT files: HDF5 behind MATLAB's header, which, unlike v5, hold signals of more than 2 GB.

Laid out as MATLAB does it. scipy writes none, and the one library that does rests on parts of numpy that are to go.
"""

import io
from pathlib import Path

import h5py
import numpy as np

from diffdrive.support.atomic_write import atomic_write

HEADER, TEXT = 512, 124  # bytes in front of HDF5, and of these for the text
ENDING = b"\x00\x02IM"  # version 2, little-endian


def write_mat73(path: Path, columns: dict[str, np.ndarray], units: dict[str, str]) -> None:
    """Write columns as column vectors, beside a structure `units` of texts."""
    buffer = io.BytesIO()  # on a full disk HDF5 fails without saying so
    with h5py.File(buffer, "w", userblock_size=HEADER) as file:
        for name, values in columns.items():
            # HDF5 runs through a matrix by rows, MATLAB by columns: [1, n] is a column there
            _write_dataset(file, name, "double", values[None, :], compression="gzip", shuffle=True)
        group = file.create_group("units")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, unit in units.items():
            _write_dataset(group, name, "char", np.frombuffer(unit.encode("utf-16-le"), np.uint16)[:, None]).attrs[
                "MATLAB_int_decode"
            ] = np.int32(2)
    buffer.seek(0)
    buffer.write(b"MATLAB 7.3 MAT-file, written by diffdrive, HDF5 schema 1.00".ljust(TEXT) + ENDING)
    with atomic_write(path) as file:
        file.write(buffer.getbuffer())


def _write_dataset(parent: h5py.Group, name: str, kind: str, values: np.ndarray, **options: object) -> h5py.Dataset:
    data = parent.create_dataset(name, data=values, **options)
    data.attrs["MATLAB_class"] = np.bytes_(kind)
    return data
