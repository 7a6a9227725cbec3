"""`tuning.identify_controller`: the gains of a position and speed cascade from logs, each with its interval."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from diffdrive.axis import Axis, require_axis
from diffdrive.controllers import UnknownController
from diffdrive.controllers.cascade import Cascade
from diffdrive.errors import LogError, ParameterError
from diffdrive.logs import Log, read_logs
from diffdrive.results import Result, Status
from diffdrive.support.bounds import require_number
from tuning.identification.controller.cascade import cascade_of
from tuning.identification.controller.compare import SMALLEST, Difference, Named, differences_of
from tuning.identification.controller.gains import Gain, Parts, gains_of, parts_of, parts_of_cascade, pooled
from tuning.identification.controller.law import Reading
from tuning.identification.controller.readings import fit_log


@dataclass(frozen=True)
class LogController:
    """The controller of one log.

    `reading` says what its rows are; `unexplained` is the share of the command (root mean square) that a cascade with
    these gains leaves, of snapshots of its slow part. `window` is the time over which the velocity is differenced (s).
    Of snapshots, `delay` is by how much the command was logged late (s); zero where each row is a sample.
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

    @property
    def is_explained(self) -> bool:
        """Whether a cascade explains the command as closely as gains are compared: a change of less would be seen."""
        return self.unexplained < SMALLEST


@dataclass(frozen=True, repr=False, eq=False)
class ControllerEstimate(Result):
    """The gains of a cascade as estimated from logs: of each log, and of all together where they are the same.

    `gains` are of all logs; where the logs differ they are of the last one, and `differences` say so. `axis` is the one
    that was given with a cascade of these gains; None where none was given, or the controller's rate is not known. Not
    ok: the logs determine no K_v, or the logs' controllers differ from one another.
    """

    gains: tuple[Gain, ...]
    logs: tuple[LogController, ...]
    differences: tuple[Difference, ...]  # between logs, and between the logs and the drive file
    notes: tuple[str, ...]
    status: Status
    axis: Axis | None = None

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
        axis: Names the columns of logs that are files, the controller to compare with, and the axis in which the
            cascade that is found takes its place; None for none of these.
        logs: One or several of `Log`, files, data frames or dicts of arrays [n]. They may have different rates.
        control_rate: Rate of the controller (Hz), which may be faster than the rows; by default the axis's, if its
            controller is known or [trace] says another rate of the rows.
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
    if axis is not None:
        require_axis(axis)
    if control_rate is not None:
        require_number("control_rate", control_rate, "Hz", above=0.0)
    read = _read(axis, logs)
    control_rate = control_rate or known_rate(axis)
    each = tuple(of_log(log, control_rate) for log in read)
    result = _together(axis, each, control_rate)
    return result.require_ok() if throw else result


def _read(axis: Axis | None, logs: object) -> list[Log]:
    listed = logs if isinstance(logs, list | tuple) else [logs]
    if not listed:
        raise LogError("no log is given; give one or more")
    unread = [source for source in listed if not isinstance(source, Log)]
    mapping = None if axis is None else axis.mapping  # not its rate: a trace may be slower than the loop
    read = iter(read_logs(unread, mapping=mapping) if unread else ())
    return [source if isinstance(source, Log) else next(read) for source in listed]


def known_rate(axis: Axis | None) -> float | None:
    """The rate of the axis's controller (Hz); None where the rate of its file may be that of a trace."""
    if axis is None or (isinstance(axis.controller, UnknownController) and axis.trace.rate is None):
        return None
    return axis.rate


def of_log(log: Log, control_rate: float | None) -> LogController:
    """The controller of one log; raises `LogError` where it shows none."""
    fit = fit_log(log)
    parts = parts_of(fit, None if control_rate is None else 1.0 / control_rate)
    delay = fit.period * float(fit.law.shift.real)
    return LogController(log.name, gains_of(parts), fit.reading, fit.unexplained, fit.window, delay, parts)


def differences_between(axis: Axis | None, each: Sequence[LogController]) -> tuple[Difference, ...]:
    """Those between logs; where there are none, those from the axis's cascade, of all logs together.

    A log whose command a cascade does not explain is compared with nothing.
    """
    explained = [one for one in each if one.is_explained]
    several = [Named(one.log, one.parts) for one in explained]
    between = differences_of(list(itertools.combinations(several, 2)))
    known = parts_of_cascade(axis.controller) if axis is not None and isinstance(axis.controller, Cascade) else None
    if known is None or not several:
        return between
    if not between:
        several = [Named(_listed(explained), pooled([one.parts for one in explained]))]
    return between + differences_of([(one, Named("the drive file", known)) for one in several])


def _together(axis: Axis | None, each: Sequence[LogController], control_rate: float | None) -> ControllerEstimate:
    found = differences_between(axis, each)
    names = {one.log for one in each}
    between = [one for one in found if set(one.sources) <= names]
    parts = each[-1].parts if between else pooled([one.parts for one in each])
    gains, status = gains_of(parts), Status(True)
    if between:
        status = Status(False, "the controllers of the logs differ", code="different controllers")
    elif not _named(gains, "kp").determined:
        status = Status(False, "the logs do not determine K_v", code="not determined")
    rate = control_rate
    if rate is None and axis is not None and each[-1].reading is Reading.EVERY_SAMPLE:
        rate = axis.rate
    with_cascade = None
    if axis is not None and rate is not None and status.code != "not determined":
        controller = cascade_of(gains, axis.drive, samples=max(1, round(each[-1].window * rate)))
        with_cascade = replace(axis, controller=controller)
    return ControllerEstimate(gains, tuple(each), found, _notes(gains, each, found), status, with_cascade)


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
    notes += [
        f"{one.log}: a cascade does not explain the command to {100.0 * SMALLEST:g} %, so it is compared with none: "
        "the controller has more, or is another"
        for one in each
        if not one.is_explained
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
