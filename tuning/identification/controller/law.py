"""The cascade's law as coefficients of the signals of a log.

u = K w + ki int w + m r'',   w = kp (e - kappa r') + r' - v,   kappa = (1 - ff) / kp,

where v is the mean velocity over the last `window`, and the fed-forward speed ff r' that of `late` ago: a loop that is
faster than the rows may difference its reference backwards. `kappa`, the following error per speed on a long stroke, is
what a log shows best, so it stands in the place of the feed-forward. K = kv + ki T/2 is the velocity gain and half a
period T of the integral, which a sum over periods has beyond the integral between its rows.
"""

import enum
from typing import NamedTuple

import numpy as np

Number = complex | np.ndarray
Vector = np.ndarray  # of numbers, real or (for derivatives) complex


class Reading(enum.Enum):
    """How the rows of a log are read: see `signals`."""

    EVERY_SAMPLE = "every sample of the controller"
    SAME_INSTANT = "snapshots, the command computed from the position beside it"
    OWN_INSTANT = "snapshots, the command of an instant of its own"


class Law(NamedTuple):
    """Parameters of the law as the search moves them; `late`, `window` and `shift` are in rows, the last two
    only of snapshots.

    With an instant of its own, how the command moves with the row's noise is open: it may be of another sample.
    """

    log_kp: Number
    kappa: Number  # s
    log_gain: Number  # of K, N s/m
    rate: Number  # ki / K, 1/s: the inverse of the reset time
    mass: Number  # of the acceleration feed-forward, over K, s
    late: Number = 0.0
    window: Number = 0.0
    shift: Number = 0.0
    noise: Number = 0.0  # what of the row's own noise is in the command, over K and in 1 / row


def coefficients(law: Law, period: float, reading: Reading) -> Vector:
    """The coefficients of the regressors of `signals`, [k]; of parameters that are arrays [m], [k, m]."""
    kp, kappa, gain = np.exp(law.log_kp), law.kappa, np.exp(law.log_gain)
    rate, mass, d = law.rate, law.mass, law.window * period
    # ff (r' - late r'') and its integral, ff (r - late r' + late^2/2 r'')
    fed, late = 1.0 - kp * kappa, law.late * period
    on_speed, on_acceleration = -rate * fed * late, -fed * late * (1.0 - 0.5 * rate * late)
    if reading is Reading.EVERY_SAMPLE:
        return gain * _rows(
            kp, rate * kp, -kp * kappa + on_speed, -rate * kp * kappa, mass + on_acceleration, 1.0, rate
        )
    # v = y' - d/2 y'' + d^2/6 y''' and its integral y - d/2 y' + d^2/6 y'', with y' = r' - e' and y'' = r'' - e''
    half, sixth = 0.5 * d, d * d / 6.0
    # what the position in the row itself is to the command; the sum over the last samples has a quarter of it (of two,
    # beyond half a velocity)
    own = -kp - 1.0 / d - 0.25 * rate if reading is Reading.SAME_INSTANT else -law.noise / period
    return gain * _rows(
        kp + rate,
        rate * kp,
        -kp * kappa + rate * half + on_speed,
        -rate * kp * kappa,
        mass + half - rate * sixth + on_acceleration,
        1.0 - rate * half,
        -half + rate * sixth,
        -sixth,
        own,
    )


def _rows(*rows: Number) -> Vector:
    return np.stack(np.broadcast_arrays(*rows))
