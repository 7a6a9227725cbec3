"""An axis that was found, as a drive file in the folder of a report."""

from collections.abc import Sequence

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import axis_tables, parse_axis, write_axis
from diffdrive.errors import DiffdriveError
from experiments.reports.report import Report


def write_axis_file(report: Report, axis: Axis | None, name: str, comments: Sequence[str] = ()) -> str | None:
    """Write `axis` as the file `name`, and return the name; None, and a sentence, where no drive file can hold it.

    The gains are the axis's; observers and feed-forwards take the file's own model, as in every drive file.
    """
    assert report.out is not None
    path = report.out / name
    try:
        if axis is None:
            raise DiffdriveError("what was found does not fit into an axis")
        write_axis(path, parse_axis(axis_tables(axis), str(path)), comments)
    except DiffdriveError as problem:
        report.say(f"{name} is not written, since no drive file can say this: {problem}")
        return None
    return name
