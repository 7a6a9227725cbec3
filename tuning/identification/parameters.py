"""What is identified of a machine: each parameter by its path in an axis, and the unknown that the search moves for it.

The names of tables and options are the paths without their part: `mass` is `plant.mass`.
"""

from collections.abc import Collection
from typing import NamedTuple

from diffdrive.errors import ParameterError
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import Directional, node_at
from diffdrive.numerics.arrays import Scalar
from diffdrive.support.messages import suggestion
from tuning.identification.unknowns import Unknowns

SIDES = (".positive", ".negative")


class IdentifiedParameter(NamedTuple):
    """One parameter; of one that differs between the directions, both."""

    path: str  # in an axis, without the direction
    unit: str
    unknown: str  # the field of `Unknowns` that it rests on
    is_signed: bool = False  # may be of either sign; else its interval is that of its logarithm
    in_drive: bool = True  # is a number of its own there

    @property
    def name(self) -> str:
        """Without the part of the axis."""
        return self.path.partition(".")[2]

    def value(self, drive: Drive, unknowns: Unknowns) -> Scalar | Directional | None:
        """Its value in a drive, or where that has none among the unknowns; None where no log can show it."""
        value: Scalar | Directional | None = (
            node_at(drive, self.path) if self.in_drive else getattr(unknowns, self.unknown)
        )
        return value


PARAMETERS = (  # of several that rest on one unknown the first stands for it
    IdentifiedParameter("plant.mass", "kg", "mass"),
    IdentifiedParameter("plant.constant_force", "N", "constant_force", is_signed=True),
    IdentifiedParameter("friction.coulomb_at_no_load", "N", "coulomb", in_drive=False),
    IdentifiedParameter("friction.coulomb_screw", "N", "coulomb", is_signed=True),
    IdentifiedParameter("friction.load_coefficient", "1", "load_coefficient"),
    IdentifiedParameter("friction.breakaway_gap", "N", "breakaway", is_signed=True),
    IdentifiedParameter("friction.stribeck_velocity", "m/s", "stribeck_velocity"),
    IdentifiedParameter("friction.viscous", "N*s/m", "viscous"),
    IdentifiedParameter("friction.bristle_stiffness", "N/m", "bristle_stiffness"),
    IdentifiedParameter("friction.bristle_damping", "N*s/m", "bristle_damping"),
    IdentifiedParameter("actuator.delay", "periods", "delay", is_signed=True, in_drive=False),
    IdentifiedParameter("screw.compliance", "m/N", "compliance", is_signed=True, in_drive=False),
)
BOUNDABLE = {parameter.name: parameter for parameter in PARAMETERS}
# the friction at no load has no value in a file at which it could be held
FIXABLE = {name: parameter for name, parameter in BOUNDABLE.items() if name != "coulomb_at_no_load"}


def parameter_called(text: str, known: Collection[str], refusal: str) -> IdentifiedParameter:
    """The parameter of that path (`plant.mass`) or name (`mass`), one of the `known` names.

    `refusal` begins the `ParameterError` if there is none.
    """
    for name in known:
        if text in (name, BOUNDABLE[name].path):
            return BOUNDABLE[name]
    raise ParameterError(f"{refusal}; {suggestion(without_side(text).rpartition('.')[2], known)}")


def without_side(path: str) -> str:
    """A path, or a name, of both directions."""
    return path.removesuffix(SIDES[0]).removesuffix(SIDES[1])


def parameter_at(path: str) -> IdentifiedParameter:
    """The parameter of a path in an axis, with or without the direction."""
    return next(parameter for parameter in PARAMETERS if parameter.path == without_side(path))


def axis_path(unknown: str) -> str:
    """The path in an axis of an unknown's path, such as `breakaway.positive`."""
    field, dot, side = unknown.partition(".")
    return next(parameter.path for parameter in PARAMETERS if parameter.unknown == field) + dot + side
