"""The kinds of controller by name, and `register` for further ones."""

from diffdrive.controllers import cascade, dobvsc, feedforward_dob, friction_compensation, pd, unknown
from diffdrive.controllers.kinds import Kind
from diffdrive.errors import ParameterError

KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        pd.KIND, dobvsc.KIND, feedforward_dob.KIND, *friction_compensation.KINDS, cascade.KIND, unknown.KIND,
    )
}  # fmt: skip
"""Every known kind of controller by its name in a drive file."""


def register(kind: Kind) -> Kind:
    """Make a kind of controller known: drive files state it, and everything that takes a controller takes it.

    `kind` of its controllers must return this name, and `table` their keys. Raises `ParameterError` for a name that
    another kind has.
    """
    if kind.name in KINDS:
        raise ParameterError(f"controller kind {kind.name!r}: there is one of this name; choose another")
    KINDS[kind.name] = kind
    return kind
