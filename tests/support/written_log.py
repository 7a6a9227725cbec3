"""A small log, and the ways in which it is written into files of each format."""

import h5py
import numpy as np

from diffdrive.logs import Log

N = 400
TIME = np.arange(N) * 1e-3
REFERENCE = 0.02 * np.sin(2 * np.pi * TIME)
POSITION = np.round(REFERENCE - 1e-6, 9)
COMMAND = np.round(100 * np.cos(2 * np.pi * TIME), 6)
COLUMNS = {"time": TIME, "reference": REFERENCE, "position": POSITION, "command": COMMAND}


def assert_is_the_log(log: Log, *, exact: bool = False) -> None:
    for name, values in COLUMNS.items():
        scale = 0.0 if exact else 1e-12 * np.max(np.abs(values))
        np.testing.assert_allclose(log.channels[name], values, rtol=0, atol=scale, err_msg=name)
    assert log.gaps == ()


def rows(delimiter=",", decimal=".", end="\n", columns=tuple(COLUMNS.values())) -> str:
    lines = (delimiter.join(repr(float(v)) for v in row).replace(".", decimal) for row in zip(*columns, strict=True))
    return end.join(lines) + end


def in_units() -> tuple[np.ndarray, ...]:
    """The log in ms, mm, um and kN."""
    return 1e3 * TIME, 1e3 * REFERENCE, 1e6 * POSITION, 1e-3 * COMMAND


NAMES = "time,reference,position,command"
PLAIN = {name: values.reshape(-1, 1) for name, values in COLUMNS.items()}


def write_v73(path, variables: dict) -> None:
    """A v7.3 file as MATLAB lays it out: arrays transposed, texts as UTF-16 codes, structure arrays as references."""

    def put(parent, name, value):
        if isinstance(value, dict):
            group = parent.create_group(name)
            group.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, one in value.items():
                put(group, key, one)
        elif isinstance(value, np.ndarray) and value.dtype.names:
            if len(value) == 1:
                return put(parent, name, {field: value[field][0] for field in value.dtype.names})
            group = parent.create_group(name)
            group.attrs["MATLAB_class"] = np.bytes_("struct")
            for field in value.dtype.names:
                made = [put(refs, f"{name}_{field}_{k}", one) for k, one in enumerate(value[field])]
                group.create_dataset(field, data=np.array([[one.ref] for one in made], dtype=h5py.ref_dtype))
        elif isinstance(value, str):
            data = parent.create_dataset(name, data=np.array([[ord(c)] for c in value], dtype=np.uint16))
            data.attrs["MATLAB_class"] = np.bytes_("char")
            return data
        else:
            array = np.atleast_2d(np.asarray(value, dtype=float))
            if not array.size:
                data = parent.create_dataset(name, data=np.array(array.shape, dtype=np.uint64))
                data.attrs["MATLAB_empty"] = np.uint8(1)
            else:
                data = parent.create_dataset(name, data=array.T)
            data.attrs["MATLAB_class"] = np.bytes_("double")
            return data

    with h5py.File(path, "w", userblock_size=512) as file:
        refs = file.create_group("#refs#")
        for name, value in variables.items():
            put(file, name, value)
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan  1 00:00:00 2024 HDF5 schema 1.00 ."
    with open(path, "r+b") as file:
        file.write(header.ljust(124, b" ") + b"\x00\x02IM")
