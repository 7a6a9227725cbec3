"""What an export wrote, and how far its code was found to agree with the simulator."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from diffdrive.results import Result, Status

OK = Status(True)


@dataclass(frozen=True, repr=False)
class ExportResult(Result):
    """The files, and the largest difference of each output from the run over the largest value that the run has of it.

    `differences` is empty where no compiler was found, and where the target's code is compiled elsewhere. In single
    precision, `lost` is the same between the simulator in single and in double precision.
    """

    target: str
    folder: Path
    files: tuple[str, ...]
    kind: str  # of the controller
    rate: float  # Hz
    fingerprint: str  # of the law and of its numbers, whatever the target
    precision: str
    steps: int  # of the run
    differences: dict[str, float]
    lost: dict[str, float]
    next_command: str  # that compiles or replays what was written
    status: Status = OK
    notes: tuple[str, ...] = ()

    schema: ClassVar[str] = "export/1"

    def headline(self) -> str:
        """The target, and the agreement."""
        head = f"{self.kind} at {self.rate:g} Hz as {self.target}, {self.precision} precision"
        if not self.differences:
            return f"{head}: not replayed here, its bench does that"
        agreement = f"{max(self.differences.values()):.2g} of the largest value of each output over {self.steps} steps"
        return f"{head}: differs from the simulation by {agreement}"

    def summary(self) -> str:
        files = f"files: {', '.join(self.files)}"
        return "\n".join(
            [
                self.headline(),
                f"fingerprint: {self.fingerprint}",
                files,
                f"next: {self.next_command}",
                *(f"- {note}" for note in self.notes),
            ]
        )

    def as_dict(self) -> dict[str, object]:
        """Every number, by names that carry their unit."""
        return {
            "target": self.target,
            "files": list(self.files),
            "controller": self.kind,
            "rate_Hz": self.rate,
            "fingerprint": self.fingerprint,
            "precision": self.precision,
            "steps": self.steps,
            "relative_differences": self.differences,
            "relative_loss_of_single_precision": self.lost,
        }
