"""Which motion would decide between the causes that the logs leave open.

Each motion that the axis can do is simulated with the surest cause and then read by the model of its rival, the
rival's own parameters free to make the best of it: what is left is what the motion would tell (T-optimality: Atkinson
and Fedorov 1975).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffdrive.controllers import UnknownController
from diffdrive.drive_file import DriveDescription
from diffdrive.motion import Motion
from diffdrive.parameters import as_arrays
from diffdrive.simulate import Inputs, inputs_of, rollout
from tuning.diagnosis.diagnose import Diagnosis
from tuning.diagnosis.fitting import Fitted, Fitter
from tuning.diagnosis.gap import drive_of
from tuning.diagnosis.model import Logged, Member, Model, thinned
from tuning.next_motion import candidates
from tuning.prediction import Lanes

STEPS = 3  # of the rival's fit
ENOUGH = 12.0  # of cost between them
MOTIONS = 4  # that are tried


class Experiment(NamedTuple):
    """A motion, and what it would tell."""

    motion: str  # as `diffdrive simulate --motion` takes it; "" where none is needed or none can be tried
    between: list[str]
    tells: float  # difference of the costs that it would make
    says: str


_rollout = eqx.filter_jit(rollout)


def next_experiment(found: Diagnosis, description: DriveDescription) -> Experiment:
    """The motion that tells the surest cause from its nearest rival best."""
    beliefs = found.verdict.beliefs
    if found.lacks:
        return Experiment("", [], 0.0, f"log {found.lacks[0].motion}")
    if not beliefs or found.verdict.verdict == "none":
        return Experiment("", [], 0.0, "nothing is left to decide")
    first = beliefs[0]
    rivals = [one for one in beliefs if one.round == first.round and one.effect in first.alternatives]
    if not rivals:
        return Experiment("", [first.effect], 0.0, "these logs leave no rival: no further motion is needed")
    rival = rivals[0]
    between = [first.effect, rival.effect]
    if isinstance(description.controller, UnknownController):
        return Experiment("", between, 0.0, "no motion can be tried: the drive file names no controller to simulate")
    motions = candidates(description.drive, description.limits, description.sampling.rate)
    best = ("", 0.0)
    for name, motion in list(motions.items())[-MOTIONS:]:
        told = _told(first.fitted, rival.fitted, description, inputs_of(motion, np.zeros(len(motion.time))))
        if told > best[1]:
            best = (name, told)
    if best[1] < ENOUGH:
        says = f"none of the motions tried would tell {between[0]} from {between[1]}: a second sensor would"
        return Experiment("", between, best[1], says)
    says = f"{best[0]} would tell {between[0]} from {between[1]} (by {best[1]:.0f} in -2 log likelihood)"
    return Experiment(best[0], between, best[1], says)


def reference(offer: Experiment, description: DriveDescription) -> Motion | None:
    """The motion that was offered; None where none was."""
    if not offer.motion:
        return None
    return candidates(description.drive, description.limits, description.sampling.rate)[offer.motion]


def _told(truth: Fitted, rival: Fitted, description: DriveDescription, inputs: Inputs) -> float:
    """By how much a log of this motion would speak for the truth and against the rival."""
    logged = truth.model.logged
    frame = _rollout(*as_arrays((drive_of(truth, 0), description.controller)), inputs, logged.control)
    noise = float(logged.noise) * np.random.default_rng(0).standard_normal(len(frame.position))
    position = frame.position + jnp.asarray(noise)
    flat = jnp.zeros_like(position)
    signals = (position, frame.command, flat, flat, jnp.ones_like(position))
    lanes = thinned(Lanes(*(one[None] for one in signals), velocity=jnp.zeros(1)), logged.thinning)
    fitter = Fitter(logged._replace(lanes=lanes, owner=(0,)))
    flat = jnp.zeros(lanes.position.shape[1])
    costs = []
    for one in (truth, rival):
        model, u = _alone(one, fitter.logged)
        course = jax.tree.map(lambda _: flat[None], one.track.course)._replace(position=lanes.position)
        start = fitter.at(model, u, truth.process, course)
        costs.append(fitter.fit(model, u, truth.process, start.track.course, STEPS).cost)
    return costs[1] - costs[0]


def _alone(fitted: Fitted, logged: Logged) -> tuple[Model, np.ndarray]:
    """The model and its numbers on the first log alone."""
    model = Model(
        logged, tuple(Member(one.candidate, one.fixed) for one in fitted.model.members), fitted.model.tolerance
    )
    kept = [log is None or log == 0 for _, _, log in fitted.model.slots]
    calibration = fitted.model.size - len(kept)
    return model, np.r_[fitted.u[:calibration], fitted.u[calibration:][kept]]
