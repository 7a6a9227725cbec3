"""A complete drive file to start from: the paper's testbed under a controller of one's choice."""

import re

from diffdrive.library import PAPER_DRIVE

THE_PAPERS = "pd+fc+le"
SECTION, AFTER = "[controller]", "[units]"
COMMENTED = {
    "pd+fc+ls": """[controller]
kind = "pd+fc+ls"               # PD, friction observer with the load as a state; cascade: most CNCs; unknown: to read
                                # logs only; all kinds: docs/reference/drive-file.md
kp = 7979645.34                 # N/m: 50,000 command volts per metre
kd = 15959.29                   # N s/m: 100 command volts per metre per second

[controller.observer]           # Q = diag(position, velocity, bristle, load) and R of the Kalman filter
position = 1e-16                # m^2
velocity = 1e-11                # m^2/s^2
bristle = 1e-15                 # m^2
load = 1000.0                   # N^2 per control step: larger follows a changing load faster, and is noisier
measurement = 8.3e-16           # m^2: resolution^2 / 12

""",
    "cascade": """[controller]
kind = "cascade"                # position P, velocity PI: the loop of most CNCs
kp = 50.0                       # 1/s: the Kv factor of the position loop; "3 m/min/mm" is read, too
                                # (1 (m/min)/mm = 16.67 1/s)
kv = 1e5                        # N s/m: velocity gain, NOT the Kv factor
ki = 1e6                        # N/m: its integral gain, kv / T_n with the reset time T_n in s; left out: none
velocity_feedforward = 1.0      # share of the reference velocity that is fed forward
# feedforward = true            # inertia and damping of [plant] as well

""",
}


# where the paper's numbers are from, and how well it knows them, with the comments above: of no use to another machine
OF_THE_PAPER = re.compile(r"(?:^#[^\n]*\n)*^\[(?:provenance|uncertainty)\]\n(?:[^\n]+\n)*\n?", re.M)


def template(kind: str) -> str:
    """The file's text; raises `ParameterError` for a kind of controller that is not known."""
    text = OF_THE_PAPER.sub("", PAPER_DRIVE.read_text(encoding="utf-8")).rstrip() + "\n"
    if kind == THE_PAPERS:
        return text
    before, _, rest = text.partition(SECTION)
    return before + (COMMENTED.get(kind) or _table(kind)) + AFTER + rest.partition(AFTER)[2]


def _table(kind: str) -> str:
    """The controller's table without comments."""
    import tomli_w  # what follows imports JAX, for which the usual templates need not wait

    from diffdrive.axis_file.controller_file import controller_table
    from diffdrive.paper import paper_axis

    return tomli_w.dumps({"controller": controller_table(paper_axis(controller=kind).controller)}) + "\n"
