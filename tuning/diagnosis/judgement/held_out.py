"""What the held-out logs say of a verdict: an effect that does not prove itself there is withdrawn or not believed."""

import itertools
from typing import NamedTuple

import numpy as np

from tuning.diagnosis.fits.fitted import last_candidate
from tuning.diagnosis.fits.goodness_of_fit import is_plausible, restores_nominal
from tuning.diagnosis.judgement.ladder import ModelComparison, known_floor
from tuning.diagnosis.judgement.verdict import Verdict
from tuning.diagnosis.levels import DETAILS, IMPOSSIBLE, SURELY, WORTH
from tuning.diagnosis.selection.explanation import Explanation

HIDDEN = 1.0 + DETAILS  # times the floor: a gap below is none, and no share of it means anything
PLAIN = 2.0  # times the floor's mean square: a gap, be it in a single place, which draws of pieces may miss
PROVED = 0.5  # of the gap beyond the floor, that must be gone
ENLARGED = 2.5  # times its floor: more than what the details of a coarse effect leave
SEEN = 2.0  # times the first model's floor: a larger gap in closed loop counts, and a larger floor makes it void


class GapReduction(NamedTuple):
    """Share of what recalibration left beyond the floor that is gone, with its 95 % interval."""

    share: float
    low: float
    high: float


def gap_reduction(before: ModelComparison, after: ModelComparison, rate: float) -> GapReduction | None:
    """From one model to another, in mean squares beyond the floor; None where only the first filter is lost, and where
    the first gap is at its floor, or may be and the interval excludes nothing, unless the second model opens one.

    A second filter that is lost or ran away closes nothing.
    """
    alike = np.array_equal(before.trusting, after.trusting)  # else each has the floor of its own filter
    floors = np.array([after.floor if alike else before.floor, after.floor])
    squares = [np.r_[one.force.rms**2, one.force.drawn(rate)] for one in (before, after)]
    if not np.all(np.isfinite([*floors, *squares[0], *squares[1]])) or not after.force.is_known:
        return GapReduction(0.0, 0.0, 0.0)
    if not before.force.is_known:
        return None
    least = (HIDDEN**2 - 1.0) * floors[0] ** 2
    hidden = [one[0] < (HIDDEN * floor) ** 2 for one, floor in zip(squares, floors, strict=True)]
    surely = np.percentile(squares[1][1:] - squares[0][1:], 2.5) > 0.0
    opened = surely or squares[1][0] > PLAIN * floors[1] ** 2
    if hidden[0] and (hidden[1] or not opened):
        return None
    beyond = [np.maximum(squares[0] - floors[0] ** 2, least), np.maximum(squares[1] - floors[1] ** 2, 0.0)]
    shares = 1.0 - beyond[1] / beyond[0]
    low, high = np.percentile(shares[1:], [2.5, 97.5])
    perhaps = np.percentile(squares[0][1:], 2.5) < (HIDDEN * floors[0]) ** 2  # there was nothing to be closed
    if perhaps and low <= 0.0 and high >= 1.0 and squares[1][0] <= squares[0][0]:
        return None
    return GapReduction(float(shares[0]), float(low), float(high))


def is_hidden(found: Explanation) -> bool:
    """Whether recalibration alone tells the logs as well as what was found, but with a nominal parameter moved far: a
    payload is a heavier table. Then no log holds one against the other, what either leaves is the same, and the drive
    file decides.
    """
    gained = float(found.base.filtered.deviance) - float(found.best.filtered.deviance)
    return gained < WORTH and restores_nominal(found.best, found.base)


def gap_reductions(found: Explanation, comparisons: list[ModelComparison], rate: float) -> list[float | None]:
    """Of each effect found, the share that it surely takes of what the model before it leaves beyond the floor, at the
    low end of its interval; none where what was found cannot be, or foresees what is held out worse than nothing.
    """
    gained = found.base.evidence - found.best.evidence
    if (
        len(comparisons) <= 2
        or not is_plausible(found.best)
        or fails_validation(comparisons[-1], comparisons[1], gained)
    ):
        return []
    steps = [gap_reduction(before, after, rate) for before, after in itertools.pairwise(comparisons[1:])]
    return [None if one is None else one.low for one in steps]


