"""What several commands take, and what no option may be."""

import math
from pathlib import Path
from typing import Annotated

import typer

from diffdrive.errors import ParameterError
from diffdrive.support.messages import short_repr

MOST = 2**63  # beyond: what the libraries count in


def finite(param: typer.CallbackParam, value: float | None) -> float | None:
    """A number, and not nan or infinite, which pass every range."""
    if value is not None and not math.isfinite(value):
        raise ParameterError(f"{param.opts[0]}: must be a finite number, got {value:g}")
    return value


def seed_of(param: typer.CallbackParam, value: int | None) -> int | None:
    """A seed that every generator takes."""
    if value is not None and not 0 <= value < MOST:
        raise ParameterError(f"{param.opts[0]}: must be a whole number from 0 to 2^63 - 1, got {short_repr(value)}")
    return value


def count_of(param: typer.CallbackParam, value: int | None) -> int | None:
    """A count that the machine can count to."""
    if value is not None and value >= MOST:
        raise ParameterError(f"{param.opts[0]}: must be less than 2^63, got {short_repr(value)}")
    return value


def parse_folder(text: str) -> Path:
    """A folder by its name; one without a name would be the current one."""
    if not text.strip():
        raise typer.BadParameter("is empty; name a folder, or . for the current one")
    return Path(text)


def figures_also(param: typer.CallbackParam, asked: bool) -> bool:
    """Have every report of this command save its figures in the format that the option is named after, too."""
    from experiments.reports.formats import figure_formats

    ending = param.opts[0].removeprefix("--")
    others = tuple(one for one in figure_formats.get() if one != ending)  # a command before this one may have asked
    figure_formats.set((*others, ending) if asked else others)
    return asked


DriveFile = Annotated[
    Path,
    typer.Argument(
        help="Drive file (TOML), `diffdrive template` prints one; or an axis by name, `diffdrive axes` lists them."
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        parser=parse_folder,
        metavar="PATH",
        help="Folder for figures, tables and result.json; made if it does not exist.",
    ),
]
StudyFolder = Annotated[
    Path,
    typer.Option(
        "--out",
        parser=parse_folder,
        metavar="PATH",
        help="Folder; a study that was interrupted goes on from what is in it.",
    ),
]
Svg = Annotated[
    bool, typer.Option("--svg", callback=figures_also, help="Write each figure as SVG, too, beside its PNG.")
]
Pdf = Annotated[
    bool, typer.Option("--pdf", callback=figures_also, help="Write each figure as PDF, too, as a paper includes it.")
]
Logs = Annotated[
    list[Path],
    typer.Argument(
        help="Logs of one machine: CSV or other text, MAT, Parquet, HDF5, MDF, TDMS, MCAP, SINUMERIK XML, TNCscope.",
        metavar="LOG...",
        show_default=False,
    ),
]
DriveOption = Annotated[
    Path,
    typer.Option("--drive", help="Drive file, or axis by name: the nominal axis, and columns and units of its logs."),
]
Columns = Annotated[
    list[str] | None,
    typer.Option(
        "--column",
        help="CHANNEL=COLUMN: the column of a channel, `position=ActPos`; takes precedence over the drive file's "
        "\\[columns]; repeatable. Channels: time, reference, position, command, motor_position, velocity, current, "
        "load, disturbance, injected, temperature.",
    ),
]
Units = Annotated[
    list[str] | None,
    typer.Option(
        "--unit",
        help="CHANNEL=UNIT: the unit of its column, or what one unit of it is: `position=mm`, `command=1.26 N`; takes "
        "precedence over the drive file's \\[units]; repeatable.",
    ),
]
Shifts = Annotated[
    list[str] | None,
    typer.Option(
        "--shift",
        help="CHANNEL=SAMPLES: move a channel by whole samples, positive to later times: `command=-1` for one recorded "
        "a sample late in all logs, `lap2:command=-1` in lap2 alone; takes precedence over \\[shifts]; repeatable.",
    ),
]
Loads = Annotated[
    list[str] | None,
    typer.Option(
        "--load",
        help="LOG=FORCE: the constant load (normal force on the guides) while LOG was recorded, if no column holds it: "
        "`lap2.csv=8kN`; repeatable.",
    ),
]
Machine = Annotated[
    Path | None,
    typer.Option(
        "--machine",
        help="Drive file, or axis by name, of the machine, where it differs from the controller's nominal model.",
    ),
]
MeasuredOf = Annotated[
    str | None,
    typer.Option(
        "--of",
        help="What the measured response is of: plant (torque that acts to speed), plant-with-current-loop (torque "
        "set-point to speed), speed-loop, position-loop (closed), open-loop (opened at the force). An XML says it.",
    ),
]
MeasuredUnit = Annotated[
    str | None,
    typer.Option("--unit", help="Unit of a measured plant: `(rad/s)/(N*m)` of the motor, `(m/s)/N` at the table."),
]
Settle = Annotated[
    float,
    typer.Option("--settle", callback=finite, min=0.0, help="Seconds at the start that do not count for the errors."),
]
Fixed = Annotated[
    list[str] | None,
    typer.Option(
        "--fixed", help="A parameter that keeps the drive file's value, by its key there: `mass`; repeatable."
    ),
]
Seed = Annotated[int, typer.Option("--seed", callback=seed_of, help="Seed of the random numbers.")]
MotionText = Annotated[
    str,
    typer.Option(
        "--motion",
        help="`name:setting=value,...` with units where you like, see `diffdrive motions`; names: triangular, "
        "constant_speed, trapezoidal, jerk_limited, sine, multisine, chirp, staircase. Or a CSV file with the columns "
        "time and reference, or else position, each with its unit: `time (s),position (mm)`; without one, s and m.",
    ),
]
LoadText = Annotated[
    str,
    typer.Option(
        "--load",
        help="Load on the guides: a number of newtons, `8kN`, `step:at=1s,to=10kN`, `ramp:start=1,end=2,to=10kN`, "
        "`piecewise:times=0;1;2,loads=0;5kN;0`, or `material_removal:workpiece=800,removal_rate=20,cuts=0.5~2;3~4`.",
    ),
]

# not 10 mm/s: ten quanta of 0.1 um a period, on which a quantised loop locks and looks unlike its neighbours
DEFAULT_MOTION = "triangular:speed=10.137mm/s,stroke=8.9863mm,rounding=0.2s,duration=3s"
