"""`tuning.identify_controller`: the gains of a position and speed cascade from logs, each with its interval."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from diffdrive.axis import Axis
from diffdrive.controllers.cascade import Cascade
from diffdrive.errors import LogError, ParameterError
from diffdrive.logs import Log, read_logs
from diffdrive.results import Result, Status
from tuning.identification.controller.compare import SMALLEST, Difference, differences
from tuning.identification.controller.fit import LawFit
from tuning.identification.controller.gains import Gain, Parts, gains_of, parts_of, parts_of_cascade, pooled
from tuning.identification.controller.law import Reading
from tuning.identification.controller.readings import fit_log


@dataclass(frozen=True)
class LogController:
    """The controller of one log.

    `reading` says what its rows are; `unexplained` is the share of the command (root mean square) that a cascade with
    these gains leaves. Of snapshots, `window` is the time over which the velocity is differenced (s) and `delay` by how
    much the command was logged late (s); zero where each row is a sample.
    """

    log: str
    gains: tuple[Gain, ...]
    reading: Reading
    unexplained: float
    window: float
    delay: float
    parts: Parts

    def gain(self, name: str) -> Gain:
        """One gain by name; raises `ParameterError` for an unknown one."""
        return _named(self.gains, name)


@dataclass(frozen=True, repr=False, eq=False)
class ControllerEstimate(Result):
    """The gains of a cascade as estimated from logs: of each log, and of all together where they are the same.

    `gains` are of all logs; where the logs differ they are of the last one, and `differences` say so. Not ok: the logs
    determine no K_v, or the logs' controllers differ from one another.
    """

    gains: tuple[Gain, ...]
    logs: tuple[LogController, ...]
    differences: tuple[Difference, ...]  # between logs, and between the logs and the drive file
    notes: tuple[str, ...]
    status: Status

    schema: ClassVar[str] = "controller/1"

    def gain(self, name: str) -> Gain:
        """One gain, by name; raises `ParameterError` for an unknown one.

        They are `kp` (K_v, 1/s), `kv` (velocity gain, N s/m), `ki` (N/m), `reset_time` (s), `velocity_feedforward` (1),
        `acceleration_feedforward` (kg) and `following_time` (following error per speed, s).
        """
        return _named(self.gains, name)

    def interval(self, name: str) -> tuple[float, float]:
        """The 95 % interval of one gain."""
        gain = self.gain(name)
        return gain.low, gain.high

    def headline(self) -> str:
        prefix = "" if self.status.ok else "NOT OK: "
        kp = self.gain("kp")
        return f"{prefix}{self.status.message}: K_v {kp.value:.4g} 1/s ({kp.low:.4g} to {kp.high:.4g})"

    def summary(self) -> str:
        rows = [f"{'gain':<28}{'unit':<8}{'estimated':>12}  95 % interval"]
        for gain in self.gains:
            interval = f"{gain.low:.4g} to {gain.high:.4g}"
            if not gain.determined and gain.name in ("kp", "kv", "reset_time", "ki"):
                interval += " (not determined)"
            rows.append(f"{gain.name:<28}{_unit(gain.unit):<8}{gain.value:>12.4g}  {interval}")
        return "\n".join([self.headline(), *rows, *(f"- {note}" for note in self.notes)])

    def as_dict(self) -> dict[str, object]:
        return {
            "gains": [gain._asdict() for gain in self.gains],
            "logs": [
                {
                    "log": one.log,
                    "gains": [gain._asdict() for gain in one.gains],
                    "reading": one.reading.value,
                    "unexplained": one.unexplained,
                    "window_s": one.window,
                    "delay_s": one.delay,
                }
                for one in self.logs
            ],
            "differences": [difference._asdict() for difference in self.differences],
        }


def identify_controller(
    axis: Axis | None, logs: object, *, control_rate: float | None = None, throw: bool = False
) -> ControllerEstimate:
    """Estimate the gains of a position and speed cascade from reference, position and command of logs.

    The rows may be every sample of the controller or snapshots of a faster loop; which of them is told from the log.
    Where the axis has a cascade of its own, the logs are compared with it. Method: docs/method/controller.md.

    Args:
        axis: Names the columns of logs that are files, and the controller to compare with; None for neither.
        logs: One or several of `Log`, files, data frames or dicts of arrays [n]. They may have different rates.
        control_rate: Rate of the controller (Hz), which may be faster than the rows; by default the axis's, if its
            controller is known.
        throw: Raise an error where no K_v is determined, or the logs differ.

    Raises:
        LogError: A log has no reference, is too short, or holds no command of a cascade.
        ParameterError: `control_rate` is no such rate.
        ResultError: No K_v is determined or the logs differ, with `throw`.

    Examples:
        >>> estimate = identify_controller(None, ["before.csv", "today.csv"])
        >>> estimate.interval("kp")
        >>> [difference.sentence for difference in estimate.differences]

    """
    if control_rate is not None and not (np.isfinite(control_rate) and control_rate > 0):
        raise ParameterError(f"control_rate: must be positive and finite, in Hz, got {control_rate!r}")
    read = _read(axis, logs)
    if control_rate is None and axis is not None and isinstance(axis.controller, Cascade):
        control_rate = axis.rate
    period = None if control_rate is None else 1.0 / control_rate
    each = tuple(_of_log(log.name, fit_log(log), period) for log in read)
    result = _together(axis, each)
    return result.require_ok() if throw else result


def _read(axis: Axis | None, logs: object) -> list[Log]:
    listed = logs if isinstance(logs, list | tuple) else [logs]
    if not listed:
        raise LogError("no log is given; give one or more")
    unread = [source for source in listed if not isinstance(source, Log)]
    mapping = None if axis is None else axis.mapping  # not its rate: a trace may be slower than the loop
    read = iter(read_logs(unread, mapping=mapping) if unread else ())
    return [source if isinstance(source, Log) else next(read) for source in listed]


def _of_log(name: str, fit: LawFit, control_period: float | None) -> LogController:
    parts = parts_of(fit, control_period)
    snapshots = fit.reading is not Reading.EVERY_SAMPLE
    return LogController(
        name,
        gains_of(parts),
        fit.reading,
        fit.residual / fit.command,
        window=fit.period * float(fit.law.window.real) if snapshots else 0.0,
        delay=fit.period * float(fit.law.shift.real) if snapshots else 0.0,
        parts=parts,
    )


def _together(axis: Axis | None, each: Sequence[LogController]) -> ControllerEstimate:
    between = tuple(
        difference
        for one, other in itertools.combinations(each, 2)
        for difference in differences(one.parts, other.parts, (one.log, other.log))
    )
    parts = each[-1].parts if between else pooled([one.parts for one in each])
    stated: tuple[Difference, ...] = ()
    if axis is not None and isinstance(axis.controller, Cascade):
        compared = each if between else [LogController(_listed(each), (), each[0].reading, 0.0, 0.0, 0.0, parts)]
        known = parts_of_cascade(axis.controller)
        stated = tuple(
            difference for one in compared for difference in differences(one.parts, known, (one.log, "the drive file"))
        )
    gains = gains_of(parts)
    return ControllerEstimate(
        gains, tuple(each), (*between, *stated), _notes(gains, each, (*between, *stated)), _status(gains, between)
    )


def _status(gains: Sequence[Gain], between: Sequence[Difference]) -> Status:
    if between:
        return Status(False, "the controllers of the logs differ", code="different controllers")
    if not _named(gains, "kp").determined:
        return Status(False, "the logs do not determine K_v", code="not determined")
    return Status(True)


def _notes(gains: Sequence[Gain], each: Sequence[LogController], found: Sequence[Difference]) -> tuple[str, ...]:
    notes = [difference.sentence for difference in found]
    following = _named(gains, "following_time")
    if following.determined and following.value * _named(gains, "kp").value > SMALLEST:
        notes.append(f"on long strokes the speed is {1.0 / following.value:.4g} 1/s times the following error")
    kp, rate = _named(gains, "kp"), _named(gains, "reset_time")
    if not following.determined and not kp.determined and not rate.determined:
        notes.append(
            "without a lasting following error K_v and the inverse reset time cannot be told apart: log a stroke with "
            "sharper reversals, or every sample of the controller"
        )
    notes += [
        f"{one.log}: {one.reading.value}; {100.0 * one.unexplained:.2g} % of the command is unexplained" for one in each
    ]
    return tuple(notes)


def _listed(each: Sequence[LogController]) -> str:
    return each[0].log if len(each) == 1 else f"the {len(each)} logs"


def _named(gains: Sequence[Gain], name: str) -> Gain:
    for gain in gains:
        if gain.name == name:
            return gain
    raise ParameterError(f"{name}: is no gain; known: {', '.join(gain.name for gain in gains)}")


def _unit(unit: str) -> str:
    return "-" if unit == "1" else unit
