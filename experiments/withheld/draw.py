"""Machines, motions and faults drawn at random: what an engineer believes, what is true, and what was done to it."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive import presets
from diffdrive.parameters import Directional, Drive
from experiments.withheld.machine import Faults, Kind, Told

OFF = 0.03  # the most that a true parameter is off nominal, by its logarithm
SHORTEST, LONGEST = 8.0, 11.0  # s
FAINT, STRONG = 0.3, 4.0  # sizes against that which is clear
STROKE = 0.05  # m, to either side
ROOM = np.random.Generator


class Fault(NamedTuple):
    """One effect as it was done to a machine: changed equations and changed parameters."""

    effect: str  # name of the catalogue, or of what lies outside it
    size: float  # against what is clear
    faults: dict[str, float | tuple[float, float]]  # pairs: one for each log
    kind: dict[str, bool]
    scaled: dict[str, float]  # parameters of the drive by their factors
    true: dict[str, Any]  # what the key says


class Case(NamedTuple):
    """One machine: believed, true, and its two logs' instructions."""

    nominal: Drive
    true: Drive
    gains: tuple[float, float]
    rate: float
    faults: tuple[Fault, ...]
    told: tuple[Told, Told]
    noise: float


def _scaled(drive: Drive, factors: dict[str, float]) -> Drive:
    """The drive with parameters times factors; `name+` and `name-` are the two directions."""

    def pair(owner: Any, name: str) -> Directional:
        value = getattr(owner, name)
        return Directional(
            float(value.positive) * factors.get(f"{name}+", 1.0) * factors.get(name, 1.0),
            float(value.negative) * factors.get(f"{name}-", 1.0) * factors.get(name, 1.0),
        )

    friction, plant = drive.friction, drive.plant
    names = [one for one in vars(friction) if isinstance(getattr(friction, one), Directional)]
    return dataclasses.replace(
        drive,
        plant=dataclasses.replace(
            plant, mass=float(plant.mass) * factors.get("mass", 1.0), damping=pair(plant, "damping")
        ),
        friction=dataclasses.replace(friction, **{name: pair(friction, name) for name in names}),
    )


def _one(name: str, size: float, true: dict[str, Any], faults: dict[str, Any] | None = None, **rest: Any) -> Fault:
    return Fault(name, size, faults or {}, rest.get("kind", {}), rest.get("scaled", {}), true)


def _phases(room: ROOM) -> tuple[float, float]:
    """One for each log: homed anew."""
    return float(room.uniform(0, 2 * np.pi)), float(room.uniform(0, 2 * np.pi))


def _applied_load(room: ROOM, size: float) -> Fault:
    if room.random() < 0.4:
        load = 15e3 * size
        return _one("applied_load", size, {"load": load}, {"extra_load": load})
    load = 4e3 * size
    start, long = room.uniform(1.0, 4.0, 2), room.uniform(2.0, 4.0, 2)
    given = {"extra_load": load, "load_start": tuple(start), "load_end": tuple(start + long)}
    return _one("applied_load", size, {"more": load, "start": list(start), "end": list(start + long)}, given)


def _friction_shape(room: ROOM, size: float) -> Fault:
    which = room.choice(["stribeck_velocity", "breakaway_gap", "viscous"])
    way = float(np.exp(room.choice([-1.0, 1.0]) * min(0.15 * size, 0.7)))
    scaled = {which: way} | ({"damping": way} if which == "viscous" else {})
    return _one("friction_shape", size, {which: way - 1.0}, scaled=scaled)


def _friction_asymmetry(room: ROOM, size: float) -> Fault:
    share = float(room.choice([-1.0, 1.0]) * 0.08 * size)
    scaled = {"coulomb_screw+": 1 + share, "coulomb_screw-": 1 - share}
    return _one("friction_asymmetry", size, {"share": share}, scaled=scaled)


def _position_friction(room: ROOM, size: float) -> Fault:
    if room.random() < 0.5:
        slope = float(room.choice([-1, 1]) * 0.05 * size / STROKE)
        return _one("position_friction", size, {"slope": slope}, {"slope": slope})
    period = float(room.uniform(0.04, 0.15))
    given = {"wave": 0.05 * size, "wave_period": period, "wave_phase": float(room.uniform(0, 6.28))}
    return _one("position_friction", size, {"period": period, "amplitude": 0.05 * size}, given)


def _viscous_drift(room: ROOM, size: float) -> Fault:
    time = float(room.uniform(2.0, 6.0))
    given = {"drift_viscous": 0.08 * size, "drift_coulomb": 0.01 * size, "drift_time": time}
    return _one("viscous_drift", size, {"viscous": 0.08 * size, "time_constant": time}, given)


def _friction_dwell(room: ROOM, size: float) -> Fault:
    given = {"growth": 0.2 * size, "onset": float(room.uniform(0.05, 0.15)), "slip": float(room.uniform(5e-6, 15e-6))}
    return _one("friction_dwell", size, dict(given), given)


def _presliding(room: ROOM, size: float) -> Fault:
    longest = float(np.clip(4e-6 * size, 2e-6, 1.2e-5))
    return _one("presliding_hysteresis", size, {"longest": longest}, {"longest": longest}, kind={"maxwell": True})


