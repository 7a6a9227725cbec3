"""The gains of an estimated controller: a table of them with their intervals, and the drive file that has them."""

from experiments.reports.axis_file import write_axis_file
from experiments.reports.readable import interval, unit_of
from experiments.reports.report import Report
from tuning.identification.controller.gains import Gain
from tuning.identification.controller.workflow import ControllerEstimate

FILE = "controller.toml"
NO_RATE = (
    f"{FILE} is not written: the rate of the controller is not known; state it as [sampling] rate, and that of "
    "the logs as [trace] rate"
)
UNDETERMINED = (
    "-: the logs do not distinguish it from 0, a reset time from none; the interval says how far they know it."
)


def _row(gain: Gain) -> list[object]:
    value, between = interval(gain.value, gain.low, gain.high)
    return [gain.name, unit_of(gain.unit), value if gain.determined else None, between]


def report_controller(report: Report, estimate: ControllerEstimate) -> None:
    """Print and keep the gains, and write the drive file with them where the logs have one controller."""
    names = ("gain", "unit", "estimated", "from", "to", "determined")
    rows = [[one.name, one.unit, one.value, one.low, one.high, one.determined] for one in estimate.gains]
    report.record("controller", names, rows)
    report.show(
        "Gains of the controller, with 95 % intervals",
        ("gain", "unit", "estimated", "95 % interval"),
        [_row(one) for one in estimate.gains],
        notes=[] if all(one.determined for one in estimate.gains) else [UNDETERMINED],
        of="controller",
    )
    for note in estimate.notes:
        report.say(note)
    if not estimate.status.ok:
        report.say(f"{estimate.status.message}: no drive file is written.")
    elif report.out is not None:
        if estimate.axis is None:
            report.say(NO_RATE)
        elif name := write_axis_file(report, estimate.axis, FILE):
            report.keep("written", file=name)
