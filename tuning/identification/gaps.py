"""How far a drive is from a log, before and after identification, by measures that are the same for both."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.ndimage
from jaxtyping import Float

from diffdrive.axis import Axis
from diffdrive.controllers import UnknownController
from diffdrive.logs import Log
from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import as_arrays
from tuning.identification.prediction import constant_gains, predict
from tuning.identification.problem import FINE_SUBSTEP, lanes_of, sampling_of
from tuning.identification.replay import replay_closed_loop, replay_open_loop
from tuning.identification.row_force import BetweenRows
from tuning.identification.snapshots import as_read
from tuning.identification.uncertainty import BLOCK

BANDWIDTH = 1000.0  # rad/s of the correction, above the fastest growth on a falling Stribeck curve; less where slow
FORGOTTEN = 0.05  # s, in which the unknown velocity at the beginning is corrected
SMOOTHING = 0.02  # s, over which a missing force is averaged: below that it is the noise of the position

# what a drive makes of a log: the description with that drive in it, its delay (control periods), the log -> numbers
# by name, the unit in the name
Measure = Callable[[Axis, float, Log, BetweenRows], dict[str, float]]

_predict = eqx.filter_jit(predict)


def prediction_gaps(description: Axis, delay: float, log: Log, between: BetweenRows) -> dict[str, float]:
    """What the drive does not foresee from one sample to the next, and the force (RMS) that it lacks for it.

    Every drive is corrected with the same constant gains. Gains chosen for each (as the identification does) would
    forgive a poor drive its errors: trusting it less, they follow the measurement.
    """
    innovation, force, counts = _predicted(description.drive, delay, log, between)
    return {"one-step prediction, um": 1e6 * _rms(innovation[counts]), "missing force, N": _rms(force[counts])}


def mean_square_force(drive: Drive, delay: float, log: Log, between: BetweenRows) -> Float[np.ndarray, " blocks"]:
    """Mean square (N^2) of the force that `drive` lacks, in each block of a log: blocks that are hardly related."""
    _, force, counts = _predicted(drive, delay, log, between)
    block = max(1, round(BLOCK * log.rate))
    square, number = (
        np.pad(one, ((0, 0), (0, -one.shape[1] % block))).reshape(-1, block).sum(axis=1)
        for one in (np.where(counts, force, 0.0) ** 2, counts.astype(float))
    )
    return square[number == block] / block


def _predicted(drive: Drive, delay: float, log: Log, between: BetweenRows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Innovations (m), the force (N) that is missing, and which samples count; [lanes, n] each."""
    lanes = as_read(lanes_of([log]), between)
    gains = constant_gains(min(BANDWIDTH, 0.3 * log.rate), 1.0, lanes, 1.0 / log.rate)
    sampling = sampling_of(float(round(log.rate, 6)), FINE_SUBSTEP)
    found = _predict(
        as_arrays(drive), jnp.asarray(delay), as_arrays(gains), as_arrays(lanes), sampling, between=between
    )
    innovation = np.asarray(found.innovation)
    counts = np.asarray(lanes.counts) > 0
    counts[:, : round(FORGOTTEN * log.rate)] = False
    force = float(drive.plant.mass) * log.rate * np.asarray(gains.velocity) * innovation
    smooth = scipy.ndimage.uniform_filter1d(force, max(1, round(SMOOTHING * log.rate)), axis=1)
    return innovation, smooth, counts


def _rms(signal: np.ndarray) -> float:
    return float(np.sqrt(np.mean(signal**2))) if len(signal) else 0.0


def replay_gaps(description: Axis, _: float, log: Log, __: BetweenRows) -> dict[str, float]:
    """The log replayed by the drive: in closed loop through the controller if it has a reference, and in open loop."""
    drive, found = description.drive, {}
    if log.reference is not None and not isinstance(description.controller, UnknownController):
        loop = replay_closed_loop(drive, description.controller, log)
        found = {
            "closed loop: command, N": loop.command_rms,
            "closed loop: command, %": loop.force_percent,
            "closed loop: position, um": 1e6 * loop.position_rms,
        }
    return found | {"open loop: position, mm": replay_open_loop(drive, log).position_rms_mm}


MEASURES: tuple[Measure, ...] = (prediction_gaps, replay_gaps)


def delay_of(drive: Drive) -> float:
    """Control periods between a command and its force, as the drive says."""
    return drive.actuator.delay_samples + float(drive.actuator.delay_fraction or 0.0)


class Gap(NamedTuple):
    """How far the axis as believed and the identified one are from a log, by one measure (the unit in its name)."""

    log: str
    role: str  # "identified from" or "held out"
    measure: str
    before: float
    after: float


def gaps(before: Axis, after: Drive, delay: float, logs: Sequence[Log], role: str, between: BetweenRows) -> list[Gap]:
    """Each measure on each log, with the drive as believed and with the one `after`; nothing is refitted.

    The controller is the one `before`, with the model that it had when the logs were made. `delay` is that of `after`,
    in rows; `between` is what the command does between them, for both.
    """
    found = []
    for log in logs:
        for measure in MEASURES:
            was = measure(before, delay_of(before.drive), log, between)
            now = measure(replace(before, drive=after), delay, log, between)
            found += [Gap(log.name, role, name, was[name], now[name]) for name in was]
    return found
