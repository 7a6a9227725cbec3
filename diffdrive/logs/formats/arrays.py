"""Arrays of a file as columns: vectors as they are, matrices column by column; and why what is left is no signal."""

from collections.abc import Iterator

import numpy as np

ALONE, TEXT = "holds a single value", "holds text"  # what may stand beside signals


def signals(path: str, value: object, count: int | None = None) -> Iterator[tuple[str, np.ndarray | str]]:
    """A vector as it is, a matrix column by column, signals in time along its longer side, or the one of `count`.

    In an array of three dimensions time is the last one, as Simulink writes matrices. In place of an array that is no
    signal comes the reason.
    """
    if (why := _why_no_signal(value)) is not None:
        yield path, why
        return
    assert isinstance(value, np.ndarray)
    if value.ndim == 1:
        yield path, value
    elif value.ndim == 3:
        for i, j in np.ndindex(value.shape[:2]):
            yield f"{path}({i + 1},{j + 1})", value[i, j]
    else:
        rows, columns = value.shape
        is_row = columns == count if count in value.shape and rows != columns else rows < columns
        columns_first = value.T if is_row else value
        for k in range(columns_first.shape[1]):
            yield f"{path}({k + 1})", columns_first[:, k]


def _why_no_signal(value: object) -> str | None:
    """Why a variable is no signal; None where it is one."""
    if isinstance(value, str) or getattr(getattr(value, "dtype", None), "kind", None) in ("U", "S"):
        return TEXT
    if not isinstance(value, np.ndarray):
        return ALONE if np.isscalar(value) or value is None else f"holds a {type(value).__name__}"
    if value.dtype.kind == "c" or (value.dtype.names or ())[:1] == ("real",):
        return "holds complex numbers"
    if value.dtype.kind not in "fiub":
        return f"holds {value.dtype.name} in place of numbers"
    if value.size < 2:
        return ALONE
    return f"has {value.ndim} dimensions" if value.ndim > 3 else None
