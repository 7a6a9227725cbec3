"""The controller's relation checked against a log: what explains the command best, chosen among all hypotheses."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from diffdrive.logs.checks import hypotheses
from diffdrive.logs.checks.explanation import (
    DECISIVE,
    FAULT_COST,
    SAMPLES_PER_INDEPENDENT,
    WRONG_UNIT,
    ChannelFault,
    LogExplanation,
    faults_of,
    interpretations,
    rank_explanations,
    rivals_of,
)
from diffdrive.logs.checks.hypotheses import Hypothesis, shift
from diffdrive.logs.checks.relation import (
    EXPLAINED_AFTER_TRANSIENT,
    EXPLAINED_AS_LOGGED,
    LONGEST,
    ControllerRelation,
    ControllerSignals,
)
from diffdrive.logs.checks.statistics import RobustFit, robust_fit
from diffdrive.logs.checks.switching import find_switched_force
from diffdrive.logs.log import Signal

# A controller is software: with its own inputs it reproduces its output to the rounding of the log. 3 % is the most
# that a coarse log or numerical derivatives of the reference cost; beyond half it is another controller.
EXPLAINED, RELATED = 0.03, 0.5
# A hypothesis must leave less than these shares of the misfit; an initial transient can look a little like a shift.
CLEAR, CLEAR_OF_TRANSIENT = 0.5, 0.1
UNLIKE_TRANSIENT = ("decimated", "swapped")  # another time, other columns
# An observer fed by the log follows it even where its scale is wrong, so it must come as close as this to be believed.
EXACT = 0.01
FINALISTS = 2  # of a family, whose quick fits are made robust


@dataclass(frozen=True)
class ConsistencyResult:
    """The best explanation, its rivals, and the replay of the log as it is."""

    relation: ControllerRelation
    best: LogExplanation
    rivals: tuple[LogExplanation, ...]
    controller_command: Signal  # N, of the controller, for the log as it is
    fit_as_logged: RobustFit


def explain_command(relation: ControllerRelation) -> ConsistencyResult | None:
    """What explains the command best; None where the controller or the log gives nothing."""
    replay = relation.replay_as_logged()
    if replay is None:
        return None
    output, fit = replay
    after = replay_after = None
    if fit.error >= EXPLAINED_AS_LOGGED and not relation.axis.controller.is_memoryless:
        after = replace(relation, after_transient=True)
        replay_after = after.replay_as_logged()
        if replay_after is not None and _is_initial_transient(fit, replay_after[1]):
            relation, (output, fit), replay_after = after, replay_after, None
    explanations = interpretations(relation, hypotheses.as_logged(relation), fit)
    if fit.error >= (EXPLAINED_AFTER_TRANSIENT if relation.after_transient else EXPLAINED_AS_LOGGED) or any(
        explanation.faults for explanation in explanations
    ):
        explanations = _candidate_explanations(relation) or explanations
        if after is not None and replay_after is not None:  # a transient and another fault may come together
            explanations_after = _candidate_explanations(after)
            if explanations_after and _is_initial_transient(_best_fit(explanations), _best_fit(explanations_after)):
                relation, (output, fit), explanations = after, replay_after, explanations_after
    ranking = rank_explanations(explanations)
    ranking = rank_explanations([*ranking, *_explanations_with_pulses(relation, ranking[0])])
    return ConsistencyResult(relation, ranking[0], tuple(rivals_of(ranking)), output, fit)


def _stretch_of_most_travel(relation: ControllerRelation) -> slice:
    """A stretch of at most `LONGEST` samples: the first, or where the table hardly moves in it, that of most travel."""
    piece, position = relation.piece, relation.log.position
    stretches = [
        slice(start, min(start + LONGEST, piece.stop))
        for start in range(piece.start, max(piece.stop - LONGEST, piece.start) + 1, LONGEST)
    ]
    travel = [float(np.ptp(position[stretch])) for stretch in stretches]
    return stretches[0 if travel[0] > 0.5 * max(travel) else int(np.argmax(travel))]


def _best_fit(explanations: list[LogExplanation]) -> RobustFit:
    """The fit that leaves least."""
    return min(
        (explanation.fit for explanation in explanations if explanation.fit is not None), key=lambda fit: fit.error
    )


def _is_initial_transient(fit_whole: RobustFit, fit_after: RobustFit) -> bool:
    """Whether the later half is explained better, and by the same controller: a constant explains standstill, too."""
    is_closer = fit_after.error < min(0.5 * fit_whole.error, EXACT)
    ratios = fit_after.coefficients[0], fit_whole.coefficients[0]
    return is_closer and 0.5 * abs(ratios[1]) < abs(ratios[0]) < 2.0 * abs(ratios[1])


def _candidate_explanations(relation: ControllerRelation) -> list[LogExplanation]:
    """Interpretations of the log as it is, first, and of every hypothesis that explains the command clearly better."""
    relation = replace(relation, piece=_stretch_of_most_travel(relation))
    replay = relation.replay_as_logged()
    if replay is None:
        return []
    output, fit_as_logged = replay
    has_observer = relation.axis.controller.has_friction_observer
    explanations = interpretations(relation, hypotheses.as_logged(relation), fit_as_logged)
    for hypothesis, fit in _fit_hypotheses(relation, output, fit_as_logged):
        threshold = CLEAR_OF_TRANSIENT if has_observer and hypothesis.cause not in UNLIKE_TRANSIENT else CLEAR
        if fit.error < max(threshold * fit_as_logged.error, EXPLAINED_AS_LOGGED):
            explanations += interpretations(relation, hypothesis, fit)
    return explanations


def _fit_hypotheses(
    relation: ControllerRelation, output: Signal, fit_as_logged: RobustFit
) -> Iterator[tuple[Hypothesis, RobustFit]]:
    ratio = _tracking_ratio(relation)
    single = [*hypotheses.swapped(relation), *hypotheses.rounded(relation)]
    if ratio is not None:
        single += hypotheses.position_and_reference(relation, ratio)
    commands = relation.controller_commands([hypothesis.signals for hypothesis in single])
    for hypothesis, command in zip(single, commands, strict=True):
        yield hypothesis, relation.fit(hypothesis.signals.command, command)
    for hypothesis in hypotheses.decimated(relation):
        (command,) = relation.controller_commands([hypothesis.signals])
        yield hypothesis, relation.fit(hypothesis.signals.command, command)
    yield from hypotheses.rounded_command(relation, fit_as_logged)
    yield from _fit_shifts(relation)
    families: dict[str, list[Hypothesis]] = {"lengths": list(hypotheses.lengths(relation))}
    for hypothesis in hypotheses.filtered(relation):
        families.setdefault(hypothesis.channel, []).append(hypothesis)
    for name, family in families.items():
        for hypothesis, fit in _best_of_family(relation, family) if family else ():
            # wrong lengths leave the command as it is: a factor beside them would be another fault, to fit anything
            if name != "lengths" or (fit.error < EXPLAINED and abs(float(fit.coefficients[0]) - 1) < WRONG_UNIT):
                yield hypothesis, fit
    for hypothesis in (*hypotheses.rectified(relation, output),):
        yield hypothesis, relation.fit(np.abs(hypothesis.signals.command), np.abs(output))
    for hypothesis in (*hypotheses.offset(relation, output), *hypotheses.other_gains(relation, output)):
        yield hypothesis, relation.fit(hypothesis.signals.command, *hypothesis.regressors)
    for hypothesis in (*hypotheses.filtered_velocity(relation, output), *hypotheses.slower_velocity(relation, output)):
        yield hypothesis, relation.fit(hypothesis.signals.command, *hypothesis.regressors)


def _tracking_ratio(relation: ControllerRelation) -> float | None:
    """Position over reference where they are one motion in different units or signs."""
    logged = relation.logged
    if np.std(logged.reference) == 0 or np.std(logged.position) == 0:
        return None
    fit = robust_fit([logged.reference], logged.position)
    ratio = float(fit.coefficients[0])
    return ratio if fit.error < 0.5 and not 0.97 < ratio < 1.03 else None


def _best_of_family(relation: ControllerRelation, family: list[Hypothesis]) -> Iterator[tuple[Hypothesis, RobustFit]]:
    commands = relation.controller_commands([hypothesis.signals for hypothesis in family])
    misfits = [
        _quick_misfit(relation, hypothesis, command) for hypothesis, command in zip(family, commands, strict=True)
    ]
    for k in np.argsort(misfits)[:FINALISTS]:
        fit = relation.fit(family[k].signals.command, commands[k])
        control = family[k].control_signals
        if control is not None:
            control_fit = relation.fit(control.command, relation.controller_commands([control])[0])
            if fit.error > CLEAR * control_fit.error:
                continue
        yield family[k], fit


def _quick_misfit(relation: ControllerRelation, hypothesis: Hypothesis, output: Signal) -> float:
    """The misfit by plain least squares, without the worst hundredth."""
    logged, replayed = relation.valid_samples(hypothesis.signals.command), relation.valid_samples(output)
    logged, replayed = logged - np.mean(logged), replayed - np.mean(replayed)
    energy, replayed_energy = float(logged @ logged), float(replayed @ replayed)
    if not (energy > 0 and 0 < replayed_energy < np.inf):
        return np.inf
    residual = np.abs(logged - float(logged @ replayed) / replayed_energy * replayed)
    kept = int(0.99 * len(residual))
    bulk = np.partition(residual, kept - 1)[:kept]
    return float(np.sqrt(bulk @ bulk / kept / (energy / len(logged))))


def _fit_shifts(relation: ControllerRelation) -> Iterator[tuple[Hypothesis, RobustFit]]:
    """Whole shifts, and fractions of a sample beside the best in each direction."""
    shifts = list(hypotheses.whole_shifts(relation))
    as_logged = hypotheses.as_logged(relation)
    commands = relation.controller_commands([as_logged.signals, *(hypothesis.signals for hypothesis in shifts)])
    command_of_shift = {(0, 0): commands[0]} | {
        (int(hypothesis.parameters["reference"]), int(hypothesis.parameters["position"])): command
        for hypothesis, command in zip(shifts, commands[1:], strict=True)
    }
    fits = {pair: _quick_misfit(relation, as_logged, command) for pair, command in command_of_shift.items()}
    for pair in sorted(fits, key=fits.__getitem__)[: 4 * FINALISTS]:
        if pair != (0, 0):
            yield shift(relation, *pair), relation.fit(as_logged.signals.command, command_of_shift[pair])
    if relation.after_transient or not relation.axis.controller.has_friction_observer:
        for direction in ((1, 1), (1, 0), (0, 1)):
            yield from _fit_fractional_shifts(relation, command_of_shift, direction, fits)


def _fit_fractional_shifts(
    relation: ControllerRelation,
    command_of_shift: dict[tuple[int, int], Signal],
    direction: tuple[int, int],
    fits: dict[tuple[int, int], float],
) -> Iterator[tuple[Hypothesis, RobustFit]]:
    """Between the best whole shift in a direction and its neighbours, by interpolation."""
    shifts = [(k * direction[0], k * direction[1]) for k in range(-hypotheses.REACH, hypotheses.REACH + 1)]
    k = int(np.argmin([fits[pair] for pair in shifts]))
    for neighbour in (k - 1, k + 1):
        if not 0 <= neighbour < len(shifts):
            continue
        first, second = command_of_shift[shifts[k]], command_of_shift[shifts[neighbour]]
        command = relation.logged.command
        ratio, slope = relation.fit(command, first, second - first).coefficients[:2]
        fraction = float(slope / ratio) if ratio else 0.0
        if 0.05 < fraction < 0.95:
            shift_pair = [a + fraction * (b - a) for a, b in zip(shifts[k], shifts[neighbour], strict=True)]
            yield shift(relation, *shift_pair), relation.fit(command, first + fraction * (second - first))


def _explanations_with_pulses(relation: ControllerRelation, best: LogExplanation) -> list[LogExplanation]:
    """The likeliest explanation, and the log as it is, with a force beside them that is switched on and off.

    Either it acts on the table, or it stands in the recording alone: mass and friction decide.
    """
    if best.fit is None or best.fit.error < EXPLAINED or relation.disturbance is not None:
        return []
    explanations = []
    as_logged = hypotheses.as_logged(relation)
    for hypothesis in {one.cause: one for one in (best.hypothesis or as_logged, as_logged)}.values():
        if hypothesis.cause == "other controller":
            continue  # its command is not that of the drive file's controller
        signals, steps = hypothesis.signals, faults_of(hypothesis)
        full_relation = replace(
            relation, piece=slice(relation.piece.start, relation.piece.start + len(signals.command))
        )
        output = full_relation.controller_commands([signals])[0]
        switched = find_switched_force(
            full_relation.valid_samples(signals.command), full_relation.valid_samples(output)
        )
        if switched is None or switched.fit.error > CLEAR * best.fit.error:
            continue
        if switched.switch_count == 1 and not relation.axis.controller.is_memoryless:
            continue  # the friction that held the table as the log began, until it moved
        ratio = float(switched.fit.coefficients[0])
        parameters = {"newtons": switched.amplitude / ratio, "changes": switched.switch_count, "share": switched.duty}
        fit = switched.fit._replace(coefficients=np.array([ratio, switched.fit.coefficients[-1]]))
        residual = signals.command - ratio * output - switched.fit.coefficients[-1]
        pulses = np.where(residual / switched.amplitude > 0.5, switched.amplitude, 0.0)
        parameters["acted"] = _pulses_acted(full_relation, signals, pulses)
        fault = ChannelFault("burst", "command", {name: float(value) for name, value in parameters.items()})
        repaired = signals if parameters["acted"] else signals._replace(command=signals.command - pulses)
        explanations += [
            replace(
                explanation,
                faults=(*steps, fault, *explanation.faults),
                cost=explanation.cost + FAULT_COST * (1 + len(steps)),
            )
            for explanation in interpretations(full_relation, Hypothesis("", "command", repaired), fit)
        ]
    return explanations


def _pulses_acted(relation: ControllerRelation, signals: ControllerSignals, pulses: Signal) -> float:
    """Whether the pulses in the command move the table: 1 or 0, or 0.5 where the balance of forces is undecided."""
    with_pulses = relation.dynamics(signals)
    without_pulses = relation.dynamics(signals._replace(command=signals.command - pulses))
    if with_pulses is None or without_pulses is None:
        return 0.5
    log_ratio = len(pulses) / SAMPLES_PER_INDEPENDENT * float(np.log(without_pulses.misfit / with_pulses.misfit))
    return 0.5 if abs(log_ratio) < DECISIVE else float(log_ratio > 0)
