"""The command against mass and friction: what the log asks for beside the drive file, and what would explain it."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from diffdrive.axis import Axis
from diffdrive.logs.checks.dynamics import DynamicsEstimate, DynamicsFit, inverse_dynamics
from diffdrive.logs.checks.explanation import (
    FAULT_COST,
    ChannelFault,
    LogExplanation,
    evaluate_explanation,
    rank_explanations,
    rivals_of,
)
from diffdrive.logs.checks.factors import unit_error_text
from diffdrive.logs.checks.finding import CAUSES, Finding
from diffdrive.logs.checks.hypotheses import DECIMATION_FACTORS, is_on_grid
from diffdrive.logs.checks.relation import ControllerRelation, LoopSignals
from diffdrive.logs.checks.repair import Repair, ScaleChannel, SwapChannels
from diffdrive.logs.checks.rivals import causes_of, rivals_text
from diffdrive.logs.checks.statistics import derivative, longest_piece, sampling_period
from diffdrive.logs.log import Log

# Mass and friction must explain the command but for a tenth of its power, or they say nothing of it.
EXPLAINS = 0.3
# nats: without a filter no position is off its counts, and of ten loops one is ahead of its reference
NO_COUNTS_COST, LEADING_COST = 2 * FAULT_COST, float(np.log(10.0))
LEADS = -0.5  # correlation of following error and speed: a loop that follows has 0.9


def check_force_balance(log: Log, description: Axis) -> Iterator[Finding]:
    """The command against mass and friction of the drive file, where no controller is known that gives it."""
    relation = ControllerRelation(description, log, longest_piece(log))
    dynamics = relation.dynamics(relation.logged)
    if dynamics is None or dynamics.misfit > EXPLAINS:
        yield Finding(
            "note",
            "command",
            "the unit of the command cannot be checked: neither the drive file's controller nor its mass and friction "
            "explain it",
            "make sure that it is in newtons on the table",
            "gain",
        )
        return
    ranking = rank_explanations([_evaluate(relation, *one) for one in _hypotheses(relation, dynamics)])
    best, rivals = ranking[0], rivals_of(ranking)
    yield from _fault_findings(best, rivals)
    if not best.faults:
        yield from other_machine(
            best.dynamics, description, tuple(sorted({c for one in rivals for c, _ in one.causes}))
        )


def _evaluate(relation: ControllerRelation, faults: tuple[ChannelFault, ...], signals: LoopSignals) -> LogExplanation:
    """The explanation; what makes the two columns look exchanged asks for a fault."""
    found = evaluate_explanation(relation, faults, signals, None)
    named = {one.cause for one in faults}
    if "swapped" in named or not looks_swapped(relation):
        return found
    return replace(found, cost=found.cost + LEADING_COST + (0.0 if "filtered" in named else NO_COUNTS_COST))


def _hypotheses(
    relation: ControllerRelation, dynamics: DynamicsFit
) -> Iterator[tuple[tuple[ChannelFault, ...], LoopSignals]]:
    """What may have happened to the log, and its signals without that."""
    now = relation.logged
    yield (), now
    minus = ChannelFault("reversed", "command", {"ratio": -1.0}, (ScaleChannel("command", -1.0),))
    for signs, sign in (((), 1.0), ((minus,), -1.0)):
        yield signs, now._replace(command=sign * now.command)
        known = [one.value * sign for one in (dynamics.mass, dynamics.friction, dynamics.viscous) if one.determined]
        ratios = [value for value in known if value > 0]
        if ratios:
            ratio = float(np.exp(np.median(np.log(ratios))))
            unit = ChannelFault("gain", "command", {"ratio": ratio}, (ScaleChannel("command", 1 / ratio),))
            yield (*signs, unit), now._replace(command=sign * now.command / ratio)
    if dynamics.mass.determined and dynamics.mass.value > 0:
        ratio = dynamics.mass.value
        both = (
            ScaleChannel("position", 1 / ratio),
            *((ScaleChannel("reference", 1 / ratio),) * (relation.log.reference is not None)),
        )
        lengths = ChannelFault("gain", "position", {"ratio": ratio}, both)
        yield (lengths,), now._replace(position=now.position / ratio, reference=now.reference / ratio)
    if looks_swapped(relation):
        exchanged = ChannelFault("swapped", "position", {}, (SwapChannels("reference", "position"),))
        yield (exchanged,), now._replace(reference=now.position, position=now.reference)
        yield (ChannelFault("filtered", "position", {}),), now
    for count in DECIMATION_FACTORS:
        slower = ChannelFault("decimated", "time", {"skipped": float(count)}, (ScaleChannel("time", float(count)),))
        yield (slower,), now._replace(period=count * now.period)
    if np.min(now.command) >= 0:
        speed = derivative(now.position, now.period, 1)
        yield (
            (ChannelFault("rectified", "command", {}),),
            now._replace(command=now.command * np.sign(speed)),
        )


def looks_swapped(relation: ControllerRelation) -> bool:
    """Whether the reference lies on the scale's counts and the position does not, but is ahead of the reference.

    Counts alone say nothing: a set-point may be rounded to them, and a simulated or averaged position has none.
    """
    now, stated = relation.logged, relation.description.drive.sensor.resolution
    if stated is None or relation.log.reference is None or not _leads_reference(now):
        return False
    return is_on_grid(now.reference, float(stated)) and not is_on_grid(now.position, float(stated))


def _leads_reference(now: LoopSignals) -> bool:
    """Whether the position moves before the reference does: a loop follows."""
    error, speed = now.reference - now.position, derivative(now.position, now.period, 1)
    return np.std(error) > 0 and np.std(speed) > 0 and float(np.corrcoef(error, speed)[0, 1]) < LEADS


def _fault_findings(best: LogExplanation, rivals: list[LogExplanation]) -> Iterator[Finding]:
    unchanged = any(not one.faults for one in rivals)
    causes = tuple("other machine" if one == "nothing" else one for one in causes_of(best, rivals))
    if any(one.cause == "gain" for one in best.faults):  # that of a machine which is known within a factor of two alone
        causes = (*causes, *(("other machine",) if "other machine" not in causes else ()))
    doubts = rivals_text(best, rivals, lambda fault: _DESCRIPTIONS[fault.cause](fault)[1], CAUSES["other machine"])
    mendable = not causes and all(one.steps for one in best.faults)
    for fault in best.faults:
        found, mend = _DESCRIPTIONS[fault.cause](fault)
        repair = Repair(fault.steps) if mendable else None
        yield Finding(
            "warning" if unchanged else "fatal", fault.channel, found, mend + doubts, fault.cause, causes, repair
        )


def _tolerance_range(middle: float) -> str:
    """What the drive file's tolerance leaves of a factor."""
    return f"{middle / 2:.3g} to {2 * middle:.3g}"


