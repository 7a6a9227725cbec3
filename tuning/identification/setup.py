"""The problem of an identification: which parameters are free, within which bounds, and where the search starts."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from diffdrive.errors import DiffdriveError, LogError, ParameterError
from diffdrive.logs import Log
from diffdrive.model.friction import steepest_stribeck_slope
from diffdrive.model.parameters import Drive, check_drive
from diffdrive.numerics.arrays import Scalar
from diffdrive.support.rates import is_same_rate
from tuning.identification import inverse_dynamics
from tuning.identification.inverse_dynamics import LOAD_SPREAD, MIN_SPEED
from tuning.identification.motor_encoder import with_motor_encoder
from tuning.identification.padding import padded
from tuning.identification.parameters import FIXABLE, parameter_called
from tuning.identification.prediction import constant_gains
from tuning.identification.problem import IdentificationProblem, lanes_of, noise_floor
from tuning.identification.ranges import free_space
from tuning.identification.regressors import DIRECTIONAL
from tuning.identification.row_force import MAX_DELAY
from tuning.identification.seed import initial_drive
from tuning.identification.unknowns import Unknowns, free_paths, unknowns_of
from tuning.optimisation.space import FreeParameter

SAME_RATE = 1e-4  # relative; clocks differ by less, and a fit does not see it
ROUGH_BANDWIDTH, FASTER = 200.0, 3.0  # rad/s at least, and times the growth on a falling Stribeck curve


class IdentificationSetup(NamedTuple):
    """A problem, the parameters that are free in it, the measuring noise, and what the logs do not excite."""

    problem: IdentificationProblem
    free: tuple[FreeParameter, ...]
    rate: float  # Hz
    noise: float  # m, of the scale; beside the motor's encoder at least what they are apart
    scale_noise: float  # m, as the scale itself shows it
    unexcited: frozenset[str]  # paths of parameters that no motion of these logs bears on
    notes: tuple[str, ...]


def build_problem(
    logs: Sequence[Log],
    drive: Drive,
    fixed: Sequence[str],
    bounded: Mapping[str, tuple[float, float]],
    start: Unknowns | None = None,
) -> IdentificationSetup:
    """The identification problem of these logs; raises `LogError` and `ParameterError` where there is none.

    The search starts from what inverse dynamics finds, or from `start`.
    """
    if drive.effects:
        names = ", ".join(effect.name for effect in drive.effects)
        raise ParameterError(f"identification does not know the drive file's effects ({names}): take them out")
    rate = _common_rate(logs)
    lanes = lanes_of(list(logs))
    seeded, notes = _initial_drive(drive, logs) if start is None else (drive, [])
    delay = drive.actuator.delay_samples + float(drive.actuator.delay_fraction or 0.0)
    if delay >= MAX_DELAY:
        raise ParameterError(
            f"the drive file's delay of {delay:g} samples is beyond the {MAX_DELAY} that identification looks at: "
            "shift the log's command by the whole samples, and lower delay_samples by as many"
        )
    noise = scale_noise = noise_floor(drive, lanes, rate)
    believed, begun = unknowns_of(drive, delay), unknowns_of(seeded, delay) if start is None else start
    both = with_motor_encoder(logs, seeded, lanes, noise, rate)
    compliance: Scalar | None = None
    if both is not None:
        lanes, noise, compliance = both.lanes, both.noise, both.compliance
    lanes = padded(lanes)
    if compliance is not None:  # believed is the drive's rigid screw
        believed = dataclasses.replace(believed, compliance=0.0)
        compliance = compliance if begun.compliance is None else begun.compliance
    begun = dataclasses.replace(begun, compliance=compliance)
    problem = IdentificationProblem(
        believed=drive,
        believed_unknowns=believed,
        unknowns=begun,
        lanes=lanes,
        gains=constant_gains(_rough_bandwidth(drive, rate), noise, lanes, 1.0 / rate),
        origin=np.zeros(0),
        bounds=np.zeros((2, 0)),
        prior=np.zeros(0),
    )
    fixed_names, unexcited = held_unknowns(fixed), frozenset[str]()
    if "coulomb" in fixed_names and "load_coefficient" not in fixed_names and not _has_one_load(problem):
        raise ParameterError(
            "the loads differ between or within the logs: fix coulomb_screw and load_coefficient together, or neither, "
            "since friction shows only their sum at each load"
        )
    if "load_coefficient" not in fixed_names and _has_one_load(problem):
        fixed_names.add("load_coefficient")
        unexcited = frozenset(path for path in free_paths(believed) if path.startswith("load_coefficient"))
        note = "these logs hold one load: load_coefficient stays as in the drive file"
        if float(drive.friction.initial_load) > 0 and "coulomb" not in fixed_names:
            note += (
                ", and coulomb_screw is what it leaves of coulomb_at_no_load, the sum that they determine; the same "
                "motion under a second load would part them"
            )
        notes.append(note)
    if "load_coefficient" not in fixed_names and float(drive.friction.initial_load) > 0:
        notes.append(
            "coulomb_screw rests on the drive file's initial_load, which no log shows; their sum at no load does not"
        )
    problem, free, more_notes = free_space(_with_fixed(problem, fixed_names), fixed_names, bounded)
    return IdentificationSetup(problem, free, rate, noise, scale_noise, unexcited, (*notes, *more_notes))


def _common_rate(logs: Sequence[Log]) -> float:
    if not logs:
        raise LogError("no log to identify from")
    for log in logs:
        if not is_same_rate(log.rate, logs[0].rate, SAME_RATE):
            raise LogError(
                f"{log.name} is sampled at {log.rate:g} Hz, {logs[0].name} at {logs[0].rate:g} Hz: identify from "
                "logs of one rate"
            )
    return float(round(np.mean([log.rate for log in logs]), 6))


def _initial_drive(drive: Drive, logs: Sequence[Log]) -> tuple[Drive, list[str]]:
    """The drive with what inverse dynamics finds; as it is, with a note, where that finds nothing."""
    try:
        found = inverse_dynamics.identify(list(logs), DIRECTIONAL, min_speed=MIN_SPEED)
        seeded, notes = initial_drive(drive, found)
        check_drive(seeded)
    except DiffdriveError as problem:
        return drive, [f"inverse dynamics gave no start ({problem}); started from the drive file"]
    return seeded, list(notes)


def held_unknowns(fixed: Sequence[str]) -> set[str]:
    """The unknowns that parameters which stay as they are rest on; raises `ParameterError` for an unknown name."""
    return {parameter_called(name, FIXABLE, f"cannot fix '{name}'").unknown for name in fixed}


def _rough_bandwidth(drive: Drive, rate: float) -> float:
    """Bandwidth (rad/s) of the first searches: well above the rate at which motion on the Stribeck slope runs away."""
    friction, mass = drive.friction, float(drive.plant.mass)
    slopes = (steepest_stribeck_slope(friction, side) for side in ("positive", "negative"))
    return float(np.clip(FASTER * max(slopes) / mass, ROUGH_BANDWIDTH, 0.3 * rate))


def _has_one_load(problem: IdentificationProblem) -> bool:
    """Whether the load differs too little for friction to show it."""
    loads = np.asarray(problem.lanes.load)[np.asarray(problem.lanes.counts) > 0]
    return bool(np.ptp(loads) <= LOAD_SPREAD * np.max(np.abs(loads)))


def _with_fixed(problem: IdentificationProblem, fixed_names: set[str]) -> IdentificationProblem:
    """Held parameters at the believed values; a held gap stays a gap, whatever becomes of the Coulomb friction."""
    before = problem.believed_unknowns
    values = {name: getattr(before, name) for name in fixed_names} | (
        {"breakaway": None} if "breakaway" in fixed_names else {}
    )
    return problem._replace(unknowns=dataclasses.replace(problem.unknowns, **values))
