"""Faults drawn at random: those of the catalogue, those from outside it, and those that other parameters absorb.

A size of one is what should be clear on the paper's axis.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from experiments.studies.withheld.motions import ROOM, STROKE

LEADS, SCALE_PERIODS, POLES = (3e-3, 1.6e-2), (8e-6, 6e-5), (5e-4, 4e-3)  # m, between which they are drawn


class Fault(NamedTuple):
    """One effect as it was done to a machine: changed equations and changed parameters."""

    effect: str  # name of the catalogue, or of what lies outside it
    size: float  # against what is clear
    faults: dict[str, float | tuple[float, float]]  # pairs: one for each log
    kind: dict[str, bool]
    scaled: dict[str, float]  # parameters of the drive by their factors
    traces: dict[str, float]  # of what acts as a trace drawn for each log: its scale


def _one(name: str, size: float, faults: dict[str, Any] | None = None, **rest: Any) -> Fault:
    return Fault(name, size, faults or {}, rest.get("kind", {}), rest.get("scaled", {}), rest.get("traces", {}))


def between(room: ROOM, ends: tuple[float, float]) -> float:
    """Anywhere between the two, by the logarithm."""
    return float(np.exp(room.uniform(*np.log(ends))))


def _phases(room: ROOM) -> tuple[float, float]:
    """One for each log: homed anew."""
    return float(room.uniform(0, 2 * np.pi)), float(room.uniform(0, 2 * np.pi))


def _applied_load(room: ROOM, size: float) -> Fault:
    if room.random() < 0.4:
        load = 15e3 * size
        return _one("applied_load", size, {"extra_load": load})
    load = 4e3 * size
    start, long = room.uniform(1.0, 4.0, 2), room.uniform(2.0, 4.0, 2)
    given = {"extra_load": load, "load_start": tuple(start), "load_end": tuple(start + long)}
    return _one("applied_load", size, given)


def _friction_shape(room: ROOM, size: float) -> Fault:
    which = room.choice(["stribeck_velocity", "stribeck_exponent", "breakaway_gap", "viscous"])
    share = 0.3 if which == "stribeck_exponent" else 0.15  # of which little shows
    way = float(np.exp(room.choice([-1.0, 1.0]) * min(share * size, 0.7)))
    scaled = {which: way} | ({"damping": way} if which == "viscous" else {})
    return _one("friction_shape", size, scaled=scaled)


def _friction_asymmetry(room: ROOM, size: float) -> Fault:
    share = float(room.choice([-1.0, 1.0]) * 0.08 * size)
    scaled = {"coulomb_screw+": 1 + share, "coulomb_screw-": 1 - share}
    return _one("friction_asymmetry", size, scaled=scaled)


def _position_friction(room: ROOM, size: float) -> Fault:
    if room.random() < 0.5:
        slope = float(room.choice([-1, 1]) * 0.05 * size / STROKE)
        return _one("position_friction", size, {"slope": slope})
    period = float(room.uniform(0.04, 0.15))
    given = {"wave": 0.05 * size, "wave_period": period, "wave_phase": float(room.uniform(0, 6.28))}
    return _one("position_friction", size, given)


def _viscous_drift(room: ROOM, size: float) -> Fault:
    time = float(room.uniform(2.0, 6.0))
    given = {"drift_viscous": 0.08 * size, "drift_coulomb": 0.01 * size, "drift_time": time}
    return _one("viscous_drift", size, given)


def _friction_dwell(room: ROOM, size: float) -> Fault:
    given = {"growth": 0.2 * size, "onset": float(room.uniform(0.05, 0.15)), "slip": float(room.uniform(5e-6, 15e-6))}
    return _one("friction_dwell", size, given)


def _presliding(room: ROOM, size: float) -> Fault:
    longest = float(np.clip(4e-6 * size, 2e-6, 1.2e-5))
    return _one("presliding_hysteresis", size, {"longest": longest}, kind={"maxwell": True})


def _payload_mass(room: ROOM, size: float) -> Fault:
    return _one("payload_mass", size, scaled={"mass": 1 + 0.12 * size})


def _constant_force(room: ROOM, size: float) -> Fault:
    force = float(room.choice([-1, 1]) * 3.0 * size)
    return _one("constant_force", size, {"constant": force})


def _position_spring(room: ROOM, size: float) -> Fault:
    given = {"spring": 80.0 * size, "neutral": float(room.uniform(-0.02, 0.02))}
    return _one("position_spring", size, given)


def _elastic(room: ROOM, frequency: float, damping: float) -> dict[str, float]:
    share = float(room.uniform(0.25, 0.5))
    stiffness = share * (1 - share) * 100.0 * (2 * np.pi * frequency) ** 2
    return {
        "stiffness": float(stiffness),
        "screw_damping": damping,
        "motor_share": share,
        "table_friction": float(room.uniform(0.3, 0.7)),
    }


def _compliance(room: ROOM, size: float) -> Fault:
    frequency = float(np.clip(between(room, (200.0, 312.5)) / np.sqrt(size), 100.0, 500.0))
    given = _elastic(room, frequency, between(room, (0.015, 0.08)))
    return _one("compliance", size, given, kind={"elastic": True})


def _backlash(room: ROOM, size: float) -> Fault:
    gap = max(2.5e-6 * size * between(room, (1.0, 4.0)), 8e-7)  # up to 40 um: a worn screw
    given = _elastic(room, between(room, (250.0, 700.0)), between(room, (0.04, 0.15))) | {"gap": gap}
    return _one("backlash", size, given, kind={"elastic": True})


def _frame_vibration(room: ROOM, size: float) -> Fault:
    given = {
        "base_ratio": 0.015 * size,
        "base_frequency": between(room, (10.0, 60.0)),
        "base_damping": between(room, (0.015, 0.08)),
    }
    return _one("frame_vibration", size, given)


def _process_force(room: ROOM, size: float) -> Fault:
    start, long = room.uniform(0.5, 3.0, 2), room.uniform(3.0, 5.0, 2)
    given = {
        "process": 1.2 * size,
        "process_mean": float(room.uniform(0, 0.6) * size),
        "process_frequency": float(room.uniform(30, 180)),
        "process_phase": _phases(room),
        "process_start": tuple(start),
        "process_end": tuple(start + long),
    }
    return _one("process_force", size, given)


def _cogging(room: ROOM, size: float) -> Fault:
    given = {
        "cogging": 1.2 * size,
        "cogging_period": between(room, POLES),
        "cogging_phase": float(room.uniform(0, 6.28)),
        "second": float(room.uniform(0, 0.2)),
        "sixth": float(room.uniform(0, 0.3)),
    }
    return _one("cogging", size, given)


def _force_gain(room: ROOM, size: float) -> Fault:
    gain = float(room.choice([-1, 1]) * min(0.06 * size, 0.3))
    return _one("force_gain", size, {"gain": gain})


def _actuator_lag(room: ROOM, size: float) -> Fault:
    lag = 3e-4 * size
    return _one("actuator_lag", size, {"lag": lag}, kind={"lagging": True})


def _loop_delay(room: ROOM, size: float) -> Fault:
    delay = float(np.clip(0.4 * size, 0.15, 2.0))
    return _one("loop_delay", size, {"delay": delay})


def _force_limit(room: ROOM, size: float) -> Fault:
    return _one("force_limit", size, {"limit": -min(0.04 * size, 0.2)})


def _lead_error(room: ROOM, size: float) -> Fault:
    given = {
        "lead_error": 2e-6 * size,
        "lead": between(room, LEADS),
        "lead_phase": _phases(room),
        "linear": float(room.normal(0, 2e-5)),
    }
    return _one("lead_error", size, given)


def _interpolation_error(room: ROOM, size: float) -> Fault:
    given = {
        "interpolation": 1.5e-7 * size,
        "interpolation_period": between(room, SCALE_PERIODS),
        "interpolation_phase": _phases(room),
    }
    return _one("interpolation_error", size, given)


def _chip(room: ROOM, size: float) -> Fault:
    given = {
        "chip": 3.0 * size,
        "chip_place": tuple(room.uniform(-0.5 * STROKE, 0.5 * STROKE, 2)),
        "chip_width": float(room.uniform(2e-3, 8e-3)),
        "chip_start": tuple(room.uniform(2.0, 4.0, 2)),
    }
    return _one("chip", size, given)


def _dent(room: ROOM, size: float) -> Fault:
    """A rail's: at one spot from the first to the last, as deep in either log."""
    share, width = float(room.uniform(0.2, 0.8)), float(room.uniform(1e-3, 4e-3))
    return _one("dent", size, {"chip": 3.0 * size, "chip_place": share, "chip_width": width})


