"""Which hypothesis explains a log: rivals compete by what each leaves unexplained and by what it has to assume.

An explanation is a set of faults. Its cost is minus the logarithm of its posterior probability, up to a constant, in
nats:

- each fault costs ln 100: of a hundred logs one has it;
- what the controller leaves of the command counts by the logarithm of its RMS, for each independent sample;
- what the position leaves of the reference counts likewise, as far as no loop at its bandwidth explains it;
- mass and friction that the mended log asks for count by how far they are from the drive file's tolerance.

Explanations within ln 100 of the best are its rivals: the log does not rule them out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diffdrive.logs.checks.dynamics import CHANGED_STD, DynamicsFit
from diffdrive.logs.checks.hypotheses import Hypothesis
from diffdrive.logs.checks.relation import ControllerRelation, LoopSignals
from diffdrive.logs.checks.repair import AddToChannel, RepairStep, ScaleChannel
from diffdrive.logs.checks.replay import is_linear, is_memoryless
from diffdrive.logs.checks.statistics import RobustFit

FAULT_COST = float(np.log(100.0))
DECISIVE = float(np.log(100.0))
EQUAL_WITHIN = 0.02  # relative: amounts of one mend that are the same for all practical purposes
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
# A load that an observer remembers wrongly scales friction, and so most of the command: in logs cut out of others by up
# to 18 times what it leaves unexplained.
INITIAL_LOAD = 20.0
# An amplifier's offset is some per cent of its rated current; a zero is off by anything from 1 um to 0.1 m, 12 e-folds.
AMPLIFIER_OFFSET, ZERO_OFFSET, SMALLEST_ZERO = 0.05, float(np.log(12.0)), 1e-6


@dataclass(frozen=True)
class ChannelFault:
    """One thing that is wrong, how large, and the steps that undo it (empty where nothing does)."""

    cause: str
    channel: str
    numbers: dict[str, float]
    steps: tuple[RepairStep, ...] = ()


@dataclass(frozen=True)
class LogExplanation:
    """Faults, what they leave of the command, the mended signals, and the cost."""

    faults: tuple[ChannelFault, ...]
    fit: RobustFit | None
    signals: LoopSignals
    dynamics: DynamicsFit | None
    cost: float
    relation: ControllerRelation | None = None  # that mass and friction are still to be asked of
    hypothesis: Hypothesis | None = None  # behind it

    @property
    def causes(self) -> frozenset[tuple[str, str]]:
        """What is wrong, without numbers."""
        return frozenset((one.cause, one.channel) for one in self.faults)

    @property
    def steps(self) -> tuple[RepairStep, ...]:
        """What undoes all of it."""
        return tuple(step for one in self.faults for step in one.steps)


def interpretations(relation: ControllerRelation, hypothesis: Hypothesis, fit: RobustFit) -> list[LogExplanation]:
    """All that a hypothesis and its fit may mean: a factor is a unit or a gain, a constant an offset of either end."""
    return [replace(one, hypothesis=hypothesis) for one in _interpretations(relation, hypothesis, fit)]


def _interpretations(relation: ControllerRelation, hypothesis: Hypothesis, fit: RobustFit) -> list[LogExplanation]:
    own = faults_of(hypothesis)
    signals = hypothesis.signals
    if hypothesis.columns and hypothesis.cause != "rectified":  # the factors are those of the controller's gains
        if hypothesis.cause == "offset":
            own = (_zero_offset(relation, float(fit.coefficients[1] / fit.coefficients[0])),)
        elif not _stabilises(hypothesis, fit) or _has_constant(relation, signals, fit):
            return []
        else:
            own = (replace(own[0], numbers=own[0].numbers | _part_factors(hypothesis, fit)),)
        found = evaluate_explanation(relation, own, signals, fit)
        return [replace(found, cost=found.cost + _parameter_cost(len(hypothesis.columns) - 1, fit))]
    found = []
    ratio, constant = float(fit.coefficients[0]), float(fit.coefficients[-1])
    coarse = hypothesis.cause == "rounded" and hypothesis.channel != "command"
    if coarse:  # it is judged by smoothed signals, but mass and friction by those of the log
        signals = relation.logged
    for factor_faults, factor in _factor_interpretations(relation, fit, ratio, coarse):
        for offset_faults, subtract in _constant_interpretations(relation, signals, fit, ratio, constant):
            mended = factor(signals._replace(command=signals.command - subtract))
            found.append(evaluate_explanation(relation, (*own, *offset_faults, *factor_faults), mended, fit))
    return found


def faults_of(hypothesis: Hypothesis) -> tuple[ChannelFault, ...]:
    """What a hypothesis itself says is wrong: nothing of the log as it is."""
    if not hypothesis.cause:
        return ()
    return (ChannelFault(hypothesis.cause, hypothesis.channel, dict(hypothesis.numbers), hypothesis.steps),)


def _parameter_cost(count: int, fit: RobustFit) -> float:
    """What free parameters cost, each by the Bayesian information criterion."""
    return 0.5 * count * float(np.log(max(1.0, len(fit.residual) / SAMPLES_PER_INDEPENDENT)))


def _stabilises(hypothesis: Hypothesis, fit: RobustFit) -> bool:
    """Whether a controller's gains are above zero, as in every loop that follows its reference."""
    taps = int(hypothesis.numbers.get("taps", 0))
    gains = fit.coefficients[: taps or hypothesis.gains]
    if taps:  # on the last errors: their sum is the stiffness, their first moment minus the damping
        return float(np.sum(gains)) > 0 and float(np.arange(taps) @ gains) < 0
    return bool(np.all(gains > 0))


