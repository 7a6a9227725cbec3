"""The command against mass and friction: what the log asks for beside the drive file, and what would explain it."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from diffdrive.axis import Axis
from diffdrive.logs.checks.dynamics import Dynamics, Estimate, inverse_dynamics
from diffdrive.logs.checks.explanation import FAULT, Explanation, Fault, judged, ranked, rivals_of
from diffdrive.logs.checks.factors import name_in_brackets
from diffdrive.logs.checks.finding import CAUSES, Finding
from diffdrive.logs.checks.hypotheses import SKIPPED, on_grid
from diffdrive.logs.checks.relation import Relation, Signals
from diffdrive.logs.checks.repair import Repair, Scale, Swap
from diffdrive.logs.checks.rivals import causes_of, told
from diffdrive.logs.checks.statistics import derivative, longest_piece, mean_step
from diffdrive.logs.log import Log

# Mass and friction must explain the command but for a tenth of its power, or they say nothing of it.
EXPLAINS = 0.3
# nats: without a filter no position is off its counts, and of ten loops one is ahead of its reference
NO_COUNTS, AHEAD = 2 * FAULT, float(np.log(10.0))
LEADS = -0.5  # correlation of following error and speed: a loop that follows has 0.9


def command(log: Log, description: Axis) -> Iterator[Finding]:
    """The command against mass and friction of the drive file, where no controller is known that gives it."""
    relation = Relation(description, log, longest_piece(log))
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
    ranking = ranked([_judged(relation, *one) for one in _hypotheses(relation, dynamics)])
    best, rivals = ranking[0], rivals_of(ranking)
    yield from _faults(best, rivals)
    if not best.faults:
        yield from machine(best.dynamics, description, tuple(sorted({c for one in rivals for c, _ in one.causes})))


def _judged(relation: Relation, faults: tuple[Fault, ...], signals: Signals) -> Explanation:
    """The explanation; what makes the two columns look exchanged asks for a fault."""
    found = judged(relation, faults, signals, None)
    named = {one.cause for one in faults}
    if "swapped" in named or not looks_exchanged(relation):
        return found
    return replace(found, cost=found.cost + AHEAD + (0.0 if "filtered" in named else NO_COUNTS))


def _hypotheses(relation: Relation, dynamics: Dynamics) -> Iterator[tuple[tuple[Fault, ...], Signals]]:
    """What may have happened to the log, and its signals without that."""
    now = relation.logged
    yield (), now
    minus = Fault("reversed", "command", {"ratio": -1.0}, (Scale("command", -1.0),))
    for signs, sign in (((), 1.0), ((minus,), -1.0)):
        yield signs, now._replace(command=sign * now.command)
        known = [one.value * sign for one in (dynamics.mass, dynamics.friction, dynamics.viscous) if one.determined]
        ratios = [value for value in known if value > 0]
        if ratios:
            ratio = float(np.exp(np.median(np.log(ratios))))
            unit = Fault("gain", "command", {"ratio": ratio}, (Scale("command", 1 / ratio),))
            yield (*signs, unit), now._replace(command=sign * now.command / ratio)
    if dynamics.mass.determined and dynamics.mass.value > 0:
        ratio = dynamics.mass.value
        both = (
            Scale("position", 1 / ratio),
            *((Scale("reference", 1 / ratio),) * (relation.log.reference is not None)),
        )
        lengths = Fault("gain", "position", {"ratio": ratio}, both)
        yield (lengths,), now._replace(position=now.position / ratio, reference=now.reference / ratio)
    if looks_exchanged(relation):
        exchanged = Fault("swapped", "position", {}, (Swap("reference", "position"),))
        yield (exchanged,), now._replace(reference=now.position, position=now.reference)
        yield (Fault("filtered", "position", {}),), now
    for count in SKIPPED:
        slower = Fault("decimated", "time", {"skipped": float(count)}, (Scale("time", float(count)),))
        yield (slower,), now._replace(period=count * now.period)
    if np.min(now.command) >= 0:
        speed = derivative(now.position, now.period, 1)
        yield (Fault("rectified", "command", {}),), now._replace(command=now.command * np.sign(speed))


def looks_exchanged(relation: Relation) -> bool:
    """Whether the reference lies on the scale's counts and the position does not, but is ahead of the reference.

    Counts alone say nothing: a set-point may be rounded to them, and a simulated or averaged position has none.
    """
    now, stated = relation.logged, relation.description.drive.sensor.resolution
    if stated is None or relation.log.reference is None or not _is_ahead(now):
        return False
    return on_grid(now.reference, float(stated)) and not on_grid(now.position, float(stated))


def _is_ahead(now: Signals) -> bool:
    """Whether the position moves before the reference does: a loop follows."""
    error, speed = now.reference - now.position, derivative(now.position, now.period, 1)
    return np.std(error) > 0 and np.std(speed) > 0 and float(np.corrcoef(error, speed)[0, 1]) < LEADS


def _faults(best: Explanation, rivals: list[Explanation]) -> Iterator[Finding]:
    unchanged = any(not one.faults for one in rivals)
    causes = tuple("other machine" if one == "nothing" else one for one in causes_of(best, rivals))
    if any(one.cause == "gain" for one in best.faults):  # that of a machine which is known within a factor of two alone
        causes = (*causes, *(("other machine",) if "other machine" not in causes else ()))
    doubts = told(best, rivals, lambda fault: _SENTENCES[fault.cause](fault)[1], CAUSES["other machine"])
    mendable = not causes and all(one.steps for one in best.faults)
    for fault in best.faults:
        found, mend = _SENTENCES[fault.cause](fault)
        repair = Repair(fault.steps) if mendable else None
        yield Finding(
            "warning" if unchanged else "fatal", fault.channel, found, mend + doubts, fault.cause, causes, repair
        )


def _range(middle: float) -> str:
    """What the drive file's tolerance leaves of a factor."""
    return f"{middle / 2:.3g} to {2 * middle:.3g}"


