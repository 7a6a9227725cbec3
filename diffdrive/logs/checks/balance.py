"""The command against mass and friction: what the log implies beside the drive file, and what would explain it."""

from collections.abc import Callable, Iterator
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
from diffdrive.logs.checks.relation import ControllerRelation, ControllerSignals
from diffdrive.logs.checks.repair import Repair, ScaleChannel, SwapChannels
from diffdrive.logs.checks.rivals import causes_of, rivals_text
from diffdrive.logs.checks.statistics import derivative, longest_piece, sampling_period
from diffdrive.logs.log import Log

# Mass and friction must explain the command but for a tenth of its power, or they say nothing of it.
EXPLAINS = 0.3
# nats: without a filter no position is off its counts, and of ten loops one is ahead of its reference
NO_COUNTS_COST, LEADING_COST = 2 * FAULT_COST, float(np.log(10.0))
LEADS = -0.5  # correlation of following error and speed: a loop that follows has 0.9


def check_force_balance(log: Log, axis: Axis) -> Iterator[Finding]:
    """The command against mass and friction of the drive file, where no known controller reproduces it."""
    relation = ControllerRelation(axis, log, longest_piece(log))
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
    ranking = rank_explanations([_evaluate(relation, *rival) for rival in _hypotheses(relation, dynamics)])
    best, rivals = ranking[0], rivals_of(ranking)
    yield from _fault_findings(best, rivals)
    if not best.faults:
        yield from other_machine(
            best.dynamics, axis, tuple(sorted({cause for rival in rivals for cause, _ in rival.causes}))
        )


def _evaluate(
    relation: ControllerRelation, faults: tuple[ChannelFault, ...], signals: ControllerSignals
) -> LogExplanation:
    """The explanation and its cost; columns that look swapped need a fault to explain it."""
    explanation = evaluate_explanation(relation, faults, signals, None)
    causes = {fault.cause for fault in faults}
    if "swapped" in causes or not looks_swapped(relation):
        return explanation
    return replace(
        explanation, cost=explanation.cost + LEADING_COST + (0.0 if "filtered" in causes else NO_COUNTS_COST)
    )


def _hypotheses(
    relation: ControllerRelation, dynamics: DynamicsFit
) -> Iterator[tuple[tuple[ChannelFault, ...], ControllerSignals]]:
    """The faults of each hypothesis, and the signals as they would be without them."""
    logged = relation.logged
    yield (), logged
    reversal = ChannelFault("reversed", "command", {"ratio": -1.0}, (ScaleChannel("command", -1.0),))
    for sign_faults, sign in (((), 1.0), ((reversal,), -1.0)):
        yield sign_faults, logged._replace(command=sign * logged.command)
        ratios_of_estimates = [
            estimate.value * sign
            for estimate in (dynamics.mass, dynamics.friction, dynamics.viscous)
            if estimate.is_determined
        ]
        ratios = [value for value in ratios_of_estimates if value > 0]
        if ratios:
            ratio = float(np.exp(np.median(np.log(ratios))))
            unit = ChannelFault("gain", "command", {"ratio": ratio}, (ScaleChannel("command", 1 / ratio),))
            yield (*sign_faults, unit), logged._replace(command=sign * logged.command / ratio)
    if dynamics.mass.is_determined and dynamics.mass.value > 0:
        ratio = dynamics.mass.value
        scaling = (
            ScaleChannel("position", 1 / ratio),
            *((ScaleChannel("reference", 1 / ratio),) * (relation.log.reference is not None)),
        )
        unit_fault = ChannelFault("gain", "position", {"ratio": ratio}, scaling)
        yield (unit_fault,), logged._replace(position=logged.position / ratio, reference=logged.reference / ratio)
    if looks_swapped(relation):
        swap_fault = ChannelFault("swapped", "position", {}, (SwapChannels("reference", "position"),))
        yield (swap_fault,), logged._replace(reference=logged.position, position=logged.reference)
        yield (ChannelFault("filtered", "position", {}),), logged
    for count in DECIMATION_FACTORS:
        decimation = ChannelFault("decimated", "time", {"skipped": float(count)}, (ScaleChannel("time", float(count)),))
        yield (decimation,), logged._replace(period=count * logged.period)
    if np.min(logged.command) >= 0:
        speed = derivative(logged.position, logged.period, 1)
        yield (
            (ChannelFault("rectified", "command", {}),),
            logged._replace(command=logged.command * np.sign(speed)),
        )


def looks_swapped(relation: ControllerRelation) -> bool:
    """Whether the reference lies on the scale's counts and the position does not, but leads the reference.

    Counts alone say nothing: a set-point may be rounded to them, and a simulated or averaged position has none.
    """
    logged, resolution = relation.logged, relation.axis.drive.sensor.resolution
    if resolution is None or relation.log.reference is None or not _leads_reference(logged):
        return False
    return is_on_grid(logged.reference, float(resolution)) and not is_on_grid(logged.position, float(resolution))


def _leads_reference(signals: ControllerSignals) -> bool:
    """Whether the position leads the reference: in a loop it lags."""
    error, speed = signals.reference - signals.position, derivative(signals.position, signals.period, 1)
    return np.std(error) > 0 and np.std(speed) > 0 and float(np.corrcoef(error, speed)[0, 1]) < LEADS


