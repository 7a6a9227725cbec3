"""Which hypothesis explains a log: rivals compete by what each leaves unexplained and by what it has to assume.

An explanation is a set of faults. Its cost is minus the logarithm of its posterior probability, up to a constant, in
nats:

- each fault costs ln 100: of a hundred logs one has it;
- what the controller leaves of the command counts by the logarithm of its RMS, for each independent sample;
- what the position leaves of the reference counts likewise, as far as no loop at its bandwidth explains it;
- mass and friction that the repaired log implies count by how far they are from the drive file's tolerance.

Explanations within ln 100 of the best are its rivals: the log does not rule them out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diffdrive.logs.checks.dynamics import CHANGED_STD, DynamicsFit
from diffdrive.logs.checks.hypotheses import Hypothesis
from diffdrive.logs.checks.relation import ControllerRelation, ControllerSignals
from diffdrive.logs.checks.repair import AddToChannel, RepairStep, ScaleChannel
from diffdrive.logs.checks.statistics import RobustFit

FAULT_COST = float(np.log(100.0))
DECISIVE = float(np.log(100.0))
EQUAL_WITHIN = 0.02  # relative: amounts of one repair that are the same for all practical purposes
# Some hundred samples are one correlation time of what a controller leaves: that many count as one.
SAMPLES_PER_INDEPENDENT = 100.0
# What is left below these shares is explained: a log of six digits, and a loop that lags by 6 degrees.
SMALLEST_COMMAND_ERROR, SMALLEST_TRACKING_ERROR = 1e-5, 0.1
IMPOSSIBLE = 1e6  # nats: no such machine exists
LARGEST_DYNAMICS_COST = 100.0  # nats: no machine is less likely than that it is not as we think
# A force constant is known to some per cent; an error above a tenth is a unit or a wrong gain.
WRONG_UNIT, OFF = 0.1, 0.005
# A match beyond this says nothing about a few per cent.
ROUGH = 0.1
# A wrong initial load of an observer scales friction, and so most of the command: in logs cut out of others by up
# to 18 times what it leaves unexplained.
INITIAL_LOAD = 20.0
# An amplifier's offset is some per cent of its rated current; a zero is off by anything from 1 um to 0.1 m, 12 e-folds.
AMPLIFIER_OFFSET, ZERO_OFFSET, SMALLEST_ZERO = 0.05, float(np.log(12.0)), 1e-6


@dataclass(frozen=True)
class ChannelFault:
    """One fault of a channel, how large it is, and the steps that undo it (empty where nothing does)."""

    cause: str
    channel: str
    parameters: dict[str, float]
    steps: tuple[RepairStep, ...] = ()


@dataclass(frozen=True)
class LogExplanation:
    """Faults, what they leave of the command, the repaired signals, and the cost (nats)."""

    faults: tuple[ChannelFault, ...]
    fit: RobustFit | None
    signals: ControllerSignals
    dynamics: DynamicsFit | None
    cost: float
    relation: ControllerRelation | None = None  # while mass and friction are not yet evaluated
    hypothesis: Hypothesis | None = None  # that it interprets

    @property
    def causes(self) -> frozenset[tuple[str, str]]:
        """What is wrong, without numbers."""
        return frozenset((fault.cause, fault.channel) for fault in self.faults)

    @property
    def steps(self) -> tuple[RepairStep, ...]:
        """What undoes all of it."""
        return tuple(step for fault in self.faults for step in fault.steps)


def interpretations(relation: ControllerRelation, hypothesis: Hypothesis, fit: RobustFit) -> list[LogExplanation]:
    """All that a hypothesis and its fit may mean: a factor is a unit or a gain, a constant an offset of one channel."""
    return [replace(explanation, hypothesis=hypothesis) for explanation in _interpretations(relation, hypothesis, fit)]


def _interpretations(relation: ControllerRelation, hypothesis: Hypothesis, fit: RobustFit) -> list[LogExplanation]:
    faults = faults_of(hypothesis)
    signals = hypothesis.signals
    if hypothesis.regressors and hypothesis.cause != "rectified":  # the factors are those of the controller's gains
        if hypothesis.cause == "offset":
            faults = (_zero_offset(relation, float(fit.coefficients[1] / fit.coefficients[0])),)
        elif not _stabilises(hypothesis, fit) or _has_constant(relation, signals, fit):
            return []
        else:
            faults = (replace(faults[0], parameters=faults[0].parameters | _part_factors(hypothesis, fit)),)
        explanation = evaluate_explanation(relation, faults, signals, fit)
        return [replace(explanation, cost=explanation.cost + _parameter_cost(len(hypothesis.regressors) - 1, fit))]
    explanations = []
    ratio, constant = float(fit.coefficients[0]), float(fit.coefficients[-1])
    has_coarse_steps = hypothesis.cause == "rounded" and hypothesis.channel != "command"
    if has_coarse_steps:  # it is judged by smoothed signals, but mass and friction by those of the log
        signals = relation.logged
    for factor_faults, apply_factor in _factor_interpretations(relation, fit, ratio, has_coarse_steps):
        for offset_faults, constant_to_subtract in _constant_interpretations(relation, signals, fit, ratio, constant):
            repaired = apply_factor(signals._replace(command=signals.command - constant_to_subtract))
            explanations.append(
                evaluate_explanation(relation, (*faults, *offset_faults, *factor_faults), repaired, fit)
            )
    return explanations


def faults_of(hypothesis: Hypothesis) -> tuple[ChannelFault, ...]:
    """The fault of a hypothesis; none of the log as it is."""
    if not hypothesis.cause:
        return ()
    return (ChannelFault(hypothesis.cause, hypothesis.channel, dict(hypothesis.parameters), hypothesis.steps),)


def _parameter_cost(count: int, fit: RobustFit) -> float:
    """What free parameters cost, each by the Bayesian information criterion."""
    return 0.5 * count * float(np.log(max(1.0, len(fit.residual) / SAMPLES_PER_INDEPENDENT)))


def _stabilises(hypothesis: Hypothesis, fit: RobustFit) -> bool:
    """Whether a controller's gains are above zero, as in every loop that follows its reference."""
    taps = int(hypothesis.parameters.get("taps", 0))
    gains = fit.coefficients[: taps or hypothesis.gain_count]
    if taps:  # on the last errors: their sum is the stiffness, their first moment minus the damping
        return float(np.sum(gains)) > 0 and float(np.arange(taps) @ gains) < 0
    return bool(np.all(gains > 0))


