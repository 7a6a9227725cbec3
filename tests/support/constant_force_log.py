"""A log of a tilted machine, its diagnosis, and the command as if it had found what it is given."""

import dataclasses
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from diffdrive.axis_file.drive_file import write_axis
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.effects.forces import ConstantForce
from diffdrive.logs import write_log
from experiments.reports.diagnosis import diagnosis as command
from tests.support.sound_log import DRIVE, simulate_log, two_sines
from tuning.diagnosis.diagnose import diagnose
from tuning.diagnosis.hypotheses.calibration import LOGARITHMS, calibrated
from tuning.diagnosis.next_experiment import Experiment

# how far the machine is from its file, but for constant force and delay
DEVIATIONS = np.append(np.random.default_rng(8).uniform(-0.02, 0.02, LOGARITHMS), [0.0, 0.0])
AMONG = ("constant_force", "friction_asymmetry", "position_spring")  # the effects that such a log may show
NO_EXPERIMENT = Experiment("", [], 0.0, "not asked")


@cache
def log():
    machine = jax.tree.map(float, calibrated(DRIVE.drive, jnp.asarray(DEVIATIONS)))
    return simulate_log(
        dataclasses.replace(DRIVE, drive=dataclasses.replace(machine, effects=(ConstantForce(6.0),))), two_sines()
    )


@cache
def diagnosis():
    """One effect, looked for among few: what is told of it is the same, and the search is a fraction of the whole."""
    others = [name for name in EFFECTS if name not in AMONG]
    return diagnose(DRIVE.drive, DRIVE.controller, [log()], without=others, most_effects=1)


def command_for(folder, monkeypatch):
    """The command, as if it had found what it is given in a log, this one or another; and the folder that it wrote."""

    def run(found, given=None, **options):
        write_log(folder / "lap.parquet", given or log())
        write_axis(folder / "drive.toml", DRIVE)
        monkeypatch.setattr("tuning.diagnosis.workflow.diagnose_drive", lambda *_, **__: found)
        monkeypatch.setattr("tuning.diagnosis.workflow.next_experiment", lambda *_: NO_EXPERIMENT)
        out = folder / "out"
        return command.diagnose_logs([folder / "lap.parquet"], folder / "drive.toml", out, **options), out

    return run
