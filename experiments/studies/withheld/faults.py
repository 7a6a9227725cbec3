"""Faults drawn at random: those of the catalogue, and those that other parameters absorb.

A size of 1 is clearly visible on the paper's axis.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from experiments.studies.withheld.motions import STROKE

LEADS, SCALE_PERIODS, POLES = (3e-3, 1.6e-2), (8e-6, 6e-5), (5e-4, 4e-3)  # m, between which they are drawn

Parameters = Mapping[str, float | tuple[float, float]]  # pairs: one for each log


class InjectedFault(NamedTuple):
    """One effect as it is injected into a machine: changed equations and changed parameters."""

    effect: str  # name of the catalogue, or of what lies outside it
    size: float  # 1: clearly visible
    parameters: dict[str, float | tuple[float, float]]  # pairs: one for each log
    structure: dict[str, bool]
    drive_factors: dict[str, float]  # parameters of the drive by their factors
    random_scales: dict[str, float]  # of signals that are drawn for each log


def fault(
    name: str,
    size: float,
    parameters: Parameters | None = None,
    *,
    structure: dict[str, bool] | None = None,
    drive_factors: dict[str, float] | None = None,
    random_scales: dict[str, float] | None = None,
) -> InjectedFault:
    """A fault; what is not given stays as it is."""
    return InjectedFault(name, size, dict(parameters or {}), structure or {}, drive_factors or {}, random_scales or {})


def log_uniform(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    """A draw that is uniform in the logarithm, between the two ends."""
    return float(np.exp(rng.uniform(*np.log(ends))))


def _phases(rng: np.random.Generator) -> tuple[float, float]:
    """One for each log: homed again."""
    return float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(0, 2 * np.pi))


def _applied_load(rng: np.random.Generator, size: float) -> InjectedFault:
    if rng.random() < 0.4:
        load = 15e3 * size
        return fault("applied_load", size, {"extra_load": load})
    load = 4e3 * size
    start, duration = rng.uniform(1.0, 4.0, 2), rng.uniform(2.0, 4.0, 2)
    parameters: Parameters = {"extra_load": load, "load_start": tuple(start), "load_end": tuple(start + duration)}
    return fault("applied_load", size, parameters)


def _friction_shape(rng: np.random.Generator, size: float) -> InjectedFault:
    which = str(rng.choice(["stribeck_velocity", "stribeck_exponent", "breakaway_gap", "viscous"]))
    share = 0.3 if which == "stribeck_exponent" else 0.15  # of which little shows
    factor = float(np.exp(rng.choice([-1.0, 1.0]) * min(share * size, 0.7)))
    drive_factors = {which: factor} | ({"damping": factor} if which == "viscous" else {})
    return fault("friction_shape", size, drive_factors=drive_factors)


def _friction_asymmetry(rng: np.random.Generator, size: float) -> InjectedFault:
    share = float(rng.choice([-1.0, 1.0]) * 0.08 * size)
    drive_factors = {"coulomb_screw+": 1 + share, "coulomb_screw-": 1 - share}
    return fault("friction_asymmetry", size, drive_factors=drive_factors)


def _position_friction(rng: np.random.Generator, size: float) -> InjectedFault:
    if rng.random() < 0.5:
        slope = float(rng.choice([-1, 1]) * 0.05 * size / STROKE)
        return fault("position_friction", size, {"slope": slope})
    period = float(rng.uniform(0.04, 0.15))
    parameters = {"wave": 0.05 * size, "wave_period": period, "wave_phase": float(rng.uniform(0, 6.28))}
    return fault("position_friction", size, parameters)


def _viscous_drift(rng: np.random.Generator, size: float) -> InjectedFault:
    time = float(rng.uniform(2.0, 6.0))
    parameters = {"drift_viscous": 0.08 * size, "drift_coulomb": 0.01 * size, "drift_time": time}
    return fault("viscous_drift", size, parameters)


def _friction_dwell(rng: np.random.Generator, size: float) -> InjectedFault:
    parameters = {
        "growth": 0.2 * size,
        "onset": float(rng.uniform(0.05, 0.15)),
        "slip": float(rng.uniform(5e-6, 15e-6)),
    }
    return fault("friction_dwell", size, parameters)


def _presliding(rng: np.random.Generator, size: float) -> InjectedFault:
    longest = float(np.clip(4e-6 * size, 2e-6, 1.2e-5))
    return fault("presliding_hysteresis", size, {"longest": longest}, structure={"maxwell": True})


def _payload_mass(rng: np.random.Generator, size: float) -> InjectedFault:
    return fault("payload_mass", size, drive_factors={"mass": 1 + 0.12 * size})


def _constant_force(rng: np.random.Generator, size: float) -> InjectedFault:
    force = float(rng.choice([-1, 1]) * 3.0 * size)
    return fault("constant_force", size, {"constant": force})


def _position_spring(rng: np.random.Generator, size: float) -> InjectedFault:
    parameters = {"spring": 80.0 * size, "neutral": float(rng.uniform(-0.02, 0.02))}
    return fault("position_spring", size, parameters)


def _elastic(rng: np.random.Generator, frequency: float, damping: float) -> dict[str, float]:
    share = float(rng.uniform(0.25, 0.5))
    stiffness = share * (1 - share) * 100.0 * (2 * np.pi * frequency) ** 2
    return {
        "stiffness": float(stiffness),
        "screw_damping": damping,
        "motor_share": share,
        "table_friction": float(rng.uniform(0.3, 0.7)),
    }


def _compliance(rng: np.random.Generator, size: float) -> InjectedFault:
    frequency = float(np.clip(log_uniform(rng, (200.0, 312.5)) / np.sqrt(size), 100.0, 500.0))
    parameters = _elastic(rng, frequency, log_uniform(rng, (0.015, 0.08)))
    return fault("compliance", size, parameters, structure={"elastic": True})


def _backlash(rng: np.random.Generator, size: float) -> InjectedFault:
    gap = max(2.5e-6 * size * log_uniform(rng, (1.0, 4.0)), 8e-7)  # up to 40 um: a worn screw
    parameters = _elastic(rng, log_uniform(rng, (250.0, 700.0)), log_uniform(rng, (0.04, 0.15))) | {"gap": gap}
    return fault("backlash", size, parameters, structure={"elastic": True})


def _frame_vibration(rng: np.random.Generator, size: float) -> InjectedFault:
    parameters = {
        "base_ratio": 0.015 * size,
        "base_frequency": log_uniform(rng, (10.0, 60.0)),
        "base_damping": log_uniform(rng, (0.015, 0.08)),
    }
    return fault("frame_vibration", size, parameters)


def _process_force(rng: np.random.Generator, size: float) -> InjectedFault:
    start, duration = rng.uniform(0.5, 3.0, 2), rng.uniform(3.0, 5.0, 2)
    parameters: Parameters = {
        "process": 1.2 * size,
        "process_mean": float(rng.uniform(0, 0.6) * size),
        "process_frequency": float(rng.uniform(30, 180)),
        "process_phase": _phases(rng),
        "process_start": tuple(start),
        "process_end": tuple(start + duration),
    }
    return fault("process_force", size, parameters)


def _cogging(rng: np.random.Generator, size: float) -> InjectedFault:
    parameters = {
        "cogging": 1.2 * size,
        "cogging_period": log_uniform(rng, POLES),
        "cogging_phase": float(rng.uniform(0, 6.28)),
        "second": float(rng.uniform(0, 0.2)),
        "sixth": float(rng.uniform(0, 0.3)),
    }
    return fault("cogging", size, parameters)


def _force_gain(rng: np.random.Generator, size: float) -> InjectedFault:
    gain = float(rng.choice([-1, 1]) * min(0.06 * size, 0.3))
    return fault("force_gain", size, {"gain": gain})


def _actuator_lag(rng: np.random.Generator, size: float) -> InjectedFault:
    lag = 3e-4 * size
    return fault("actuator_lag", size, {"lag": lag}, structure={"lagging": True})


def _loop_delay(rng: np.random.Generator, size: float) -> InjectedFault:
    delay = float(np.clip(0.4 * size, 0.15, 2.0))
    return fault("loop_delay", size, {"delay": delay})


def _force_limit(rng: np.random.Generator, size: float) -> InjectedFault:
    return fault("force_limit", size, {"limit": -min(0.04 * size, 0.2)})


def _lead_error(rng: np.random.Generator, size: float) -> InjectedFault:
    parameters: Parameters = {
        "lead_error": 2e-6 * size,
        "lead": log_uniform(rng, LEADS),
        "lead_phase": _phases(rng),
        "linear": float(rng.normal(0, 2e-5)),
    }
    return fault("lead_error", size, parameters)


def _interpolation_error(rng: np.random.Generator, size: float) -> InjectedFault:
    parameters: Parameters = {
        "interpolation": 1.5e-7 * size,
        "interpolation_period": log_uniform(rng, SCALE_PERIODS),
        "interpolation_phase": _phases(rng),
    }
    return fault("interpolation_error", size, parameters)


def _swallowed_frame(rng: np.random.Generator, size: float) -> InjectedFault:
    """Above the loop's bandwidth and well damped: it looks like a softer bristle and some delay."""
    parameters = {
        "base_ratio": 0.04 * size,
        "base_frequency": float(rng.uniform(60, 150)),
        "base_damping": float(rng.uniform(0.1, 0.3)),
    }
    return fault("frame_vibration", size, parameters)


