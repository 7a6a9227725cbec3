"""A table of Arrow as ours: nulls are NaN, times are counted, columns of anything but numbers are named as left out."""

import numpy as np
import pyarrow as pa

from diffdrive.logs.formats.table import Table, skipped_note


def from_arrow(table: pa.Table, source: str) -> Table:
    """The columns of a table of Arrow; a unit is the metadata "unit" of its field."""
    columns, units, skipped = {}, {}, {}
    for field, column in zip(table.schema, table.columns, strict=True):
        if pa.types.is_nested(field.type):
            skipped[field.name] = f"holds a {field.type} in each row"
            continue
        if pa.types.is_timestamp(field.type) or pa.types.is_duration(field.type):
            column = column.cast(pa.int64())
            units[field.name] = {"s": "s", "ms": "ms", "us": "us", "ns": "ns"}[field.type.unit]
        elif pa.types.is_decimal(field.type):
            column = column.cast(pa.float64())
        columns[field.name] = _array(column)
        if field.metadata and b"unit" in field.metadata:
            units[field.name] = field.metadata[b"unit"].decode()
    return Table(source, columns, units, notes=skipped_note(skipped), skipped=skipped)


def _array(column: pa.ChunkedArray) -> np.ndarray:
    values = column.to_numpy()
    return values if values.dtype.kind in "fiub" else np.array(["" if v is None else v for v in values], dtype=object)