def left_in_loop(comparisons: list[ModelComparison]) -> float | None:
    """Share of the recalibrated drive's gap in closed loop that the last model leaves; None where the loop cannot tell.

    Beside another effect that closes the gap, one whose details differ must have closed most of what it found there.
    """
    if len(comparisons) <= 2:
        return None
    share = _left(comparisons[1], comparisons[-1])
    if share is None or share >= PROVED:
        return share
    steps = [
        _left(before, after)
        for before, after in itertools.pairwise(comparisons[1:])
        if last_candidate(after.fitted).coarse
    ]
    return share if all(one is not None and one < PROVED for one in steps) else None


def _left(before: ModelComparison, after: ModelComparison) -> float | None:
    """Share of the gap in closed loop, in mean squares, that one model leaves of another's, of position or command the
    larger; None where there is hardly any, or where it is not known.

    Either is measured against the lesser floor: a simulation that hunts differs from itself as much as from the log.
    """
    if before.loop is None or after.loop is None or before.loop.says:
        return None
    if after.loop.says:
        return 1.0
    shares = []
    for name in ("position", "command"):
        (rms, floor), (then, there) = (
            (getattr(one.loop, f"{name}_rms"), getattr(one.loop, f"{name}_floor")) for one in (before, after)
        )
        if rms > SEEN * floor and there <= SEEN * floor:
            none = PLAIN * min(floor, there) ** 2
            shares.append(float(np.clip((then**2 - none) / (rms**2 - none), 0.0, 1.0)))
    return max(shares, default=None)


def prune_on_validation(
    found: Explanation, comparisons: list[ModelComparison]
) -> tuple[Explanation, list[ModelComparison]]:
    """Without the further effects that foresee the held-out logs worse than fewer effects do."""
    for number in range(1, found.best.model.added):
        without, more = comparisons[number + 1], comparisons[number + 2]
        gained = found.rounds[number].before.evidence - found.rounds[number].fits[0].evidence
        if fails_validation(more, without, gained):
            believed, withdrawn = found.rounds[:number], found.rounds[number:]
            rounds = [*believed, *(one._replace(enough=np.inf) for one in withdrawn)]
            fewer = found.rounds[number].before  # against which what another way found with more effects is no rival
            return found._replace(rounds=rounds, best=fewer, other=None), comparisons[: number + 2]
    return found, comparisons


def fails_validation(more: ModelComparison, fewer: ModelComparison, gained: float) -> bool:
    """Whether the held-out logs are foreseen worse with more effects: by more than chance, and than a little.

    Numbers that no machine of this drive file can have may foresee a little better: they deny nothing. A filter that
    ran away foresees nothing.
    """
    if not np.all(np.isfinite(more.unlikely)):
        return True
    if not np.all(np.isfinite(fewer.unlikely)):
        return False
    if restores_nominal(more.fitted, fewer.fitted, IMPOSSIBLE):
        return False
    worse = more.unlikely - fewer.unlikely
    return bool(worse.sum() > max(WORTH, DETAILS * gained, SURELY * np.sqrt(worse.size) * np.std(worse)))


def confirmed(verdict: Verdict, comparisons: list[ModelComparison], share: GapReduction | None) -> Verdict:
    """No sure cause that foresees the held-out logs worse than the recalibrated drive, leaves most of their gap, or is
    one that may leave details and leaves plainly more than noise makes.
    """
    gained = sum(one.gain for one in verdict.beliefs if one.found)
    names = " and ".join(one.effect for one in verdict.beliefs if one.found)
    if not names:
        return verdict
    if fails_validation(comparisons[-1], comparisons[1], gained):
        return verdict.downgraded("the held-out data are predicted worse than without")
    if share is not None and (share.share < PROVED or share.low <= 0.0):
        gone = f"{100 * share.share:.0f} % ({100 * share.low:.0f} to {100 * share.high:.0f})"
        return verdict.downgraded(f"in the held-out data only {gone} of the missing force is gone")
    last = comparisons[-1]
    floor = known_floor(comparisons, last) if last.fitted.model.coarse and last.force.is_known else None
    if floor is not None and last.force.rms > ENLARGED * floor:
        times = last.force.rms / floor
        return verdict.downgraded(f"the force still missing in the held-out data is {times:.1f} times its floor")
    return verdict