def _gain(fault: ChannelFault) -> tuple[str, str]:
    ratio = fault.numbers["ratio"]
    if fault.channel == "position":
        return (
            f"position and reference are {ratio:.3g} times what mass of the drive file asks for, while friction is in "
            f"order{unit_error_text(ratio)}",
            f"correct the unit of position and reference: a factor of {_tolerance_range(1 / ratio)}, as far as "
            "the mass is the drive file's within a factor of two",
        )
    return (
        f"the command is {ratio:.3g} times what mass and friction of the drive file ask for: volts, amperes or per "
        "cent taken as newtons?",
        f"give the force constant (about {1 / ratio:.3g} N per unit of the command, {_tolerance_range(1 / ratio)} N "
        "where mass and friction are the drive file's within a factor of two), or correct the drive file",
    )


def _reversed(fault: ChannelFault) -> tuple[str, str]:
    return (
        "the command pushes against the motion: its sign is reversed",
        'reverse the command, in newtons by --unit command=-N or [units] command = "-N" (in volts -V), or position and '
        "reference",
    )


def _decimated(fault: ChannelFault) -> tuple[str, str]:
    count = fault.numbers["skipped"]
    return (
        f"mass and friction are those of the drive file if the time runs {count:.0f} times slower: only one row in "
        f"{count:.0f} was kept, and the time was counted at the full rate?",
        f"multiply the time by {count:.0f}, or log every sample",
    )


