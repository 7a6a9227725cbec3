"""The controller's relation put to a log: what explains the command best, chosen among all hypotheses."""

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
from diffdrive.logs.checks.relation import LONGEST, ControllerRelation, LoopSignals
from diffdrive.logs.checks.replay import is_linear, is_memoryless
from diffdrive.logs.checks.statistics import RobustFit, robust_fit
from diffdrive.logs.checks.switching import find_switched_force
from diffdrive.logs.log import Signal

# A controller is software: put to its own inputs it gives back its output to the rounding of the log. 3 % is the most
# that a coarse log or numerical derivatives of the reference cost; beyond half it is another controller.
EXPLAINED, RELATED = 0.03, 0.5
# What explains the command this well needs no other explanation; a load that is slow to be forgotten leaves the latter.
EXPLAINED_AS_LOGGED, EXPLAINED_AFTER_TRANSIENT = 1e-3, 3e-3
# A hypothesis must leave less than these shares of the misfit; a past can look a little like a shift.
CLEAR, CLEAR_OF_TRANSIENT = 0.5, 0.1
UNLIKE_TRANSIENT = ("decimated", "swapped")  # another time, other columns
# An observer fed by the log follows it even where its scale is wrong, so it must come as close as this to be believed.
EXACT = 0.01
FINALISTS = 2  # of a family, whose quick fits are made robust


@dataclass(frozen=True)
class ConsistencyResult:
    """The best explanation, its rivals, the fit of the log as it is, and how the relation was judged."""

    relation: ControllerRelation
    best: LogExplanation
    rivals: tuple[LogExplanation, ...]
    output: Signal  # N, of the controller, for the log as it is
    plain: RobustFit


def explain_command(relation: ControllerRelation) -> ConsistencyResult | None:
    """What explains the command best; None where the controller or the log gives nothing."""
    whole = relation.plain()
    if whole is None:
        return None
    output, fit = whole
    later = late = None
    if fit.error >= EXPLAINED_AS_LOGGED and not is_memoryless(relation.description.controller):
        later = replace(relation, late=True)
        late = later.plain()
        if late is not None and _is_initial_transient(fit, late[1]):
            relation, (output, fit), late = later, late, None
    found = interpretations(relation, hypotheses.as_logged(relation), fit)
    if fit.error >= (EXPLAINED_AFTER_TRANSIENT if relation.late else EXPLAINED_AS_LOGGED) or any(
        one.faults for one in found
    ):
        found = _candidate_explanations(relation) or found
        if later is not None and late is not None:  # a past and another fault may come together
            others = _candidate_explanations(later)
            if others and _is_initial_transient(_best_fit(found), _best_fit(others)):
                relation, (output, fit), found = later, late, others
    likeliest = rank_explanations(found)
    ranking = rank_explanations([*likeliest, *_explanations_with_pulses(relation, likeliest[0])])
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


def _best_fit(found: list[LogExplanation]) -> RobustFit:
    """The fit that leaves least."""
    return min((one.fit for one in found if one.fit is not None), key=lambda fit: fit.error)


def _is_initial_transient(whole: RobustFit, late: RobustFit) -> bool:
    """Whether the later half is explained better, and by the same controller: a constant explains a rest, too."""
    closer = late.error < min(0.5 * whole.error, EXACT)
    scales = late.coefficients[0], whole.coefficients[0]
    return closer and 0.5 * abs(scales[1]) < abs(scales[0]) < 2.0 * abs(scales[1])


def _candidate_explanations(relation: ControllerRelation) -> list[LogExplanation]:
    """The readings of the log as it is, first, and of every hypothesis that explains the command clearly better."""
    relation = replace(relation, piece=_stretch_of_most_travel(relation))
    short = relation.plain()
    if short is None:
        return []
    output, now = short
    remembers = not is_linear(relation.description.controller)
    found = interpretations(relation, hypotheses.as_logged(relation), now)
    for hypothesis, fit in _fit_hypotheses(relation, output, now):
        clear = CLEAR_OF_TRANSIENT if remembers and hypothesis.cause not in UNLIKE_TRANSIENT else CLEAR
        if fit.error < max(clear * now.error, EXPLAINED_AS_LOGGED):
            found += interpretations(relation, hypothesis, fit)
    return found


