"""The smooth variant of a drive and its controller, for gradients.

The exact machine rounds positions, clips forces and switches estimators on and off; its tracking error is a function of
the gains with steps and kinks at every scale, and has no useful derivative. The smooth variant keeps the physics and
replaces these three by differentiable approximations. Tune on it, verify on the exact one.
"""

from typing import Protocol, TypeVar, cast, runtime_checkable

import jax
from jax.tree_util import all_leaves

Part = TypeVar("Part")


@runtime_checkable
class _Smoothable(Protocol):
    """What has a smooth variant: sensor, actuator, effects, controllers, and any part of them."""

    def smoothed(self) -> object:
        """The smooth variant; its own parts are smooth already."""


def smooth(part: Part) -> Part:
    """The same drive, controller or tree of them, each part by its own `smoothed`, the innermost first.

    Of ours: no quantiser; the actuator's force limit with corners rounded over 1 % of the limit; eq. (20)'s speed gate
    opened over 10 % of its threshold; no floor under load estimates. The effect `ForceLimit` stays a clip, which has
    the right derivative but at its corners. Noise stays: for a given seed it is a fixed sequence.
    """
    if all_leaves([part]):
        return part
    children, tree = jax.tree.flatten(part, is_leaf=lambda node: node is not part)
    whole = jax.tree.unflatten(tree, [smooth(child) for child in children])
    return cast(Part, whole.smoothed() if isinstance(whole, _Smoothable) else whole)
