"""Which motion would decide between the causes that the logs leave open, or show more of what none explains.

Each motion that the axis can do is simulated with the surest cause and then read by the model of its rival, the
rival's own parameters free to make the best of it: what is left is what the motion would tell (T-optimality: Atkinson
and Fedorov 1975). Where no effect explains the gap, there are no two models to tell apart: the motion is one that
dwells where the gap lies.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffdrive import motion as motions
from diffdrive.axis import Axis
from diffdrive.controllers import UnknownController
from diffdrive.errors import MotionError
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.step import Inputs
from diffdrive.model.parameters import Sensor
from diffdrive.motion.motion import Motion, require_within
from diffdrive.numerics.arrays import as_arrays
from tuning.diagnosis.diagnose import Diagnosis
from tuning.diagnosis.fits.fitted import Fitted, last_candidate
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.gap.gap import MOVING, drive_of
from tuning.diagnosis.gap.where import SIGNIFICANT, Region
from tuning.diagnosis.hypotheses.model import Logged, Model, thinned
from tuning.diagnosis.judgement.verdict import Belief
from tuning.diagnosis.levels import COLDEST, EXCLUDED, LEFT
from tuning.experiment_design.next_motion import ACCELERATION, available_limits, candidates
from tuning.identification.prediction import Lanes

STEPS, MORE = 3, 12  # of the rival's fit: to choose a motion, and before it is believed
LASTS = 10.0  # s, that strokes are repeated for
TURNS = 5.0  # Hz, of a sine that is to turn often
SLOW, PAUSE = 5.0, 0.5  # s for a slow stroke, and between strokes that stop often
UNITS = {
    "amplitude": "m", "travel": "m", "distance": "m", "start": "m", "speed": "m/s", "speeds": "m/s",
    "acceleration": "m/s^2", "dwell": "s", "duration": "s", "frequency": "Hz",
}  # fmt: skip
ELSEWHERE = ("subsystem", "signal")  # regions that are no part of a motion
ROOM = 0.9  # of the travel that was logged: the longest stroke, about its middle


class Experiment(NamedTuple):
    """A motion, and what it would tell."""

    motion: str  # as `diffdrive simulate --motion` takes it; "" where none is needed or none can be tried
    between: list[str]
    tells: float  # difference of the costs that it would make
    says: str  # a whole sentence
    reference: Motion | None = None  # that motion, to be run

    @classmethod
    def none(cls, says: str, between: Sequence[str] = (), tells: float = 0.0) -> "Experiment":
        """No motion."""
        return cls("", list(between), tells, says)


_rollout = eqx.filter_jit(rollout_loop)


def next_experiment(found: Diagnosis, description: Axis) -> Experiment:
    """The motion that tells a cause that was found from its nearest rival best, or that shows more of the gap."""
    verdict = found.verdict
    causes = [one for one in verdict.beliefs if one.found]
    if found.excitation_deficits:
        return Experiment.none(f"Log {found.excitation_deficits[0].motion}.")
    if verdict.verdict == "none":
        return Experiment.none("Nothing is left to decide.")
    if verdict.verdict == "unknown" and not causes and verdict.unexplained == 0.0:
        return Experiment.none(f"Measure that parameter by itself, no motion is proposed: {verdict.says}.")
    pairs = [(cause, *rival) for cause in causes for rival in _rivals(found, cause)]
    if not pairs and verdict.verdict == "unknown":
        return _exciting(found, description)
    if not pairs:
        says = "These logs leave no rival: no further motion is needed."
        return Experiment.none(says, [one.effect for one in causes])
    first, rival, fitted = pairs[0]
    between = [first.effect, rival]
    if isinstance(description.controller, UnknownController):
        return Experiment.none("No motion can be tried: the drive file names no controller to simulate.", between)
    limits, about = available_limits(found.logged.lanes, description.limits)
    tried = candidates(description.drive, limits, description.sampling.rate, about)

    def tells_of(name: str, steps: int) -> float:
        inputs = loop_inputs(tried[name], np.zeros(len(tried[name].time)))
        return _misfit(first.fitted, fitted, description, inputs, steps)

    best, tells = _surest({name: tells_of(name, STEPS) for name in tried}, lambda name: tells_of(name, MORE))
    needed = EXCLUDED * max(COLDEST, LEFT * (first.gain + tells))  # by which a verdict excludes a rival
    if tells < needed:
        says = (
            f"None of the {len(tried)} motions tried would distinguish {between[0]} from {between[1]} "
            f"(the best by {tells:.0f} in -2 log likelihood, {needed:.0f} being enough)."
        )
        return Experiment.none(says, between, tells)
    says = f"The motion {best} would distinguish {between[0]} from {between[1]} (by {tells:.0f} in -2 log likelihood)."
    return Experiment(best, between, tells, says, tried[best])


def _rivals(found: Diagnosis, cause: Belief) -> list[tuple[str, Fitted]]:
    """What the logs cannot exclude in the place of a cause, first what was fitted beside the same effects.

    A rival may be surer in another round: there it stands beside others, maybe beside the cause itself.
    """
    beliefs = found.verdict.beliefs
    beside = {last_candidate(one).name: one for one in found.explanation.rounds[cause.round].fits}
    beside |= {one.effect: one.fitted for one in beliefs if one.round == cause.round}
    rivals = [one for one in beliefs if not one.found and one.effect in cause.alternatives]
    rivals.sort(key=lambda one: one.effect not in beside)
    return [(one.effect, beside.get(one.effect, one.fitted)) for one in rivals]


def _surest(misfits: dict[str, float], again: Callable[[str], float]) -> tuple[str, float]:
    """The motion that tells most once it was looked at `again`: a rival's short fit may have stopped on its way."""
    looked: dict[str, float] = {}
    while misfits:
        name = max(misfits, key=lambda one: looked.get(one, misfits[one]))
        if name in looked:
            return name, looked[name]
        looked[name] = min(misfits[name], again(name))
    return "", 0.0