_DESCRIPTIONS = {
    "gain": _gain,
    "reversed": _reversed,
    "decimated": _decimated,
    "swapped": lambda fault: (
        "reference and position are exchanged: the reference lies on the counts of the scale and follows the position, "
        "which has no counts",
        "exchange the two columns",
    ),
    "filtered": lambda fault: (
        "the position is off the counts of the scale and ahead of the reference: it was averaged or resampled",
        "log the raw counts",
    ),
    "rectified": lambda fault: (
        "the command is never negative, although the table moves both ways: its absolute value was logged",
        "log the command with its sign",
    ),
}


def other_machine(found: DynamicsFit | None, description: Axis, rivals: tuple[str, ...] = ()) -> Iterator[Finding]:
    """Mass and friction that the log asks for, where they are not those of the drive file."""
    if found is None or not found.changed or not found.physical or found.misfit > EXPLAINS:
        return
    if found.one_sided:
        yield _constant_force(found, description)
        return
    nominal = nominal_friction(description)
    asked = [
        _value_text("a mass of", found.mass, float(description.drive.plant.mass), "kg"),
        _value_text("Coulomb friction of", found.positive, nominal[0], "N forwards"),
        _value_text("and", found.negative, nominal[1], "N backwards"),
    ]
    beyond = "by more than a factor of two " if found.beyond_tolerance else ""
    yield Finding(
        "warning" if found.beyond_tolerance else "note",
        "command",
        f"the log asks for {', '.join(one for one in asked if one)}: {beyond}other than the drive file's",
        "the log of another machine, a load that no column holds, a machine that has changed, or a drive file that is "
        "not its own; several logs of one machine, or its log of another day, decide",
        "other machine",
        rivals,
    )


def _constant_force(found: DynamicsFit, description: Axis) -> Finding:
    """Friction that is the drive file's in the mean, but not in either direction: a constant force, or an offset."""
    forwards, backwards = nominal_friction(description)
    newtons = ((found.positive.value - 1.0) * forwards - (found.negative.value - 1.0) * backwards) / 2
    return Finding(
        "warning" if found.beyond_tolerance else "note",
        "command",
        f"mass and mean friction are the drive file's, but beside them the command carries a constant {newtons:.4g} N",
        "an offset of the amplifier or of the logger, or a tilt or weight that plant.constant_force does not state; "
        "friction that differs between the directions would look alike; a log of the axis turned round decides",
        "offset",
        ("other machine",),
    )


def nominal_friction(description: Axis) -> tuple[float, float]:
    """Coulomb friction (N) of the drive file without an applied load, forwards and backwards."""
    friction = description.drive.friction
    screw, guide, pressed = friction.coulomb_screw, friction.load_coefficient, float(friction.initial_load)
    return (
        float(screw.positive) + float(guide.positive) * pressed,
        float(screw.negative) + float(guide.negative) * pressed,
    )


def _value_text(what: str, one: DynamicsEstimate, nominal: float, unit: str) -> str:
    return f"{what} {one.value * nominal:.3g} {unit} ({one.value:.2g} times)" if nominal else ""


def command_sign(log: Log) -> Iterator[Finding]:
    """Friction costs force in the direction of motion: a command that pushes against every motion is reversed."""
    piece, step = longest_piece(log), sampling_period(log)
    force = log.command[piece] + (0.0 if log.disturbance is None else log.disturbance[piece])
    found = inverse_dynamics(log.position[piece], force, step)
    if found is None or found.friction.positive or found.misfit > EXPLAINS:
        return
    mass = "" if found.mass.positive else " and inertia"
    yield Finding(
        "fatal",
        "command",
        f"the command pushes against the motion, by {-found.friction.value:.4g} N both ways: its sign is reversed, or "
        f"that of position and reference, or these two are exchanged: friction{mass} would be negative",
        'reverse the command, in newtons by --unit command=-N or [units] command = "-N" (in volts -V), or position '
        "and reference; a drive file with the controller decides",
        "reversed",
        ("swapped",),
    )
