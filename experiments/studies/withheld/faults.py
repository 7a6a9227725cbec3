"""Faults drawn at random: those of the catalogue, those from outside it, and those that other parameters absorb.

A size of one is what should be clear on the paper's axis.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from experiments.studies.withheld.motions import ROOM, STROKE

LEADS, SCALE_PERIODS, POLES = (3e-3, 1.6e-2), (8e-6, 6e-5), (5e-4, 4e-3)  # m, between which they are drawn


class InjectedFault(NamedTuple):
    """One effect as it was done to a machine: changed equations and changed parameters."""

    effect: str  # name of the catalogue, or of what lies outside it
    size: float  # against what is clear
    parameters: dict[str, float | tuple[float, float]]  # pairs: one for each log
    structure: dict[str, bool]
    drive_factors: dict[str, float]  # parameters of the drive by their factors
    random_scales: dict[str, float]  # of what acts as a trace drawn for each log: its scale


def _fault(name: str, size: float, faults: dict[str, Any] | None = None, **rest: Any) -> InjectedFault:
    return InjectedFault(name, size, faults or {}, rest.get("kind", {}), rest.get("scaled", {}), rest.get("traces", {}))


def log_uniform(room: ROOM, ends: tuple[float, float]) -> float:
    """Anywhere between the two, by the logarithm."""
    return float(np.exp(room.uniform(*np.log(ends))))


def _phases(room: ROOM) -> tuple[float, float]:
    """One for each log: homed anew."""
    return float(room.uniform(0, 2 * np.pi)), float(room.uniform(0, 2 * np.pi))


def _applied_load(room: ROOM, size: float) -> InjectedFault:
    if room.random() < 0.4:
        load = 15e3 * size
        return _fault("applied_load", size, {"extra_load": load})
    load = 4e3 * size
    start, long = room.uniform(1.0, 4.0, 2), room.uniform(2.0, 4.0, 2)
    given = {"extra_load": load, "load_start": tuple(start), "load_end": tuple(start + long)}
    return _fault("applied_load", size, given)


def _friction_shape(room: ROOM, size: float) -> InjectedFault:
    which = room.choice(["stribeck_velocity", "stribeck_exponent", "breakaway_gap", "viscous"])
    share = 0.3 if which == "stribeck_exponent" else 0.15  # of which little shows
    way = float(np.exp(room.choice([-1.0, 1.0]) * min(share * size, 0.7)))
    scaled = {which: way} | ({"damping": way} if which == "viscous" else {})
    return _fault("friction_shape", size, scaled=scaled)


def _friction_asymmetry(room: ROOM, size: float) -> InjectedFault:
    share = float(room.choice([-1.0, 1.0]) * 0.08 * size)
    scaled = {"coulomb_screw+": 1 + share, "coulomb_screw-": 1 - share}
    return _fault("friction_asymmetry", size, scaled=scaled)


def _position_friction(room: ROOM, size: float) -> InjectedFault:
    if room.random() < 0.5:
        slope = float(room.choice([-1, 1]) * 0.05 * size / STROKE)
        return _fault("position_friction", size, {"slope": slope})
    period = float(room.uniform(0.04, 0.15))
    given = {"wave": 0.05 * size, "wave_period": period, "wave_phase": float(room.uniform(0, 6.28))}
    return _fault("position_friction", size, given)


def _viscous_drift(room: ROOM, size: float) -> InjectedFault:
    time = float(room.uniform(2.0, 6.0))
    given = {"drift_viscous": 0.08 * size, "drift_coulomb": 0.01 * size, "drift_time": time}
    return _fault("viscous_drift", size, given)


def _friction_dwell(room: ROOM, size: float) -> InjectedFault:
    given = {"growth": 0.2 * size, "onset": float(room.uniform(0.05, 0.15)), "slip": float(room.uniform(5e-6, 15e-6))}
    return _fault("friction_dwell", size, given)


def _presliding(room: ROOM, size: float) -> InjectedFault:
    longest = float(np.clip(4e-6 * size, 2e-6, 1.2e-5))
    return _fault("presliding_hysteresis", size, {"longest": longest}, kind={"maxwell": True})


def _payload_mass(room: ROOM, size: float) -> InjectedFault:
    return _fault("payload_mass", size, scaled={"mass": 1 + 0.12 * size})


def _constant_force(room: ROOM, size: float) -> InjectedFault:
    force = float(room.choice([-1, 1]) * 3.0 * size)
    return _fault("constant_force", size, {"constant": force})


def _position_spring(room: ROOM, size: float) -> InjectedFault:
    given = {"spring": 80.0 * size, "neutral": float(room.uniform(-0.02, 0.02))}
    return _fault("position_spring", size, given)


def _elastic(room: ROOM, frequency: float, damping: float) -> dict[str, float]:
    share = float(room.uniform(0.25, 0.5))
    stiffness = share * (1 - share) * 100.0 * (2 * np.pi * frequency) ** 2
    return {
        "stiffness": float(stiffness),
        "screw_damping": damping,
        "motor_share": share,
        "table_friction": float(room.uniform(0.3, 0.7)),
    }


def _compliance(room: ROOM, size: float) -> InjectedFault:
    frequency = float(np.clip(log_uniform(room, (200.0, 312.5)) / np.sqrt(size), 100.0, 500.0))
    given = _elastic(room, frequency, log_uniform(room, (0.015, 0.08)))
    return _fault("compliance", size, given, kind={"elastic": True})


def _backlash(room: ROOM, size: float) -> InjectedFault:
    gap = max(2.5e-6 * size * log_uniform(room, (1.0, 4.0)), 8e-7)  # up to 40 um: a worn screw
    given = _elastic(room, log_uniform(room, (250.0, 700.0)), log_uniform(room, (0.04, 0.15))) | {"gap": gap}
    return _fault("backlash", size, given, kind={"elastic": True})


def _frame_vibration(room: ROOM, size: float) -> InjectedFault:
    given = {
        "base_ratio": 0.015 * size,
        "base_frequency": log_uniform(room, (10.0, 60.0)),
        "base_damping": log_uniform(room, (0.015, 0.08)),
    }
    return _fault("frame_vibration", size, given)


def _process_force(room: ROOM, size: float) -> InjectedFault:
    start, long = room.uniform(0.5, 3.0, 2), room.uniform(3.0, 5.0, 2)
    given = {
        "process": 1.2 * size,
        "process_mean": float(room.uniform(0, 0.6) * size),
        "process_frequency": float(room.uniform(30, 180)),
        "process_phase": _phases(room),
        "process_start": tuple(start),
        "process_end": tuple(start + long),
    }
    return _fault("process_force", size, given)


def _cogging(room: ROOM, size: float) -> InjectedFault:
    given = {
        "cogging": 1.2 * size,
        "cogging_period": log_uniform(room, POLES),
        "cogging_phase": float(room.uniform(0, 6.28)),
        "second": float(room.uniform(0, 0.2)),
        "sixth": float(room.uniform(0, 0.3)),
    }
    return _fault("cogging", size, given)


def _force_gain(room: ROOM, size: float) -> InjectedFault:
    gain = float(room.choice([-1, 1]) * min(0.06 * size, 0.3))
    return _fault("force_gain", size, {"gain": gain})


def _actuator_lag(room: ROOM, size: float) -> InjectedFault:
    lag = 3e-4 * size
    return _fault("actuator_lag", size, {"lag": lag}, kind={"lagging": True})


def _loop_delay(room: ROOM, size: float) -> InjectedFault:
    delay = float(np.clip(0.4 * size, 0.15, 2.0))
    return _fault("loop_delay", size, {"delay": delay})


def _force_limit(room: ROOM, size: float) -> InjectedFault:
    return _fault("force_limit", size, {"limit": -min(0.04 * size, 0.2)})


def _lead_error(room: ROOM, size: float) -> InjectedFault:
    given = {
        "lead_error": 2e-6 * size,
        "lead": log_uniform(room, LEADS),
        "lead_phase": _phases(room),
        "linear": float(room.normal(0, 2e-5)),
    }
    return _fault("lead_error", size, given)


def _interpolation_error(room: ROOM, size: float) -> InjectedFault:
    given = {
        "interpolation": 1.5e-7 * size,
        "interpolation_period": log_uniform(room, SCALE_PERIODS),
        "interpolation_phase": _phases(room),
    }
    return _fault("interpolation_error", size, given)


def _chip(room: ROOM, size: float) -> InjectedFault:
    given = {
        "chip": 3.0 * size,
        "chip_place": tuple(room.uniform(-0.5 * STROKE, 0.5 * STROKE, 2)),
        "chip_width": float(room.uniform(2e-3, 8e-3)),
        "chip_start": tuple(room.uniform(2.0, 4.0, 2)),
    }
    return _fault("chip", size, given)


def _dent(room: ROOM, size: float) -> InjectedFault:
    """A rail's: at one spot from the first to the last, as deep in either log."""
    share, width = float(room.uniform(0.2, 0.8)), float(room.uniform(1e-3, 4e-3))
    return _fault("dent", size, {"chip": 3.0 * size, "chip_place": share, "chip_width": width})