def _written(kind: str, **settings: float | list[float]) -> str:
    """A motion as text."""
    texts = {key: ";".join(f"{one:.6g}" for one in np.atleast_1d(value)) for key, value in settings.items()}
    return f"{kind}:" + ",".join(f"{key}={value}{UNITS.get(key, '')}" for key, value in texts.items())


def _built(text: str, rate: float) -> Motion:
    """The motion from such a text."""
    kind, _, rest = text.partition(":")
    settings = dict(item.split("=") for item in rest.split(","))
    values = {
        key: [float(one) for one in value.removesuffix(UNITS.get(key, "")).split(";")]
        for key, value in settings.items()
    }
    given = {key: value if key == "speeds" else value[0] for key, value in values.items()}
    return getattr(motions, kind)(**given, rate=rate)


class _Axis(NamedTuple):
    """What the logs went through, and what a motion may do there."""

    middle: float  # m
    travel: float  # m
    speed: float  # m/s
    acceleration: float  # m/s^2

    def start(self, travel: float) -> float:
        """Where a motion that goes so far begins, to lie about the middle (m)."""
        return self.middle - 0.5 * travel


def _exciting(found: Diagnosis, description: Axis) -> Experiment:
    """The motion that dwells where the recalibrated drive's gap lies."""
    if not found.gap.is_known:
        return Experiment.none("No motion is proposed for a drive file so far from its logs: correct units, signs.")
    limits = description.limits
    counted = np.asarray(found.logged.lanes.counts) > 0
    position = np.asarray(found.logged.lanes.position)[counted]
    speeds = np.abs(np.asarray(found.gap.trajectory.velocity)[counted])
    moving = speeds[speeds > min(MOVING, 0.5 * float(np.max(speeds, initial=0.0)))]
    speed = np.percentile(moving, 95) if moving.size else limits.speed
    at = _Axis(
        float(position.min() + 0.5 * np.ptp(position)),
        float(ROOM * np.ptp(position)),
        min(float(speed), 0.8 * limits.speed),
        min(ACCELERATION, 0.8 * limits.acceleration),
    )
    telling = [one for one in found.where if one.p_value < SIGNIFICANT and one.dimension not in ELSEWHERE]
    text, does = _dwelling(telling[0] if telling else None, at)
    lies = (
        f"Of what the recalibrated drive leaves unexplained, {telling[0].says}"
        if telling
        else "The gap lies nowhere in particular"
    )
    try:
        run = require_within(_built(text, description.sampling.rate), limits)
    except MotionError as problem:
        return Experiment.none(f"{lies}; no motion is proposed: {problem}.")
    return Experiment(text, [], 0.0, f"{lies}: log {text}, which {does}.", run)


