"""What a log can tell at all: whether it moves, turns, runs at several speeds, and is not saturated throughout."""

import numpy as np

from tuning.diagnosis.hypotheses.model import Logged
from tuning.diagnosis.hypotheses.setting import Setting
from tuning.identification.excitation import ONE_WAY, SHORTEST, SPEEDS
from tuning.identification.shown_motion import LARGEST, ExcitationDeficit, shown_velocity

TRAVEL = 10.0  # times the bristle's bend before it slides
SCATTER = 20.0  # standard deviations of the measured position, which noise and a servo that hunts may span
SATURATED = 0.5  # of the time in which it moves, at the limit
AT_THE_LIMIT = 0.98  # of it: a measured command is noisy


def excitation_deficits(logged: Logged, at: Setting) -> list[ExcitationDeficit]:
    """What stands in the way of a diagnosis; empty where nothing does."""
    counts = np.asarray(logged.lanes.counts) > 0
    position, command = np.asarray(logged.lanes.position), np.asarray(logged.lanes.command)
    rate, noise, travel = logged.sampling.rate, float(logged.noise), at.high - at.low
    for least, why in ((TRAVEL * at.bristle, "too little to slide"), (SCATTER * noise, "which may be noise")):
        if travel < least:
            return [
                ExcitationDeficit(
                    "anything but the stiffness at rest",
                    f"the table travels {1e6 * travel:.3g} um, {why}",
                    "a motion of several millimetres to and fro, at two speeds at least",
                    hopeless=True,
                )
            ]
    few, velocity, slowest = shown_velocity(position, counts, noise, rate)
    moves = counts[:, few:] & (np.abs(velocity) > slowest)
    moving = velocity[moves]
    found = []
    if len(moving) < few:  # any motion shows for as long as the velocity is told over
        return [
            ExcitationDeficit(
                "friction and mass",
                f"the table is nowhere faster than the {1e3 * slowest:.2g} mm/s that would stand out from the noise",
                "a faster motion to and fro, at two speeds at least",
            )
        ]
    if len(moving) < SHORTEST * rate:
        found.append(
            ExcitationDeficit(
                "friction and mass",
                f"the table moves for {len(moving) / rate:.2g} s only",
                "several seconds of motion to and fro, with pauses",
            )
        )
    shares = [float(np.mean(way * moving > 0)) for way in (1, -1)]
    if min(shares) < ONE_WAY:
        found.append(
            ExcitationDeficit(
                "asymmetry, constant forces, backlash and the friction at reversals",
                "the table moves in one direction only",
                "a motion to and fro",
            )
        )
    slow, fast = np.percentile(np.abs(moving), [10, 95])
    if fast < SPEEDS * slow:
        found.append(
            ExcitationDeficit(
                "viscous against Coulomb friction, and everything that depends on speed",
                f"the table runs at one speed, {1e3 * np.median(np.abs(moving)):.3g} mm/s",
                "strokes at two speeds at least, a factor of five apart",
            )
        )
    asked = np.abs(command[:, few:][moves])
    # the command is that before the actuator, and may be far beyond what it can do
    known = logged.drive.actuator.force_limit
    limit = float(np.percentile(asked, LARGEST)) if known is None else float(known)
    if np.mean(asked > AT_THE_LIMIT * limit) > SATURATED:
        found.append(
            ExcitationDeficit(
                "anything in the forces",
                "the command is at its limit for most of the time",
                "a gentler motion, within the drive's force",
                hopeless=known is not None,  # where no limit is known, it may be friction at one speed
            )
        )
    return found
