"""A model's friction and hysteresis along logged motions, to be laid beside what was measured."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from diffdrive.logs import Log
from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import as_arrays
from tuning.identification.curves import HysteresisCurves, hysteresis_curves
from tuning.identification.friction_along import friction_along
from tuning.identification.gaps import delay_of
from tuning.identification.problem import long_pieces


def gap_free_pieces(logs: Sequence[Log]) -> list[Log]:
    """The gap-free stretches in the order of `tuning.identification.problem.lanes_of`, each as a log of its own."""
    return [_piece_of(log, piece) for log in logs for piece in long_pieces(log)]


def _piece_of(log: Log, piece: slice) -> Log:
    channels: dict[str, Any] = {name: values[piece] for name, values in log.channels.items()}
    return dataclasses.replace(log, gaps=(), **channels)


_along = eqx.filter_jit(friction_along)


def modelled_friction(drive: Drive, stretch: Log, velocity: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Friction and damping (N) of `drive` at these velocities (m/s) of a stretch, the bristle relaxed at the start."""
    load = np.zeros_like(velocity) if stretch.load is None else stretch.load
    arguments = as_arrays((drive, jnp.asarray(velocity), jnp.asarray(load), jnp.asarray(1.0 / stretch.rate)))
    return np.asarray(_along(*arguments).friction)


def modelled_hysteresis(
    drive: Drive, reference: Drive, stretches: Sequence[Log], velocities: Sequence[Float[np.ndarray, " n"]]
) -> HysteresisCurves:
    """Hysteresis curves of the friction of `drive`, made as curves measured with `reference` are made.

    The command that would have moved the mass of `reference` along each stretch against that friction takes the place
    of the logged one. So the filters blur the model as they blur the measurement, and what the hold and the delay of
    the command do to a measured curve (at a fast reversal, a good part of its slope) they do to the model's.
    """
    rubbed = [
        dataclasses.replace(stretch, command=_command(drive, reference, stretch, velocity), disturbance=None)
        for stretch, velocity in zip(stretches, velocities, strict=True)
    ]
    return hysteresis_curves(rubbed, reference)


def _command(
    drive: Drive, reference: Drive, stretch: Log, velocity: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """The force (N) over each period, given as early as the delay of `reference` asks."""
    friction = modelled_friction(drive, stretch, velocity)
    sample = np.arange(len(velocity))
    mean = np.append(0.5 * (friction[1:] + friction[:-1]), friction[-1])
    inertia = float(reference.plant.mass) * stretch.rate * np.append(np.diff(velocity), 0.0)
    return np.interp(sample + delay_of(reference), sample, mean + inertia - float(drive.plant.constant_force))
