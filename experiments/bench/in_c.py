"""The hand-written step in C, compiled for this processor."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from diffdrive.errors import DiffdriveError

SOURCE = Path(__file__).with_name("step.c")
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC", "-std=c11")


def _at(values: np.ndarray) -> Any:
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


class InC:
    """`roll` and `sweep` of step.c."""

    def __init__(self, library: Path) -> None:
        self._library = ctypes.CDLL(str(library))

    def roll(
        self, row: np.ndarray, reference: np.ndarray, load: np.ndarray, period: float, substeps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Costs (RMS and peak error, m; RMS load error, N) and the table's position, [n]; `reference` is [3, n]."""
        costs, position, n = np.zeros(3), np.zeros(load.size), ctypes.c_long(load.size)
        self._library.roll(
            _at(row), _at(reference), _at(load), n, ctypes.c_double(period), substeps, _at(costs), _at(position)
        )
        return costs, position

    def sweep(
        self, rows: np.ndarray, reference: np.ndarray, load: np.ndarray, period: float, substeps: int
    ) -> np.ndarray:
        """Costs of each lane, [lanes, 3]."""
        costs, n, lanes = np.zeros((len(rows), 3)), ctypes.c_long(load.size), ctypes.c_long(len(rows))
        self._library.sweep(
            _at(rows), lanes, _at(reference), _at(load), n, ctypes.c_double(period), substeps, _at(costs)
        )
        return costs


@contextmanager
def compiled(compiler: str = "gcc") -> Iterator[InC]:
    """The step compiled into a temporary library; `DiffdriveError` where there is no compiler."""
    found = shutil.which(compiler)
    if found is None:
        raise DiffdriveError(f"no {compiler} on this machine: install one to compare with C, or leave C out")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "step.so"
        done = subprocess.run(
            [found, *FLAGS, str(SOURCE), "-o", str(library), "-lm"], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise DiffdriveError(f"{compiler} does not compile {SOURCE.name}: {done.stderr.strip()}")
        yield InC(library)