def _payload_mass(room: ROOM, size: float) -> Fault:
    return _one("payload_mass", size, {"share": 0.12 * size}, scaled={"mass": 1 + 0.12 * size})


def _constant_force(room: ROOM, size: float) -> Fault:
    force = float(room.choice([-1, 1]) * 3.0 * size)
    return _one("constant_force", size, {"force": force}, {"constant": force})


def _position_spring(room: ROOM, size: float) -> Fault:
    given = {"spring": 80.0 * size, "neutral": float(room.uniform(-0.02, 0.02))}
    return _one("position_spring", size, {"stiffness": given["spring"], "neutral": given["neutral"]}, given)


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
    frequency = float(np.clip(250.0 / np.sqrt(size), 100.0, 500.0))
    given = _elastic(room, frequency, float(room.uniform(0.02, 0.05)))
    return _one("compliance", size, {"frequency": frequency}, given, kind={"elastic": True})


def _backlash(room: ROOM, size: float) -> Fault:
    gap = float(np.clip(2.5e-6 * size, 8e-7, 1e-5))
    given = _elastic(room, float(room.uniform(350, 600)), float(room.uniform(0.05, 0.1))) | {"gap": gap}
    return _one("backlash", size, {"gap": gap}, given, kind={"elastic": True})


def _frame_vibration(room: ROOM, size: float) -> Fault:
    given = {
        "base_ratio": 0.015 * size,
        "base_frequency": float(room.uniform(12, 45)),
        "base_damping": float(room.uniform(0.02, 0.05)),
    }
    return _one("frame_vibration", size, {"ratio": 0.015 * size, "frequency": given["base_frequency"]}, given)


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
    return _one("process_force", size, {"frequency": given["process_frequency"], "amplitude": 1.2 * size}, given)


def _cogging(room: ROOM, size: float) -> Fault:
    period = float(room.choice([1.0e-3, 1.25e-3]))
    given = {
        "cogging": 1.2 * size,
        "cogging_period": period,
        "cogging_phase": float(room.uniform(0, 6.28)),
        "second": float(room.uniform(0, 0.2)),
        "sixth": float(room.uniform(0, 0.3)),
    }
    return _one("cogging", size, {"period": period, "amplitude": 1.2 * size}, given)


def _force_gain(room: ROOM, size: float) -> Fault:
    gain = float(room.choice([-1, 1]) * min(0.06 * size, 0.3))
    return _one("force_gain", size, {"gain": gain}, {"gain": gain})


def _actuator_lag(room: ROOM, size: float) -> Fault:
    lag = 3e-4 * size
    return _one("actuator_lag", size, {"time_constant": lag}, {"lag": lag}, kind={"lagging": True})


def _loop_delay(room: ROOM, size: float) -> Fault:
    delay = float(np.clip(0.4 * size, 0.15, 2.0))
    return _one("loop_delay", size, {"delay": delay}, {"delay": delay})


def _force_limit(room: ROOM, size: float) -> Fault:
    return _one("force_limit", size, {"below": min(0.04 * size, 0.2)}, {"limit": -min(0.04 * size, 0.2)})


def _lead_error(room: ROOM, size: float) -> Fault:
    given = {"lead_error": 2e-6 * size, "lead_phase": _phases(room), "linear": float(room.normal(0, 2e-5))}
    return _one("lead_error", size, {"amplitude": 2e-6 * size, "lead": 5e-3}, given)


def _interpolation_error(room: ROOM, size: float) -> Fault:
    given = {"interpolation": 1.5e-7 * size, "interpolation_phase": _phases(room)}
    return _one("interpolation_error", size, {"amplitude": 1.5e-7 * size, "period": 2e-5}, given)


def _chip(room: ROOM, size: float) -> Fault:
    given = {
        "chip": 3.0 * size,
        "chip_place": tuple(room.uniform(-0.5 * STROKE, 0.5 * STROKE, 2)),
        "chip_width": float(room.uniform(2e-3, 8e-3)),
        "chip_start": tuple(room.uniform(2.0, 4.0, 2)),
    }
    return _one("chip", size, {}, given)


def _droop(room: ROOM, size: float) -> Fault:
    return _one("droop", size, {}, {"droop": min(0.1 * size, 0.4)})


def _shocks(room: ROOM, size: float) -> Fault:
    return _one("shocks", size, {"peak": 10.0 * size})


def _wandering(room: ROOM, size: float) -> Fault:
    return _one("wandering_friction", size, {"share": 0.03 * size})


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
}


