"""The count grid of a signal: an encoder's counts, a converter's steps, and whether the signal still lies on it."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from diffdrive.axis import Axis
from diffdrive.logs.checks.factors import unit_error_text
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.ranges import LONGEST
from diffdrive.logs.checks.statistics import robust_std
from diffdrive.logs.log import Log, Signal

# Residuals to a grid, in steps: uniform ones have an RMS of 1/sqrt(12) = 0.289; single-precision storage of 0.25 m on
# a 5e-8 m grid, the worst that we met, makes 0.09.
ON_GRID = 0.15
# A grid finer than this share of the travel is that of the numbers' storage, not of a sensor.
STORAGE = 1e-10
# A sensor that is this much coarser than its data sheet is another sensor, or another setting.
COARSER = 1.5
# Steps that are this much coarser may be a wrong unit as well.
UNIT_OF_STEPS = 100.0
# Distinct values below which a command is a staircase: its steps are above 2 % of its range.
COARSE_LEVELS = 50
FEW = 20  # samples for each value, where a signal is a staircase


class CountGrid(NamedTuple):
    """A grid that the signal lies on: its step, and the RMS distance of the small gaps from it, in steps."""

    step: float
    misfit: float


def fit_count_grid(signal: Signal) -> CountGrid | None:
    """The grid on which the values lie, or None: the step of which all gaps between values are multiples.

    At constant speed the gaps are all large, such as 49, 50 and 51 counts; the gaps between these are single counts.
    """
    values = np.unique(signal)
    if len(values) < 3:
        return None
    rounding = STORAGE * max(float(np.max(np.abs(values))), float(np.ptp(values)))
    differences = np.sort(np.diff(values))
    differences = differences[differences > rounding]
    second_differences = np.diff(differences)
    differences = np.sort(np.concatenate([differences, second_differences[second_differences > rounding]]))
    if len(differences) < 20:
        return None
    # the smallest gaps are single steps (or, of a smooth signal, arbitrary numbers, which the misfit shows)
    step = float(np.median(differences[differences < 1.5 * differences[0]]))
    small_differences = differences[differences < 200.5 * step]
    if len(small_differences) < 20:
        return None
    for _ in range(3):
        counts = np.maximum(np.round(small_differences / step), 1.0)
        step = float(np.sum(small_differences * counts) / np.sum(counts**2))
    misfit = float(np.sqrt(np.mean((small_differences / step - np.round(small_differences / step)) ** 2)))
    return CountGrid(step, misfit) if misfit < ON_GRID else None


def noise_std(signal: Signal) -> float:
    """Standard deviation of a signal's noise, from its third differences, which no motion survives, and its counts."""
    grid = fit_count_grid(signal)
    quantisation = grid.step / np.sqrt(12) if grid else 0.0
    return max(robust_std(np.diff(signal, 3)) / np.sqrt(20), quantisation)  # 20 = 1 + 9 + 9 + 1


def off_grid_share(signal: Signal, step: float) -> float | None:
    """Share of the moving stretches whose samples do not lie on a grid of `step`; None if nothing moves.

    Stretches of 50 samples are short enough that a home offset or a scale error of 1e-5 does not smear the grid. Only
    stretches whose increments vary count: at a speed of whole steps per sample any signal repeats its phase.
    """
    length = 50
    count = len(signal) // length
    if count == 0:
        return None
    blocks = signal[: count * length].reshape(count, length) / step
    is_moving = np.std(np.diff(blocks, axis=1), axis=1) > 0.3
    if np.sum(is_moving) < 3:
        return None
    phase = blocks[is_moving] - blocks[is_moving][:, :1]
    centre = np.angle(np.mean(np.exp(2j * np.pi * phase), axis=1, keepdims=True)) / (2 * np.pi)
    residual = phase - centre - np.round(phase - centre)
    return float(np.mean(np.sqrt(np.mean(residual**2, axis=1)) > ON_GRID))


def _longest_travel(axis: Axis | None) -> float:
    low, high = (-np.inf, np.inf) if axis is None else axis.limits.stroke
    return min(1.05 * (high - low), LONGEST)


def position_grid(log: Log, axis: Axis | None) -> Iterator[Finding]:
    """The position's counts against the drive file's resolution, or whether there are counts at all."""
    grid = fit_count_grid(log.position)
    resolution = None if axis is None else axis.drive.sensor.resolution
    if resolution is None:
        if grid is None:
            yield Finding(
                "note",
                "position",
                "no count grid: interpolated, filtered or floating point",
                "if the encoder has counts, log them; a filter before the log delays the position",
                "filtered",
            )
        return
    resolution = float(resolution)
    if grid is not None and grid.step > COARSER * resolution:
        ratio = grid.step / resolution
        yield Finding(
            "fatal" if ratio > UNIT_OF_STEPS else "warning",
            "position",
            f"the position moves in steps of {grid.step:.4g} m, {ratio:.4g} times the drive file's resolution of "
            f"{resolution:g} m",
            "log all digits, or correct sensor.resolution"
            + ("; or the unit of position and reference is wrong" if ratio > UNIT_OF_STEPS else ""),
            "rounded",
            ("gain",) if ratio > UNIT_OF_STEPS else (),
        )
        return
    ratio = 1.0 if grid is None else grid.step / resolution
    # digits and single precision make fine grids too; a unit is wrong only if the right one makes an axis of it
    if grid is not None and ratio < 0.01 and float(np.ptp(log.position)) / ratio < _longest_travel(axis):
        yield Finding(
            "fatal",
            "position",
            f"the position moves in steps of {grid.step:.4g} m, {ratio:.4g} times the drive file's resolution of "
            f"{resolution:g} m{unit_error_text(ratio)}",
            "correct the unit of the position, or sensor.resolution",
            "gain",
        )
        return
    share = off_grid_share(log.position, resolution)
    if share is not None and share > 0.5:
        grid_text = f", but on one of {grid.step:.4g} m" if grid is not None else ""
        yield Finding(
            "warning",
            "position",
            f"{100 * share:.0f} % of the moving stretches are off the count grid of {resolution:g} m{grid_text}: the "
            "position was resampled or filtered",
            "log the raw counts; until then do not trust this position at high frequency, nor its delay",
            "filtered",
        )


def coarse_step(signal: Signal) -> float | None:
    """The step of a signal that takes few values, all of them multiples of one step; None of any other."""
    values = np.unique(signal)
    if not 2 < len(values) < len(signal) / FEW:
        return None
    counts = (values - values[0]) / float(np.min(np.diff(values)))
    return float(np.min(np.diff(values))) if np.max(np.abs(counts - np.round(counts))) < ON_GRID else None


def command_grid(log: Log) -> Iterator[Finding]:
    """A command in coarse steps."""
    levels = len(np.unique(log.command))
    value_range = float(np.ptp(log.command))
    if 2 < levels < COARSE_LEVELS and levels < len(log.command) / 20:
        step = float(np.median(np.diff(np.unique(log.command))))
        yield Finding(
            "warning",
            "command",
            f"the command takes only {levels} values, {step:.4g} apart over a range of {value_range:.4g}",
            "log it with more digits, or before the D/A converter",
            "rounded",
        )