def _part_factors(hypothesis: Hypothesis, fit: RobustFit) -> dict[str, float]:
    """What each column is multiplied by: not the known disturbance, which `ControllerRelation.fit` appends."""
    return {f"part {k}": float(c) for k, c in enumerate(fit.coefficients[: len(hypothesis.regressors)])}


def _zero_offset(relation: ControllerRelation, metres: float) -> ChannelFault:
    """The offset of the reference; or of the position, where the second encoder shows it."""
    log, piece = relation.log, relation.piece
    if log.motor_position is not None:
        difference = float(np.median((log.motor_position - log.position)[piece]))
        if abs(difference + metres) < 0.5 * abs(metres):
            return ChannelFault("offset", "position", {"metres": metres}, (AddToChannel("position", -metres),))
    return ChannelFault("offset", "reference", {"metres": metres}, (AddToChannel("reference", metres),))


SignalRepair = Callable[[ControllerSignals], ControllerSignals]


def _factor_interpretations(
    relation: ControllerRelation, fit: RobustFit, ratio: float, smoothed: bool
) -> list[tuple[tuple[ChannelFault, ...], SignalRepair]]:
    """Interpretations of the factor between the logged command and the controller's."""

    def unchanged(signals: ControllerSignals) -> ControllerSignals:
        return signals

    is_large = not 1 / 3 < abs(ratio) < 3
    if smoothed and abs(ratio - 1) < WRONG_UNIT:  # what smoothing leaves of coarse steps scales the rest
        return [((), unchanged)]
    if ratio == 0 or (
        ratio > 0 and not is_large and (fit.error > ROUGH or abs(ratio - 1) <= ratio_tolerance(relation, fit))
    ):
        return [((), unchanged)]
    reversal = (
        (ChannelFault("reversed", "command", {"ratio": ratio}, (ScaleChannel("command", -1.0),)),) if ratio < 0 else ()
    )
    magnitude = abs(ratio)
    if ratio < 0 and abs(magnitude - 1) <= max(ratio_tolerance(relation, fit), WRONG_UNIT):
        return [(reversal, lambda signals: signals._replace(command=-signals.command))]
    unit = ChannelFault("gain", "command", {"ratio": magnitude}, (ScaleChannel("command", 1 / magnitude),))
    alternatives: list[tuple[tuple[ChannelFault, ...], SignalRepair]] = [
        ((*reversal, unit), lambda signals: signals._replace(command=signals.command / ratio))
    ]
    if ratio > 0:
        alternatives.append(((ChannelFault("other controller", "command", {"ratio": ratio}),), unchanged))
        if relation.axis.controller.is_linear:
            scaling = (ScaleChannel("position", ratio), ScaleChannel("reference", ratio))
            alternatives.append(
                (
                    (ChannelFault("gain", "position", {"ratio": 1 / ratio, "both": 1.0}, scaling),),
                    lambda signals: signals._replace(
                        position=ratio * signals.position, reference=ratio * signals.reference
                    ),
                )
            )
    return alternatives


