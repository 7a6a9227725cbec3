"""The clock: is the log uniform, is it the rate of the drive file, and is anything missing?"""

from collections.abc import Iterator

import numpy as np

from diffdrive.axis import Axis
from diffdrive.logs.checks.factors import unit_error_text
from diffdrive.logs.checks.finding import Finding, Severity
from diffdrive.logs.checks.statistics import sampling_period
from diffdrive.logs.log import Log

# A quartz keeps a few 1e-6; a step that is off by more was rounded, or comes from another clock.
CLOCK_ERROR = 5e-6
# A wrong rate scales every velocity by as much, every acceleration by twice that: 1 % is no clock error, but an error.
WRONG_RATE = 1e-2
# Stamps scattered by a twentieth of a step are not those of a controller's interrupt.
JITTER = 0.05


def order(log: Log) -> Iterator[Finding]:
    """Time must increase."""
    intervals = np.diff(log.time)
    if not np.all(intervals > 0):
        k = int(np.argmin(intervals > 0)) + 1
        yield Finding(
            "fatal",
            "time",
            f"{np.sum(intervals <= 0)} time stamps do not increase, first at sample {k} (t = {log.time[k]:g} s)",
            "sort the rows and drop repeated ones",
            "unreadable",
        )


def gaps(log: Log) -> Iterator[Finding]:
    """Missing samples that the stamps show, listed in `gaps` or not."""
    intervals, period = np.diff(log.time), sampling_period(log)
    listed = np.zeros(len(intervals), bool)
    listed[[k - 1 for k in log.gaps]] = True
    lost = intervals[listed] - period
    if log.gaps:
        yield Finding(
            "warning",
            "time",
            f"{len(log.gaps)} gaps, {lost.sum():.4g} s in all, the longest {lost.max():.4g} s at "
            f"t = {log.time[log.gaps[int(np.argmax(lost))] - 1]:.6g} s",
            "the stretches between the gaps are used one by one",
            "lost rows",
        )
    unlisted = np.flatnonzero(~listed & (intervals > 1.5 * period))
    if len(unlisted):
        count = int(np.sum(np.round(intervals[unlisted] / period) - 1))
        yield Finding(
            "fatal",
            "time",
            f"{count} samples are missing at {len(unlisted)} places, first after t = {log.time[unlisted[0]]:.6g} s",
            f"list the gaps (Log.gaps = {tuple(int(k) + 1 for k in unlisted[:5])}...) or cut the log there",
            "lost rows",
        )


def stamps(log: Log) -> Iterator[Finding]:
    """Rounded or scattered stamps, whose single differences are no time step."""
    intervals, period = np.diff(log.time), sampling_period(log)
    regular = intervals[intervals < 1.5 * period]
    jitter = float(np.max(np.abs(regular - period)))
    drift = 1e3 * jitter / period * log.duration
    if jitter > JITTER * period:
        yield Finding(
            "warning",
            "time",
            f"the time stamps scatter by up to {1e6 * jitter:.4g} us, {100 * jitter / period:.3g} % of the step",
            "they are not the controller's clock; if the controller runs on a timer, take the samples as uniform",
            "rate",
        )
    elif jitter > CLOCK_ERROR * period:
        median_rate = float(1.0 / np.median(regular))
        median_error = abs(median_rate * period - 1)
        severity: Severity = "warning" if median_error > CLOCK_ERROR else "note"
        drift_text = (
            f"even their median is off by {median_error:.2g}, a rate of {median_rate:.8g} Hz, which drifts by "
            f"{1e3 * median_error * log.duration:.3g} ms over the log"
            if severity == "warning"
            else f"a single difference taken as the step would drift by up to {drift:.3g} ms over the log"
        )
        yield Finding(
            severity,
            "time",
            f"the time stamps are rounded by up to {1e9 * jitter:.3g} ns: {drift_text}",
            f"take the samples as uniform, {period:.10g} s apart (the mean over the whole log)",
            "rate",
        )


def is_decimated(periods: float) -> bool:
    """Whether a log's samples are a whole number of control periods apart."""
    return 2 <= round(periods) <= 100 and abs(periods / round(periods) - 1) < 1e-3


def rate(log: Log, axis: Axis) -> Iterator[Finding]:
    """The log's rate against that of the drive file."""
    intervals, period = np.diff(log.time), sampling_period(log)
    nominal = axis.sampling.rate
    rate_error = 1.0 / (period * nominal) - 1.0
    regular = intervals[intervals < 1.5 * period]
    uncertainty = 2 * float(np.max(np.abs(regular - period))) / max(log.duration, period)
    if is_decimated(period * nominal):
        factor = round(period * nominal)
        yield Finding(
            "warning",
            "time",
            f"the log holds one sample in {factor}: {1 / period:.6g} Hz, while the controller runs at {nominal:g} Hz",
            "log every sample; until then the controller cannot be replayed, nor its delays seen",
            "decimated",
        )
    elif abs(rate_error) > WRONG_RATE:
        yield Finding(
            "fatal",
            "time",
            f"the log is sampled at {1 / period:.6g} Hz, {1 / (period * nominal):.4g} times the drive file's "
            f"{nominal:g} Hz" + unit_error_text(period * nominal),
            "correct sampling.rate, or the unit of the time column",
            "rate",
        )
    elif abs(rate_error) > max(CLOCK_ERROR, uncertainty):
        yield Finding(
            "warning",
            "time",
            f"the log's rate of {1 / period:.9g} Hz is off the drive file's {nominal:g} Hz by {rate_error:.3g}, which "
            f"drifts by {1e3 * abs(rate_error) * log.duration:.3g} ms over the log",
            "trust the controller's clock: take the samples as uniform at sampling.rate, or correct it",
            "rate",
        )
