"""The forms: which commands there are on the page, what each takes, and the command line that comes of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from experiments.app.workspace import AppError

Kind = Literal["trace", "traces", "drive", "text", "choice", "flag"]


@dataclass(frozen=True)
class Field:
    """One field; `option` is what the command line calls it, empty for an argument."""

    name: str
    label: str
    kind: Kind = "text"
    option: str = ""
    help: str = ""
    default: Any = ""
    required: bool = False
    choices: tuple[str, ...] = ()
    obvious: bool = True  # where there is one file alone, it is the one


@dataclass(frozen=True)
class Form:
    """A command: what it answers, and its fields; those of `more` are shown on request."""

    command: str
    title: str
    answers: str
    fields: tuple[Field, ...]
    more: tuple[Field, ...] = ()
    fixed: tuple[str, ...] = ()  # what always stands on the command line
    mapped: bool = True  # whether columns and units that were stated for the traces go along

    def field(self, name: str) -> Field:
        """A field by its name."""
        return next(one for one in (*self.fields, *self.more) if one.name == name)


_TRACES = Field("traces", "Traces of one machine", "traces", required=True)
_DRIVE = Field("drive", "Drive file", "drive", "--drive", "The axis as it should be.", required=True)
_AXIS = Field("drive", "Drive file", "drive", required=True)
_LOAD = Field("load", "Load on the guides", "text", "--load", "A force such as 8kN; where the trace holds none: 0.")
_STARTS = Field("starts", "Number of searches", "text", "--starts", "6 if empty; fewer take less time.")
_FORCE = Field("force", "In spite of fatal findings", "flag", "--force", default=False)

FORMS = (
    Form(
        "start", "Start", "I have a trace and no drive file.",
        (
            Field("trace", "Trace", "trace", required=True),
            Field("mass", "Moving mass", "text", "--mass", "With motor and screw: 500kg. A factor of two is enough."),
            Field("lead", "Lead", "text", "--lead", "Travel per turn of the screw, for units of the motor: 10mm."),
            Field("rated_torque", "Rated torque", "text", "--rated-torque", "For a command in per cent: 5Nm."),
        ),
        (
            Field("gear_ratio", "Gear ratio", "text", "--gear-ratio", "Turns of the motor per turn of the screw."),
            Field("rated_current", "Rated current", "text", "--rated-current", "4A"),
            Field("torque_constant", "Torque constant", "text", "--torque-constant", "For a current: 1.2N*m/A."),
            Field("encoder_counts", "Encoder counts", "text", "--encoder-counts", "Counts per turn of the motor."),
            Field("rate", "Rate of the rows", "text", "--rate", "Where no column is a time: 1kHz."),
            Field("kind", "Axis", "choice", "--kind", default="linear", choices=("linear", "rotary")),
        ),
        ("--drive", "{out}/drive.toml"),
    ),
    Form(
        "check", "Check", "What in these traces would mislead?", (_TRACES, _DRIVE),
        (Field("controller", "The gains of the controller, too", "flag", "--controller", default=False), _LOAD),
    ),
    Form(
        "identify", "Identify", "What are friction, mass and delay?", (_TRACES, _DRIVE),
        (Field("held_out", "Traces that are only predicted", "traces", "--held-out"), _STARTS, _LOAD, _FORCE),
    ),
    Form(
        "diagnose", "Diagnose", "Why does the machine differ from its model?", (_TRACES, _DRIVE),
        (
            Field("tolerance", "How well the drive file is known", "text", "--tolerance", "0.02 is right to 2 %."),
            Field("most", "Largest number of effects at once", "text", "--most-effects", "1 to 4; 2 if empty."),
            Field("tune", "Tune on what was found", "flag", "--tune", "Takes minutes more.", default=False),
            _LOAD,
        ),
    ),
    Form(
        "compare", "Compare", "What has changed since?",
        (
            Field("before", "Traces before", "traces", required=True, obvious=False),
            Field("after", "Traces after", "traces", required=True, obvious=False),
            _DRIVE,
        ),
        (_STARTS, _LOAD, _FORCE),
    ),
    Form(
        "simulate", "Simulate", "How well does this axis follow?",
        (
            _AXIS,
            Field("machine", "Machine, where it differs", "drive", "--machine", "A second drive file with effects."),
            Field("motion", "Motion", "text", "--motion", "sine:amplitude=15mm,frequency=0.5Hz,duration=6s"),
            Field("load", "Load on the guides", "text", "--load", "0 if empty; 8kN."),
        ),
        mapped=False,
    ),
    Form(
        "tune", "Tune", "Which gains are better?",
        (
            _AXIS,
            Field("phase", "Smallest phase margin, degrees", "text", "--phase-margin"),
            Field("noise", "Largest command noise", "text", "--command-noise", "20N; twice today's if empty."),
        ),
        mapped=False,
    ),
)  # fmt: skip
BY_COMMAND = {form.command: form for form in FORMS}
LONGEST = 1000  # characters of a value: no option needs as many, and a command line has an end


def arguments(
    form: Form, values: Mapping[str, Any], there: Callable[[str], object], mapping: Callable[[str], Mapping[str, Any]]
) -> list[str]:
    """The command line of a form, without its name; raises `AppError` that names the field which is missing.

    `there` raises `AppError` for a path that is none of the workspace, `mapping` gives what was stated for a trace.
    """
    options: list[str] = list(form.fixed)
    files: list[str] = []
    traces: list[str] = []
    for field in (*form.fields, *form.more):
        value = values.get(field.name, field.default)
        if field.kind == "flag":
            options += [field.option] if value else []
            continue
        found = _values(field, value)
        if field.required and not found:
            raise AppError(f"{field.label}: choose {'one' if field.kind != 'traces' else 'one or more'}")
        if field.kind in ("trace", "traces", "drive"):
            for path in found:
                there(path)
        traces += found if field.kind in ("trace", "traces") else []
        if field.option:
            options += [f"{field.option}={one}" for one in found]
        else:
            files += ["--"] if field.name == "after" else []
            files += found
    return [*options, *(_mapped(traces, mapping) if form.mapped else ()), *files]


def follow_up(made: Sequence[str], found: str = "") -> dict[str, Any]:
    """What the form of the next command begins with: the traces of this one, and its drive file or the `found` one.

    `made` is the whole command line of a job: the path of a drive file that it writes, or reads, is an option in it.
    """
    pairs = list(zip(["", *made], made, strict=False))
    after = {option: value for option, value in pairs if option in ("--out", "--drive")}
    drive = next((one.removeprefix("--drive=") for one in made if one.startswith("--drive=")), after.get("--drive", ""))
    traces = [one for before, one in pairs[1:] if not one.startswith("-") and before not in after]
    return {"traces": traces, "drive": found or drive}


def _values(field: Field, value: object) -> list[str]:
    """What a field holds, as texts."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [str(one) for one in value if str(one)]
    text = "" if value is None else str(value).strip()
    if len(text) > LONGEST or not text.isprintable():
        raise AppError(f"{field.label}: is no {field.label.lower()}")
    return [text] if text and not (field.kind == "choice" and text == field.default) else []


def _mapped(traces: Sequence[str], mapping: Callable[[str], Mapping[str, Any]]) -> list[str]:
    """The options for columns and units that were stated; for all traces of a command they must be the same."""
    stated = [mapping(trace) for trace in traces]
    for trace, other in zip(traces[1:], stated[1:], strict=True):
        if other != stated[0]:
            raise AppError(
                f"{trace.rpartition('/')[2]}: has other columns or units than {traces[0].rpartition('/')[2]}; state "
                "the same for all traces that go together"
            )
    if not stated:
        return []
    return [
        f"--{kind}={channel}={text}"
        for kind in ("column", "unit")
        for channel, text in dict(stated[0].get(kind, {})).items()
    ]
