"""Brings a log onto a uniform clock: order of its stamps, their rounding or jitter, missing samples, its rate."""

import itertools

import numpy as np
from scipy.optimize import minimize_scalar

from diffdrive.errors import LogError
from diffdrive.logs.clocks.interpolate import resample
from diffdrive.logs.clocks.rate import rate_notes
from diffdrive.logs.clocks.uniform_clock import EXACT, ROUNDED, UniformClock, fit_clock
from diffdrive.logs.column_unit import Conversion
from diffdrive.logs.formats.table import Table
from diffdrive.logs.log import Samples, Signal

FEWEST = 3  # samples
REPEATED = 0.01  # share of repeated stamps beyond which the clock's resolution is coarser than the period
IRREGULAR = 0.5  # periods, RMS: beyond, there is no common clock
DIGITS_ALLOWANCE = 0.05  # periods: what the digits of coarse stamps may add
MOST_GAPS = 0.02  # of all samples: so many among jittered stamps are no gaps
_WRAPS = (8, 15, 16, 24, 31, 32)  # bits


def ordered_times(table: Table, stamps: Signal, clock: Conversion) -> tuple[Samples, np.ndarray, list[str]]:
    """Times, which rows to keep, and notes: no stamp missing or repeated, none earlier than the one before it.

    Stamps of a clock coarser than the period become uniform. Raises `LogError` naming the row.
    """
    keep, notes = np.isfinite(stamps), []
    if not keep.all():
        notes.append(f"{np.sum(~keep)} rows without a time stamp were left out")
    rows = np.flatnonzero(keep)
    times = stamps[rows]
    if len(times) < FEWEST:
        raise LogError(
            f"{table.source}: has {len(times)} samples with a time stamp; a log needs at least {FEWEST}, of one motion"
        )
    steps = np.diff(times)
    if (steps < 0).any():
        k = int(np.argmax(steps < 0))
        raise LogError(
            f"{table.source}: {table.where(rows[k + 1])}: time goes back from {times[k]:.9g} to {times[k + 1]:.9g} s: "
            f"{_why_back(times, k, clock)}"
        )
    repeated = np.concatenate(([False], steps == 0))
    if not repeated.any():
        return times, rows, notes
    if not steps.any():
        raise LogError(f"{table.source}: the clock stands still at {times[0]:.9g} s; name another column for the time")
    if repeated.mean() > REPEATED:
        return _uniform_times(table, times, rows), rows, [*notes, _coarse_clock_note(times)]
    first = table.where(rows[int(np.argmax(repeated))])
    notes.append(f"{repeated.sum()} samples with a repeated time stamp were left out, the first at {first}")
    return times[~repeated], rows[~repeated], notes


def _why_back(times: Signal, k: int, clock: Conversion) -> str:
    backstep = times[k] - times[k + 1] + float(np.median(np.diff(times[: k + 2])))
    if abs(backstep - 86_400) < 1:
        return "a time of day that passed midnight; add 24 h to the rows from there on"
    for bits in _WRAPS:
        if abs(backstep / clock.factor / 2**bits - 1) < 1e-3:
            return f"a counter of {bits} bits wrapped; add 2^{bits} counts to the rows from there on"
    if times[k + 1] < times[0] + 0.01 * (times[k] - times[0]):
        return "a second recording begins there; put it into a file of its own"
    return "the rows are not in order; sort them, or cut the log there"


def _coarse_clock_note(times: Signal) -> str:
    steps = np.diff(times)
    missing = _fewest_missing(times)
    return (
        f"time stamps are coarser than the period (resolution {steps[steps > 0].min():.3g} s): replaced by uniform "
        "ones; "
        + (
            f"at least {missing} samples are missing or late, and the stamps do not show where"
            if missing
            else "single samples that are missing would not show"
        )
    )


def _fewest_missing(times: Signal) -> int:
    """How many samples the stamps of a coarse clock lack at least: none where a uniform clock makes these stamps.

    Between the last sample with one stamp and the first with the next, a uniform clock reaches that stamp. So the first
    samples of all stamps lie within one period above a line, and each that is missing moves the rest by one period.
    """
    first_samples = np.flatnonzero(np.diff(times) > 0) + 1
    if len(first_samples) < FEWEST:
        return 0
    stamps, mean = times[first_samples], float(np.mean(np.diff(times)))

    def spread(period: float) -> float:
        return float(np.ptp(stamps - period * first_samples))

    slope_range = 2.0 * spread(mean) / (first_samples[-1] - first_samples[0])  # no other slope lies closer
    best = minimize_scalar(
        spread,
        bounds=(mean - slope_range, mean + slope_range),
        method="bounded",
        options={"xatol": 1e-3 * mean / len(times)},
    )
    return max(0, int(np.ceil(float(best.fun) / mean - 1.0 - DIGITS_ALLOWANCE)))


