"""The records of the check as JSON holds them: answers, keys, and the scored rows."""

from typing import NotRequired, TypedDict

Number = float | list[float] | tuple[float, float]  # of all logs, or one for each


class Cause(TypedDict):
    """An effect that was considered, as the diagnosis writes it."""

    effect: str
    found: bool
    confidence: float
    evidence: float
    indistinguishable_from: list[str]
    parameters: dict[str, Number]
    intervals: dict[str, list[Number]]  # low and high; an end may be missing


class Answer(TypedDict):
    """The parts of a diagnosis that are scored; one that failed has the first three alone."""

    verdict: str
    says: NotRequired[str]
    causes: list[Cause]
    gap: NotRequired[dict[str, float | None]]
    ladder: NotRequired[list[dict[str, float | str | None]]]
    seconds: NotRequired[float]


class TrueEffect(TypedDict):
    """An effect of a machine; `true` has its parameters in the names of the catalogue."""

    name: str
    size: float
    outside: bool
    true: NotRequired[dict[str, Number]]


class CaseKey(TypedDict):
    """The key to one machine; a bench may state kind and visibility in place of sizes."""

    effects: list[TrueEffect]
    rate: NotRequired[float]
    samples_a_row: NotRequired[int]  # of the control, of which a log has the first
    pitfall: NotRequired[bool]
    kind: NotRequired[str]
    visibility: NotRequired[str]


class ScoredCase(TypedDict):
    """An answer against the key."""

    case: str
    kind: str
    true: list[str]
    size: list[float]
    visibility: float | None
    clear: bool
    failed: bool
    verdict: str
    found: list[str]
    top1: bool
    named: bool
    top2: bool
    declared: bool
    declared_of_few: bool
    rivals: int
    both: bool
    exact: bool
    said_none: bool
    alarm: bool
    said_unknown: bool
    confidently_wrong: bool
    sure: list[tuple[str, float, bool]]
    within: list[bool]
    parameter_error: float | None
    shrink: float | None
    seconds: float | None


Answers = dict[str, Answer]
Key = dict[str, CaseKey]
