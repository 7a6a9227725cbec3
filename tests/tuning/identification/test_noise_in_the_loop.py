"""Why identification fits the prediction error: the noise of the scale acts through the controller on the machine."""

import numpy as np
import pytest

from diffdrive.controllers import PD, PDGains
from diffdrive.controllers.base import Tracking
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.motion.load import ramp
from experiments.studies.emps.closed_loop_fit import fit_closed_loop
from experiments.studies.recovery.excitation import identification_motion
from experiments.studies.recovery.random_drive import random_drive
from experiments.studies.recovery.truth import truth_log
from tuning.identification.identify import identify


def off(found, true, name):
    """Relative error of one friction parameter, positive direction."""
    return abs(getattr(found.friction, name).positive / getattr(true.friction, name).positive - 1)


@pytest.mark.slow
def test_a_closed_loop_fit_is_bent_by_the_noise_even_from_the_truth_and_the_prediction_error_is_not():
    drive, gains = random_drive(np.random.default_rng(0)), PDGains(PAPER_KP, PAPER_KD)
    motion = identification_motion(4_000.0)
    log = truth_log(drive, gains, motion, ramp(motion.time, start=6.0, end=6.2, to=8_000.0), seed=0)
    fitted, _ = fit_closed_loop([log], paper_drive(), PD(Tracking(gains)), start=drive)
    identified = identify([log], paper_drive()).drive
    for name in ("bristle_damping", "bristle_stiffness", "load_coefficient"):
        print(name, off(fitted, drive, name), off(identified, drive, name))
        assert off(identified, drive, name) < 0.05 * off(fitted, drive, name)
    assert off(fitted, drive, "bristle_damping") > 0.05
