"""What other tools take of a diagnosis: the drive with what was found, and the motion that would decide."""

import numpy as np

from diffdrive.motion.motion import Motion
from diffdrive.support.atomic_write import atomic_write
from experiments.reports.axis_file import write_axis_file
from experiments.reports.report import Report
from tuning.diagnosis.workflow import DiagnosisResult

AUGMENTED = "augmented.toml"
NEXT = "next_reference.csv"


def write_augmented(report: Report, result: DiagnosisResult) -> str | None:
    """augmented.toml, which `simulate`, `tune` and `sweep` take, below the verdict; None where it is not written."""
    if not result.details["searched"]:
        return None
    says = " ".join(result.says.split())  # in one line
    comments = [f"the verdict of the diagnosis was {result.verdict}: {says}", result.details["scale_noise"]]
    return write_axis_file(report, result.axis, AUGMENTED, [one for one in comments if one])


def write_reference(report: Report, motion: Motion | None) -> None:
    """next_reference.csv: the motion that would decide, sample by sample, for the machine's controller to run."""
    if motion is None:
        return
    assert report.out is not None
    rows = np.stack([motion.time, motion.position], axis=1)
    with atomic_write(report.out / NEXT, "w") as file:
        np.savetxt(file, rows, delimiter=",", header="time_s,reference_m", comments="", fmt="%.9g")
