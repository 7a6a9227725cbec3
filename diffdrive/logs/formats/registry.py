"""Which extension is of which format; a format of your own joins them."""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import cast

from diffdrive.logs.formats.table import Table
from diffdrive.support.registry import Registry

Reader = Callable[[Path], Table]


def _reader(name: str) -> Reader:
    """`read_NAME` of the module NAME_file, imported when a file needs it: its library takes longer than all else."""

    def read(path: Path) -> Table:
        module = importlib.import_module(f"diffdrive.logs.formats.{name}_file")
        return cast(Table, getattr(module, f"read_{name}")(path))

    return read


EXTENSIONS = {
    "csv": (".csv", ".tsv", ".txt", ".dat", ".asc"),
    "mat": (".mat",),
    "parquet": (".parquet", ".pq"),
    "hdf5": (".h5", ".hdf5"),
    "mdf": (".mf4", ".mdf"),
    "tdms": (".tdms",),
    "mcap": (".mcap",),
    "sinumerik": (".xml",),
    "tncscope": (".sco",),
}
READERS: Registry[Reader] = Registry(
    "log format",
    {extension: _reader(name) for name, extensions in EXTENSIONS.items() for extension in extensions},
    pattern=r"\.[^\s./\\]+",
    hint="the last extension of a file with its dot, such as '.trc'",
)


def register_format(*extensions: str) -> Callable[[Reader], Reader]:
    """Make a reader of files with these extensions known, as a decorator of a function from a path to a `Table`.

    It raises `LogError`, one line that names the file and the remedy, for a file that it cannot read. What the columns
    mean, their units and the clock are worked out from the table as for every format. A reader of your own is replaced
    by one that is registered for its extension. Raises `ParameterError` for an extension that the package reads, or
    that is none.

    Examples:
        >>> @register_format(".trc")
        ... def read_trace(path):
        ...     values = numpy.loadtxt(path)
        ...     return Table(str(path), {"time": values[:, 0], "position": values[:, 1], "command": values[:, 2]})

    """

    def add(reader: Reader) -> Reader:
        for extension in extensions:
            READERS.add(extension.lower() if isinstance(extension, str) else extension, reader)
        return reader

    return add
