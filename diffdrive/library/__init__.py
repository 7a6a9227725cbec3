"""The library of axes: drive files that come with the package, and folders in which a user keeps further ones.

    paper, emps                       identified machines
    cnc, gantry, vertical, linear     generic ones, of what data sheets state

`read_axis` and every command take them by name (docs/reference/axes.md).
"""

from pathlib import Path

OWN_FOLDER = Path(__file__).parent
PAPER_DRIVE = OWN_FOLDER / "paper.toml"