def _part_factors(hypothesis: Hypothesis, fit: RobustFit) -> dict[str, float]:
    """What each column is multiplied by: not the known disturbance, which `ControllerRelation.fit` appends."""
    return {f"part {k}": float(c) for k, c in enumerate(fit.coefficients[: len(hypothesis.columns)])}


def _zero_offset(relation: ControllerRelation, metres: float) -> ChannelFault:
    """The reference is to be moved by so much; or the position against it, where the second encoder says so."""
    log, piece = relation.log, relation.piece
    if log.motor_position is not None:
        apart = float(np.median((log.motor_position - log.position)[piece]))
        if abs(apart + metres) < 0.5 * abs(metres):
            return ChannelFault("offset", "position", {"metres": metres}, (AddToChannel("position", -metres),))
    return ChannelFault("offset", "reference", {"metres": metres}, (AddToChannel("reference", metres),))


SignalRepair = Callable[[LoopSignals], LoopSignals]


def _factor_interpretations(
    relation: ControllerRelation, fit: RobustFit, ratio: float, smoothed: bool
) -> list[tuple[tuple[ChannelFault, ...], SignalRepair]]:
    """Readings of the factor between the logged command and the controller's."""

    def same(signals: LoopSignals) -> LoopSignals:
        return signals

    large = not 1 / 3 < abs(ratio) < 3
    if smoothed and abs(ratio - 1) < WRONG_UNIT:  # what smoothing leaves of coarse steps scales the rest
        return [((), same)]
    if ratio == 0 or (
        ratio > 0 and not large and (fit.error > ROUGH or abs(ratio - 1) <= ratio_tolerance(relation, fit))
    ):
        return [((), same)]
    reversed_ = (
        (ChannelFault("reversed", "command", {"ratio": ratio}, (ScaleChannel("command", -1.0),)),) if ratio < 0 else ()
    )
    size = abs(ratio)
    if ratio < 0 and abs(size - 1) <= max(ratio_tolerance(relation, fit), WRONG_UNIT):
        return [(reversed_, lambda signals: signals._replace(command=-signals.command))]
    unit = ChannelFault("gain", "command", {"ratio": size}, (ScaleChannel("command", 1 / size),))
    found: list[tuple[tuple[ChannelFault, ...], SignalRepair]] = [
        ((*reversed_, unit), lambda signals: signals._replace(command=signals.command / ratio))
    ]
    if ratio > 0:
        found.append(((ChannelFault("other controller", "command", {"ratio": ratio}),), same))
        if is_linear(relation.description.controller):
            both = (ScaleChannel("position", ratio), ScaleChannel("reference", ratio))
            found.append(
                (
                    (ChannelFault("gain", "position", {"ratio": 1 / ratio, "both": 1.0}, both),),
                    lambda one: one._replace(position=ratio * one.position, reference=ratio * one.reference),
                )
            )
    return found


def ratio_tolerance(relation: ControllerRelation, fit: RobustFit) -> float:
    """By how much the factor may be off 1 all the same."""
    if not is_memoryless(relation.description.controller):
        return max(OFF, INITIAL_LOAD * fit.error)
    return max(OFF, 3 * fit.error / float(np.sqrt(max(1.0, len(fit.residual) / SAMPLES_PER_INDEPENDENT))))


def _has_constant(relation: ControllerRelation, signals: LoopSignals, fit: RobustFit) -> bool:
    """Whether a constant stands beside the controller's command; one that remembers may have begun with it."""
    least = max(0.02, 3 * fit.error) * float(np.std(signals.command))
    return is_memoryless(relation.description.controller) and abs(float(fit.coefficients[-1])) > least


