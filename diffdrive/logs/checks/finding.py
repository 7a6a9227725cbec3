"""What a check found in a log, in words that an engineer can act on."""

from dataclasses import dataclass
from typing import Literal

Severity = Literal["fatal", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("fatal", "warning", "note")


@dataclass(frozen=True)
class Finding:
    """One trap: what was found in which channel, and what to do about it.

    `fatal`: an identification on this log would be wrong; `warning`: it can go on, but the user must know; `note`:
    nothing is wrong with the log, but it limits what can be learnt from it, or confirms something that was in doubt.
    """

    severity: Severity
    channel: str
    found: str  # one sentence, with numbers
    mend: str  # what to do
    resembles: str | None = None  # effect of the catalogue that would look alike, had the machine it and not the log
    amount: float | None = None  # of it: the gain, or the delay in samples
    voids: bool = False  # whether nothing that is made of the log means anything before that is mended

    def __str__(self) -> str:
        return f"{self.severity}: {self.channel}: {self.found}; {self.mend}"
