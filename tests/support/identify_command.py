"""The command `identify` on short logs of one machine."""

from typer.testing import CliRunner

from experiments.cli.main import app
from experiments.studies.recovery.excitation import concatenate, resting, strokes
from tests.support.sound_log import RATE, axis_of

TRUE = axis_of()
# distance m, speed m/s, acceleration m/s^2, jerk m/s^3: slow and fast reversals, 2.2 s
STROKES = (
    (2e-5, 4e-4, 0.05, 20.0),
    (2e-4, 1.5e-3, 0.05, 20.0),
    (1e-3, 5e-3, 0.3, 30.0),
    (2e-3, 2e-2, 0.5, 50.0),
    (4e-3, 0.08, 2.0, 200.0),
    (1e-3, 3e-3, 0.3, 30.0),
)
# the same question wherever one is asked in full, so that it is compiled once
QUESTION = ("--starts", 2, "--fixed", "stribeck_velocity", "--bound", "mass=70kg:150")
MOTION = concatenate([resting(0.05, RATE), *strokes(STROKES, RATE), resting(0.05, RATE)], "reversals")


def run(*arguments):
    return CliRunner().invoke(app, ["identify", *(str(one) for one in arguments)], catch_exceptions=False)
