"""Samples that no motion makes: not a number, single-sample spikes, rows lost or repeated."""

from collections.abc import Iterator

import numpy as np

from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.grid import fit_count_grid, noise_std
from diffdrive.logs.checks.statistics import SIGMA_PER_MAD, longest_piece, robust_fit
from diffdrive.logs.checks.stuck import clipped_samples
from diffdrive.logs.log import CHANNELS, Log, Samples, Signal

# Robust standard deviations: heavy tails of real noise reach 8, a reversal's jerk 10.
SPIKE = 20.0
FEWEST = 100  # samples without a gap: any comparison of channels needs as many
NINETY = 1.645  # standard deviations within which 90 % of normal values lie


def finite(log: Log) -> Iterator[Finding]:
    """Every sample must be a number."""
    for name, signal in log.channels.items():
        bad = ~np.isfinite(signal)
        if bad.any():
            k = int(np.argmax(bad))
            yield Finding(
                "fatal",
                name,
                f"{bad.sum()} of {len(bad)} samples are not finite numbers, first sample {k}",
                "cut the stretch out and list it as a gap, or leave the channel out",
                "unreadable",
            )


def lengths(log: Log) -> Iterator[Finding]:
    """A log must be long enough to look at."""
    longest_segment = longest_piece(log)
    count = longest_segment.stop - longest_segment.start
    if count < FEWEST:
        yield Finding(
            "fatal",
            "time",
            f"only {len(log.time)} samples"
            + (f", and no more than {count} of them without a gap" if count < len(log.time) else ""),
            "log at least some hundred samples of a motion in one piece",
            "unreadable",
        )


def _second_difference(signal: Signal) -> Samples:
    """Half the second difference: how far each inner sample lies off the line between its neighbours."""
    return signal[1:-1] - (signal[:-2] + signal[2:]) / 2


def spike_indices(second_difference: Signal, floor: float) -> np.ndarray:
    """Samples that leave the line between their neighbours by more than `SPIKE` deviations and return at once.

    A spike's second differences read -1/2, 1, -1/2: that shape distinguishes it from a step or a kink, which are
    physics. The deviation is that of the hundred samples around, or of the whole log, or the floor, whichever is
    largest. Around, it is taken from the 90 % quantile: a controller at standstill chatters in bursts, a logger's
    spikes stand alone.
    """
    log_std = SIGMA_PER_MAD * float(np.median(np.abs(second_difference)))
    is_large = np.abs(second_difference) > SPIKE * max(floor, log_std, np.finfo(float).tiny)
    is_large[[0, -1]] = False
    k = np.flatnonzero(is_large)
    k = k[np.abs(second_difference[k]) > SPIKE / NINETY * _quantile_around(np.abs(second_difference), k)]
    returns_at_once = (np.abs(second_difference[k - 1] / second_difference[k] + 0.5) < 0.2) & (
        np.abs(second_difference[k + 1] / second_difference[k] + 0.5) < 0.2
    )
    return k[returns_at_once]


def _quantile_around(values: Signal, places: np.ndarray, reach: int = 50, batch_size: int = 10_000) -> Samples:
    """The 90 % quantile of the samples around each of some places, mirrored at the ends."""
    padded = np.pad(values, min(reach, len(values) - 1), mode="symmetric")
    windows = np.lib.stride_tricks.sliding_window_view(padded, len(padded) - len(values) + 1)
    batches = [places[first : first + batch_size] for first in range(0, len(places), batch_size)]
    return np.concatenate([np.empty(0), *(np.quantile(windows[batch], 0.9, axis=1) for batch in batches)])


def _floor(signal: Signal, share: float) -> float:
    grid = fit_count_grid(signal)
    return max(share * float(np.ptp(np.quantile(signal, [0.01, 0.99]))), grid.step if grid else 0.0)


