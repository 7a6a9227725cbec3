"""What one core can do at most, measured: the roof under which a step's arithmetic lies."""

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from experiments.benchmarks.in_c import library, pointer

SOURCE = Path(__file__).with_name("roof.c")
FLAGS = ("-ffp-contract=fast", "-std=gnu11")
ROUNDS, VECTOR_SIZE, CHAINS = 200_000, 8, 12  # as in roof.c
OPERATIONS = ROUNDS * VECTOR_SIZE * CHAINS
KERNELS = {"fused": 2, "added": 1, "multiplied": 1, "divided": 1}  # operations that each counts as
START = 5.0  # makes the factor 1: products neither grow nor vanish
READ_SIZE = 1 << 25  # doubles, more than any cache holds


@contextmanager
def kernels() -> Iterator[tuple[dict[str, Callable[[], float]], float]]:
    """Jobs that do nothing but one operation each, `read` among them, and the bytes that it reads.

    `DiffdriveError` where there is no compiler.
    """
    with library(SOURCE, *FLAGS) as code:
        for name in KERNELS:
            getattr(code, name).restype = ctypes.c_double
        code.read_through.restype = ctypes.c_double
        buffer = np.ones(READ_SIZE + VECTOR_SIZE)
        offset = (
            -buffer.ctypes.data // buffer.itemsize
        ) % VECTOR_SIZE  # a vector is read from an address of its own size
        values = buffer[offset : offset + READ_SIZE]

        def job(name: str) -> Callable[[], float]:
            return lambda: getattr(code, name)(ctypes.c_long(ROUNDS), ctypes.c_double(START))

        jobs = {name: job(name) for name in KERNELS}
        jobs["read"] = lambda: code.read_through(pointer(values), ctypes.c_long(READ_SIZE))
        yield jobs, float(values.nbytes)
