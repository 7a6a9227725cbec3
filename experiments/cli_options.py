"""What several commands take."""

from pathlib import Path
from typing import Annotated

import typer

DriveFile = Annotated[Path, typer.Argument(help="Drive file (TOML); `diffdrive template` prints one.")]
Out = Annotated[
    Path | None, typer.Option("--out", help="Folder for figures, tables and result.json; made if it does not exist.")
]
Logs = Annotated[
    list[Path],
    typer.Argument(help="Logs of one machine: CSV, MAT or Parquet.", metavar="LOG...", show_default=False),
]
Believed = Annotated[
    Path, typer.Option("--drive", help="Drive file: what is believed about the axis, and how its logs read.")
]
Columns = Annotated[
    list[str] | None, typer.Option("--column", help="CHANNEL=COLUMN, over the drive file's \\[columns]; repeatable.")
]
Units = Annotated[
    list[str] | None, typer.Option("--unit", help="CHANNEL=UNIT, over the drive file's \\[units]; repeatable.")
]
Shifts = Annotated[
    list[str] | None,
    typer.Option(
        "--shift",
        help="CHANNEL=SAMPLES, over the drive file's \\[shifts]: `command=-1` for one recorded late in all logs, "
        "`lap2:command=-1` in lap2 alone; repeatable.",
    ),
]
Loads = Annotated[
    list[str] | None,
    typer.Option(
        "--load",
        help="LOG=FORCE: the load on the table in a log without a column for it: `lap2.csv=8kN`; repeatable.",
    ),
]
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
DEFAULT_MOTION = "triangular:speed=10.137mm/s,stroke=10mm,rounding=0.2s,duration=3s"