def _swallowed_screw(rng: np.random.Generator, size: float) -> InjectedFault:
    """Stiff and well damped: it looks like some delay, and a softer bristle."""
    frequency = float(np.clip(450.0 / np.sqrt(size), 200.0, 600.0))
    parameters = _elastic(rng, frequency, float(rng.uniform(0.15, 0.3)))
    return fault("compliance", size, parameters, structure={"elastic": True})


KNOWN: dict[str, Callable[[np.random.Generator, float], InjectedFault]] = {
    "applied_load": _applied_load,
    "friction_shape": _friction_shape,
    "friction_asymmetry": _friction_asymmetry,
    "position_friction": _position_friction,
    "viscous_drift": _viscous_drift,
    "friction_dwell": _friction_dwell,
    "presliding_hysteresis": _presliding,
    "payload_mass": _payload_mass,
    "constant_force": _constant_force,
    "position_spring": _position_spring,
    "compliance": _compliance,
    "backlash": _backlash,
    "frame_vibration": _frame_vibration,
    "process_force": _process_force,
    "cogging": _cogging,
    "force_gain": _force_gain,
    "actuator_lag": _actuator_lag,
    "loop_delay": _loop_delay,
    "force_limit": _force_limit,
    "lead_error": _lead_error,
    "interpolation_error": _interpolation_error,
}
PITFALLS: dict[str, Callable[[np.random.Generator, float], InjectedFault]] = {
    "swallowed_frame": _swallowed_frame,
    "swallowed_screw": _swallowed_screw,
}