def spikes(log: Log, controller_command: Signal | None = None) -> Iterator[Finding]:
    """Single-sample spikes; in the command only what the controller did not make from position and reference.

    `controller_command` is the controller's command [n], where it is known.
    """
    for name in ("reference", "position", "motor_position", "velocity", "load", "command"):
        signal = log.channels.get(name)
        if signal is None or np.ptp(signal) == 0:
            continue
        second_difference = _second_difference(signal)
        floor = _floor(signal, 1e-6)
        if name == "command":
            second_difference = (
                _residual_of_command(log, second_difference)
                if controller_command is None
                else _second_difference(signal - controller_command)
            )
            at_limit = clipped_samples(signal)
            second_difference[at_limit[:-2] | at_limit[1:-1] | at_limit[2:]] = (
                0.0  # no spikes, but where it leaves its limit
            )
            floor = _floor(signal, 1e-3)
        k = spike_indices(second_difference, floor)
        if len(k):
            worst = k[int(np.argmax(np.abs(second_difference[k])))]
            yield Finding(
                "warning",
                name,
                f"{f'{len(k)} single-sample spikes, the largest' if len(k) > 1 else '1 single-sample spike,'} "
                f"{second_difference[worst]:.4g} {CHANNELS[name].unit} at "
                f"t = {log.time[worst + 1]:.6g} s",
                "mask these samples or replace them by the mean of their neighbours",
                "outliers",
            )


def _residual_of_command(log: Log, second_difference: Signal) -> Signal:
    """The command's second differences less their fit by those of reference and position, within one sample.

    A controller turns one flickering count into a spike of its own: kp and kd times the count.
    """
    inputs = [_second_difference(log.position)] + ([] if log.reference is None else [_second_difference(log.reference)])
    columns = [np.roll(signal, samples) for signal in inputs for samples in (-1, 0, 1) if np.ptp(signal) > 0]
    return robust_fit(columns, second_difference).residual if np.ptp(second_difference) > 0 else second_difference


def _relative_jumps(signal: Signal) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each increment over the median of its six neighbours, less one; that median; and how far they scatter."""
    increment = np.diff(signal)
    neighbours = np.stack([np.roll(increment, samples) for samples in (-3, -2, -1, 1, 2, 3)])
    median = np.median(neighbours, axis=0)
    magnitude = np.maximum(np.abs(median), max(1e-12 * float(np.ptp(signal)), np.finfo(float).tiny))
    scatter = np.ptp(neighbours, axis=0) / magnitude
    scatter[:3], scatter[-3:] = np.inf, np.inf
    return (increment - median) / magnitude * np.sign(median), median, scatter


def _jump_between(signal: Signal, k: int, count: int = 10) -> float:
    """How far the signal jumps from sample k to k + 1 beyond its own motion: the lines before and after, half-way."""
    offsets = np.arange(count) + 0.5
    before, after = signal[max(0, k + 1 - count) : k + 1], signal[k + 1 : k + 1 + count]
    if len(before) < count or len(after) < count:
        return 0.0
    return float(
        np.polynomial.Polynomial.fit(offsets, after, 1)(0) - np.polynomial.Polynomial.fit(-offsets[::-1], before, 1)(0)
    )


def lost_rows(log: Log) -> Iterator[Finding]:
    """Rows lost or repeated although the stamps are uniform: reference and position jump by the same whole steps."""
    if log.reference is None:
        return
    jumps, increments, scatter = _relative_jumps(log.reference)
    count = np.round(jumps)
    # the reference must be smooth around, and the jump that of whole steps
    is_whole = (np.abs(jumps - count) < 0.1) & (scatter < 0.1)
    # and both clear of noise and digits: at a creep every increment is a digit, and any two of them make a jump
    is_whole &= np.abs(count * increments) > 5 * max(noise_std(log.reference), noise_std(log.position))
    is_known = np.zeros(len(jumps), bool)
    is_known[[k - 1 for k in log.gaps]] = True
    is_known |= np.diff(log.time) > 1.5 * np.median(np.diff(log.time))  # the stamps show it already
    lost = np.flatnonzero(is_whole & (count >= 1) & ~is_known)
    # and the position must make the same jump: otherwise it is the set-point generator that missed its cycle
    follows = [abs(_jump_between(log.position, int(k)) / (count[k] * increments[k]) - 1) < 0.5 for k in lost]
    lost = lost[np.array(follows, bool)]
    repeated = np.flatnonzero(is_whole & (count == -1) & (np.diff(log.command) == 0) & (np.diff(log.position) == 0))
    for rows, happened in ((lost, "lost"), (repeated, "repeated")):
        if len(rows):
            yield Finding(
                "fatal",
                "time",
                f"{int(np.sum(np.abs(count[rows])))} rows were {happened} at {len(rows)} places although the time "
                f"stamps are uniform, first at t = {log.time[rows[0]]:.6g} s: reference and position jump there by "
                "whole steps",
                "list these places as gaps (repeated rows: drop them), and find out what the logger does",
                "lost rows",
            )