def _dwelling(region: Region | None, at: _Axis) -> tuple[str, str]:
    """A motion that has much of a region, and what it does there."""
    name = "" if region is None else region.region
    line = region is not None and region.dimension == "position" and region.low is None
    if region is None or region.dimension == "frequency" or name == "cruise" or line:
        speeds, travel = [share * at.speed for share in (0.2, 0.5, 1.0)], min(at.travel, 0.4 * SLOW * at.speed)
        start = at.start(travel)
        text = _written("staircase", speeds=speeds, travel=travel, acceleration=at.acceleration, start=start)
        does = "cruises at three speeds: what is locked to time keeps its frequency, what is locked to place its period"
        return text, does
    if name in ("reversal", "acceleration"):
        swing = 2.0 * np.pi * TURNS
        amplitude = min(0.5 * at.travel, at.speed / swing, at.acceleration / swing**2)
        start = at.start(2.0 * amplitude)
        text = _written("sine", amplitude=amplitude, frequency=TURNS, duration=LASTS, start=start)
        return text, f"turns {2 * TURNS:.0f} times a second and accelerates in between"
    if name in ("rest", "start and stop"):
        return _strokes(at, at.speed, 0.2 * at.travel, PAUSE), "starts and stops often, and rests in between"
    if region.dimension == "position":
        return _strokes(at, min(at.speed, at.travel / SLOW), at.travel), "passes slowly over the travel"
    if region.low is not None and region.high is not None and region.dimension == "speed":
        speed = 0.5 * (region.low + region.high)
        return _strokes(at, speed, min(at.travel, SLOW * speed)), "stays at such a speed"
    if region.dimension == "load":
        return _strokes(at, at.speed, at.travel), "is to be run under such a load and under another"
    if region.dimension == "direction":
        return _strokes(at, at.speed, at.travel), "runs the same strokes in both directions"
    return _strokes(
        at, at.speed, at.travel
    ), "repeats one stroke, and so separates what comes once from what comes again"


def _strokes(at: _Axis, speed: float, distance: float, dwell: float = 0.1) -> str:
    """Strokes there and back, for `LASTS` s or once."""
    once = 2.0 * (distance / speed + speed / at.acceleration + dwell)
    return _written(
        "trapezoidal", distance=distance, speed=speed, acceleration=at.acceleration, dwell=dwell,
        repeats=max(1, round(LASTS / once)), start=at.start(distance),
    )  # fmt: skip


def _misfit(truth: Fitted, rival: Fitted, description: Axis, inputs: Inputs, steps: int) -> float:
    """By how much a log of this motion would speak for the truth and against the rival."""
    logged, drive = truth.model.logged, drive_of(truth, 0)
    drive = dataclasses.replace(drive, sensor=Sensor(None, float(logged.noise)))  # quantisation is a part of that noise
    frame = _rollout(*as_arrays((drive, description.controller)), inputs, logged.control, jax.random.key(0))
    position, command = jnp.asarray(frame.measured), jnp.asarray(frame.command)
    none, counts = jnp.zeros_like(position)[None], jnp.ones_like(position)[None]
    lanes = thinned(Lanes(position[None], command[None], none, none, counts, jnp.zeros(1)), logged.thinning)
    fitter = Fitter(logged._replace(lanes=lanes, owner=(0,), starts=jnp.zeros(1)))
    flat = jnp.zeros(lanes.position.shape[1])
    costs = []
    for one in (truth, rival):
        model, theta = _alone(one, fitter.logged)
        trajectory = jax.tree.map(lambda _: flat[None], one.filtered.trajectory)._replace(position=lanes.position)
        start = fitter.at(model, theta, truth.process_noise, trajectory)
        costs.append(fitter.fit(model, theta, truth.process_noise, start.filtered.trajectory, steps).cost)
    return costs[1] - costs[0] if np.all(np.isfinite(costs)) else 0.0


def _alone(fitted: Fitted, logged: Logged) -> tuple[Model, np.ndarray]:
    """The model and its numbers on the first log alone."""
    model = fitted.model.on(logged)
    kept = [log is None or log == 0 for _, _, log in fitted.model.slots]
    calibration = fitted.model.size - len(kept)
    return model, np.r_[fitted.theta[:calibration], fitted.theta[calibration:][kept]]
