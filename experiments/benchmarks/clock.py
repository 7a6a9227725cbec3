"""Timing by turns: every job once in each round, so that a machine that slows down slows all of them alike."""

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

ROUNDS = 15  # the best of fewer still scatters by several percent on a server that others use, too
LEAST = 0.02  # s: a shorter job is run several times in a turn


class Timing(NamedTuple):
    """Seconds of a job."""

    best: float  # what the job takes where nothing disturbs it
    median: float
    rounds: int


def by_turns(jobs: Mapping[str, Callable[[], Any]], rounds: int | None = None) -> dict[str, Timing]:
    """Time each job; the first run of each, which may compile, does not count."""
    repeats = {}
    for name, job in jobs.items():
        job()
        repeats[name] = max(1, round(LEAST / max(_seconds(job, 1), 1e-9)))
    rounds = rounds or ROUNDS
    told: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(rounds):
        for name, job in jobs.items():
            told[name].append(_seconds(job, repeats[name]))
    return {name: Timing(min(all_of), float(np.median(all_of)), rounds) for name, all_of in told.items()}


def _seconds(job: Callable[[], Any], repeats: int) -> float:
    began = time.perf_counter()
    for _ in range(repeats):
        job()
    return (time.perf_counter() - began) / repeats
