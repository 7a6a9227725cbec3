"""The scales of a machine and its logs, on which the priors and grids of all hypotheses rest."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from diffdrive.model.parameters import Drive
from tuning.identification.prediction import Lanes
from tuning.identification.problem import noise_floor

LEAST = 0.05  # of the largest command: the scale of a friction that the drive file does not know
SLIPPERY = 1e-6  # a load coefficient that is none


class Setting(NamedTuple):
    """The scales of a machine and its logs that priors and grids rest on."""

    mass: float  # kg
    friction: float  # N, Coulomb; a share of the command where the drive file knows next to none
    load_coefficient: float
    viscous: float  # N s/m
    delay: float  # samples, that the drive file claims
    bristle: float  # m, by which the bristle bends before it slides
    period: float  # s
    duration: float  # s
    low: float  # m, least position
    high: float  # m
    speed: float  # m/s, fastest
    command: float  # N, largest
    peak: float  # N, largest of a single control period that the drive file lets pass
    # m, of the scale: its resolution, or as coarse a one as the log's scatter is
    count: float = 0.0  # type: ignore[assignment]  # in the place of tuple.count


def setting(drive: Drive, lanes: Lanes, period: float, thinning: int = 1, starts: ArrayLike = 0.0) -> Setting:
    """The scales of `drive` and `lanes`, whose samples are `period` (s) or so many control periods apart.

    `starts` (s) is when each lane begins in its log.
    """
    friction, plant = drive.friction, drive.plant
    load = float(friction.initial_load) + float(np.mean(np.asarray(lanes.load)))
    guide = 0.5 * float(friction.load_coefficient.positive + friction.load_coefficient.negative)
    level = 0.5 * float(friction.coulomb_screw.positive + friction.coulomb_screw.negative) + guide * load
    viscous = 0.5 * float(
        friction.viscous.positive + friction.viscous.negative + plant.damping.positive + plant.damping.negative
    )
    actuator = drive.actuator
    counted = np.asarray(lanes.counts) > 0
    command = float(np.abs(np.asarray(lanes.command)[counted]).max())
    single = np.abs(
        np.asarray(lanes.command if lanes.period_commands is None else lanes.period_commands)[counted]
    ).max()
    position = np.asarray(lanes.position)
    speed = np.abs(np.diff(position, axis=1))[:, :: max(1, round(1e-3 / period))] / period
    fastest = float(np.percentile(speed, 99))
    level = max(level, LEAST * command)
    return Setting(
        mass=float(plant.mass),
        friction=level,
        load_coefficient=max(guide, SLIPPERY),
        viscous=max(viscous, LEAST * command / max(fastest, 1e-4)),
        delay=(actuator.delay_samples + float(actuator.delay_fraction or 0.0)) / thinning,
        bristle=level / float(friction.bristle_stiffness.positive),
        period=period,
        duration=float((np.asarray(starts) + counted.sum(axis=1) * period).max()),
        low=float(position[counted].min()),
        high=float(position[counted].max()),
        speed=fastest,
        command=command,
        peak=float(single if actuator.force_limit is None else min(single, actuator.force_limit)),
        count=float(np.sqrt(12.0)) * noise_floor(drive, lanes, 1.0 / period),
    )