def _moves(room: ROOM, rate: float) -> Float[np.ndarray, " n"]:
    """Strokes at several speeds with pauses, and vibrations to and fro, as a commissioning engineer would run them."""
    pieces, at = [np.zeros(round(0.2 * rate))], 0.0
    total, wanted = 0.2, room.uniform(SHORTEST, LONGEST)
    while total < wanted:
        if room.random() < 0.25:
            amplitude, frequency = np.exp(room.uniform(np.log(2e-5), np.log(3e-3))), room.uniform(0.8, 5.0)
            amplitude = min(amplitude, 4.0 / (2 * np.pi * frequency) ** 2)
            time = np.arange(round(max(2.0 / frequency, 0.8) * rate)) / rate
            turns = np.round(time[-1] * frequency)
            smooth = np.sin(np.pi * np.clip(time / time[-1], 0, 1)) ** 2
            piece = at + amplitude * smooth * np.sin(2 * np.pi * turns * time / time[-1])
        else:
            speed = np.exp(room.uniform(np.log(1e-3), np.log(0.09)))
            stroke = min(speed * room.uniform(0.3, 1.2), 0.7 * STROKE) * room.choice([-1.0, 1.0])
            if abs(at + stroke) > STROKE:
                stroke = -stroke
            ramp = max(0.04, speed / room.uniform(0.8, 2.5))
            time = np.arange(round((abs(stroke) / speed + ramp) * rate)) / rate
            share = np.clip(time / ramp, 0, 1)
            rise = share**3 * (10 - 15 * share + 6 * share**2)
            share = np.clip((time[-1] - time) / ramp, 0, 1)
            profile = np.minimum(rise, share**3 * (10 - 15 * share + 6 * share**2))
            piece = at + stroke * np.cumsum(profile) / profile.sum()
        pieces.append(piece)
        at = float(piece[-1])
        rest = room.uniform(0.02, 0.5)
        pieces.append(np.full(round(rest * rate), at))
        total = sum(map(len, pieces)) / rate
    return np.concatenate(pieces)


def draw(room: ROOM, effects: tuple[str, ...]) -> Case:
    """A machine with these effects, of sizes drawn at random."""
    base = presets.paper_drive()
    varied = {name: float(np.exp(room.normal(0, 0.1))) for name in ("mass", "coulomb_screw", "viscous")}
    nominal = dataclasses.replace(
        _scaled(base, varied), sensor=dataclasses.replace(base.sensor, resolution=1e-7, noise=0.0)
    )
    names = ("mass", "coulomb_screw+", "coulomb_screw-", "load_coefficient+", "load_coefficient-", "breakaway_gap+",
             "breakaway_gap-", "stribeck_velocity+", "stribeck_velocity-", "viscous+", "viscous-", "damping",
             "bristle_stiffness", "bristle_damping")  # fmt: skip
    off = {name: float(np.exp(room.choice([-1, 1]) * room.uniform(0.3, 1.0) * OFF)) for name in names}
    sizes = np.exp(room.uniform(np.log(FAINT), np.log(STRONG), len(effects)))
    if len(effects) > 1:
        sizes = np.maximum(sizes, 1.5)
    faults = tuple((KNOWN | OUTSIDE)[name](room, float(size)) for name, size in zip(effects, sizes, strict=True))
    true = _scaled(nominal, off)
    for fault in faults:
        true = _scaled(true, fault.scaled)
    rate = float(room.choice([2000.0, 4000.0, 10000.0], p=[0.6, 0.3, 0.1]))
    bandwidth = room.uniform(170, 210)  # rad/s
    kp, kd = float(nominal.plant.mass) * bandwidth**2, 0.6 * float(nominal.plant.mass) * bandwidth
    noise = float(room.uniform(2e-8, 5e-8))
    told = tuple(_told(room, rate, noise, faults) for _ in range(2))
    return Case(nominal, true, (kp, kd), rate, faults, told, noise)  # type: ignore[arg-type]


def _told(room: ROOM, rate: float, noise: float, faults: tuple[Fault, ...]) -> Told:
    reference = _moves(room, rate)
    n = len(reference)
    push, rub = np.zeros(n), np.zeros(n)
    for fault in faults:
        if fault.effect == "shocks":
            width = max(2, round(3e-3 * rate))
            for at in room.uniform(0.5, n / rate - 0.5, room.integers(8, 20)):
                k = int(at * rate)
                peak = fault.true["peak"] * np.exp(room.normal(0, 0.4)) * room.choice([-1, 1])
                push[k : k + width] += peak * np.sin(np.pi * (np.arange(width) + 0.5) / width)
        if fault.effect == "wandering_friction":
            fade = np.exp(-1.0 / (0.3 * rate))
            kick = fault.true["share"] * np.sqrt(1 - fade**2) * room.standard_normal(n)
            for k in range(1, n):
                rub[k] = fade * rub[k - 1] + kick[k]
    return Told(reference, np.zeros(n), noise * room.standard_normal(n), push, rub)


def of_log(case: Case, log: int, peak: float | None) -> tuple[Faults, Kind]:
    """Faults of one log; a limit is set below the `peak` (N) of the command without it."""
    values: dict[str, float] = {}
    kind: dict[str, bool] = {}
    for fault in case.faults:
        values |= {name: value[log] if isinstance(value, tuple) else value for name, value in fault.faults.items()}
        kind |= fault.kind
    if values.get("limit", 1.0) < 0.0:
        values["limit"] = 1e9 if peak is None else (1.0 + values["limit"]) * peak
    return Faults(**values), Kind(**kind)
