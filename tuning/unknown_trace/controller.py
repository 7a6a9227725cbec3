"""The controller of an unknown trace: a cascade, where the log shows its gains and it gives the logged command."""

import warnings
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from diffdrive.axis import Axis
from diffdrive.controllers.base import Feedforward, PDGains, Tracking
from diffdrive.controllers.cascade import Cascade
from diffdrive.controllers.pd import PD
from diffdrive.errors import DiffdriveError
from diffdrive.logs import Log
from diffdrive.logs.checks.consistency import EXPLAINED
from diffdrive.logs.checks.relation import controller_relation
from diffdrive.logs.checks.statistics import percent
from tuning.identification.controller.law import Reading
from tuning.identification.controller.workflow import ControllerEstimate, identify_controller

ROUNDING = 1e-5  # of the command: what the digits of a log leave
NO_FEEDFORWARD = 0.02  # share, below which a velocity feed-forward counts as none: what the gains are accurate to


class FirstController(NamedTuple):
    """The cascade or PD (None: unknown), what was estimated, and the sentence that says why."""

    controller: Cascade | PD | None
    estimate: ControllerEstimate | None
    why: str
    is_exact: bool = False  # whether it leaves nothing but rounding of the command


def first_controller(log: Log, axis: Axis) -> FirstController:
    """The log's cascade; unknown where it has no reference, its rows are snapshots, or the cascade does not give it."""
    if log.reference is None:
        return FirstController(None, None, "the trace has no reference")
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a search in a log of which nobody said that it has a cascade
            estimate = identify_controller(axis, log)
    except (DiffdriveError, np.linalg.LinAlgError) as problem:
        return FirstController(None, None, f"no cascade is seen: {problem}")
    if estimate.logs[0].reading is not Reading.EVERY_SAMPLE:
        return FirstController(None, estimate, "the rows are snapshots of a faster loop")
    if estimate.axis is None or not all(estimate.gain(name).determined for name in ("kp", "kv")):
        return FirstController(None, estimate, "the trace does not determine the gains")
    cascade = estimate.axis.controller
    assert isinstance(cascade, Cascade)
    tried = [(_misfit(log, axis, one), one) for one in _controllers(cascade, axis)]
    misfit, controller = min(reversed(tried), key=lambda one: max(one[0], ROUNDING))  # a PD where both are exact
    left = f"{percent(misfit)} % of the command" if misfit > ROUNDING else "the rounding of the command"
    if not misfit < EXPLAINED:
        return FirstController(None, estimate, f"a {controller.kind} with the gains that are seen leaves {left}")
    return FirstController(controller, estimate, f"this {controller.kind} leaves {left}", misfit <= ROUNDING)


def _controllers(found: Cascade, axis: Axis) -> list[Cascade | PD]:
    """The cascade that was found, in digits that a file has, and the PD that it is with full feed-forward alone."""
    digits = {name: float(f"{float(gain):.6g}") for name, gain in replace(axis, controller=found).gains.items()}
    cascade = replace(axis, controller=found).with_gains(**digits).controller
    assert isinstance(cascade, Cascade)
    cascade = replace(cascade, velocity_feedforward=float(f"{float(cascade.velocity_feedforward):.4g}"))
    has_integral = cascade.reset_time is not None or float(cascade.ki) > 0
    if has_integral or abs(float(cascade.velocity_feedforward) - 1.0) > NO_FEEDFORWARD:
        return [cascade]
    kp, kd = float(cascade.kp), float(cascade.kv)
    feedforward = None if cascade.feedforward is None else Feedforward.of(axis.drive.plant)
    return [cascade, PD(Tracking(PDGains(kp=float(f"{kp * kd:.6g}"), kd=kd), feedforward))]


def _misfit(log: Log, axis: Axis, controller: Cascade | PD) -> float:
    """What a controller leaves of the logged command, relative."""
    relation = controller_relation(log, replace(axis, controller=controller))
    replay = None if relation is None else relation.replay_as_logged()
    return np.inf if replay is None else float(replay[1].error)
