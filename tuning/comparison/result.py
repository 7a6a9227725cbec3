"""What `tuning.compare` gives: what has changed between two sets of logs, and what else would have been seen."""

from dataclasses import dataclass
from typing import ClassVar

from diffdrive.axis import Axis
from diffdrive.errors import ParameterError
from diffdrive.logs.encoders.result import EncoderComparison
from diffdrive.results import Result, Status
from tuning.comparison.change import Change
from tuning.comparison.findings import Finding
from tuning.comparison.sides import Sides
from tuning.identification.controller.workflow import LogController
from tuning.identification.workflow import IdentificationResult


@dataclass(frozen=True, repr=False, eq=False)
class ComparisonResult(Result):
    """What has changed between two sets of logs of one axis: the findings, a sentence each, and every change.

    `changes` are all numbers that were compared, `before` and `after` the identifications that they rest on;
    `p_unchanged` says how often two sets of one machine would differ as much as these. Where nothing has changed a
    finding is made in a share `level` of the comparisons, or fewer.

    Ok, with code `changed` or `unchanged`. Not ok, `doubtful`: one of the identifications did not converge or is
    doubtful itself, or the checks of the logs have found what would look like a change of the machine.
    """

    findings: tuple[Finding, ...]
    changes: tuple[Change, ...]
    explanations: tuple[tuple[str, ...], ...]  # the sets of machine parameters that explain all, the likeliest first
    p_unchanged: float
    level: float
    limits: str  # the smallest changes that would have been found
    before: IdentificationResult
    after: IdentificationResult
    controllers: Sides[LogController]
    encoders: Sides[EncoderComparison]
    notes: tuple[str, ...]
    status: Status

    schema: ClassVar[str] = "comparison/1"

    @property
    def axis(self) -> Axis:
        """The axis as it is after."""
        return self.after.axis

    def change(self, path: str) -> Change:
        """One number that was compared, by its path, such as `plant.mass`; raises `ParameterError` for another."""
        for one in self.changes:
            if one.path == path:
                return one
        known = ", ".join(one.path for one in self.changes)
        raise ParameterError(f"{path}: is not compared; known: {known}")

    def headline(self) -> str:
        prefix = "" if self.status.ok else f"NOT OK: {self.status.message}; "
        if not self.findings:
            return f"{prefix}no change found (p = {self.p_unchanged:.2g})"
        return prefix + "; ".join(finding.sentence for finding in self.findings)

    def summary(self) -> str:
        rows = [f"{'compared':<37}{'unit':<8}{'before':>12}{'after':>12}  change, 95 % interval"]
        for one in self.changes:
            mark = " *" if one.has_changed else ""
            low, high = one.factor * one.change.low, one.factor * one.change.high
            named = f"{one.path:<37}{'-' if one.unit == '1' else one.unit.replace('*', ' '):<8}"
            interval = f"{low:+.3g} to {high:+.3g} {one.shown_unit}"
            rows.append(f"{named}{one.before:>12.4g}{one.after:>12.4g}  {interval}{mark}")
        said = [finding.sentence for finding in self.findings] or ["no change found"]
        return "\n".join([self.headline(), *rows, *(f"- {note}" for note in (*said, *self.notes))])

    def as_dict(self) -> dict[str, object]:
        return {
            "findings": [finding._asdict() for finding in self.findings],
            "changes": [one._asdict() | {"change": one.change._asdict()} for one in self.changes],
            "explanations": self.explanations,
            "p_unchanged": self.p_unchanged,
            "level": self.level,
            "before": self.before.as_dict(),
            "after": self.after.as_dict(),
            "encoders": {"before": _of(self.encoders.before), "after": _of(self.encoders.after)},
        }


def _of(side: tuple[EncoderComparison, ...]) -> list[dict[str, object]]:
    return [{"log": one.log, **one.as_dict()} for one in side]
