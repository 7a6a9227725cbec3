"""Faults from outside the catalogue, drawn at random: the right answer to them is `unknown`.

A size of 1 is clearly visible on the paper's axis.
"""

from collections.abc import Callable

import numpy as np

from experiments.studies.withheld.faults import POLES, InjectedFault, Parameters, fault, log_uniform
from experiments.studies.withheld.motions import MAX_DURATION, STROKE


def _chip(rng: np.random.Generator, size: float) -> InjectedFault:
    parameters: Parameters = {
        "chip": 3.0 * size,
        "chip_place": tuple(rng.uniform(-0.5 * STROKE, 0.5 * STROKE, 2)),
        "chip_width": float(rng.uniform(2e-3, 8e-3)),
        "chip_start": tuple(rng.uniform(2.0, 4.0, 2)),
    }
    return fault("chip", size, parameters)


def _dent(rng: np.random.Generator, size: float) -> InjectedFault:
    """A rail's: at one spot from the first to the last, as deep in either log."""
    share, width = float(rng.uniform(0.2, 0.8)), float(rng.uniform(1e-3, 4e-3))
    return fault("dent", size, {"chip": 3.0 * size, "chip_place": share, "chip_width": width})


def _dead_time(rng: np.random.Generator, size: float) -> InjectedFault:
    return fault("dead_time", size, {"dead": 5.0 * size})


def _fading_magnets(rng: np.random.Generator, size: float) -> InjectedFault:
    return fault("fading_magnets", size, {"fading": 0.06 * size, "fading_time": float(rng.uniform(2.0, 6.0))})


def _bumper(rng: np.random.Generator, size: float) -> InjectedFault:
    """A cover that folds up near one end of the stroke."""
    return fault("bumper", size, {"bumper": 500.0 * size, "bumper_place": float(rng.uniform(0.5, 0.8))})


def _droop(rng: np.random.Generator, size: float) -> InjectedFault:
    return fault("droop", size, {"droop": min(0.1 * size, 0.4), "droop_force": 300.0})


def _shocks(rng: np.random.Generator, size: float) -> InjectedFault:
    return fault("shocks", size, random_scales={"peak": 10.0 * size})


def _wandering(rng: np.random.Generator, size: float) -> InjectedFault:
    return fault("wandering_friction", size, random_scales={"share": 0.03 * size})


def _run_up(rng: np.random.Generator, size: float) -> InjectedFault:
    """A spindle out of balance, whose force grows with the square of its speed as long as the log lasts."""
    fastest = float(rng.uniform(60.0, 180.0))
    parameters: Parameters = {
        "spin": 6.0 * size,
        "spin_start": tuple(rng.uniform(0.2, 1.0, 2)),
        "spin_rise": fastest / MAX_DURATION,
        "spin_fastest": fastest,
    }
    return fault("run_up", size, parameters)


def _coarse_command(rng: np.random.Generator, size: float) -> InjectedFault:
    """A command that the power stage takes in counts."""
    return fault("coarse_command", size, {"step": 4.0 * size})


def _dropouts(rng: np.random.Generator, size: float) -> InjectedFault:
    """A power stage that lets go for some milliseconds."""
    return fault("dropouts", size, random_scales={"cut": 2e-3 * size})


def _frictional_lag(rng: np.random.Generator, size: float) -> InjectedFault:
    """A Stribeck curve that the film of oil follows late (Hess and Soom 1990)."""
    return fault("frictional_lag", size, {"film_time": 6e-3 * size})


def _clock_jitter(rng: np.random.Generator, size: float) -> InjectedFault:
    return fault("clock_jitter", size, random_scales={"lateness": 4e-6 * size})


def _commutation(rng: np.random.Generator, size: float) -> InjectedFault:
    """A force constant that comes and goes along the motor: of cogging it is told by the command."""
    parameters = {
        "commutation": min(0.04 * size, 0.3),
        "commutation_period": log_uniform(rng, POLES),
        "commutation_phase": float(rng.uniform(0, 6.28)),
    }
    return fault("commutation", size, parameters)


def _cable_chain(rng: np.random.Generator, size: float) -> InjectedFault:
    """It takes millimetres to be bent the other way."""
    return fault("cable_chain", size, {"chain": 3.0 * size, "chain_length": float(rng.uniform(2e-3, 8e-3))})


def _windage(rng: np.random.Generator, size: float) -> InjectedFault:
    return fault("windage", size, {"windage": 6.0 * size / 0.09**2})


def _lubrication(rng: np.random.Generator, size: float) -> InjectedFault:
    return fault("lubrication", size, random_scales={"oil": 0.06 * size})


def _neighbour(rng: np.random.Generator, size: float) -> InjectedFault:
    """Another axis that starts and stops."""
    return fault("neighbour", size, random_scales={"pulse": 3.0 * size})


# outside the catalogue, and in no study while the engine was shaped
UNSEEN: dict[str, Callable[[np.random.Generator, float], InjectedFault]] = {
    "run_up": _run_up,
    "coarse_command": _coarse_command,
    "dropouts": _dropouts,
    "frictional_lag": _frictional_lag,
    "clock_jitter": _clock_jitter,
    "commutation": _commutation,
    "cable_chain": _cable_chain,
    "windage": _windage,
    "lubrication": _lubrication,
    "neighbour": _neighbour,
}
OUTSIDE: dict[str, Callable[[np.random.Generator, float], InjectedFault]] = {
    "chip": _chip,
    "droop": _droop,
    "shocks": _shocks,
    "wandering_friction": _wandering,
    "dent": _dent,
    "dead_time": _dead_time,
    "fading_magnets": _fading_magnets,
    "bumper": _bumper,
    **UNSEEN,
}
PLACED = {"dent": "chip_place", "bumper": "bumper_place"}  # drawn as shares of the stroke, so that the table gets there
