"""Noise of the scale that logs show and the drive file does not state."""

import numpy as np

from diffdrive.model.parameters import Drive

NOTABLE = 1.2  # times what is stated


def unstated_noise(drive: Drive, shown: float) -> str:
    """What to write into the drive file where positions scatter by more than it says; "" where they do not.

    `shown` is the standard deviation (m) of the measured position about the true one, the scale's steps included.
    """
    steps = 0.0 if drive.sensor.resolution is None else float(drive.sensor.resolution) / np.sqrt(12.0)
    stated = np.hypot(steps, float(drive.sensor.noise))
    if not shown > NOTABLE * stated:
        return ""
    noise = 1e9 * float(np.sqrt(shown**2 - steps**2))
    of_steps = f"the scale's steps make {1e9 * steps:.3g} nm of it, added in squares, and " if steps else ""
    states = f"{of_steps}the drive file states {1e9 * float(drive.sensor.noise):.3g} nm of noise"
    return (
        f"The measured positions scatter by {1e9 * shown:.3g} nm RMS; {states}: write "
        f'[sensor] noise = "{noise:.3g} nm" before you tune, or the command noise will be more than is promised.'
    )