def ratio_tolerance(relation: ControllerRelation, fit: RobustFit) -> float:
    """By how much the factor may be off 1 by chance."""
    if not relation.axis.controller.is_memoryless:
        return max(OFF, INITIAL_LOAD * fit.error)
    return max(OFF, 3 * fit.error / float(np.sqrt(max(1.0, len(fit.residual) / SAMPLES_PER_INDEPENDENT))))


def _has_constant(relation: ControllerRelation, signals: ControllerSignals, fit: RobustFit) -> bool:
    """Whether the command has a constant beside the controller's; one with states may have begun with it."""
    threshold = max(0.02, 3 * fit.error) * float(np.std(signals.command))
    return relation.axis.controller.is_memoryless and abs(float(fit.coefficients[-1])) > threshold


def _constant_interpretations(
    relation: ControllerRelation, signals: ControllerSignals, fit: RobustFit, ratio: float, constant: float
) -> list[tuple[tuple[ChannelFault, ...], float]]:
    """Interpretations of the constant beside the controller's command, and what to subtract from the command (N)."""
    if ratio == 0 or not _has_constant(relation, signals, fit):
        return [((), 0.0)]
    displacement = 1e-6
    commands = relation.controller_commands([signals._replace(reference=signals.reference + displacement), signals])
    stiffness = float(np.median(commands[0] - commands[1])) / displacement
    alternatives: list[tuple[tuple[ChannelFault, ...], float]] = [
        (
            (ChannelFault("offset", "command", {"newtons": constant / ratio}, (AddToChannel("command", -constant),)),),
            constant,
        )
    ]
    if stiffness > 0:
        alternatives.append(((_zero_offset(relation, constant / (ratio * stiffness)),), 0.0))
    return alternatives


def evaluate_explanation(
    relation: ControllerRelation, faults: tuple[ChannelFault, ...], signals: ControllerSignals, fit: RobustFit | None
) -> LogExplanation:
    """The explanation with its cost, but for what mass and friction cost, which `rank_explanations` adds."""
    cost = FAULT_COST * len(faults)
    cost += sum(_size_cost(fault, signals) for fault in faults)
    if fit is not None:
        cost += len(fit.residual) / SAMPLES_PER_INDEPENDENT * float(np.log(max(fit.error, SMALLEST_COMMAND_ERROR)))
    return LogExplanation(faults, fit, signals, None, cost + _tracking_cost(signals), relation)


