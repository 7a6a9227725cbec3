"""The stretches of logs that can be filtered without phase: no gap within, long enough, sampled fast enough, finite."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive.errors import LogError
from diffdrive.logs import Log

Signal = Float[np.ndarray, " n"]


class Stretch(NamedTuple):
    """One piece of a log, as sampled: arrays of shape [n]. `force` is command + disturbance."""

    log: str
    rate: float  # Hz
    time: Signal  # s
    position: Signal  # m
    force: Signal  # N
    load: Signal  # N; zero where the log has none
    border: int  # samples at an end that the filters spoil


def stretches(logs: Log | Sequence[Log], dynamics: float) -> tuple[list[Stretch], tuple[str, ...]]:
    """The stretches that allow filters for motion up to `dynamics` (Hz), and a note on each piece that does not.

    Raises `LogError` where a log is sampled too slowly or is not finite, and where no piece is long enough.
    """
    logs = [logs] if isinstance(logs, Log) else list(logs)
    if not logs:
        raise LogError("no log is given: give at least one")
    if not (np.isfinite(dynamics) and dynamics > 0):
        raise LogError(f"dynamics must be a frequency above 0 Hz, got {dynamics!r}")
    loaded = any(log.load is not None for log in logs)
    found, notes = [], []
    for log in logs:
        if log.load is None and loaded:
            notes.append(f"{log.name}: has no load signal, though others have: taken as no applied load")
        rate = log.rate if len(log.time) > 1 else np.inf
        if rate < 11 * dynamics:  # the position's filter, at 5 x dynamics, must lie well within the band
            raise LogError(
                f"{log.name}: sampled at {rate:.6g} Hz, too slowly for dynamics of {dynamics:g} Hz, which needs "
                f"{11 * dynamics:.4g} Hz: give dynamics of at most {rate / 11.02:.4g} Hz"
            )
        for piece in log.pieces():
            shortest = 4.0 / dynamics  # twice the border and the filters' padding, and as much to learn something from
            seconds = (piece.stop - piece.start) / rate
            if seconds >= shortest:
                found.append(_stretch(log, piece, round(0.98 * rate / dynamics)))  # the benchmark's 49 at 1 kHz
                continue
            where = f" from {log.time[piece.start]:.4g} s" if seconds > 0 else ""
            notes.append(
                f"{log.name}: the piece{where} is too short: {seconds:.3g} s; the filters need {shortest:.3g} s at "
                f"dynamics of {dynamics:g} Hz"
            )
    if not found:
        raise LogError("; ".join(notes))
    return found, tuple(notes)


def _stretch(log: Log, piece: slice, border: int) -> Stretch:
    force = log.command[piece] + (0.0 if log.disturbance is None else log.disturbance[piece])
    load = np.zeros_like(force) if log.load is None else np.asarray(log.load[piece], dtype=float)
    position = np.asarray(log.position[piece], dtype=float)
    for name, signal in (("position", position), ("command + disturbance", force), ("load", load)):
        if not np.all(np.isfinite(signal)):
            time = log.time[piece][np.flatnonzero(~np.isfinite(signal))[0]]
            raise LogError(f"{log.name}: {name} is not finite at {time:.6g} s: mark a gap there")
    return Stretch(log.name, log.rate, log.time[piece], position, force, load, border)
