"""Any machine of a sweep again, from its number: its drive, its load, its noise, and every signal of its run."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from diffdrive.effects.stages import force_limit
from diffdrive.errors import ParameterError
from diffdrive.loop.rollout import compiled_rollout, loop_inputs
from diffdrive.loop.run import Run, with_status
from diffdrive.model.parameters import Drive
from diffdrive.motion.load import Ramp
from diffdrive.numerics.arrays import as_arrays
from tuning.sweeps.costs import SweepCosts, costs_of
from tuning.sweeps.identity import identity
from tuning.sweeps.machines import lane
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.possible import machine_cycles

if TYPE_CHECKING:
    import xarray

SIGNALS = {
    "reference": "m",
    "position": "m",
    "error": "m",
    "velocity": "m/s",
    "command": "N",
    "force": "N",
    "friction": "N",
    "friction_estimate": "N",
    "load": "N",
    "load_estimate": "N",
}


class SweepMachine(NamedTuple):
    """One machine of a sweep: the drive as it is in truth, the values of what varies, the load beside the plan's."""

    number: int
    drive: Drive
    values: dict[str, float]
    ramp: Ramp
    key: Array | None  # of its measuring noise


def sweep_machine(plan: SweepPlan, number: int, motion: str) -> SweepMachine:
    """The machine of that number, as it is on a motion; raises `ParameterError` if the sweep has none."""
    if not 0 <= number < plan.samples:
        raise ParameterError(f"machine {number}: the sweep has machines 0 to {plan.samples - 1}")
    numbers = np.array([number])
    drives, ramps, _, keys = plan.machines(numbers)
    return SweepMachine(
        number,
        lane(drives, 0),
        {name: float(value[0]) for name, value in plan.values(numbers, motion).items()},
        jax.tree.map(lambda leaf: leaf[0], ramps),
        None if keys is None else keys[0],
    )


def choose_names(plan: SweepPlan, controller: str | None, motion: str | None) -> tuple[str, str]:
    """The controller and the motion of these names, or the first ones; raises `ParameterError` for one that is not."""
    controller, motion = controller or next(iter(plan.controllers)), motion or next(iter(plan.motions))
    _require_known(plan.controllers, controller, "controller")
    _require_known(plan.motions, motion, "motion")
    return controller, motion


def _require_known(choices: Mapping[str, object], name: str, what: str) -> None:
    if name not in choices:
        raise ParameterError(f"{what} '{name}': is not of this sweep; known: {', '.join(choices)}")


def machine_run(plan: SweepPlan, machine: SweepMachine, controller: str, motion: str, every: int = 1) -> Run:
    """Every signal of a machine under a controller, with a status as any simulation has."""
    control, [(planned, over_time)] = (
        plan.controllers[controller],
        machine_cycles(plan, np.array([machine.number]), motion),
    )
    loads = over_time + np.asarray(machine.ramp.at(planned.time - planned.time[0]))
    inputs = loop_inputs(planned, loads)
    frames = compiled_rollout(
        as_arrays(machine.drive), as_arrays(control), inputs, plan.axis.sampling, machine.key, every
    )
    limit = force_limit(machine.drive)
    run = Run.from_frames(planned, loads, frames, every)
    if every == 1:  # of fewer samples no trace is written
        run = replace(run, trace=plan.axis.trace, seed=machine.number)
    return with_status(run, plan.axis.limits, None if limit is None else float(limit))


def run_errors(plan: SweepPlan, run: Run) -> tuple[float, float]:
    """RMS and peak error (m) of a run from where errors count."""
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(run.error[run.time >= plan.settle])
        return float(np.sqrt(np.mean(error**2))), float(np.max(error))


def repeat_costs(plan: SweepPlan, number: int, controller: str, motion: str) -> SweepCosts:
    """What the sweep itself computed for a machine, to the last bit: by the same program, the machine alone in it."""
    return costs_of(plan, np.array([number]), motion, [controller])[controller]


def traces(
    plan: SweepPlan,
    numbers: Iterable[int],
    controllers: Iterable[str],
    motion: str,
    signals: Iterable[str],
    every: int = 1,
) -> "xarray.Dataset":
    """Signals of some machines along a motion as an xarray.Dataset: [controller, machine, time] each.

    A signal that a controller does not have is NaN, and so is one after the end of a cycle that is shorter.
    `rms_m` and `peak_m` are the errors of what is recorded.
    Raises `ParameterError` for a signal that there is not.
    """
    import xarray as xr

    names, numbers, controllers = list(signals), list(numbers), list(controllers)
    for name in names:
        _require_known(SIGNALS, name, "signal")
    drawn = [sweep_machine(plan, number, motion) for number in numbers]
    runs = [[machine_run(plan, machine, controller, motion, every) for machine in drawn] for controller in controllers]
    time = max((run.time for run in runs[0]), key=len)

    def signal_of(run: Run, name: str) -> np.ndarray:
        value, padded = getattr(run, "table_position" if name == "position" else name), np.full(len(time), np.nan)
        if value is not None:
            padded[: len(value)] = value
        return padded

    def varied(name: str) -> tuple[str, list[float], dict[str, str]]:
        return "machine", [machine.values[name] for machine in drawn], {"units": plan.units[name]}

    recorded = {
        name: (
            ("controller", "machine", "time"),
            np.array([[signal_of(run, name) for run in row] for row in runs]),
            {"units": SIGNALS[name]},
        )
        for name in names
    }
    errors = np.array([[run_errors(plan, run) for run in row] for row in runs])
    judged_by = {
        name: (("controller", "machine"), errors[..., k], {"units": "m"}) for k, name in enumerate(("rms_m", "peak_m"))
    }
    return xr.Dataset(
        recorded | judged_by,
        {
            "controller": controllers,
            "machine": numbers,
            "time": ("time", time, {"units": "s"}),
            **{name: varied(name) for name in plan.units},
        },
        {"motion": motion, "sweep": identity(plan)},
    )