def _gain(fault: Fault) -> tuple[str, str]:
    ratio = fault.numbers["ratio"]
    if fault.channel == "position":
        return (
            f"position and reference are {ratio:.3g} times what mass of the drive file asks for, while friction is in "
            f"order{name_in_brackets(ratio)}",
            f"correct the unit of position and reference: a factor of {_range(1 / ratio)}, as far as the mass is the "
            "drive file's within a factor of two",
        )
    return (
        f"the command is {ratio:.3g} times what mass and friction of the drive file ask for: volts, amperes or per "
        "cent taken as newtons?",
        f"give the force constant (about {1 / ratio:.3g} N per unit of the command, {_range(1 / ratio)} N where mass "
        "and friction are the drive file's within a factor of two), or correct the drive file",
    )


def _reversed(fault: Fault) -> tuple[str, str]:
    return (
        "the command pushes against the motion: its sign is reversed",
        'reverse the command, in newtons by --unit command=-N or [units] command = "-N" (in volts -V), or position and '
        "reference",
    )


def _decimated(fault: Fault) -> tuple[str, str]:
    count = fault.numbers["skipped"]
    return (
        f"mass and friction are those of the drive file if the time runs {count:.0f} times slower: only one row in "
        f"{count:.0f} was kept, and the time was counted at the full rate?",
        f"multiply the time by {count:.0f}, or log every sample",
    )


_SENTENCES = {
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


def machine(found: Dynamics | None, description: Axis, rivals: tuple[str, ...] = ()) -> Iterator[Finding]:
    """Mass and friction that the log asks for, where they are not those of the drive file."""
    if found is None or not found.changed or not found.physical or found.misfit > EXPLAINS:
        return
    if found.one_sided:
        yield _constant(found, description)
        return
    nominal = nominal_friction(description)
    asked = [
        _value("a mass of", found.mass, float(description.drive.plant.mass), "kg"),
        _value("Coulomb friction of", found.positive, nominal[0], "N forwards"),
        _value("and", found.negative, nominal[1], "N backwards"),
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


def _constant(found: Dynamics, description: Axis) -> Finding:
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


def _value(what: str, one: Estimate, nominal: float, unit: str) -> str:
    return f"{what} {one.value * nominal:.3g} {unit} ({one.value:.2g} times)" if nominal else ""


def command_sign(log: Log) -> Iterator[Finding]:
    """Friction costs force in the direction of motion: a command that pushes against every motion is reversed."""
    piece, step = longest_piece(log), mean_step(log)
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
