"""One effect more, where the simulation of what was held out says that much is left of which the filter sees little.

An effect that answers the table has details of its own, with which a filter makes up for another's: beside it little is
missing, be that all the difference to a simulation. What is found so is proved on what was held out, or given up.
"""

from collections.abc import Sequence
from functools import partial

from tuning.diagnosis.candidate import Candidate
from tuning.diagnosis.explain import RELIEF, Explanation, left_by
from tuning.diagnosis.fitting import Fitter
from tuning.diagnosis.held_out import PROVED, denied, left_beyond_floor, left_in_loop
from tuning.diagnosis.ladder import Rung
from tuning.diagnosis.search import Progress, Round, look, whole
from tuning.diagnosis.verdict import may_leave


def beyond(
    fitter: Fitter, found: Explanation, rungs: list[Rung], catalogue: Sequence[Candidate], progress: Progress
) -> Explanation | None:
    """What was found and the likeliest effect beside it, to be proved.

    None where the loop asks for none, or none brings what a small one must.
    """
    left = left_in_loop(rungs)
    if not found.best.model.coarse or left is None or left <= may_leave(found.best):
        return None
    looked = _looked(fitter, found, catalogue, progress)._replace(enough=RELIEF)
    if not looked.worth_it:
        return None
    rounds = [*found.rounds[: found.best.model.added], looked]
    return found._replace(rounds=rounds, best=looked.fits[0])


def proved(more: list[Rung], before: list[Rung], gained: float) -> bool:
    """Whether one effect more closes half of what was left in closed loop, and foresees what is held out no worse."""
    left, then = (left_beyond_floor(rungs[1], rungs[-1]) for rungs in (more, before))
    closes = left is not None and then is not None and left <= (1.0 - PROVED) * then
    return closes and not denied(more[-1], more[-2], gained)


def _looked(fitter: Fitter, found: Explanation, catalogue: Sequence[Candidate], progress: Progress) -> Round:
    """The round in which one more was looked for and was not worth it, if it was among all effects; else a new one."""
    number, left = found.best.model.added, partial(left_by, fitter, found.base)
    if len(found.rounds) > number and not whole(found.best, left):
        return found.rounds[number]
    return look(fitter, found.best, catalogue, progress, left, found.rounds[0].telling)
