"""Interleaved timing: every job once in each round, so that a machine that slows down slows all of them alike."""

import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

ROUNDS = 15  # on a shared server the best of fewer scatters by several per cent
MIN_TURN = 0.02  # s: a shorter job is run several times in a turn


class Timing(NamedTuple):
    """Seconds of a job."""

    best: float  # what the job takes where nothing disturbs it
    median: float
    rounds: int


def time_interleaved(jobs: Mapping[str, Callable[[], object]], rounds: int | None = None) -> dict[str, Timing]:
    """Time each job; the first run of each, which may compile, does not count."""
    repeats = {}
    for name, job in jobs.items():
        job()
        repeats[name] = max(1, round(MIN_TURN / max(_seconds(job, 1), 1e-9)))
    rounds = rounds or ROUNDS
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(rounds):
        for name, job in jobs.items():
            seconds[name].append(_seconds(job, repeats[name]))
    return {name: Timing(min(samples), float(np.median(samples)), rounds) for name, samples in seconds.items()}


def _seconds(job: Callable[[], object], repeats: int) -> float:
    start = time.perf_counter()
    for _ in range(repeats):
        job()
    return (time.perf_counter() - start) / repeats
