"""Signals between their samples: positions are smooth, commands are held, and what else may jump must not ring."""

import numpy as np

from diffdrive.logs.log import Samples, Signal

HELD = ("command", "disturbance", "injected")  # constant from one sample to the next
# a spline: a monotone cubic flattens every reversal, by some um of a 20 mm stroke where five samples are missing
SMOOTH = ("position", "reference", "motor_position")


def interpolate(channel: str, time: Signal, values: Signal, new_times: Samples) -> Samples:
    """The channel at `new_times` (s) within [time[0], time[-1]]; held channels keep the value of the sample before."""
    if len(time) < 2:
        return np.full(len(new_times), values[0])
    if channel in HELD:
        return values[np.searchsorted(time, new_times, side="right") - 1]
    from scipy.interpolate import CubicSpline, PchipInterpolator

    return (CubicSpline if channel in SMOOTH else PchipInterpolator)(time, values)(new_times)


def resample(channel: str, time: Signal, values: Signal, new_times: Samples) -> Samples:
    """The channel at the uniform `new_times` (s) within [time[0], time[-1]].

    A held channel becomes its mean over the period that follows, so that what it does in that period is kept: the value
    at an instant would be that of one sample earlier wherever a stamp is late, half a period of delay on average.
    """
    if channel not in HELD or len(new_times) < 2:
        return interpolate(channel, time, values, new_times)
    edges = np.append(new_times, 2 * new_times[-1] - new_times[-2])
    integral = np.append(0.0, np.cumsum(values[:-1] * np.diff(time)))
    integral_at_edges = np.interp(edges, time, integral) + values[-1] * np.maximum(edges - time[-1], 0.0)
    return np.diff(integral_at_edges) / np.diff(edges)
