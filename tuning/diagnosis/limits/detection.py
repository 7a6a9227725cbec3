"""How small an effect the logs would show.

To first order, an effect of size a moves the residuals by a s. What is free makes way, and leaves the curvature S of
its sensitivity s (`reduced`). Where the machine has the effect, -2 log likelihood then falls by a^2 S^2 / (1 + S) with
it: its own prior takes the share 1 / (1 + S) of a^2 S. Its parameters cost the logarithm of the volume that the logs
leave of their prior. The limit is the size at which the difference is the evidence that an effect must bring. So
nothing is simulated and nothing fitted.

Where the effect is not linear in its size, the filter runs with it at several sizes, and the change of the residuals is
in the place of a s.

No model is right to the last digit: the filter allows it the force that counts as nothing missing (`relevant_forces`).
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive.effects.actuator import LoopDelay
from diffdrive.effects.catalogue import EFFECTS
from tuning.diagnosis.filter.second_encoder import predicted_twist, seen_by
from tuning.diagnosis.fits.curvature import log_volume, solved
from tuning.diagnosis.fits.fitted import Fitted, Point
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.goodness_of_fit import relevant_forces
from tuning.diagnosis.fits.reduced import reduced
from tuning.diagnosis.hypotheses.candidate import WAVE, Candidate
from tuning.diagnosis.hypotheses.model import Vector, effect_in_lanes
from tuning.diagnosis.hypotheses.priors import ITSELF, Parameter
from tuning.diagnosis.levels import LOST, STRAINED
from tuning.diagnosis.selection.screening import DEARNESS, Values, begin, joined, sensitivities

EITHER = (-1.0, 1.0)  # deviations of its prior, to which each parameter is moved from its usual value
UNEXPECTED = STRAINED  # deviations of its prior: a larger amplitude is none that anyone would expect
SIZES = np.linspace(-8.0, 4.0, 7)  # deviations of the prior, at which an effect that is not linear in its size is tried
DECADES = np.geomspace(1e-4, 4.0, 5)  # the same of a size that is normal about zero
INSIDE = 1e-3  # of a bound, by which a size is inside it
HALVINGS = 4  # of the distance between the sizes about a limit
AMPLITUDE = "amplitude"  # of a wave

Group = Sequence[int]  # columns of one size in one log: one, or cosine and sine
Products = Float[np.ndarray, "k k"]
Labels = Sequence[tuple[Parameter, int | None]]  # of columns: a parameter, and of which log; None: of all


class Answers(NamedTuple):
    """How residuals move with amounts of an effect, a column each; `second` are those of a second encoder."""

    labels: Labels
    residuals: Float[np.ndarray, "n k"]
    second: Float[np.ndarray, "m k"]


class ByAmount(NamedTuple):
    """An effect that is there by degrees: what answers it at usual values of its other numbers, and at unusual ones."""

    candidate: Candidate
    usual: Values
    answers: list[Answers]

    @property
    def labels(self) -> Labels:
        """Of the columns of any of them."""
        return self.answers[0].labels


class DetectionLimit(NamedTuple):
    """What the logs would show of an effect.

    From `size` on (SI, `unit`) it brings the evidence that an effect must bring; up to it, where the effect is the
    weaker the larger this parameter is (`weakens`); None: at no size that would be expected.
    """

    effect: str
    parameter: str
    unit: str
    size: float | None
    weakens: bool


def small_amounts(fitter: Fitter, fitted: Fitted, catalogue: Sequence[Candidate]) -> list[ByAmount]:
    """Answers to each effect that is there by degrees and that a fit has not; the fit is that of `allowed`."""
    logs, found = fitted.model.logged.logs, []
    for candidate in others(fitted, catalogue):
        if any(one.amplitude for one in candidate.parameters):
            points = [usual_values(candidate, logs), *unusual_values(candidate, logs)]
            found.append(ByAmount(candidate, points[0], [answers(fitter, fitted, candidate, at) for at in points]))
    return found


def allowed(fitter: Fitter, fitted: Fitted) -> Fitted | None:
    """The fit in a filter that allows every model the force which counts as nothing missing; None of a fit whose effect
    is stepped within the filter, where each number would take a filter of its own, and where no filter follows.
    """
    if fitted.model.coupled:
        return None
    found = fitter.under(fitted, np.maximum(fitted.process_noise, relevant_forces(fitter, fitted)))
    return found if np.all(np.isfinite(found.hessian)) else None


def detection_limits(
    fitter: Fitter, fitted: Fitted, catalogue: Sequence[Candidate], amounts: Sequence[ByAmount], needed: float
) -> list[DetectionLimit]:
    """Of each effect that a fit has not; `needed` is the evidence that one more must bring. The fit is that of
    `allowed`.
    """
    by_amount = {one.candidate.kind: one for one in amounts}
    limits: dict[tuple[str, str], DetectionLimit] = {}
    for candidate in others(fitted, catalogue):
        for one in _limits_of(fitter, fitted, candidate, by_amount.get(candidate.kind), needed):
            limits.setdefault((one.effect, one.parameter), one)
    return list(limits.values())


def others(fitted: Fitted, catalogue: Sequence[Candidate]) -> list[Candidate]:
    """One of each kind that a fit has not."""
    members = [member.candidate for member in fitted.model.members]
    kinds = {one.kind: one for one in reversed(catalogue) if not any(one.excludes(other) for other in members)}
    return list(reversed(kinds.values()))


def _limits_of(
    fitter: Fitter, fitted: Fitted, candidate: Candidate, amounts: ByAmount | None, needed: float
) -> Iterator[DetectionLimit]:
    if amounts is not None:
        yield from _of_amplitudes(fitter, fitted, amounts, needed)
    elif candidate.parameters:
        yield _of_sizes(fitter, fitted, candidate, needed)


def _of_amplitudes(fitter: Fitter, fitted: Fitted, amounts: ByAmount, needed: float) -> Iterator[DetectionLimit]:
    """A limit for each amplitude, where the other numbers of the effect make it hardest to see."""
    candidate, curvatures = amounts.candidate, [curvature_of(fitted, one) for one in amounts.answers]
    known = candidate.by_name
    for parameter, groups in amplitude_groups(amounts.labels).items():
        sizes = [
            deviations(gain_per_deviation(explained(one, one), groups), needed + volume(one)) for one in curvatures
        ]
        spread, worst = known[parameter].spread, max(sizes)
        if not is_alone(fitted, candidate, amounts.usual, parameter, UNEXPECTED * spread):
            continue
        size = max(spread * worst, candidate.least if parameter == WAVE[0] else 0.0)
        yield limit_of(fitter, candidate, parameter, size if worst <= UNEXPECTED else None)


def answers(fitter: Fitter, fitted: Fitted, candidate: Candidate, values: Values) -> Answers:
    """To the amplitudes of a candidate, in units of their priors, at values of its other numbers."""
    columns, labels = sensitivities(fitted, candidate, values)
    if fitter.twist is None:
        return Answers(labels, columns, np.zeros((0, len(labels))))
    logged, seen = fitted.model.logged, []
    there = predicted_twist(fitted.model.effects(fitted.theta), fitted.filtered)
    for one, log in labels:
        here = np.array([one.spread if log in (None, k) else 0.0 for k in range(logged.logs)])
        effect = effect_in_lanes(candidate.effect, values | {one.name: here}, logged.owner)
        twist = predicted_twist((effect,), fitted.filtered) if candidate.twists else 0.0 * there
        seen.append(seen_by(fitter.twist, twist, there, logged.sampling.period))
    return Answers(labels, columns, np.stack(seen, axis=1))


def curvature_of(fitted: Fitted, one: Answers) -> Products:
    """Of the cost by what is answered, once what is free has made way."""
    return reduced(fitted, one.residuals).curvature + one.second.T @ one.second


def volume(curvature: Products) -> float:
    """Logarithm of the volume that the logs leave of the priors of amounts."""
    return float(log_volume(curvature + np.eye(len(curvature))))


def explained(shared: Products, own: Products) -> Products:
    """What -2 log likelihood falls by, as a square of amounts of one effect, with another in its place.

    `own` is the curvature of the other's amounts, and `shared` has the products of the first with them; of the effect
    itself both are its curvature. Its prior takes its share.
    """
    return shared @ solved(own + np.eye(len(own)), shared.T)


def usual_values(candidate: Candidate, logs: int) -> Values:
    """What is no amplitude at the middle of its prior; what has no prior, as the grid has it."""
    middle = {one.name: one.middle for one in candidate.parameters if not one.amplitude}
    return {name: np.full(logs, value) for name, value in (candidate.grid[0] | middle).items()}


def unusual_values(candidate: Candidate, logs: int) -> list[Values]:
    """The usual values with each of them moved by a deviation of its prior, within its bounds; times stay."""
    usual, points = usual_values(candidate, logs), []
    for one in candidate.parameters:
        if not (one.amplitude or one.session):
            moved = (usual | {one.name: np.full(logs, one.value(by))} for by in EITHER)
            points += [values for values in moved if _within(candidate, one.name, float(values[one.name][0]))]
    return points


def _within(candidate: Candidate, name: str, value: float) -> bool:
    return all(low < value < high for bound, low, high in candidate.bounds if bound == name)


def is_alone(fitted: Fitted, candidate: Candidate, usual: Values, parameter: str, size: float) -> bool:
    """Whether a candidate may be this amplitude alone, however large: a lead error is a wave, whatever else it is."""
    logs = fitted.model.logged.logs
    none = {one.name: np.zeros(logs) for one in candidate.parameters if one.amplitude}
    return candidate.plausible(usual | none | {parameter: np.full(logs, size)}, fitted.model.logged.lasts)


def amplitude_groups(labels: Labels) -> dict[str, list[Group]]:
    """The columns of each size by its parameter, log by log: cosine and sine are one; of waves the first harmonic."""
    groups: dict[str, dict[int | None, list[int]]] = {}
    for column, (parameter, log) in enumerate(labels):
        if parameter.name[-1].isdigit() and parameter.name[:-1] in WAVE:
            continue
        name = WAVE[0] if parameter.name in WAVE else parameter.name
        groups.setdefault(name, {}).setdefault(log, []).append(column)
    return {name: list(each.values()) for name, each in groups.items()}


def gain_per_deviation(gains: Products, groups: Sequence[Group]) -> float:
    """Evidence of one deviation of the prior in every log alike; of a wave, at the phases that show least of it.

    `gains` are those of all amounts, as a square.
    """
    every = [column for group in groups for column in group]
    gains = gains[np.ix_(every, every)]
    if len(every) == len(groups):
        return float(gains.sum())
    return len(groups) * float(np.linalg.eigvalsh(gains)[0])


def deviations(evidence: float, needed: float) -> float:
    """Size, in deviations of its prior, that brings the evidence that is needed."""
    return float(np.sqrt(max(needed, 0.0) / evidence)) if evidence > 0.0 else np.inf


def _of_sizes(fitter: Fitter, fitted: Fitted, candidate: Candidate, needed: float) -> DetectionLimit:
    """The limit of an effect that is not linear in its size, all else as usual: the last size, from the strongest on,
    that brings what is needed, by sizes that close in on it.
    """
    one, needed = candidate.parameters[0], needed + DEARNESS * len(candidate.parameters)
    gain, sizes = gain_of(fitter, fitted, candidate), possible_sizes(candidate)
    size: float | None = None
    for value in map(float, sizes if candidate.weakens else sizes[::-1]):
        if gain(value) >= needed:
            size = value
            continue
        if size is not None:
            size = _between(value, size, lambda middle: gain(middle) >= needed)
        break
    return limit_of(fitter, candidate, one.name, None if size is None else one.value(size))


def _between(weak: float, strong: float, is_seen: Callable[[float], bool]) -> float:
    """The least size that is seen, between one that is not and one that is."""
    for _ in range(HALVINGS):
        middle = 0.5 * (weak + strong)
        weak, strong = (weak, middle) if is_seen(middle) else (middle, strong)
    return strong


def possible_sizes(candidate: Candidate) -> Vector:
    """Sizes of the first parameter at which a candidate without amplitudes is tried, in deviations of its prior: evenly
    over what is expected, and just inside of its bounds.
    """
    one = candidate.parameters[0]
    sizes = DECADES if one.scale is ITSELF else SIZES
    ends = [
        one.standard(end)
        for name, low, high in candidate.bounds
        if name == one.name
        for end in (low * (1.0 + INSIDE), high * (1.0 - INSIDE))
        if 0.0 < end < np.inf
    ]
    every = np.unique([*sizes, *(end for end in ends if sizes[0] < end < sizes[-1])])
    return np.array([size for size in every if _within(candidate, one.name, one.value(size))])


def gain_of(fitter: Fitter, fitted: Fitted, candidate: Candidate) -> Callable[[float], float]:
    """What -2 log likelihood falls by with an effect without amplitudes in the log of a machine that has it, by a size
    of its first parameter (in deviations of its prior); beyond what it does where it is `bare`.
    """
    one, logs = candidate.parameters[0], fitted.model.logged.logs
    usual, model = usual_values(candidate, logs), joined(fitted.model, candidate)

    def at(value: float) -> tuple[Point, Float[np.ndarray, "lanes n"]]:
        theta = np.r_[fitted.theta, begin(model, usual | {one.name: np.full(logs, value)})]
        point = fitter.at(model, theta, fitted.process_noise, fitted.filtered.trajectory)
        return point, predicted_twist(model.effects(theta), point.filtered)

    def without() -> tuple[Point, Float[np.ndarray, "lanes n"]]:
        there = fitter.again(fitted)
        return there, predicted_twist(fitted.model.effects(fitted.theta), there.filtered)

    before, wound = without() if candidate.bare is None else at(candidate.bare)

    def gain(size: float) -> float:
        point, twist = at(one.value(size))
        gained = float(reduced(fitted, _change(fitter, before, point)[:, None]).curvature[0, 0])
        if fitter.twist is not None and candidate.twists:
            seen = seen_by(fitter.twist, twist - wound, wound, fitter.logged.sampling.period)
            gained += float(seen @ seen)
        return gained

    return gain


def _change(fitter: Fitter, before: Point, after: Point) -> Vector:
    """Of the residuals; where a filter is lost that was not, by as much as a lost filter counts."""
    (old, kept), (new, still) = fitter.residuals(before), fitter.residuals(after)
    return np.where(kept > 0.0, np.where(still > 0.0, new - old, LOST * kept), 0.0)


def limit_of(fitter: Fitter, candidate: Candidate, parameter: str, size: float | None) -> DetectionLimit:
    """In the units of the catalogue; delays in periods of the controller."""
    fields = {one.name: one.metadata["quantity"] for one in dataclasses.fields(EFFECTS[candidate.name])}
    per = float(fitter.logged.control_periods) if candidate.effect is LoopDelay else 1.0
    label = AMPLITUDE if parameter == WAVE[0] else parameter
    unit = fields[parameter].unit
    return DetectionLimit(candidate.name, label, unit, None if size is None else per * size, candidate.weakens)
