"""Tables in memory: data frames of any library that narwhals knows (pandas, polars, Arrow ...), and dicts of arrays."""

from collections.abc import Mapping
from typing import cast

import narwhals as nw
import numpy as np
import pyarrow as pa
from narwhals.exceptions import DuplicateError
from narwhals.typing import IntoFrame
from numpy.typing import ArrayLike

from diffdrive.errors import LogError
from diffdrive.logs.formats.arrow import from_arrow
from diffdrive.logs.formats.table import Table


def read_frame(source: object, name: str) -> Table:
    """The columns of a data frame or of a dict of arrays; `name` stands for it in messages. Raises `LogError`."""
    return _from_arrays(source, name) if isinstance(source, Mapping) else _from_frame(source, name)


def _from_arrays(source: Mapping[object, ArrayLike], name: str) -> Table:
    columns, units = {}, {}
    for key, values in source.items():
        array = np.asarray(values)
        if array.ndim != 1:
            raise LogError(f"{name}: column '{key}' has {array.ndim} dimensions; a signal is one number in each row")
        if array.dtype.kind not in "fiubOUMm":
            raise LogError(f"{name}: column '{key}' holds {array.dtype}; a signal is one real number in each row")
        if array.dtype.kind in "Mm":
            array = array.astype(f"{array.dtype.kind}8[ns]").astype(np.int64)
            units[str(key)] = "ns"
        columns[str(key)] = array
    return Table(name, columns, units)


def _from_frame(source: object, name: str) -> Table:
    try:
        frame = nw.from_native(cast(IntoFrame, source))  # which refuses what it is not
    except DuplicateError:
        raise LogError(f"{name}: several columns have one name; give each a name of its own") from None
    except TypeError:
        mend = "; take its .log()" if hasattr(source, "log") else ""
        raise LogError(
            f"{name}: a log is a path, a data frame or a dict of arrays by column, got {type(source).__name__}{mend}"
        ) from None
    if isinstance(frame, nw.LazyFrame):
        frame = frame.collect()
    index = nw.maybe_get_index(frame)
    if index is not None and getattr(index, "name", None) is not None:  # pandas: the time, more often than not
        frame = nw.from_native(nw.to_native(frame).reset_index())  # type: ignore[attr-defined]  # pandas has it
    try:
        return from_arrow(frame.rename({column: str(column) for column in frame.columns}).to_arrow(), name)
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise LogError(f"{name}: is no table of numbers: {str(error).splitlines()[0]}") from None
