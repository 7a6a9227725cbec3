"""Reads and writes Parquet; a column's unit is the metadata "unit" of its field."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from diffdrive.errors import LogError
from diffdrive.logs.formats.arrow import from_arrow
from diffdrive.logs.formats.table import Table
from diffdrive.support.atomic_write import atomic_write
from diffdrive.support.resources import format_count, require_memory

IN_MEMORY = 24.0  # bytes for each number: as the library reads it, as an array, as a signal


def read_parquet(path: Path) -> Table:
    """The columns of a Parquet file, nulls as NaN; raises `LogError` if it is none or cut off."""
    try:
        with pq.ParquetFile(path) as file:
            cells = file.metadata.num_rows * file.metadata.num_columns
            remedy = "cut it into several, or leave columns out"
            require_memory(LogError, f"{path}: reading {format_count(cells)} numbers", IN_MEMORY * cells, remedy)
            table = file.read()
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise LogError(
            f"{path}: cannot be read as Parquet, it is another format or cut off ({_first_line(error)}); "
            "export or copy it again"
        ) from None
    return from_arrow(table, str(path))


def write_parquet(path: Path, columns: dict[str, np.ndarray], units: dict[str, str]) -> None:
    """Write columns as float64 with their units."""
    schema = pa.schema([pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in columns])
    with atomic_write(path) as file:
        pq.write_table(pa.table([pa.array(values) for values in columns.values()], schema=schema), file)


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
