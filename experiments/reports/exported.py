"""The command that writes a controller as code."""

from pathlib import Path

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.motion.text import parse_load, parse_motion
from diffdrive.support.rates import require_same_rate
from experiments.exports.names import name_of
from experiments.exports.result import ExportResult
from experiments.exports.workflow import export
from experiments.reports import readable
from experiments.reports.report import Report


def export_drive(
    drive: Path,
    out: Path,
    target: str,
    name: str | None,
    precision: str,
    motion: str,
    load: str,
    machine: Path | None,
) -> None:
    """`diffdrive export`."""
    axis = read_axis(drive)
    other = None if machine is None else read_axis(machine)
    if other is not None:
        require_same_rate("--machine", other.rate, "the drive file", axis.rate)
    planned = parse_motion(motion, axis.sampling.rate, axis.sheet)
    loads = parse_load(load, planned.time, axis.sheet)
    with Report(f"{drive.name}: {target}", out) as report:
        with report.working("writing the controller and replaying it"):
            result = export(
                axis,
                planned,
                out,
                target=target,
                name=name_of(drive.stem) if name is None else name,
                precision=precision,
                load=loads,
                machine=other,
            )
        report_export(report, result)


def report_export(report: Report, result: ExportResult) -> None:
    """What was written, how far it agrees, and what to do with it."""
    report.keep("result", **result.as_dict())
    headline = f"{readable.titled(result.headline())}."
    report.print(headline, style="bold")
    # what was compiled nowhere here is neither proved nor wrong
    good = result.status.ok if result.differences or not result.status.ok else None
    report.conclude(headline, good=good)
    if result.differences or result.lost:
        outputs = result.differences or result.lost
        columns = ["output"]
        columns += ["compiled code, relative difference"] if result.differences else []
        columns += ["single precision of the simulator, relative"] if result.lost else []
        rows = [[name, *(one[name] for one in (result.differences, result.lost) if one)] for name in outputs]
        report.table("agreement", columns, rows, "Largest difference from the simulation over the largest value")
    for note in result.notes:
        report.say(note)
    report.print(f"fingerprint: {result.fingerprint}")
    report.print(f"files: {', '.join(result.files)}")
    report.say(f"Next, in {result.folder}: {result.next_command}")
