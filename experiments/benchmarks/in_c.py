"""The hand-written step in C, compiled for this processor."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from diffdrive.errors import DiffdriveError

SOURCE = Path(__file__).with_name("step.c")
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC")


def pointer(values: np.ndarray) -> object:
    """The address of an array of doubles."""
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


class HandWrittenStep:
    """`roll` and `sweep` of step.c."""

    def __init__(self, code: ctypes.CDLL) -> None:
        self._code = code

    def roll(
        self, row: np.ndarray, reference: np.ndarray, load: np.ndarray, period: float, substeps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Costs (RMS and peak error, m; RMS load error, N) and the table's position, [n]; `reference` is [3, n]."""
        costs, position, n = np.zeros(3), np.zeros(load.size), ctypes.c_long(load.size)
        self._code.roll(
            pointer(row),
            pointer(reference),
            pointer(load),
            n,
            ctypes.c_double(period),
            substeps,
            pointer(costs),
            pointer(position),
        )
        return costs, position

    def sweep(
        self, rows: np.ndarray, reference: np.ndarray, load: np.ndarray, period: float, substeps: int
    ) -> np.ndarray:
        """Costs of each lane, [lanes, 3]."""
        costs, n, lanes = np.zeros((len(rows), 3)), ctypes.c_long(load.size), ctypes.c_long(len(rows))
        self._code.sweep(
            pointer(rows),
            lanes,
            pointer(reference),
            pointer(load),
            n,
            ctypes.c_double(period),
            substeps,
            pointer(costs),
        )
        return costs


@contextmanager
def library(source: Path, *flags: str, compiler: str = "gcc") -> Iterator[ctypes.CDLL]:
    """A source file compiled for this processor into a temporary library; `DiffdriveError` without a compiler."""
    compiler_path = shutil.which(compiler)
    if compiler_path is None:
        raise DiffdriveError(f"no {compiler} on this machine: install one to compare with C, or leave C out")
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / f"{source.stem}.so"
        result = subprocess.run(
            [compiler_path, *FLAGS, *flags, str(source), "-o", str(output), "-lm"],
            capture_output=True,
            text=True,
            check=False,
        )
        if result.returncode:
            raise DiffdriveError(f"{compiler} does not compile {source.name}: {result.stderr.strip()}")
        yield ctypes.CDLL(str(output))


@contextmanager
def compiled(compiler: str = "gcc") -> Iterator[HandWrittenStep]:
    """The step by hand; `DiffdriveError` without a compiler."""
    with library(SOURCE, "-std=c11", compiler=compiler) as code:
        yield HandWrittenStep(code)
