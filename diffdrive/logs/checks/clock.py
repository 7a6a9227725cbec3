"""The clock: is the log uniform, is it the rate of the drive file, and is anything missing?"""

from collections.abc import Iterator

import numpy as np

from diffdrive.axis import Axis
from diffdrive.logs.checks.factors import unit_error_text
from diffdrive.logs.checks.finding import Finding
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
    steps = np.diff(log.time)
    if not np.all(steps > 0):
        k = int(np.argmin(steps > 0)) + 1
        yield Finding(
            "fatal",
            "time",
            f"{np.sum(steps <= 0)} time stamps do not increase, first at sample {k} (t = {log.time[k]:g} s)",
            "sort the rows and drop repeated ones",
            "unreadable",
        )


def gaps(log: Log) -> Iterator[Finding]:
    """Missing samples that the stamps show, listed in `gaps` or not."""
    steps, step = np.diff(log.time), sampling_period(log)
    listed = np.zeros(len(steps), bool)
    listed[[k - 1 for k in log.gaps]] = True
    lost = steps[listed] - step
    if log.gaps:
        yield Finding(
            "warning",
            "time",
            f"{len(log.gaps)} gaps, {lost.sum():.4g} s in all, the longest {lost.max():.4g} s at "
            f"t = {log.time[log.gaps[int(np.argmax(lost))] - 1]:.6g} s",
            "the stretches between the gaps are used one by one",
            "lost rows",
        )
    missed = np.flatnonzero(~listed & (steps > 1.5 * step))
    if len(missed):
        count = int(np.sum(np.round(steps[missed] / step) - 1))
        yield Finding(
            "fatal",
            "time",
            f"{count} samples are missing at {len(missed)} places, first after t = {log.time[missed[0]]:.6g} s",
            f"list the gaps (Log.gaps = {tuple(int(k) + 1 for k in missed[:5])}...) or cut the log there",
            "lost rows",
        )


def stamps(log: Log) -> Iterator[Finding]:
    """Rounded or scattered stamps, whose single differences are no time step."""
    steps, step = np.diff(log.time), sampling_period(log)
    regular = steps[steps < 1.5 * step]
    off = float(np.max(np.abs(regular - step)))
    drift = 1e3 * off / step * log.duration
    if off > JITTER * step:
        yield Finding(
            "warning",
            "time",
            f"the time stamps scatter by up to {1e6 * off:.4g} us, {100 * off / step:.3g} % of the step",
            "they are not the controller's clock; if the controller runs on a timer, take the samples as uniform",
            "rate",
        )
    elif off > CLOCK_ERROR * step:
        usual = float(1.0 / np.median(regular))
        median = abs(usual * step - 1)
        severity = "warning" if median > CLOCK_ERROR else "note"
        which = (
            f"even their median is off by {median:.2g}, a rate of {usual:.8g} Hz, which drifts by "
            f"{1e3 * median * log.duration:.3g} ms over the log"
            if severity == "warning"
            else f"a single difference taken as the step would drift by up to {drift:.3g} ms over the log"
        )
        yield Finding(
            severity,
            "time",
            f"the time stamps are rounded by up to {1e9 * off:.3g} ns: {which}",
            f"take the samples as uniform, {step:.10g} s apart (the mean over the whole log)",
            "rate",
        )


def is_decimated(periods: float) -> bool:
    """Whether a log's samples are a whole number of control periods apart."""
    return 2 <= round(periods) <= 100 and abs(periods / round(periods) - 1) < 1e-3


def rate(log: Log, description: Axis) -> Iterator[Finding]:
    """The log's rate against that of the drive file."""
    steps, step = np.diff(log.time), sampling_period(log)
    stated = description.sampling.rate
    off = 1.0 / (step * stated) - 1.0
    regular = steps[steps < 1.5 * step]
    doubt = 2 * float(np.max(np.abs(regular - step))) / max(log.duration, step)
    if is_decimated(step * stated):
        skipped = round(step * stated)
        yield Finding(
            "warning",
            "time",
            f"the log holds one sample in {skipped}: {1 / step:.6g} Hz, while the controller runs at {stated:g} Hz",
            "log every sample; until then the controller cannot be replayed, nor its delays seen",
            "decimated",
        )
    elif abs(off) > WRONG_RATE:
        yield Finding(
            "fatal",
            "time",
            f"the log is sampled at {1 / step:.6g} Hz, {1 / (step * stated):.4g} times the drive file's {stated:g} Hz"
            + unit_error_text(step * stated),
            "correct sampling.rate, or the unit of the time column",
            "rate",
        )
    elif abs(off) > max(CLOCK_ERROR, doubt):
        yield Finding(
            "warning",
            "time",
            f"the log's rate of {1 / step:.9g} Hz is off the drive file's {stated:g} Hz by {off:.3g}, which drifts by "
            f"{1e3 * abs(off) * log.duration:.3g} ms over the log",
            "trust the controller's clock: take the samples as uniform at sampling.rate, or correct it",
            "rate",
        )
