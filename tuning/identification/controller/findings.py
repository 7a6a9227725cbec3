"""Whether logs have one controller, and the drive file's, as findings beside those of the checks of logs."""

from collections.abc import Iterator, Sequence

from diffdrive.axis import Axis
from diffdrive.controllers import UnknownController
from diffdrive.controllers.cascade import Cascade
from diffdrive.errors import LogError
from diffdrive.logs import Log
from diffdrive.logs.checks.finding import Finding
from tuning.identification.controller.workflow import LogController, differences_between, known_rate, of_log

OTHER_LOG = (
    "use logs of one controller together; diffdrive check --controller prints the gains of each, with their intervals"
)
OTHER_FILE = (
    "correct [controller]; diffdrive check --controller --out FOLDER writes the drive file with the gains of the logs"
)


def controller_findings(axis: Axis, logs: Sequence[Log], before: Sequence[Log] = ()) -> Iterator[tuple[str, Finding]]:
    """A sentence for each log whose cascade is not that of a log before it, or not the drive file's.

    Only where the controller cannot be computed again (`Axis.as_logged`): otherwise the checks compare the command
    itself. Nor where the rows have means, or forces that act: the law is that of single commands. `before` are logs
    that were looked over before; logs that show no cascade are passed over.
    """
    trace = axis.trace
    if not isinstance(axis.controller, UnknownController | Cascade) or axis.as_logged().controller.can_simulate:
        return
    if trace.command != "set-point" or trace.sample != "snapshot":
        return
    each = list(_shown([*before, *logs], known_rate(axis)))
    new = {log.name for log in logs}
    found: dict[str, list[str]] = {}
    among: dict[str, str] = {}
    for difference in differences_between(axis, each):
        source, other = difference.sources
        # of two logs the later one is said to differ, from the first that it differs from
        at, against = (source, other) if other == "the drive file" else (other, source)
        if at not in new and at in {one.log for one in each}:
            continue
        if among.setdefault(at, against) == against:
            found.setdefault(at, []).append(difference.sentence)
    for at, sentences in found.items():
        remedy = OTHER_FILE if among[at] == "the drive file" else OTHER_LOG
        yield at, Finding("warning", "command", ", and ".join(sentences), remedy, cause="other controller")


def _shown(logs: Sequence[Log], control_rate: float | None) -> Iterator[LogController]:
    for log in logs:
        if log.reference is None:
            continue
        try:
            yield of_log(log, control_rate)
        except LogError:
            continue
