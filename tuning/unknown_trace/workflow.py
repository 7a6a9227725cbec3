"""`tuning.start`: a drive file from a trace of which nothing is known but what its owner can read off a data sheet."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import ClassVar

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import parse_axis
from diffdrive.controllers import UnknownController
from diffdrive.errors import DriveFileError, ParameterError
from diffdrive.logs import ColumnMapping, Log, read_log
from diffdrive.logs.guess.result import Guess, Question
from diffdrive.logs.guess.trace import TraceGuess, guess_trace
from diffdrive.logs.read import table_of
from diffdrive.model.data_sheet import DataSheet
from diffdrive.model.parameters import Sampling
from diffdrive.motion.text import number
from diffdrive.results import Result, Status
from diffdrive.support.atomic_write import write_text
from tuning.checked_logs import CheckedLogs, check_logs
from tuning.unknown_trace.controller import FirstController, first_controller
from tuning.unknown_trace.friction import FirstMachine, first_machine
from tuning.unknown_trace.text import drive_text


@dataclass(frozen=True, repr=False, eq=False)
class StartResult(Result):
    """A drive file to start from, each value with its reason; or what has to be stated before there is one.

    `text` is the drive file, `axis` what it says, `findings` what the checks find in the log with it. Where `questions`
    are left there is none of these; each says what is open, which readings there are, and what decides. Not ok: a
    question is open (code `open questions`), or a finding is fatal (`fatal findings`).
    """

    guesses: tuple[Guess, ...]
    questions: tuple[Question, ...]
    notes: tuple[str, ...]
    status: Status
    text: str | None = None
    axis: Axis | None = None
    findings: CheckedLogs | None = None
    machine: FirstMachine | None = None
    controller: FirstController | None = None
    implied_mass: float | None = None  # kg, by inverse dynamics

    schema: ClassVar[str] = "start/1"

    def headline(self) -> str:
        prefix = "" if self.status.ok else "NOT OK: "
        return f"{prefix}{self.status.message}"

    def summary(self) -> str:
        lines = [self.headline(), *(f"  {guess}" for guess in self.guesses)]
        lines += [f"  ? {question}" for question in self.questions]
        return "\n".join([*lines, *(f"- {note}" for note in self.notes)])

    def as_dict(self) -> dict[str, object]:
        found = None if self.machine is None else self.machine.found
        return {
            "guesses": [guess._asdict() for guess in self.guesses],
            "questions": [question._asdict() | {"option": question.option} for question in self.questions],
            "drive_file": self.text,
            "implied_mass_kg": self.implied_mass,
            "coulomb_N": None if found is None else found.values.get("coulomb"),
            "viscous_N_s_per_m": None if found is None else found.values.get("viscous"),
            "findings": [
                {"log": log, "severity": one.severity, "channel": one.channel, "message": one.message}
                for log, one in (() if self.findings is None else self.findings.findings)
            ],
        }

    def write(self, path: str | Path) -> Path:
        """Write the drive file; raises `DriveFileError` where there is none, and where a file of that name exists."""
        path = Path(path)
        if self.text is None:
            raise DriveFileError(f"{path}: there is no drive file yet: {self.status.message}")
        require_new(path)
        try:
            write_text(path, self.text)
        except OSError as problem:
            raise DriveFileError(f"{path}: cannot be written: {problem.strerror or problem}") from None
        return path


def require_new(path: Path) -> None:
    """Raise `DriveFileError` where a file, or anything else, has this name already."""
    if path.is_symlink() or path.exists():
        raise _exists(path)


def _exists(path: Path) -> DriveFileError:
    return DriveFileError(f"{path}: exists, and is not overwritten: remove it, or name another file")


def start(
    source: object,
    *,
    mass: float | str | None = None,
    lead: float | str | None = None,
    gear_ratio: float | str | None = None,
    rated_torque: float | str | None = None,
    rated_current: float | str | None = None,
    torque_constant: float | str | None = None,
    encoder_counts: float | str | None = None,
    kind: str = "linear",
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    rate: float | str | None = None,
    throw: bool = False,
) -> StartResult:
    """Make a drive file from a trace alone: guess its columns, units, signs, friction and controller.

    Guesses rest on names and on the numbers: what moves alike, what is whose slope, which position's noise the command
    works against, which force mass and friction explain. What cannot be guessed is asked: the result then has
    `questions`, and no drive file. Method: docs/how-to/start-from-a-trace.md.

    Args:
        source: A file of any format that `read_log` reads, a data frame, or a dict of arrays [n].
        mass: Moving mass, motor and screw included, in kg or as a text with its unit; of a rotary axis kg m^2.
        lead: Travel per turn of the screw (m), where a column is in units of the motor.
        gear_ratio: Turns of the motor per turn of the screw or table.
        rated_torque: Of the motor (N m), where the command is in per cent of it.
        rated_current: Of the motor (A).
        torque_constant: Of the motor (N m/A), where the command is a current.
        encoder_counts: Counts of the motor's encoder per turn of the motor.
        kind: Of the axis, linear or rotary.
        columns: The column of each channel that you know.
        units: The unit of its column, likewise; a minus reverses it.
        rate: Rate of the rows (Hz), where no column is a time.
        throw: Raise an error where a question is open or a finding is fatal.

    Raises:
        LogError: The trace cannot be read, or a column that is stated does not exist.
        ParameterError: A number is out of its range.
        ResultError: The result is not ok, with `throw`.

    Examples:
        >>> first = start("trace.csv", mass="500 kg", lead="10 mm")
        >>> print(first)
        >>> first.write("drive.toml")

    """
    numbers = {
        "lead": lead, "gear_ratio": gear_ratio, "rated_torque": rated_torque, "rated_current": rated_current,
        "torque_constant": torque_constant, "encoder_counts": encoder_counts,
    }  # fmt: skip
    sheet = _sheet(kind, {name: value for name, value in numbers.items() if value is not None})
    stated_mass = None if mass is None else _number("mass", mass, "kg", sheet)
    if stated_mass is not None and not stated_mass > 0.0:
        raise ParameterError(f"mass: must be above 0, got {stated_mass:g}")
    stated_rate = None if rate is None else _number("rate", rate, "Hz", sheet)
    table = table_of(source)
    name = Path(table.source).name
    trace = guess_trace(table, columns=columns, units=units, sheet=sheet, mass=stated_mass, rate=stated_rate)
    if stated_mass is None and not any(one.argument == "mass" for one in trace.questions):
        trace.questions.append(_of_mass(trace))
    result = (
        _open(trace)
        if trace.questions or stated_mass is None
        else _started(source, name, trace, stated_mass, stated_rate)
    )
    return result.require_ok() if throw else result


def _number(name: str, value: float | str, unit: str, sheet: DataSheet) -> float:
    return number(value, unit, name, sheet) if isinstance(value, str) else float(value)


def _sheet(kind: str, stated: Mapping[str, float | str]) -> DataSheet:
    declared = {one.name: one.metadata["quantity"].unit for one in fields(DataSheet) if "quantity" in one.metadata}
    none = DataSheet()
    return DataSheet(kind=kind, **{name: _number(name, value, declared[name], none) for name, value in stated.items()})


def _unit_of_mass(trace: TraceGuess) -> str:
    return "kg*m^2" if trace.sheet.is_rotary else "kg"


def _of_mass(trace: TraceGuess) -> Question:
    shown = ""
    unit = _unit_of_mass(trace)
    if trace.implied_mass is not None:
        shown = f" (with these units the trace itself shows {trace.implied_mass:.3g} {unit})"
    example = "0.5 kg*m^2" if trace.sheet.is_rotary else "500 kg"
    return Question("mass", "", f"the moving mass, motor and screw included, is not known{shown}", example)


def _open(trace: TraceGuess) -> StartResult:
    message = "; ".join(str(question) for question in trace.questions)
    return StartResult(
        tuple(trace.guesses),
        tuple(trace.questions),
        tuple(trace.notes),
        Status(False, message, code="open questions"),
        implied_mass=trace.implied_mass,
    )


def _started(source: object, name: str, trace: TraceGuess, mass: float, rate: float | None) -> StartResult:
    """The drive file, and what the checks make of the log with it."""
    mapping = ColumnMapping(sheet=trace.sheet).overridden(trace.columns, trace.units, {})
    log = read_log(source, mapping=mapping, rate=rate)
    machine = first_machine(log, mass, is_rotary=trace.sheet.is_rotary)
    bare = Axis(machine.drive, UnknownController(), Sampling(log.rate), mapping=mapping, sheet=trace.sheet)
    controller = first_controller(log, bare)
    text = drive_text(name, log, trace, machine, controller)
    axis = replace(parse_axis(tomllib.loads(text), "the drive file"), name="drive")
    found = check_logs(axis, [log])
    return StartResult(
        (*trace.guesses, *_of_drive(machine, controller, axis)),
        (),
        (*trace.notes, *machine.notes, *_of_contradiction(trace, mass), *log.notes),
        _status(found, log),
        text,
        axis,
        found,
        machine,
        controller,
        trace.implied_mass,
    )


def _of_drive(machine: FirstMachine, controller: FirstController, axis: Axis) -> list[Guess]:
    friction = machine.drive.friction
    force, damping = ("N*m", "N*m*s/rad") if axis.sheet.is_rotary else ("N", "N*s/m")
    level, drag = float(friction.coulomb_screw.positive), float(friction.viscous.positive)
    seen = machine.found is not None
    guesses = [
        Guess(
            "friction",
            f"{level:g} {force} Coulomb, {drag:g} {damping} viscous",
            "likely",
            "inverse dynamics, alike in both directions"
            if seen
            else "a hundredth of the largest command, to begin with",
        )
    ]
    kind = "unknown" if controller.controller is None else controller.controller.kind
    return [*guesses, Guess("controller", kind, "sure" if controller.is_exact else "likely", controller.why)]


def _of_contradiction(trace: TraceGuess, mass: float) -> list[str]:
    """A stated mass that is off what the trace shows by more than a factor of two."""
    shown, balance, unit = trace.implied_mass, trace.balance, _unit_of_mass(trace)
    if shown is None or balance is None or not balance.fit.mass.is_determined or 0.5 < shown / mass < 2.0:
        return []
    return [
        f"the trace shows a moving mass of {shown:.3g} {unit} with these units, and {mass:g} {unit} is stated: one of "
        "the mass, the command's unit and what it rests on (rated torque, torque constant, lead) is another"
    ]


def _status(found: CheckedLogs, log: Log) -> Status:
    if found.fatal:
        _, first = found.fatal[0]
        return Status(False, f"{log.name}: {first.channel}: {first.message}; {first.remedy}", code="fatal findings")
    count = len(found.notable)
    what = (
        "the checks find nothing wrong" if not count else f"the checks find {count} thing{'s' * (count > 1)} to look at"
    )
    return Status(True, f"a drive file to start from; {what}")