def _fault_findings(best: LogExplanation, rivals: list[LogExplanation]) -> Iterator[Finding]:
    may_be_unchanged = any(not rival.faults for rival in rivals)
    causes = tuple("other machine" if cause == "nothing" else cause for cause in causes_of(best, rivals))
    if any(fault.cause == "gain" for fault in best.faults):  # the machine itself is known within a factor of two
        causes = (*causes, *(("other machine",) if "other machine" not in causes else ()))
    rivals_note = rivals_text(best, rivals, lambda fault: _DESCRIPTIONS[fault.cause](fault)[1], CAUSES["other machine"])
    is_repairable = not causes and all(fault.steps for fault in best.faults)
    for fault in best.faults:
        message, remedy = _DESCRIPTIONS[fault.cause](fault)
        repair = Repair(fault.steps) if is_repairable else None
        yield Finding(
            "warning" if may_be_unchanged else "fatal",
            fault.channel,
            message,
            remedy + rivals_note,
            fault.cause,
            causes,
            repair,
        )


def _tolerance_range(middle: float) -> str:
    """The range of a factor within the drive file's tolerance."""
    return f"{middle / 2:.3g} to {2 * middle:.3g}"


def _gain(fault: ChannelFault) -> tuple[str, str]:
    ratio = fault.parameters["ratio"]
    if fault.channel == "position":
        return (
            f"position and reference are {ratio:.3g} times what the mass of the drive file implies, while friction "
            f"agrees{unit_error_text(ratio)}",
            f"correct the unit of position and reference: a factor of {_tolerance_range(1 / ratio)}, as far as "
            "the mass is the drive file's within a factor of two",
        )
    return (
        f"the command is {ratio:.3g} times what mass and friction of the drive file imply: volts, amperes or "
        "per cent taken as newtons?",
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
    count = fault.parameters["skipped"]
    return (
        f"mass and friction are those of the drive file if the time runs {count:.0f} times slower: only one row in "
        f"{count:.0f} was kept, and the time was counted at the full rate?",
        f"multiply the time by {count:.0f}, or log every sample",
    )


_DESCRIPTIONS: dict[str, Callable[[ChannelFault], tuple[str, str]]] = {
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


def other_machine(dynamics: DynamicsFit | None, axis: Axis, rivals: tuple[str, ...] = ()) -> Iterator[Finding]:
    """Mass and friction that the log implies, where they are not those of the drive file."""
    if dynamics is None or not dynamics.differs_from_nominal or not dynamics.is_physical or dynamics.misfit > EXPLAINS:
        return
    if dynamics.is_constant_force:
        yield _constant_force(dynamics, axis)
        return
    nominal = nominal_friction(axis)
    values = [
        _value_text("a mass of", dynamics.mass, float(axis.drive.plant.mass), "kg"),
        _value_text("Coulomb friction of", dynamics.friction_positive, nominal[0], "N forwards"),
        _value_text("and", dynamics.friction_negative, nominal[1], "N backwards"),
    ]
    tolerance_text = "by more than a factor of two " if dynamics.beyond_tolerance else ""
    yield Finding(
        "warning" if dynamics.beyond_tolerance else "note",
        "command",
        f"the log implies {', '.join(value for value in values if value)}: {tolerance_text}other than the drive file's",
        "the log of another machine, a load that no column holds, a machine that has changed, or a drive file that is "
        "not its own; several logs of one machine, or its log of another day, decide",
        "other machine",
        rivals,
    )


def _constant_force(dynamics: DynamicsFit, axis: Axis) -> Finding:
    """Friction that is the drive file's in the mean, but not in either direction: a constant force, or an offset."""
    forwards, backwards = nominal_friction(axis)
    newtons = (
        (dynamics.friction_positive.value - 1.0) * forwards - (dynamics.friction_negative.value - 1.0) * backwards
    ) / 2
    return Finding(
        "warning" if dynamics.beyond_tolerance else "note",
        "command",
        f"mass and mean friction are the drive file's, but beside them the command carries a constant {newtons:.4g} N",
        "an offset of the amplifier or of the logger, or a weight that plant.constant_force does not state; "
        "friction that differs between the directions would look alike; a log of the axis turned round decides",
        "offset",
        ("other machine",),
    )


def nominal_friction(axis: Axis) -> tuple[float, float]:
    """Coulomb friction (N) of the drive file without an applied load, forwards and backwards."""
    level = axis.drive.friction.coulomb_at(0.0)
    return float(level.positive), float(level.negative)


def _value_text(label: str, estimate: DynamicsEstimate, nominal: float, unit: str) -> str:
    return f"{label} {estimate.value * nominal:.3g} {unit} ({estimate.value:.2g} times)" if nominal else ""


def command_sign(log: Log) -> Iterator[Finding]:
    """Friction costs force in the direction of motion: a command that pushes against every motion is reversed."""
    piece, period = longest_piece(log), sampling_period(log)
    force = log.command[piece] + (0.0 if log.disturbance is None else log.disturbance[piece])
    dynamics = inverse_dynamics(log.position[piece], force, period)
    if dynamics is None or dynamics.friction.may_be_positive or dynamics.misfit > EXPLAINS:
        return
    inertia_text = "" if dynamics.mass.may_be_positive else " and inertia"
    yield Finding(
        "fatal",
        "command",
        f"the command pushes against the motion, by {-dynamics.friction.value:.4g} N both ways: its sign is reversed, "
        f"or that of position and reference, or these two are exchanged: friction{inertia_text} would be negative",
        'reverse the command, in newtons by --unit command=-N or [units] command = "-N" (in volts -V), or position '
        "and reference; a drive file with the controller decides",
        "reversed",
        ("swapped",),
    )
