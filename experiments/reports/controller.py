"""The gains of an estimated controller: a table of them with their intervals, and the drive file that has them."""

from experiments.reports.axis_file import write_axis_file
from experiments.reports.report import Report
from tuning.identification.controller.workflow import ControllerEstimate

FILE = "controller.toml"
NO_RATE = (
    f"{FILE} is not written: the rate of the controller is not known; state it as [sampling] rate, and that of "
    "the logs as [trace] rate"
)


def report_controller(report: Report, estimate: ControllerEstimate) -> None:
    """Print and keep the gains, and write the drive file with them where the logs have one controller."""
    names = ("gain", "unit", "estimated", "from", "to", "determined")
    rows = [[one.name, one.unit, one.value, one.low, one.high, one.determined] for one in estimate.gains]
    report.record("controller", names, rows)
    report.show("Gains of the controller, with 95 % intervals", names, rows, of="controller")
    for note in estimate.notes:
        report.say(note)
    if not estimate.status.ok:
        report.say(f"{estimate.status.message}: no drive file is written.")
    elif report.out is not None:
        if estimate.axis is None:
            report.say(NO_RATE)
        elif name := write_axis_file(report, estimate.axis, FILE):
            report.keep("written", file=name)