def _constant_interpretations(
    relation: ControllerRelation, signals: LoopSignals, fit: RobustFit, ratio: float, constant: float
) -> list[tuple[tuple[ChannelFault, ...], float]]:
    """Readings of the constant beside the controller's command, and what is to be taken off the command."""
    if ratio == 0 or not _has_constant(relation, signals, fit):
        return [((), 0.0)]
    small = 1e-6
    moved = relation.outputs([signals._replace(reference=signals.reference + small), signals])
    stiffness = float(np.median(moved[0] - moved[1])) / small
    found = [
        (
            (ChannelFault("offset", "command", {"newtons": constant / ratio}, (AddToChannel("command", -constant),)),),
            constant,
        )
    ]
    if stiffness > 0:
        found.append(((_zero_offset(relation, constant / (ratio * stiffness)),), 0.0))
    return found


def evaluate_explanation(
    relation: ControllerRelation, faults: tuple[ChannelFault, ...], signals: LoopSignals, fit: RobustFit | None
) -> LogExplanation:
    """The explanation with its cost, but for what mass and friction cost, which `rank_explanations` adds."""
    cost = FAULT_COST * len(faults)
    cost += sum(_size_cost(fault, signals) for fault in faults)
    if fit is not None:
        cost += len(fit.residual) / SAMPLES_PER_INDEPENDENT * float(np.log(max(fit.error, SMALLEST_COMMAND_ERROR)))
    return LogExplanation(faults, fit, signals, None, cost + _tracking_cost(signals), relation)


def _with_dynamics(one: LogExplanation) -> LogExplanation:
    """The explanation with the mass and friction that it asks for, and their cost."""
    if one.relation is None:
        return one
    dynamics = one.relation.dynamics(one.signals)
    surprise = 0.0 if dynamics is None else min(dynamics.surprise, LARGEST_DYNAMICS_COST)
    if dynamics is not None and not dynamics.physical:
        surprise += IMPOSSIBLE
    return replace(one, dynamics=dynamics, cost=one.cost + surprise, relation=None)


def _size_cost(fault: ChannelFault, signals: LoopSignals) -> float:
    """What the size of a fault costs: gains are near the drive file's, and an amplifier's offset is small."""
    if fault.cause == "other controller":
        factors = [value for name, value in fault.numbers.items() if name == "ratio" or name.startswith("part")]
        known = [] if "taps" in fault.numbers else [value for value in factors if value > 0]
        return float(sum(np.log(value) ** 2 for value in known)) / (2 * CHANGED_STD**2)
    if fault.cause != "offset":
        return 0.0
    if fault.channel != "command":
        return ZERO_OFFSET if abs(fault.numbers["metres"]) >= SMALLEST_ZERO else IMPOSSIBLE
    return 0.5 * min(fault.numbers["newtons"] / (AMPLIFIER_OFFSET * float(np.max(np.abs(signals.command)))), 20.0) ** 2


def _tracking_cost(signals: LoopSignals) -> float:
    """What the position leaves of the reference: a loop follows it."""
    size = float(np.std(signals.reference))
    if size == 0:
        return 0.0
    left = signals.reference - signals.position
    share = min(float(np.std(left)) / size, 1e3)
    return (
        len(left)
        / SAMPLES_PER_INDEPENDENT
        * float(np.log(max(share, SMALLEST_TRACKING_ERROR) / SMALLEST_TRACKING_ERROR))
    )


def rank_explanations(explanations: Sequence[LogExplanation]) -> list[LogExplanation]:
    """The likeliest first, with mass and friction weighed in all that may be among the likeliest."""
    found, least = [], np.inf
    for one in sorted(explanations, key=lambda one: one.cost):
        weighed = _with_dynamics(one) if one.cost < least + DECISIVE else one
        least = min(least, weighed.cost)
        found.append(weighed)
    return sorted(found, key=lambda one: one.cost)


def rivals_of(ranking: Sequence[LogExplanation]) -> list[LogExplanation]:
    """Those that the log does not rule out beside the first, each mend once; none that only assumes more."""
    first, seen = ranking[0], [ranking[0]]
    found = []
    for one in ranking[1:]:
        if (
            one.cost < first.cost + DECISIVE
            and not one.causes > first.causes
            and not any(_is_same(one, x) for x in seen)
        ):
            seen.append(one)
            found.append(one)
    return found


def _is_same(one: LogExplanation, other: LogExplanation) -> bool:
    """Whether two explanations say the same and are undone by the same steps."""
    return one.causes == other.causes and are_equivalent(one.steps, other.steps)


def are_equivalent(some: Sequence[RepairStep], others: Sequence[RepairStep]) -> bool:
    """Whether two mends are the same, but for a few per cent of a factor or an offset."""
    return len(some) == len(others) and all(_is_equivalent(*pair) for pair in zip(some, others, strict=True))


def _is_equivalent(one: RepairStep, other: RepairStep) -> bool:
    mine, its = vars(one), vars(other)
    return type(one) is type(other) and all(
        abs(value - its[name]) <= EQUAL_WITHIN * abs(value) if isinstance(value, float) else value == its[name]
        for name, value in mine.items()
    )
