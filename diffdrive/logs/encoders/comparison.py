"""Motor minus table taken apart: reversal error, wind-up, error per turn, linear error, drift, time between encoders.

While the table slides and the screw pushes it, at position x, velocity v, acceleration a and time t, in direction s,

    motor - table = zero + s (B + B' x) / 2 + e x + A cos(2 pi x / L + phase) + r t + T v + c a ,

where B is the reversal error (backlash and wind-up under friction), e the linear error, A that of each turn, r the
drift and T the time between the encoders' readings (with the wind-up under viscous friction). The force in the
reversals separates backlash from wind-up (`split`).
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import t as student

from diffdrive.axis import Axis
from diffdrive.errors import ParameterError
from diffdrive.logs.checks.grid import fit_count_grid, noise_std
from diffdrive.logs.checks.statistics import robust_std, sampling_period
from diffdrive.logs.encoders import split, turn
from diffdrive.logs.encoders.passes import Passes, find_passes, pushed
from diffdrive.logs.encoders.regression import LEVEL, Estimate, Regression, interval, regress
from diffdrive.logs.encoders.result import ComparedSamples, EncoderComparison, Place, Reversal
from diffdrive.logs.log import Log
from diffdrive.support.bounds import require_a

PLACES = 10  # stretches of the stroke whose reversal error is reported
ROUNDINGS = 4  # of double precision, in a difference of two positions about its mean: both, the difference, the mean
FEWEST = 50  # samples that slide
FEWEST_PASSES = 6  # two more than what their differences show: zero, reversal error, its change, drift

Columns = Mapping[str, Float[np.ndarray, " n"]]


class _Samples(NamedTuple):
    """The samples of all passes; [n] each, in SI units."""

    passes: Passes
    period: float
    time: Float[np.ndarray, " n"]
    motor: Float[np.ndarray, " n"]
    table: Float[np.ndarray, " n"]
    command: Float[np.ndarray, " n"]
    used: Bool[np.ndarray, " n"]  # by the regression

    @property
    def difference(self) -> Float[np.ndarray, " n"]:
        """Motor minus table, about its mean."""
        difference = self.motor - self.table
        return difference - float(np.mean(difference))


def compare_encoders(log: Log, axis: Axis | None = None) -> EncoderComparison:
    """Take motor minus table apart, before anything is fitted to the machine.

    Motor and table must be in metres and of one sign. The reversal error (lost motion) is what ISO 230-2 calls reversal
    value, here of the motor against the table. How much of it is backlash and how much wind-up of the screw under
    friction is said as far as the force in the reversals shows it; its interval may be as wide as the reversal error
    itself.

    Args:
        log: With `motor_position` and `position`, the table's.
        axis: States the lead, in its data sheet or its lead error; otherwise a period is looked for.

    Raises:
        ParameterError: The log has no `motor_position`, or its table hardly moves.

    Examples:
        >>> compare_encoders(read_log("lap.csv", axis), axis)
        reversal error 12.3 (12.1 to 12.5) um, backlash 9.8 (8 to 11.4) um of it

    """
    require_a(Log, "log", log, "read one with read_log")
    if log.motor_position is None:
        raise ParameterError(f"{log.name}: no motor_position: there is no second encoder to compare with")
    period = sampling_period(log)
    passes = find_passes(log, period)
    if passes is None or np.sum(passes.sliding) < FEWEST:
        raise ParameterError(f"{log.name}: the table hardly moves: nothing can be said of motor minus table")
    return _compared(log, axis, _samples(log, passes, period))


def _samples(log: Log, passes: Passes, period: float) -> _Samples:
    assert log.motor_position is not None
    time, motor, table, command = (
        signal[passes.rows] for signal in (log.time, log.motor_position, log.position, log.command)
    )
    return _Samples(passes, period, time, motor, table, command, pushed(passes, command))


def _columns(samples: _Samples) -> dict[str, Float[np.ndarray, " n"]]:
    """Of the model, the more important ones first."""
    passes, used = samples.passes, samples.used
    position = samples.table - float(np.mean(samples.table[used]))
    columns = {
        "zero": np.ones(len(position)),
        "direction": passes.direction,
        "linear": position,
        "delay": passes.velocity,
        "acceleration": passes.acceleration,
        "jerk": passes.jerk,  # the wind-up grows between the encoders' readings
        "drift": samples.time - float(np.mean(samples.time[used])),
        "change": passes.direction * position,
    }
    if len(np.unique(passes.number[used])) < FEWEST_PASSES:  # too few to distinguish these from their scatter
        del columns["drift"], columns["change"]
    return columns


def _fit(samples: _Samples, columns: Columns, y: Float[np.ndarray, " n"]) -> Regression:
    used = samples.used
    return regress({name: column[used] for name, column in columns.items()}, y[used], samples.passes.number[used])


def _model(fit: Regression, columns: Columns, without: tuple[str, ...] = ()) -> Float[np.ndarray, " n"]:
    """What the regression makes of all samples."""
    terms = [fit.value(name) * column for name, column in columns.items() if name not in without]
    return np.sum(terms, axis=0)


def _compared(log: Log, axis: Axis | None, samples: _Samples) -> EncoderComparison:
    difference, columns = samples.difference, _columns(samples)
    fit = _fit(samples, columns, difference)
    lead = turn.stated_lead(axis)
    period = lead or turn.find_period(samples.table[samples.used][:: fit.thinning], fit.residual)
    per_turn = None
    if period is not None:
        with_wave = columns | turn.wave(samples.table, period)
        wave_fit = _fit(samples, with_wave, difference)
        per_turn = wave_fit.amplitude("cosine", "sine")
        if per_turn is not None and (lead is not None or per_turn.is_significant):
            fit, columns = wave_fit, with_wave
        else:
            period = per_turn = None
    rest = difference - _model(fit, columns, without=("direction", "change"))
    reversals = _reversals(samples, rest)
    compliance, friction = _compliance(samples, columns, fit)
    direction = fit.estimate("direction")
    both = bool(np.unique(samples.passes.direction[samples.used]).size > 1)
    error = direction.times(2.0) if direction is not None and both else None
    backlash = None if error is None else _backlash(samples, difference, fit, columns, error, compliance, friction)
    change = fit.estimate("change") if both else None
    fitted = np.where(samples.used, _model(fit, columns), np.nan)
    errors = np.array([one.error for one in reversals])
    rounding = ROUNDINGS * np.finfo(float).eps * max(np.max(np.abs(samples.motor)), np.max(np.abs(samples.table)))
    per_travel, per_second, per_speed, per_force = (
        rounding / max(float(np.max(np.abs(one))), np.finfo(float).tiny)
        for one in (np.ptp(samples.table), np.ptp(samples.time), samples.passes.velocity, samples.command)
    )
    return EncoderComparison(
        log=log.name,
        reversal_error=_beyond(rounding, error),
        backlash=_beyond(rounding, backlash),
        wind_up=None if error is None or backlash is None else _beyond(rounding, _rest(error, backlash)),
        change_along_stroke=None if change is None else _beyond(per_travel, change.times(2.0)),
        scatter=float(np.std(errors, ddof=1)) if len(errors) > 1 else None,
        compliance=_beyond(per_force, compliance),
        period=period,
        per_turn=_beyond(rounding, per_turn),
        linear=_beyond(per_travel, fit.estimate("linear")),
        drift=_beyond(per_second, fit.estimate("drift")),
        delay=_beyond(per_speed, fit.estimate("delay")),
        residual=robust_std(fit.residual),
        resolution=_resolution(log, axis),
        reversals=reversals,
        places=_places(samples, rest) if both else (),
        samples=ComparedSamples(
            samples.passes.rows,
            samples.time,
            samples.table,
            difference,
            samples.passes.direction,
            fitted,
            as_table=samples.table + rest,
        ),
    )


def _beyond(rounding: float, estimate: Estimate | None) -> Estimate | None:
    """Zero where the interval lies within what rounding makes of a motor position that is a copy of the table's."""
    if estimate is None or max(abs(estimate.low), abs(estimate.high)) > rounding:
        return estimate
    return Estimate(0.0, 0.0, 0.0)