def _dead_time(room: ROOM, size: float) -> InjectedFault:
    return _fault("dead_time", size, {"dead": 5.0 * size})


def _fading_magnets(room: ROOM, size: float) -> InjectedFault:
    return _fault("fading_magnets", size, {"fading": 0.06 * size, "fading_time": float(room.uniform(2.0, 6.0))})


def _bumper(room: ROOM, size: float) -> InjectedFault:
    """A cover that folds up near one end of the stroke."""
    return _fault("bumper", size, {"bumper": 500.0 * size, "bumper_place": float(room.uniform(0.5, 0.8))})


def _droop(room: ROOM, size: float) -> InjectedFault:
    return _fault("droop", size, {"droop": min(0.1 * size, 0.4), "droop_force": 300.0})


def _shocks(room: ROOM, size: float) -> InjectedFault:
    return _fault("shocks", size, traces={"peak": 10.0 * size})


def _wandering(room: ROOM, size: float) -> InjectedFault:
    return _fault("wandering_friction", size, traces={"share": 0.03 * size})


def _swallowed_frame(room: ROOM, size: float) -> InjectedFault:
    """Above the loop's bandwidth and well damped: it looks like a softer bristle and some delay."""
    given = {
        "base_ratio": 0.04 * size,
        "base_frequency": float(room.uniform(60, 150)),
        "base_damping": float(room.uniform(0.1, 0.3)),
    }
    return _fault("frame_vibration", size, given)


def _swallowed_screw(room: ROOM, size: float) -> InjectedFault:
    """Stiff and well damped: it looks like some delay, and a softer bristle."""
    frequency = float(np.clip(450.0 / np.sqrt(size), 200.0, 600.0))
    given = _elastic(room, frequency, float(room.uniform(0.15, 0.3)))
    return _fault("compliance", size, given, kind={"elastic": True})


KNOWN: dict[str, Callable[[ROOM, float], InjectedFault]] = {
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
OUTSIDE: dict[str, Callable[[ROOM, float], InjectedFault]] = {
    "chip": _chip,
    "droop": _droop,
    "shocks": _shocks,
    "wandering_friction": _wandering,
    "dent": _dent,
    "dead_time": _dead_time,
    "fading_magnets": _fading_magnets,
    "bumper": _bumper,
}
PLACED = {"dent": "chip_place", "bumper": "bumper_place"}  # drawn as shares of the way, so that the table comes there
PITFALLS: dict[str, Callable[[ROOM, float], InjectedFault]] = {
    "swallowed_frame": _swallowed_frame,
    "swallowed_screw": _swallowed_screw,
}
