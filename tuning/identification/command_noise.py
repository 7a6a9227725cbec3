"""The command of snapshots without the noise of the loop.

A loop answers the noise of its encoder with noise in each command. A snapshot has that of its own instant, and the
force over the row the mean of many others: an error of what a fit takes as known, and one that goes with the noise of
the position that was read at the same instant. It makes a mass seem larger (by 2 % where it is 40 N).

So the command is smoothed as far as it shows nothing but noise: at each row by the parabola through the longest window
whose value agrees, within one standard error, with those of all shorter windows (intersection of confidence intervals:
Goldenshluger and Nemirovski 1997; Katkovnik 1999). Where the force changes from row to row, as after a reversal, it
stays as it was logged.
"""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import convolve1d
from scipy.signal import savgol_coeffs

from tuning.identification.problem import shown_noise

HALF_WINDOWS = (2, 3, 4, 6, 8, 12, 16, 24)  # rows, about half as long again each; of the last the noise is a fifth
ORDER = 5  # of the differences that show the noise: motion of tens of hertz does not show in them


def without_noise(command: Float[np.ndarray, "lanes n"], counts: Float[np.ndarray, "lanes n"]) -> np.ndarray:
    """The commands (N) of lanes without their noise, which is white and as large as their differences show."""
    noise = shown_noise(command, counts, ORDER)
    low, high = command - noise, command + noise
    found, agrees = command, np.ones(command.shape, bool)
    for half in HALF_WINDOWS:
        weights = savgol_coeffs(2 * half + 1, 2)
        mean, error = convolve1d(command, weights, axis=1, mode="nearest"), noise * np.linalg.norm(weights)
        low, high = np.maximum(low, mean - error), np.minimum(high, mean + error)
        agrees = agrees & (low <= high)
        found = np.where(agrees, mean, found)
    return found