def _resolution(log: Log, axis: Axis | None) -> float:
    """What the coarser encoder distinguishes (m): its step, stated or found, or the standard deviation of its noise."""
    assert log.motor_position is not None
    stated = None if axis is None else axis.drive.sensor.resolution
    sizes = [0.0 if stated is None else float(stated)]
    for signal in (log.position, log.motor_position):
        grid = fit_count_grid(signal)
        sizes += [noise_std(signal), 0.0 if grid is None else grid.step]
    return max(sizes)


def _reversals(samples: _Samples, rest: Float[np.ndarray, " n"]) -> tuple[Reversal, ...]:
    """Each reversal's own lost motion: from the half of either pass that is nearer to it."""
    passes, found = samples.passes, []
    for turned in passes.turns.tolist():
        before, after = passes.number[turned - 1], passes.number[turned]
        start, stop = np.searchsorted(passes.number, before), np.searchsorted(passes.number, after, "right")
        near = slice((int(start) + turned) // 2, (turned + int(stop) + 1) // 2)
        ahead = samples.used[near] & (passes.number[near] == before)
        behind = samples.used[near] & (passes.number[near] == after)
        if ahead.any() and behind.any():
            step = float(np.median(rest[near][behind]) - np.median(rest[near][ahead]))
            error = float(passes.direction[turned]) * step
            found.append(Reversal(float(samples.time[turned]), float(samples.table[turned]), error))
    return tuple(found)


def _compliance(samples: _Samples, columns: Columns, fit: Regression) -> tuple[Estimate | None, Estimate | None]:
    """Wind-up per newton of the command (m/N), by what acceleration takes of either; and the friction (N)."""
    names = ("zero", "direction", "linear", "delay", "acceleration", "jerk")
    forces = _fit(samples, {name: columns[name] for name in names}, samples.command)
    friction = forces.estimate("direction")
    mass = forces.value("acceleration")
    if mass == 0.0 or "acceleration" not in fit.names:
        return None, friction
    value = fit.value("acceleration") / mass
    of_fit, of_mass = (one.influences({"acceleration": 1.0 / mass}) for one in (fit, forces))
    return interval(value, of_fit.plus(of_mass.times(-value))), friction


def _backlash(
    samples: _Samples,
    difference: Float[np.ndarray, " n"],
    fit: Regression,
    columns: Columns,
    error: Estimate,
    compliance: Estimate | None,
    friction: Estimate | None,
) -> Estimate:
    """The part of the reversal error that is a gap: all of it or none, unless the force says which."""
    total = max(0.0, error.value)
    low, value = 0.0, total
    if compliance is not None and friction is not None:
        # a table of a smaller share of the mass takes less of the force: the screw is softer than it appears
        most = 2.0 * abs(friction.value) * max(0.0, compliance.high) / split.LEAST_TABLE_SHARE
        low = max(0.0, error.low - most)
        value = max(low, total - 2.0 * abs(friction.value) * max(0.0, compliance.value))
    everything = Estimate(value, low, max(total, error.high))
    change = columns["linear"] * fit.value("change")
    without = ("direction", "change", "acceleration", "jerk")
    deflection = difference - _model(fit, columns, without=without) - samples.passes.direction * change
    signals = split.Signals(deflection, samples.motor, samples.command, samples.period)
    seen = split.backlash_of_reversals(signals, samples.passes, total) if error.is_significant else None
    if seen is None or seen.value < low:  # a model of the reversals that acceleration refutes says nothing
        return everything
    high = max(low, seen.high) + max(0.0, error.high - total)
    return Estimate(float(np.clip(seen.value, low, high)), max(low, seen.low), high)


def _rest(error: Estimate, backlash: Estimate) -> Estimate:
    """What backlash leaves of the reversal error."""
    return Estimate(
        max(0.0, error.value - backlash.value), max(0.0, error.low - backlash.high), max(0.0, error.high - backlash.low)
    )


def _places(samples: _Samples, rest: Float[np.ndarray, " n"]) -> tuple[Place, ...]:
    """Forwards against backwards along the stroke, from the passes' means in each stretch."""
    used, table = samples.used, samples.table
    edges = np.linspace(float(np.min(table[used])), float(np.max(table[used])), PLACES + 1)
    stretch = np.clip(np.searchsorted(edges, table[used], "right") - 1, 0, PLACES - 1)
    number = samples.passes.number[used]
    count = int(number.max()) + 1
    key = stretch * count + number
    size = np.bincount(key, minlength=PLACES * count)
    mean = np.bincount(key, rest[used], minlength=PLACES * count) / np.maximum(size, 1)
    side = np.zeros(count)
    side[number] = samples.passes.direction[used]
    found = []
    for k in range(PLACES):
        there = size[k * count : (k + 1) * count] > 0
        forward, backward = (mean[k * count : (k + 1) * count][there & (side == one)] for one in (1.0, -1.0))
        if min(len(forward), len(backward)) < 2:
            continue
        variances = [float(np.var(one, ddof=1)) / len(one) for one in (forward, backward)]
        freedom = min(len(forward), len(backward)) - 1  # at least, by Welch
        half = float(student.ppf(0.5 + 0.5 * LEVEL, freedom)) * float(np.sqrt(sum(variances)))
        error = float(np.mean(forward) - np.mean(backward))
        found.append(Place(float(edges[k]), float(edges[k + 1]), Estimate(error, error - half, error + half)))
    return tuple(found)