def _uniform_times(table: Table, times: Signal, rows: np.ndarray) -> Signal:
    """Uniform times where the stamps are those rounded to their resolution, else an error.

    A stamp lies within half its resolution of the middle of what is rounded to it: as much again is left to samples
    that are late or missing, which `_coarse_clock_note` notes.
    """
    steps = np.diff(times)
    resolution = steps[steps > 0].min()
    count = np.arange(len(times))
    uniform = np.polynomial.Polynomial.fit(count, times, 1)(count)
    if np.max(np.abs(times - uniform)) > resolution:
        first = int(np.argmax(steps == 0))
        raise LogError(
            f"{table.source}: {table.where(rows[first + 1])}: {np.mean(steps == 0):.0%} of the time stamps repeat the "
            "one before, and samples are missing; export the time with more digits"
        )
    return uniform


def on_uniform_clock(
    source: str, signals: dict[str, Signal], rate: float | None, time_unit: float = 1.0
) -> tuple[dict[str, Samples], tuple[int, ...], list[str]]:
    """The signals on the uniform clock behind their times, the gaps, and notes; `rate` (Hz) is that of the drive file.

    The times were read in a `time_unit` of so many seconds.

    Exact stamps stay as they are, rounded ones are replaced, and signals with jittered ones are interpolated. Nothing
    is invented where samples are missing. Raises `LogError` for irregular stamps and for another rate.
    """
    times = signals["time"]
    if len(times) < FEWEST:
        raise LogError(f"{source}: has {len(times)} usable samples; a log needs at least {FEWEST}")
    clock = fit_clock(times, None if rate is None else 1.0 / rate)
    notes = [] if times[0] == 0 else [f"time starts at {times[0]:.9g} s"]
    notes += rate_notes(source, clock, rate, time_unit)
    if clock.gaps:
        notes.append(
            f"samples are missing at {len(clock.gaps)} places, the first after t = {times[clock.gaps[0] - 1]:.9g} s"
        )
    smallest = max(EXACT, 4 * float(np.spacing(np.max(np.abs(times)))) / clock.period)
    if clock.deviation <= smallest:
        return signals, clock.gaps, notes
    largest = 1e6 * clock.deviation * clock.period
    if clock.deviation <= ROUNDED:
        notes.append(f"time stamps are rounded by up to {largest:.3g} us: replaced by uniform ones")
        return signals | {"time": clock.times}, clock.gaps, notes
    if clock.rms > IRREGULAR or len(clock.gaps) > MOST_GAPS * len(times):
        raise LogError(
            f"{source}: the time stamps are irregular: {clock.rms:.2g} periods of {1e3 * clock.period:.4g} ms off a "
            f"uniform clock (RMS), with {len(clock.gaps)} gaps; log at a fixed rate, or "
            "leave the time out and give the rate"
        )
    notes.append(
        f"time stamps jitter by {1e6 * clock.rms * clock.period:.3g} us RMS and {largest:.3g} us at most, "
        f"{clock.deviation:.0%} of a period: the signals were interpolated onto {1 / clock.period:.6g} Hz"
    )
    pieces, gaps = _resample_segments(signals, clock)
    return pieces, gaps, notes


def _resample_segments(signals: dict[str, Signal], clock: UniformClock) -> tuple[dict[str, Samples], tuple[int, ...]]:
    edges = [0, *clock.gaps, len(clock.times)]
    parts: dict[str, list[Signal]] = {name: [] for name in signals}
    for begin, end in itertools.pairwise(edges):
        stamps = signals["time"][begin:end]
        uniform = clock.times[begin:end]
        # a tolerance far below the jitter: the ends belong to the piece
        new_times = uniform[
            (uniform >= stamps[0] - EXACT * clock.period) & (uniform <= stamps[-1] + EXACT * clock.period)
        ]
        new_times = np.clip(new_times, stamps[0], stamps[-1]) if len(new_times) else stamps[:1]
        for name, values in signals.items():
            parts[name].append(new_times if name == "time" else resample(name, stamps, values[begin:end], new_times))
    lengths = np.cumsum([len(part) for part in parts["time"]])
    return {name: np.concatenate(part) for name, part in parts.items()}, tuple(lengths[:-1].tolist())
