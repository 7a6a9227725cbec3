"""Which extension is of which format; a format of your own joins them."""

from collections.abc import Callable
from pathlib import Path

from diffdrive.logs.formats.table import Table
from diffdrive.support.registry import Registry

Reader = Callable[[Path], Table]


def _csv(path: Path) -> Table:
    from diffdrive.logs.formats.csv_file import read_csv

    return read_csv(path)


def _mat(path: Path) -> Table:
    from diffdrive.logs.formats.mat_file import read_mat

    return read_mat(path)


def _parquet(path: Path) -> Table:
    from diffdrive.logs.formats.parquet_file import read_parquet

    return read_parquet(path)


def _mdf(path: Path) -> Table:
    from diffdrive.logs.formats.mdf_file import read_mdf

    return read_mdf(path)


def _tdms(path: Path) -> Table:
    from diffdrive.logs.formats.tdms_file import read_tdms

    return read_tdms(path)


def _hdf5(path: Path) -> Table:
    from diffdrive.logs.formats.hdf5_file import read_hdf5

    return read_hdf5(path)


def _mcap(path: Path) -> Table:
    from diffdrive.logs.formats.mcap_file import read_mcap

    return read_mcap(path)


def _sinumerik(path: Path) -> Table:
    from diffdrive.logs.formats.sinumerik_file import read_sinumerik

    return read_sinumerik(path)


def _tncscope(path: Path) -> Table:
    from diffdrive.logs.formats.tncscope_file import read_tncscope

    return read_tncscope(path)


# each imports its library only when a file needs it: they take longer than the rest of diffdrive
READERS: Registry[Reader] = Registry(
    "log format",
    {
        ".csv": _csv, ".tsv": _csv, ".txt": _csv, ".dat": _csv, ".asc": _csv, ".mat": _mat,
        ".parquet": _parquet, ".pq": _parquet, ".h5": _hdf5, ".hdf5": _hdf5, ".mf4": _mdf, ".mdf": _mdf, ".tdms": _tdms,
        ".mcap": _mcap, ".xml": _sinumerik, ".sco": _tncscope,
    },
    pattern=r"\.[^\s./\\]+",
    hint="the last extension of a file with its dot, such as '.trc'",
)  # fmt: skip


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
