"""Which unknowns a search may move and how far: the user's bounds where given, else those about what was believed."""

from collections.abc import Mapping

import numpy as np

from diffdrive.errors import ParameterError
from tuning.identification.parameters import BOUNDABLE, axis_path, parameter_called
from tuning.identification.problem import IdentificationProblem
from tuning.identification.unknowns import default_bounds, free_paths, value_at, with_value
from tuning.optimisation.space import FreeParameter, bounds_of, search_space

MARGIN = 0.02  # of its range (of its decades, where it is positive), by which a start is kept off its bounds


def free_space(
    problem: IdentificationProblem, fixed: set[str], bounded: Mapping[str, tuple[float, float]]
) -> tuple[IdentificationProblem, tuple[FreeParameter, ...], list[str]]:
    """What is free, within bounds about what was believed; the problem with its starts inside them; notes."""
    user_bounds, notes = _user_bounds(problem, fixed, bounded)
    unknowns, free = problem.unknowns, []
    for path in free_paths(unknowns):
        stem = path.split(".")[0]
        if stem in fixed:
            continue
        limits = user_bounds.get(path) or _default_bounds(problem, path)
        possible = np.isfinite([limits.low, limits.high]).all() and limits.low < limits.high
        if not possible or limits.low <= 0 < _default_bounds(problem, path).low:
            raise ParameterError(
                f"cannot bound {axis_path(path)} within {limits.low:g} to {limits.high:g}: not a range of its values"
            )
        unknowns = with_value(unknowns, path, clipped_start(value_at(unknowns, path), limits))
        free.append(limits)
    if not free:
        raise ParameterError("every parameter is fixed: leave at least one free")
    prior = np.array([_width(parameter) / _width(_default_bounds(problem, parameter.path)) for parameter in free])
    origin = np.asarray(search_space(unknowns, free).origin)
    within = problem._replace(unknowns=unknowns, origin=origin, bounds=bounds_of(free), prior=prior)
    return within, tuple(free), notes


def _width(limits: FreeParameter) -> float:
    """How far bounds are apart, in the coordinate in which the parameter moves."""
    return float(np.log(limits.high / limits.low)) if limits.low > 0 else limits.high - limits.low


def _default_bounds(problem: IdentificationProblem, path: str) -> FreeParameter:
    """Bounds about the belief, unless inverse dynamics says that it is far off: the same for like machines."""
    believed, seeded = value_at(problem.believed_unknowns, path), value_at(problem.unknowns, path)
    trusted = 0.2 < believed / seeded < 5.0 if seeded > 0 else True
    return default_bounds(path, believed if trusted else seeded, value_at(problem.believed_unknowns, "coulomb"))


def _user_bounds(
    problem: IdentificationProblem, fixed: set[str], bounded: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, FreeParameter], list[str]]:
    """The user's bounds as bounds of the unknowns, by path, and notes on what that took."""
    before, friction, found, notes = (
        problem.believed_unknowns,
        problem.believed.friction,
        dict[str, FreeParameter](),
        [],
    )
    for given, (low, high) in bounded.items():
        parameter = parameter_called(given, BOUNDABLE, f"cannot bound '{given}'")
        name, stem = parameter.name, parameter.unknown
        if stem in fixed:
            raise ParameterError(f"{name} is both bounded and held at the drive file's value: leave out one of the two")
        if name == "coulomb_screw" and "load_coefficient" not in fixed and float(friction.initial_load) > 0:
            raise ParameterError(
                "cannot bound coulomb_screw while load_coefficient is free, since it is what that leaves of the "
                "friction at no load: bound coulomb_at_no_load"
            )
        if any(path.split(".")[0] == stem for path in found):
            raise ParameterError(f"{name} is bounded twice, under two names")
        if name == "compliance" and before.compliance is None:
            raise ParameterError(
                "cannot bound compliance: no log has a motor encoder beside the scale that shows it in both directions"
            )
        for path in free_paths(before):
            if path.split(".")[0] != stem:
                continue
            offset, unit = 0.0, 1.0
            if name == "viscous":  # only the sum with the damping acts
                offset = float(getattr(problem.believed.plant.damping, path.split(".")[1]))
            if name == "coulomb_screw":
                slope = value_at(before, path.replace("coulomb", "load_coefficient"))
                offset = slope * float(friction.initial_load)
            if name == "breakaway_gap":  # searched as the ratio F_S / F_C
                offset, unit = 1.0, value_at(before, path.replace("breakaway", "coulomb"))
            found[path] = FreeParameter(path, low / unit + offset, high / unit + offset)
        if name == "breakaway_gap" and "coulomb" not in fixed:
            notes.append(
                "the bounds of breakaway_gap are those of F_S / F_C at the drive file's Coulomb friction: they scale "
                "with the Coulomb friction found"
            )
    return found, notes


def clipped_start(start: float, limits: FreeParameter) -> float:
    """The start, moved away from a bound, where it would have no gradient."""
    if limits.low > 0:
        reach = limits.high / limits.low
        return float(np.clip(start, limits.low * reach**MARGIN, limits.high * reach**-MARGIN))
    edge = MARGIN * (limits.high - limits.low)
    return float(np.clip(start, limits.low + edge, limits.high - edge))