def _dead_time(room: ROOM, size: float) -> Fault:
    return _one("dead_time", size, {"dead": 5.0 * size})


def _fading_magnets(room: ROOM, size: float) -> Fault:
    return _one("fading_magnets", size, {"fading": 0.06 * size, "fading_time": float(room.uniform(2.0, 6.0))})


def _bumper(room: ROOM, size: float) -> Fault:
    """A cover that folds up near one end of the stroke."""
    return _one("bumper", size, {"bumper": 500.0 * size, "bumper_place": float(room.uniform(0.5, 0.8))})


def _droop(room: ROOM, size: float) -> Fault:
    return _one("droop", size, {"droop": min(0.1 * size, 0.4), "droop_force": 300.0})


def _shocks(room: ROOM, size: float) -> Fault:
    return _one("shocks", size, traces={"peak": 10.0 * size})


def _wandering(room: ROOM, size: float) -> Fault:
    return _one("wandering_friction", size, traces={"share": 0.03 * size})


def _swallowed_frame(room: ROOM, size: float) -> Fault:
    """Above the loop's bandwidth and well damped: it looks like a softer bristle and some delay."""
    given = {
        "base_ratio": 0.04 * size,
        "base_frequency": float(room.uniform(60, 150)),
        "base_damping": float(room.uniform(0.1, 0.3)),
    }
    return _one("frame_vibration", size, given)


def _swallowed_screw(room: ROOM, size: float) -> Fault:
    """Stiff and well damped: it looks like some delay, and a softer bristle."""
    frequency = float(np.clip(450.0 / np.sqrt(size), 200.0, 600.0))
    given = _elastic(room, frequency, float(room.uniform(0.15, 0.3)))
    return _one("compliance", size, given, kind={"elastic": True})


KNOWN: dict[str, Callable[[ROOM, float], Fault]] = {
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
OUTSIDE: dict[str, Callable[[ROOM, float], Fault]] = {
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
PITFALLS: dict[str, Callable[[ROOM, float], Fault]] = {
    "swallowed_frame": _swallowed_frame,
    "swallowed_screw": _swallowed_screw,
}
