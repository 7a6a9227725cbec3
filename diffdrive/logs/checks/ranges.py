"""Travel, speed, load and temperature against what an axis can be, and against the limits of this one."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from diffdrive.axis import Axis
from diffdrive.logs.checks.factors import unit_error_text
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.statistics import longest_piece, sampling_period, top_speed
from diffdrive.logs.log import Log

LONGEST = 50.0  # m: the longest gantries


class Extremes(NamedTuple):
    """What no feed drive exceeds, in the unit of its travel; the unit's name, and what is taken for it by mistake."""

    unit: str
    fastest: float  # a second
    longest: float
    smallest: float  # travel: fewer than the counts of the finest common scale
    mistaken: str


LINEAR = Extremes("m", 10.0, LONGEST, 1e-7, "millimetres, counts or degrees taken as metres?")  # linear motors reach 5
ROTARY = Extremes(
    "rad", 2e3, np.inf, 1e-8, "degrees, turns or counts taken as radians?"
)  # fast motors turn at 20,000 rpm


def travel(log: Log, axis: Axis | None) -> Iterator[Finding]:
    """Travel and speed of reference and position."""
    low, high = (-np.inf, np.inf) if axis is None else axis.limits.stroke
    speed_limit = np.inf if axis is None else axis.limits.speed
    extremes = ROTARY if axis is not None and axis.sheet.is_rotary else LINEAR
    unit = extremes.unit
    piece, period = longest_piece(log), sampling_period(log)
    for name in ("position", "reference"):
        signal = log.channels.get(name)
        if signal is None:
            continue
        travelled, speed = float(np.ptp(signal)), top_speed(signal[piece], period)
        problems = []
        # a twentieth beyond is overshoot, soft limits, or a stroke given roughly
        if np.isfinite(high - low) and travelled > 1.05 * (high - low):
            ratio = travelled / (high - low)
            problems.append(
                f"travels {travelled:.4g} {unit}, {ratio:.4g} times the stroke of {high - low:g} {unit}"
                f"{unit_error_text(ratio)}"
            )
        elif travelled > extremes.longest:
            problems.append(f"travels {travelled:.4g} {unit}, more than any axis")
        if speed > extremes.fastest:
            problems.append(f"moves at {speed:.4g} {unit}/s, faster than any feed drive")
        elif speed > 1.5 * speed_limit:
            problems.append(
                f"moves at {speed:.4g} {unit}/s, {speed / speed_limit:.4g} times the limit of {speed_limit:g} {unit}/s"
            )
        if problems:
            yield Finding(
                "fatal",
                name,
                f"the {name} " + " and ".join(problems) + f": {extremes.mistaken}",
                f"correct the unit of the {name}, or the drive file's limits",
                "gain",
            )
        elif 0 < travelled < extremes.smallest:
            yield Finding(
                "warning",
                name,
                f"the {name} travels only {travelled:.3g} {unit} in all",
                f"{'radians' if unit == 'rad' else 'metres'} are expected: correct its unit, or log a motion",
                "motion",
            )
        elif np.isfinite(high - low) and (np.max(signal) > high + 1e-3 or np.min(signal) < low - 1e-3):
            yield Finding(
                "note",
                name,
                f"the {name} runs from {np.min(signal):.4g} to {np.max(signal):.4g} {unit}, outside the "
                f"stroke [{low:g}, {high:g}] {unit}, though not longer than it",
                "its zero is not that of the drive file: shift one of them if position-dependent effects matter",
                "offset",
            )


def load(log: Log, axis: Axis | None) -> Iterator[Finding]:
    """A load that would lift the table, or that has the wrong sign."""
    if log.load is None:
        return
    lowest = float(np.min(log.load))
    if lowest < 0 and np.max(log.load) <= 0:
        yield Finding(
            "fatal",
            "load",
            f"the load is negative throughout ({lowest:.4g} to {np.max(log.load):.4g} N): its sign is reversed",
            "a load on the guides counts positive: reverse it",
            "reversed",
        )
    elif axis is not None and lowest < -float(axis.drive.friction.initial_load):
        yield Finding(
            "fatal",
            "load",
            f"the load falls to {lowest:.4g} N, below minus the initial load of "
            f"{float(axis.drive.friction.initial_load):g} N: the table would lift off",
            "correct the sign, the unit or the zero of the load",
            "offset",
        )
    elif lowest < -0.01 * float(np.max(log.load)):
        yield Finding(
            "warning",
            "load",
            f"the load is negative at times, down to {lowest:.4g} N",
            "check the zero of the load cell",
            "offset",
        )


def temperature(log: Log) -> Iterator[Finding]:
    """Kelvin given as degrees Celsius: Fahrenheit is too near to them to be distinguished."""
    if log.temperature is None:
        return
    median = float(np.median(log.temperature))
    if not -40.0 <= median <= 150.0:
        yield Finding(
            "warning",
            "temperature",
            f"the temperature is {median:.4g} degC in the middle, which no axis survives",
            "kelvin, or a raw sensor value? give degrees Celsius",
            "gain",
        )
