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
Loads = Annotated[
    list[str] | None,
    typer.Option(
        "--load",
        help="LOG=FORCE: the load on the table in a log without a column for it: `lap2.csv=8kN`; repeatable.",
    ),
]
