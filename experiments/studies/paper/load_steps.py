"""A load step at constant speed: how far each load estimator is from the truth one second later."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.controllers import Controller, FrictionCompensation
from diffdrive.controllers.base import paper_tracking
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.step import Inputs
from diffdrive.model.parameters import Drive
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.motion import load
from diffdrive.motion.builders import constant_speed
from diffdrive.motion.motion import Motion
from diffdrive.numerics.arrays import Scalar, as_arrays
from diffdrive.observers.friction_observer import KalmanObserver, LoadStateObserver, Tuning
from diffdrive.observers.load_estimator import InnovationLoad
from experiments.studies.paper import scenario as paper

SPEEDS = (0.001, 0.003, 0.010, 0.015, 0.020, 0.040, 0.100)  # m/s
OFF_GRID = 1.0137  # with the 0.1 um scale: 1 mm/s would be one quantum a period, which flatters every estimator
STEP_TIME, WAIT, LOAD = 0.3, 1.0, 10_000.0  # s, s, N


def motion_at(speed: float) -> Motion:
    """0.1 s to get to `speed` (m/s), then on at that speed."""
    return constant_speed(speed=speed, ramp=0.1, duration=STEP_TIME + WAIT + 0.1, rate=paper.SAMPLING.rate)


def estimators(drive: Drive) -> dict[str, Controller]:
    """The two load estimators with the paper's gains; eq. (20) also allowed at 1 and 3 mm/s, so that both are tried."""
    tracking = paper_tracking(drive, PAPER_KP, PAPER_KD)
    innovation_load = InnovationLoad(min_speed=0.0005)
    return {
        "eq. (20)": FrictionCompensation(
            tracking, KalmanObserver(drive.plant, drive.friction, Tuning(), innovation_load)
        ),
        "load as a state": FrictionCompensation(tracking, LoadStateObserver(drive.plant, drive.friction)),
    }


@eqx.filter_jit
def _estimate(drive: Drive, controller: Controller, inputs: Inputs) -> Float[Array, " n"] | Scalar:
    estimate = rollout_loop(drive, controller, inputs, paper.SAMPLING).estimate
    assert estimate is not None
    assert estimate.load is not None
    return estimate.load


def load_errors() -> list[list[object]]:
    """Rows of estimator, scale, and for each speed the largest |What - W| (N) from one second after the step on."""
    rows = []
    for scale in ("exact", "0.1 um"):
        drive = paper_drive(quantised=scale != "exact")
        factor = 1.0 if scale == "exact" else OFF_GRID
        for name, controller in estimators(drive).items():
            row: list[object] = [name, scale]
            for speed in SPEEDS:
                motion = motion_at(factor * speed)
                weight = load.step(motion.time, at=STEP_TIME, to=LOAD)
                estimate = np.asarray(_estimate(*as_arrays((drive, controller)), loop_inputs(motion, weight)))
                settled = motion.time >= STEP_TIME + WAIT
                row.append(float(jnp.max(jnp.abs(estimate[settled] - LOAD))))
            rows.append(row)
    return rows
