"""The smooth variant of a drive and its controller, for gradients.

The exact machine rounds positions, clips forces and switches estimators on and off; its tracking error is a function of
the gains with steps and kinks at every scale, and has no useful derivative. The smooth variant keeps the physics and
replaces these three by differentiable approximations. Tune on it, verify on the exact one.
"""

import dataclasses
from typing import TypeVar

import equinox as eqx
import jax

from diffdrive.model.parameters import Actuator, Sensor
from diffdrive.observers.friction_observer import LoadStateObserver
from diffdrive.observers.load_estimator import InnovationLoad

Part = TypeVar("Part")

LIMIT_ROUNDING = 0.01  # of the force limit
GATE_ROUNDING = 0.1  # of the estimator's minimum speed


def smooth(part: Part) -> Part:
    """The same drive, controller or tree of them, differentiable throughout.

    No quantiser; force limits with corners rounded over 1 % of the limit; eq. (20)'s speed gate opened over 10 % of its
    threshold; no floor under load estimates. Noise stays: for a given seed it is a fixed sequence.
    """

    def smoothed(module: object) -> object:
        if isinstance(module, Sensor):
            return Sensor(resolution=None, noise=module.noise)
        if isinstance(module, Actuator):
            if module.force_limit is None:
                return module
            rounded = LIMIT_ROUNDING * module.force_limit
            return dataclasses.replace(module, limit_rounding=rounded)
        if isinstance(module, InnovationLoad):
            rounding = GATE_ROUNDING * module.min_speed + 1e-9  # m/s, so that it is a width also without a gate
            return InnovationLoad(module.gain, module.min_speed, None, rounding, module.initial_load)
        if isinstance(module, LoadStateObserver):
            return eqx.tree_at(lambda m: m.floor, module, None, is_leaf=lambda leaf: leaf is None)
        return module

    replaced = (Sensor, Actuator, InnovationLoad, LoadStateObserver)
    return jax.tree.map(smoothed, part, is_leaf=lambda node: isinstance(node, replaced))
