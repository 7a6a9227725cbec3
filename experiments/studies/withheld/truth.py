"""The true parameters of a machine's faults, in the names and units of the catalogue.

`amplitude` stands for the cosine and sine of a first harmonic, whose phase differs from log to log. What a log
cannot show is left out (a scale that is longer throughout, how long the machine rested before), as is what the
catalogue describes otherwise (Maxwell elements). Pairs have one value for each log.
"""

import math
from collections.abc import Callable

from diffdrive.effects.machine import AS_LOGARITHMS
from diffdrive.model.quantity import Directional
from experiments.studies.withheld.draw import WithheldCase, log_faults
from experiments.studies.withheld.faults import InjectedFault
from experiments.studies.withheld.records import Number

LOAD_RISE, PROCESS_RISE = 0.05, 0.01  # s, of the machine's windows, which the catalogue counts from halfway up


def true_parameters(case: WithheldCase, fault: InjectedFault, peak: float | None = None) -> dict[str, Number]:
    """The true parameters of one of a machine's faults; `peak` (N) as in `draw.log_faults`."""
    make = TRUE_PARAMETERS.get(fault.effect)
    if fault.effect == "force_limit":
        return {} if peak is None else {"limit": float(log_faults(case, 0, peak)[0].limit)}
    return {} if make is None else make(case, fault)


def _renamed(**names: str) -> Callable[[WithheldCase, InjectedFault], dict[str, Number]]:
    """Numbers of the same meaning under the catalogue's names."""

    def make(case: WithheldCase, fault: InjectedFault) -> dict[str, Number]:
        return {name: fault.parameters[injected] for name, injected in names.items() if injected in fault.parameters}

    return make


def _mean(pair: Directional) -> float:
    return 0.5 * float(pair.positive + pair.negative)


def _window(fault: InjectedFault, start: str, end: str, rise: float) -> dict[str, list[float]]:
    on, off = fault.parameters[start], fault.parameters[end]
    assert isinstance(on, tuple)
    assert isinstance(off, tuple)
    return {"start": [float(t) + 0.5 * rise for t in on], "end": [float(t) - 0.5 * rise for t in off]}


def _applied_load(case: WithheldCase, fault: InjectedFault) -> dict[str, Number]:
    load = fault.parameters["extra_load"]
    if "load_start" not in fault.parameters:
        return {"load": load}
    return {"more": load, **_window(fault, "load_start", "load_end", LOAD_RISE)}


def _process_force(case: WithheldCase, fault: InjectedFault) -> dict[str, Number]:
    same = _renamed(amplitude="process", mean="process_mean", frequency="process_frequency")
    return {**same(case, fault), **_window(fault, "process_start", "process_end", PROCESS_RISE)}


def _friction_shape(case: WithheldCase, fault: InjectedFault) -> dict[str, Number]:
    drive = case.true
    values: dict[str, Number] = {
        name: math.log(factor) for name, factor in fault.drive_factors.items() if name in AS_LOGARITHMS
    }
    if "viscous" in fault.drive_factors:
        grown = _mean(drive.friction.viscous) + _mean(drive.plant.damping)
        values["viscous"] = grown * (1.0 - 1.0 / fault.drive_factors["viscous"])
    return values


def _friction_asymmetry(case: WithheldCase, fault: InjectedFault) -> dict[str, Number]:
    screw = case.true.friction.coulomb_screw
    up, down = fault.drive_factors["coulomb_screw+"], fault.drive_factors["coulomb_screw-"]
    return {"coulomb": 0.5 * float(screw.positive * (1.0 - 1.0 / up) - screw.negative * (1.0 - 1.0 / down))}


def _payload_mass(case: WithheldCase, fault: InjectedFault) -> dict[str, Number]:
    return {"mass": float(case.true.plant.mass) * (1.0 - 1.0 / fault.drive_factors["mass"])}


def _elastic(case: WithheldCase, fault: InjectedFault) -> dict[str, Number]:
    same = _renamed(gap="gap", damping="screw_damping", motor_share="motor_share", table_friction="table_friction")
    share, stiffness = fault.parameters["motor_share"], fault.parameters["stiffness"]
    assert isinstance(share, float)
    assert isinstance(stiffness, float)
    reduced = share * (1.0 - share) * float(case.true.plant.mass)
    return {**same(case, fault), "frequency": math.sqrt(stiffness / reduced) / (2.0 * math.pi)}


TRUE_PARAMETERS: dict[str, Callable[[WithheldCase, InjectedFault], dict[str, Number]]] = {
    "applied_load": _applied_load,
    "friction_shape": _friction_shape,
    "friction_asymmetry": _friction_asymmetry,
    "position_friction": _renamed(slope="slope", amplitude="wave", period="wave_period"),
    "viscous_drift": _renamed(viscous="drift_viscous", coulomb="drift_coulomb", time_constant="drift_time"),
    "friction_dwell": _renamed(growth="growth", onset="onset", slip="slip"),
    "payload_mass": _payload_mass,
    "constant_force": _renamed(force="constant"),
    "position_spring": _renamed(stiffness="spring", neutral="neutral"),
    "compliance": _elastic,
    "backlash": _elastic,
    "frame_vibration": _renamed(ratio="base_ratio", frequency="base_frequency", damping="base_damping"),
    "process_force": _process_force,
    "cogging": _renamed(amplitude="cogging", period="cogging_period"),
    "force_gain": _renamed(gain="gain"),
    "actuator_lag": _renamed(time_constant="lag"),
    "loop_delay": _renamed(delay="delay"),
    "lead_error": _renamed(amplitude="lead_error", lead="lead"),
    "interpolation_error": _renamed(amplitude="interpolation", period="interpolation_period"),
}
