"""Signals between their samples: positions are smooth, commands are held, and what else may jump must not ring."""

import numpy as np

from diffdrive.logs.log import Signal

HELD = ("command", "disturbance", "injected")  # constant from one sample to the next
# a spline: a monotone cubic flattens every reversal, by some um of a 20 mm stroke where five samples are missing
SMOOTH = ("position", "reference", "motor_position")


def interpolate(channel: str, time: Signal, values: Signal, at: Signal) -> Signal:
    """The channel at times `at` (s) within [time[0], time[-1]]; held channels keep the value of the sample before."""
    if len(time) < 2:
        return np.full(len(at), values[0])
    if channel in HELD:
        return values[np.searchsorted(time, at, side="right") - 1]
    from scipy.interpolate import CubicSpline, PchipInterpolator

    return (CubicSpline if channel in SMOOTH else PchipInterpolator)(time, values)(at)


def resample(channel: str, time: Signal, values: Signal, at: Signal) -> Signal:
    """The channel on the uniform times `at` (s) within [time[0], time[-1]].

    A held channel becomes its mean over the period that follows, so that what it does in that period is kept: the value
    at an instant would be that of one sample earlier wherever a stamp is late, half a period of delay on average.
    """
    if channel not in HELD or len(at) < 2:
        return interpolate(channel, time, values, at)
    edges = np.append(at, 2 * at[-1] - at[-2])
    integral = np.append(0.0, np.cumsum(values[:-1] * np.diff(time)))
    into = np.interp(edges, time, integral) + values[-1] * np.maximum(edges - time[-1], 0.0)
    return np.diff(into) / np.diff(edges)
