"""Which samples the models of a ladder are fitted to, and which they are judged by.

What is held out has to move, since at rest the friction may be anything, and it has to hold what was found: where the
effect does not act, nothing is proved. What is fitted has to tell every number that is carried over, the drive's own
among them, or these would be what nothing but the prior gave them (of every other piece, at least those of what was
found, where one choice does). What is of the session is registered on the first
half of a log that is held out, and judged by the second, where the first tells it and the second shows it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.gap.gap import SLID, sliding_samples
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.model import Model

TRAINED = 0.6  # of a single log's motion
TOLD = 0.1  # of what all samples tell of a number: less, and the part that is fitted does not know it
TURNS = 10  # pieces of each log's motion, every other one held out
SESSION = "phases, times and sizes of waves registered on "


Weights = Float[np.ndarray, "lanes n"]


class Split(NamedTuple):
    """Weights of the samples to fit and of those to judge by, [lanes, n] each, and what they are."""

    train: Weights
    register: Weights  # to fit the numbers of the session to
    test: Weights
    logs: list[int]  # judged by
    whole: list[int]  # of those, the ones of which nothing is fitted
    says: str


def split(fitter: Fitter, best: Fitted) -> Split:
    """The last log that the others need not; of a single one, the end. Where the rest would not tell what `best` has
    found, or what is held out would not, every other piece of each log.
    """
    logged = fitter.logged
    counts = np.asarray(logged.lanes.counts)
    moves = sliding_samples(counts, best.filtered, logged.sampling.rate)
    owner = np.array(logged.owner)
    travelled = _travelled(moves, owner)
    if logged.logs == 1:
        early, times = travelled <= TRAINED, of_session(best.model)
        if np.all(determined(best, early) | times) and np.all(
            determined(best, ~early) | times | ~_of_effects(best.model)
        ):
            says = f"the last {100 * (1 - TRAINED):.0f} % of the motion held out"
            return Split(counts * early, counts * early, counts * ~early, [0], [], says)
    # by what rests nothing is judged
    going = [log for log in range(logged.logs) if moves[owner == log].sum() > SLID * counts[owner == log].sum()]
    session = _of_session(best.model)
    for log in reversed(going) if logged.logs > 1 else ():
        mine = (owner == log)[:, None]
        shown = determined(best, counts * mine > 0, TOLD / logged.logs) | session | ~_of_effects(best.model)
        if np.all(determined(best, counts * ~mine > 0) | session) and np.all(shown):
            return _held_out(best, counts * ~mine, counts * mine, moves * mine, log)
    fitted = _every_other(best, travelled, ~np.isin(owner, going)[:, None])
    which, whole = ("the log", "its end or the rest") if logged.logs == 1 else ("each log", "any one log or the others")
    says = f"every other tenth of {which} held out, since {whole} would determine too little, {SESSION}the rest"
    return Split(counts * fitted, counts * fitted, counts * ~fitted, going, [], says)


def _every_other(best: Fitted, travelled: Weights, still: Bool[np.ndarray, "lanes 1"]) -> Bool[np.ndarray, "lanes n"]:
    """Every other tenth, and all of what is `still`: the first of both choices that tells what was found, if one does.

    What acts in a single place is not proved by what is held out. Were it held out itself, only its prior would say how
    large it is, and what is foreseen with that is no evidence against it.
    """
    still = still | (travelled <= 0.0) | (travelled >= 1.0)  # before its motion and after it
    ways = [(np.floor(travelled * TURNS) % 2 == first) | still for first in (0, 1)]
    needless = of_session(best.model) | ~_of_effects(best.model)
    return next((way for way in ways if np.all(determined(best, way) | needless)), ways[0])


def _travelled(moves: Weights, owner: Int[np.ndarray, " lanes"]) -> Weights:
    """How much of its log's motion is behind each sample, from 0 to 1."""
    travelled = np.empty_like(moves)
    for log in np.unique(owner):
        mine = moves[owner == log]
        travelled[owner == log] = np.cumsum(mine).reshape(mine.shape) / max(mine.sum(), 1.0)
    return travelled


def _held_out(best: Fitted, train: Weights, there: Weights, moves: Weights, log: int) -> Split:
    """A whole log held out; judged by its second half if the first tells what is of the session, and both its sizes."""
    session = best.model.mask(lambda _member, _name, one: one == log)
    says = f"log {log + 1} held out"
    if not session.any():
        return Split(train, there, there, [log], [log], says)
    first = (np.cumsum(moves) <= 0.5 * moves.sum()).reshape(moves.shape)
    known, seen = (determined(best, (there * half) > 0) | ~session for half in (first, ~first))
    if np.all(known) and np.all(seen | of_session(best.model)):
        return Split(train, there * first, there * ~first, [log], [log], f"{says}, {SESSION}its first half")
    return Split(train, there, there, [log], [log], f"{says}, {SESSION}it")


def of_session(model: Model) -> Bool[np.ndarray, " k"]:
    """Which numbers are times of the session: they tell where an effect acts, not how much."""
    sizes = {
        (index, one.name)
        for index, member in enumerate(model.members)
        for one in member.candidate.parameters
        if one.amplitude
    }
    return model.mask(lambda index, name, log: log is not None and (index, name) not in sizes)


def _of_session(model: Model) -> Bool[np.ndarray, " k"]:
    """Which numbers are of one log alone."""
    return model.mask(lambda _member, _name, log: log is not None)


def _of_effects(model: Model) -> Bool[np.ndarray, " k"]:
    """Which numbers are not the drive's own."""
    return np.arange(model.size) >= len(NAMES)


def determined(one: Fitted, fitted: Bool[np.ndarray, "lanes n"], least: float = TOLD) -> Bool[np.ndarray, " k"]:
    """Which of a fit's numbers these samples tell: at least such a share of what all do, or all tell less than the
    prior.
    """
    squares = one.jacobian**2
    every = squares.sum(axis=0)
    return (fitted.ravel() @ squares >= least * every) | (every < 1.0)
