"""The kinds of controller by name, and `register` for further ones."""

from diffdrive.controllers import cascade, dobvsc, feedforward_dob, friction_compensation, pd, unknown
from diffdrive.controllers.kinds import Kind
from diffdrive.support.registry import Registry

_BUILT_IN = (pd.KIND, dobvsc.KIND, feedforward_dob.KIND, *friction_compensation.KINDS, cascade.KIND, unknown.KIND)
KINDS: Registry[Kind] = Registry("controller kind", {kind.name: kind for kind in _BUILT_IN})
"""Every known kind of controller by its name in a drive file."""


def register(kind: Kind) -> Kind:
    """Make a kind of controller known: drive files state it, and everything that takes a controller takes it.

    `kind` of its controllers must return this name, and `table` their keys. A kind of your own is replaced by one that
    is registered under its name. Raises `ParameterError` for the name of a kind that the package has.
    """
    KINDS.add(kind.name, kind)
    return kind