def _fit_hypotheses(
    relation: ControllerRelation, output: Signal, now: RobustFit
) -> Iterator[tuple[Hypothesis, RobustFit]]:
    ratio = _tracking_ratio(relation)
    single = [*hypotheses.swapped(relation), *hypotheses.rounded(relation)]
    if ratio is not None:
        single += hypotheses.position_and_reference(relation, ratio)
    for one, command in zip(single, relation.outputs([one.signals for one in single]), strict=True):
        yield one, relation.fit(one.signals.command, command)
    for one in hypotheses.decimated(relation):
        yield one, relation.fit(one.signals.command, relation.outputs([one.signals])[0])
    yield from hypotheses.rounded_command(relation, now)
    yield from _fit_shifts(relation)
    families: dict[str, list[Hypothesis]] = {"lengths": list(hypotheses.lengths(relation))}
    for one in hypotheses.filtered(relation):
        families.setdefault(one.channel, []).append(one)
    for name, family in families.items():
        for one, fit in _best_of_family(relation, family) if family else ():
            # wrong lengths leave the command as it is: a factor beside them would be another fault, to fit anything
            if name != "lengths" or (fit.error < EXPLAINED and abs(float(fit.coefficients[0]) - 1) < WRONG_UNIT):
                yield one, fit
    for one in (*hypotheses.rectified(relation, output),):
        yield one, relation.fit(np.abs(one.signals.command), np.abs(output))
    for one in (*hypotheses.offset(relation, output), *hypotheses.other_gains(relation, output)):
        yield one, relation.fit(one.signals.command, *one.columns)
    for one in (*hypotheses.filtered_velocity(relation, output), *hypotheses.slower_velocity(relation, output)):
        yield one, relation.fit(one.signals.command, *one.columns)


def _tracking_ratio(relation: ControllerRelation) -> float | None:
    """Position over reference where they are one motion in different units or signs."""
    now = relation.logged
    if np.std(now.reference) == 0 or np.std(now.position) == 0:
        return None
    fit = robust_fit([now.reference], now.position)
    ratio = float(fit.coefficients[0])
    return ratio if fit.error < 0.5 and not 0.97 < ratio < 1.03 else None


def _best_of_family(relation: ControllerRelation, family: list[Hypothesis]) -> Iterator[tuple[Hypothesis, RobustFit]]:
    commands = relation.outputs([one.signals for one in family])
    quick = [_quick_misfit(relation, one, command) for one, command in zip(family, commands, strict=True)]
    for k in np.argsort(quick)[:FINALISTS]:
        fit = relation.fit(family[k].signals.command, commands[k])
        control = family[k].control
        if control is not None:
            smooth = relation.fit(control.command, relation.outputs([control])[0])
            if fit.error > CLEAR * smooth.error:
                continue
        yield family[k], fit


def _quick_misfit(relation: ControllerRelation, one: Hypothesis, output: Signal) -> float:
    """The misfit by plain least squares, without the worst hundredth."""
    given, mine = relation.judged(one.signals.command), relation.judged(output)
    if np.std(given) == 0 or np.std(mine) == 0 or not np.all(np.isfinite(mine)):
        return np.inf
    slope = float(np.cov(given, mine)[0, 1] / np.var(mine))
    left = np.abs(given - given.mean() - slope * (mine - mine.mean()))
    kept = np.partition(left, int(0.99 * len(left)) - 1)[: int(0.99 * len(left))]
    return float(np.sqrt(np.mean(kept**2))) / float(np.std(given))


def _fit_shifts(relation: ControllerRelation) -> Iterator[tuple[Hypothesis, RobustFit]]:
    """Whole shifts, and the parts of a sample beside the best of each axis."""
    whole = list(hypotheses.whole_shifts(relation))
    now = hypotheses.as_logged(relation)
    commands = relation.outputs([now.signals, *(one.signals for one in whole)])
    at = {(0, 0): commands[0]} | {
        (int(one.numbers["reference"]), int(one.numbers["position"])): command
        for one, command in zip(whole, commands[1:], strict=True)
    }
    fits = {pair: _quick_misfit(relation, now, command) for pair, command in at.items()}
    for pair in sorted(fits, key=fits.__getitem__)[: 4 * FINALISTS]:
        if pair != (0, 0):
            yield shift(relation, *pair), relation.fit(now.signals.command, at[pair])
    if relation.late or is_linear(relation.description.controller):
        for axis in ((1, 1), (1, 0), (0, 1)):
            yield from _fit_fractional_shifts(relation, at, axis, fits)


