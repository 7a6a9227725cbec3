"""What the command line says of logs: columns, units, shifts."""

import pytest

from diffdrive.errors import LogError
from diffdrive.logs import ColumnMapping
from experiments.reports.checked_logs import mapping_with_options

NONE = ColumnMapping()


def test_texts_become_columns_units_and_shifts():
    told = mapping_with_options(
        NONE, ["position=qm"], ["command=V", "force_per_volt=35.2"], ["lap=5:command=-3", "position=+2"]
    )
    shifts = {"lap=5:command": -3, "position": 2}
    assert told == ColumnMapping({"position": "qm"}, {"command": "V"}, force_per_volt=35.2, shifts=shifts)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"columns": ["position"]}, "--column position: write CHANNEL=VALUE, such as reference=qg"),
        ({"units": ["time=s", "time=ms"]}, "--unit time=ms: time is given twice"),
        ({"shifts": ["command=half"]}, "--shift command=half: write a whole number"),
        ({"shifts": ["command"]}, "--shift command: write CHANNEL=VALUE, such as command=-1"),
    ],
)
def test_what_says_nothing_is_refused(options, says):
    with pytest.raises(LogError, match=says):
        mapping_with_options(NONE, **options)
