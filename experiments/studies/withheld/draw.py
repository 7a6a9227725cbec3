"""Machines and motions drawn at random: what an engineer believes, what is true, and what was done to it."""

import dataclasses
from typing import NamedTuple

import numpy as np

from diffdrive.model.parameters import Drive, Friction, Plant
from diffdrive.model.quantity import Directional
from experiments.studies.control import Control
from experiments.studies.withheld.axes import AXES, StudyAxis
from experiments.studies.withheld.equations import FaultParameters, MachineStructure
from experiments.studies.withheld.faults import KNOWN, PITFALLS, InjectedFault, log_uniform
from experiments.studies.withheld.machine import MachineInputs
from experiments.studies.withheld.motions import draw_inputs
from experiments.studies.withheld.outsiders import OUTSIDE, PLACED

MAX_DEVIATION = 0.03  # of a true parameter from nominal, in its logarithm
MIN_SIZE, MAX_SIZE = 0.3, 4.0  # a size of 1 is clearly visible


class WithheldCase(NamedTuple):
    """One machine: the nominal drive, the true drive, its faults, and the inputs of its two logs."""

    nominal: Drive
    true: Drive
    control: Control
    samples: int  # of the control, over which its speed is a difference
    rate: float  # Hz, of the control
    samples_a_row: int  # of the control, of which a log has the first
    wind_up: float | None  # m/N, of the screw between table and a motor whose encoder is logged, too
    faults: tuple[InjectedFault, ...]
    inputs: tuple[MachineInputs, MachineInputs]
    noise: float
    resolution: float  # m
    pitfall: bool  # the effect is such that other parameters absorb much of it


def _scaled_drive(drive: Drive, factors: dict[str, float]) -> Drive:
    """The drive with parameters times factors; `name+` and `name-` are the two directions."""

    def pair(owner: Friction | Plant, name: str) -> Directional:
        value = getattr(owner, name)
        return Directional(
            float(value.positive) * factors.get(f"{name}+", 1.0) * factors.get(name, 1.0),
            float(value.negative) * factors.get(f"{name}-", 1.0) * factors.get(name, 1.0),
        )

    friction, plant = drive.friction, drive.plant
    names = [field for field in vars(friction) if isinstance(getattr(friction, field), Directional)]
    exponent_factor = factors.get("stribeck_exponent", 1.0)
    exponent = friction.stribeck_exponent if exponent_factor == 1.0 else float(friction.exponent) * exponent_factor
    return dataclasses.replace(
        drive,
        plant=dataclasses.replace(
            plant, mass=float(plant.mass) * factors.get("mass", 1.0), damping=pair(plant, "damping")
        ),
        friction=dataclasses.replace(
            friction,
            initial_load=float(friction.initial_load) * factors.get("initial_load", 1.0),
            stribeck_exponent=exponent,
            **{name: pair(friction, name) for name in names},
        ),
    )


def draw(rng: np.random.Generator, effects: tuple[str, ...], axis: StudyAxis = AXES["paper"]) -> WithheldCase:
    """A machine with these effects, of sizes drawn at random."""
    base, (load_rng, loop_rng) = axis.drive, rng.spawn(2)
    factors = {name: float(np.exp(rng.normal(0, 0.1))) for name in ("mass", "coulomb_screw", "viscous")}
    factors |= {name: float(np.exp(rng.normal(0, 0.3))) for name in ("bristle_stiffness", "bristle_damping")}
    factors["initial_load"] = float(np.exp(load_rng.normal(0, 0.2)))
    nominal = _scaled_drive(base, factors)
    nominal = dataclasses.replace(nominal, sensor=dataclasses.replace(base.sensor, noise=0.0))
    names = ("mass", "coulomb_screw+", "coulomb_screw-", "load_coefficient+", "load_coefficient-", "breakaway_gap+",
             "breakaway_gap-", "stribeck_velocity+", "stribeck_velocity-", "viscous+", "viscous-", "damping",
             "bristle_stiffness", "bristle_damping")  # fmt: skip
    deviations = {name: float(np.exp(rng.choice([-1, 1]) * rng.uniform(0.3, 1.0) * MAX_DEVIATION)) for name in names}
    sizes = np.exp(rng.uniform(np.log(MIN_SIZE), np.log(MAX_SIZE), len(effects)))
    if len(effects) > 1:
        sizes = np.maximum(sizes, 1.5)
    if any(name in OUTSIDE for name in effects):
        sizes = np.maximum(sizes, 1.0)  # what does not show is rightly none
    makers = KNOWN | OUTSIDE | PITFALLS
    drawn = [makers[name](rng, float(size)) for name, size in zip(effects, sizes, strict=True)]
    faults = tuple(_scaled_to_axis(fault, axis) for fault in drawn)
    true = _scaled_drive(nominal, deviations)
    for fault in faults:
        true = _scaled_drive(true, fault.drive_factors)
    rate = float(rng.choice(axis.rates, p=axis.rate_probabilities))
    control, samples = _control(loop_rng, axis, float(nominal.plant.mass), log_uniform(rng, axis.bandwidth))
    samples_a_row = int(loop_rng.choice(axis.samples_a_row))
    noise = float(rng.uniform(*axis.noise))
    random_scales = {name: scale for fault in faults for name, scale in fault.random_scales.items()}
    has_motor = axis.wind_up is not None
    scales = (rate, noise, random_scales, axis.length_ratio, axis.load_ratio, axis.gentleness)
    arguments = (*scales, loop_rng if has_motor else None)
    logs = draw_inputs(rng, load_rng, *arguments), draw_inputs(rng, load_rng, *arguments)
    faults = tuple(_placed(fault, logs) for fault in faults)
    pitfall = any(name in PITFALLS for name in effects)
    return WithheldCase(
        nominal,
        true,
        control,
        samples,
        rate,
        samples_a_row,
        axis.wind_up,
        faults,
        logs,
        noise,
        axis.resolution,
        pitfall,
    )