def _fit_fractional_shifts(
    relation: ControllerRelation,
    at: dict[tuple[int, int], Signal],
    axis: tuple[int, int],
    fits: dict[tuple[int, int], float],
) -> Iterator[tuple[Hypothesis, RobustFit]]:
    """Between the best whole shift along an axis and its better neighbour, by interpolation."""
    line = [(k * axis[0], k * axis[1]) for k in range(-hypotheses.REACH, hypotheses.REACH + 1)]
    k = int(np.argmin([fits[pair] for pair in line]))
    for beside in (k - 1, k + 1):
        if not 0 <= beside < len(line):
            continue
        first, second = at[line[k]], at[line[beside]]
        command = relation.logged.command
        ratio, change = relation.fit(command, first, second - first).coefficients[:2]
        share = float(change / ratio) if ratio else 0.0
        if 0.05 < share < 0.95:
            by = [a + share * (b - a) for a, b in zip(line[k], line[beside], strict=True)]
            yield shift(relation, *by), relation.fit(command, first + share * (second - first))


def _explanations_with_pulses(relation: ControllerRelation, best: LogExplanation) -> list[LogExplanation]:
    """The likeliest explanation, and the log as it is, with a force beside them that is switched on and off.

    Either it acts on the table, or it stands in the recording alone: mass and friction tell.
    """
    if best.fit is None or best.fit.error < EXPLAINED or relation.disturbance is not None:
        return []
    more = []
    now = hypotheses.as_logged(relation)
    for beside in {one.cause: one for one in (best.hypothesis or now, now)}.values():
        if beside.cause == "other controller":
            continue  # its command is not that of the drive file's controller
        signals, steps = beside.signals, faults_of(beside)
        whole = replace(relation, piece=slice(relation.piece.start, relation.piece.start + len(signals.command)))
        given = whole.outputs([signals])[0]
        switched = find_switched_force(whole.judged(signals.command), whole.judged(given))
        if switched is None or switched.fit.error > CLEAR * best.fit.error:
            continue
        if switched.changes == 1 and not is_memoryless(relation.description.controller):
            continue  # the friction that held the table as the log began, until it moved
        ratio = float(switched.fit.coefficients[0])
        numbers = {"newtons": switched.height / ratio, "changes": switched.changes, "share": switched.share}
        fit = switched.fit._replace(coefficients=np.array([ratio, switched.fit.coefficients[-1]]))
        rest = signals.command - ratio * given - switched.fit.coefficients[-1]
        pulses = np.where(rest / switched.height > 0.5, switched.height, 0.0)
        numbers["acted"] = _pulses_acted(whole, signals, pulses)
        fault = ChannelFault("burst", "command", {name: float(value) for name, value in numbers.items()})
        mended = signals if numbers["acted"] else signals._replace(command=signals.command - pulses)
        more += [
            replace(one, faults=(*steps, fault, *one.faults), cost=one.cost + FAULT_COST * (1 + len(steps)))
            for one in interpretations(whole, Hypothesis("", "command", mended), fit)
        ]
    return more


def _pulses_acted(relation: ControllerRelation, signals: LoopSignals, pulses: Signal) -> float:
    """Whether the table answers to pulses in its command: 1 or 0, or 0.5 where the balance of forces does not tell."""
    acted = relation.dynamics(signals)
    recorded = relation.dynamics(signals._replace(command=signals.command - pulses))
    if acted is None or recorded is None:
        return 0.5
    nats = len(pulses) / SAMPLES_PER_INDEPENDENT * float(np.log(recorded.misfit / acted.misfit))
    return 0.5 if abs(nats) < DECISIVE else float(nats > 0)
