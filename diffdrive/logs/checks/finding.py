"""A finding of a check: in words for an engineer, and as data for a program."""

from dataclasses import dataclass
from typing import Literal

from diffdrive.logs.checks.repair import Repair

Severity = Literal["fatal", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("fatal", "warning", "note")

# What may have happened to a log, to its controller or to its machine.
CAUSES = {
    "nothing": "nothing happened",
    "swapped": "two channels are exchanged",
    "rounded": "a channel has coarser steps than its sensor",
    "filtered": "a channel was averaged, low-passed or resampled",
    "decimated": "rows were left out",
    "rate": "the time axis has a wrong unit or rate",
    "shifted": "a channel is early or late",
    "offset": "a channel has another zero",
    "gain": "a channel has a wrong unit or factor",
    "reversed": "a channel has the wrong sign",
    "wrapped": "a counter overflowed",
    "rectified": "only the absolute value was logged",
    "clipped": "a channel sits at a limit",
    "frozen": "a channel stands still while it should move",
    "outliers": "samples that no motion makes",
    "lost rows": "rows are missing or repeated",
    "duplicate": "a channel was computed from others",
    "burst": "pulses in the command that no controller gave",
    "feedforward only": "the command is without its feedback",
    "disturbance": "a known disturbance is counted twice",
    "other controller": "another controller than the drive file's made the command",
    "other machine": "mass or friction are not those of the drive file",
    "machines differ": "logs of one machine contradict one another",
    "lost motion": "two encoders differ by the direction of motion: backlash, or wind-up under friction",
    "screw": "two encoders differ along the stroke or over time: pitch, eccentricity, heat, reading",
    "trace": "the trace of the drive file does not show all that the controller did",
    "unreadable": "nothing can be made of the samples",
    "motion": "the motion limits what can be learnt",
    "range": "a value that the axis cannot have",
}


@dataclass(frozen=True)
class Finding:
    """What was found in which channel, and what to do about it.

    `fatal`: an identification on this log would be wrong; `warning`: it can go on, but the user must know; `note`:
    nothing is wrong with the log, but it limits what can be learnt from it, or confirms something that was in doubt.

    `cause` is one of `CAUSES`; `rivals` are other causes that the log does not rule out. `repair` undoes what happened:
    it is there only where the cause is certain, can be undone, and the repaired log passes every check.
    """

    severity: Severity
    channel: str
    message: str  # one sentence, with numbers
    remedy: str  # what to do
    cause: str = "range"
    rivals: tuple[str, ...] = ()
    repair: Repair | None = None
    resembles: str | None = None  # effect of the catalogue that would show alike in the log
    amount: float | None = None  # of it: the gain, or the delay in samples
    invalidates_log: bool = False  # whether no result from the log is valid before it is repaired

    def __str__(self) -> str:
        return f"{self.severity}: {self.channel}: {self.message}; {self.remedy}"
