"""A drive to start a fit from: the parameters of an inverse-dynamics model put into a drive."""

import equinox as eqx

from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import Directional
from tuning.identification.inverse_dynamics import InverseDynamics

SIGNIFICANT = 2.0  # standard errors that a parameter must be away from zero to count as determined
VISCOUS_FLOOR = 0.01  # of the total: what is left to the friction where the plant's damping takes it all


def initial_drive(drive: Drive, result: InverseDynamics) -> tuple[Drive, tuple[str, ...]]:
    """`drive` with the mass, constant force, Coulomb and viscous friction of `result`, and notes on what it kept.

    The Coulomb friction goes into `coulomb_screw`, so that F_C under the applied load of the logs is as identified;
    `load_coefficient` changes only if the logs show it. The viscous friction gets what `plant.damping` leaves of the
    total. A value that is not positive, or not two standard errors from zero, stays as it is in `drive`.
    """
    notes: list[str] = []
    plant, friction = drive.plant, drive.friction
    mass, reason = _determined_value(result, "mass")
    if reason:
        notes.append(f"plant.mass stays at {float(plant.mass):g} kg: {reason}")
    else:
        plant = eqx.tree_at(lambda p: p.mass, plant, mass)
    offset = result.constant_force
    if offset is not None and offset == offset:
        plant = eqx.tree_at(lambda p: p.constant_force, plant, offset)
    elif offset is not None:
        notes.append(f"plant.constant_force stays at {float(plant.constant_force):g} N: not determined by the logs")
    sides = {side: _side(drive, result, side, notes) for side in ("positive", "negative")}

    def pair(of: str) -> Directional:
        return Directional(sides["positive"][of], sides["negative"][of])

    friction = eqx.tree_at(
        lambda f: (f.coulomb_screw, f.load_coefficient, f.viscous),
        friction,
        (pair("coulomb_screw"), pair("load_coefficient"), pair("viscous")),
    )
    return eqx.tree_at(lambda d: (d.plant, d.friction), drive, (plant, friction)), tuple(dict.fromkeys(notes))


def _side(drive: Drive, result: InverseDynamics, side: str, notes: list[str]) -> dict[str, float]:
    """Friction in one direction; adds to `notes` what stays as it was."""
    friction = drive.friction
    seeded = {
        name: float(getattr(getattr(friction, name), side)) for name in ("coulomb_screw", "load_coefficient", "viscous")
    }

    def keep(name: str, reason: str) -> None:
        notes.append(f"friction.{name} ({side}) stays at {seeded[name]:g}: {reason}")

    slope, reason = _determined_value(result, "load_coefficient", side)
    if result.load_coefficient is not None and reason:
        keep("load_coefficient", reason)
    elif result.load_coefficient is not None:
        seeded["load_coefficient"] = slope

    level, reason = _determined_value(result, "coulomb", side)
    if reason:
        keep("coulomb_screw", reason)
    else:
        identified = slope if slope == slope else 0.0
        level += identified * result.load - seeded["load_coefficient"] * (float(friction.initial_load) + result.load)
        if result.constant_force is None:  # the identified friction contains the constant force
            level += float(drive.plant.constant_force) * (1.0 if side == "positive" else -1.0)
        if level > 0:
            seeded["coulomb_screw"] = level
        else:
            keep(
                "coulomb_screw", "load_coefficient and initial_load alone make more Coulomb friction than the logs show"
            )

    total, reason = _determined_value(result, "viscous", side)
    if reason:
        keep("viscous", reason)
    else:
        damping = float(getattr(drive.plant.damping, side))
        if total - damping < VISCOUS_FLOOR * total:
            notes.append(
                f"friction.viscous ({side}) is set to {VISCOUS_FLOOR * total:.3g} N s/m: plant.damping, {damping:g}, "
                f"leaves nothing of the {total:.4g} N s/m identified"
            )
        seeded["viscous"] = max(total - damping, VISCOUS_FLOOR * total)
    return seeded


def _determined_value(result: InverseDynamics, name: str, side: str = "") -> tuple[float, str]:
    """A parameter's value (NaN if the logs do not determine it), and why it is not to be used, or an empty reason."""
    key = name if name in result.values else f"{name}.{side}"
    value = result.values.get(key, float("nan"))
    if value != value:
        return value, "not determined by the logs"
    error = result.standard_errors[key]
    if not value > SIGNIFICANT * error:
        return value, f"the logs give {value:.4g} with a standard error of {error:.2g}, not clearly above zero"
    return value, ""