def _with_dynamics(explanation: LogExplanation) -> LogExplanation:
    """The explanation with the mass and friction that it implies, and their cost."""
    if explanation.relation is None:
        return explanation
    dynamics = explanation.relation.dynamics(explanation.signals)
    dynamics_cost = 0.0 if dynamics is None else min(dynamics.neg_log_likelihood, LARGEST_DYNAMICS_COST)
    if dynamics is not None and not dynamics.is_physical:
        dynamics_cost += IMPOSSIBLE
    return replace(explanation, dynamics=dynamics, cost=explanation.cost + dynamics_cost, relation=None)


def _size_cost(fault: ChannelFault, signals: ControllerSignals) -> float:
    """What the size of a fault costs: gains are near the drive file's, and an amplifier's offset is small."""
    if fault.cause == "other controller":
        factors = [value for name, value in fault.parameters.items() if name == "ratio" or name.startswith("part")]
        positive = [] if "taps" in fault.parameters else [value for value in factors if value > 0]
        return float(sum(np.log(value) ** 2 for value in positive)) / (2 * CHANGED_STD**2)
    if fault.cause != "offset":
        return 0.0
    if fault.channel != "command":
        return ZERO_OFFSET if abs(fault.parameters["metres"]) >= SMALLEST_ZERO else IMPOSSIBLE
    return (
        0.5 * min(fault.parameters["newtons"] / (AMPLIFIER_OFFSET * float(np.max(np.abs(signals.command)))), 20.0) ** 2
    )


def _tracking_cost(signals: ControllerSignals) -> float:
    """What the position leaves of the reference: a loop follows it."""
    amplitude = float(np.std(signals.reference))
    if amplitude == 0:
        return 0.0
    error = signals.reference - signals.position
    relative_error = min(float(np.std(error)) / amplitude, 1e3)
    return (
        len(error)
        / SAMPLES_PER_INDEPENDENT
        * float(np.log(max(relative_error, SMALLEST_TRACKING_ERROR) / SMALLEST_TRACKING_ERROR))
    )


def rank_explanations(explanations: Sequence[LogExplanation]) -> list[LogExplanation]:
    """The likeliest first, with mass and friction weighed in all that may be among the likeliest."""
    evaluated, lowest = [], np.inf
    for explanation in sorted(explanations, key=lambda explanation: explanation.cost):
        candidate = _with_dynamics(explanation) if explanation.cost < lowest + DECISIVE else explanation
        lowest = min(lowest, candidate.cost)
        evaluated.append(candidate)
    return sorted(evaluated, key=lambda explanation: explanation.cost)


def rivals_of(ranking: Sequence[LogExplanation]) -> list[LogExplanation]:
    """Those that the log does not rule out beside the first, each repair once; none that only assumes more."""
    best, distinct = ranking[0], [ranking[0]]
    rivals = []
    for explanation in ranking[1:]:
        if (
            explanation.cost < best.cost + DECISIVE
            and not explanation.causes > best.causes
            and not any(_is_same(explanation, other) for other in distinct)
        ):
            distinct.append(explanation)
            rivals.append(explanation)
    return rivals


def _is_same(first: LogExplanation, second: LogExplanation) -> bool:
    """Whether two explanations have the same causes and are undone by the same steps."""
    return first.causes == second.causes and are_equivalent(first.steps, second.steps)


def are_equivalent(first: Sequence[RepairStep], second: Sequence[RepairStep]) -> bool:
    """Whether two repairs are the same, but for 2 % of a factor or an offset."""
    return len(first) == len(second) and all(_is_equivalent(*pair) for pair in zip(first, second, strict=True))


def _is_equivalent(first: RepairStep, second: RepairStep) -> bool:
    first_fields, second_fields = vars(first), vars(second)
    return type(first) is type(second) and all(
        abs(value - second_fields[name]) <= EQUAL_WITHIN * abs(value)
        if isinstance(value, float)
        else value == second_fields[name]
        for name, value in first_fields.items()
    )