def _control(rng: np.random.Generator, axis: StudyAxis, mass: float, bandwidth: float) -> tuple[Control, int]:
    """The controller of a bandwidth (rad/s), and the samples of its speed; each loop is slower than the one within."""
    if not axis.cascaded:
        return Control(0.0, mass * bandwidth**2, 0.6 * mass * bandwidth), 1
    gain = mass * bandwidth
    kp, ki = bandwidth / log_uniform(rng, (3.5, 8.0)), gain * bandwidth / log_uniform(rng, (3.0, 8.0))
    return Control(1.0, kp, gain, ki, float(rng.choice([0.0, 0.9, 1.0]))), int(rng.choice([1, 2, 4]))


def _scaled_to_axis(fault: InjectedFault, axis: StudyAxis) -> InjectedFault:
    """The fault in the size of this axis rather than of the paper's; shares of the stroke stay shares."""
    sizes = axis.sizes() | {name: 1.0 for effect, name in PLACED.items() if effect == fault.effect}

    def scaled(name: str, value: float | tuple[float, float]) -> float | tuple[float, float]:
        factor = sizes.get(name, 1.0)
        return (factor * value[0], factor * value[1]) if isinstance(value, tuple) else factor * value

    return fault._replace(
        parameters={name: scaled(name, value) for name, value in fault.parameters.items()},
        random_scales={name: sizes.get(name, 1.0) * scale for name, scale in fault.random_scales.items()},
    )


def _placed(fault: InjectedFault, logs: tuple[MachineInputs, MachineInputs]) -> InjectedFault:
    """With its position in metres: a share of the longer stroke of the two logs."""
    name = PLACED.get(fault.effect)
    if name is None:
        return fault
    low, high = max(((float(log.reference.min()), float(log.reference.max())) for log in logs), key=np.ptp)
    return fault._replace(parameters=fault.parameters | {name: low + fault.parameters[name] * (high - low)})  # type: ignore[operator]


def without_fault(case: WithheldCase, number: int) -> WithheldCase:
    """The machine without one of its faults."""
    undone = {name: 1.0 / factor for name, factor in case.faults[number].drive_factors.items()}
    faults = (*case.faults[:number], *case.faults[number + 1 :])
    return case._replace(true=_scaled_drive(case.true, undone), faults=faults)


def log_faults(case: WithheldCase, log: int, peak: float | None = None) -> tuple[FaultParameters, MachineStructure]:
    """Faults of one log; a limit is set below the `peak` (N) of the command without it, and not without a peak."""
    values: dict[str, float] = {}
    structure: dict[str, bool] = {}
    for fault in case.faults:
        values |= {name: value[log] if isinstance(value, tuple) else value for name, value in fault.parameters.items()}
        structure |= fault.structure
    if values.get("limit", 1.0) < 0.0:
        values["limit"] = 1e9 if peak is None else (1.0 + values["limit"]) * peak
    return FaultParameters(**values), MachineStructure(**structure)
