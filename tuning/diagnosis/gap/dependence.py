"""What a missing force depends on: place, speed, time or command, as a free function of it.

Beside a fit a function is free, a polygon over so many knots, whose corners have independent normal priors. Their scale
is not chosen: it is integrated over a grid that reaches from next to nothing to the friction itself. To first order
(`residual_jvp`) the evidence and the function itself follow at once. What no effect of the catalogue explains is
described by the likeliest of these functions: a friction that changes with time, say, by so many newtons.
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from tuning.diagnosis.filter.effect_signals import EffectSignals
from tuning.diagnosis.fits.curvature import log_volume, solved
from tuning.diagnosis.fits.fitted import Fitted, residual_jvp
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.reduced import reduced
from tuning.diagnosis.hypotheses.setting import Setting
from tuning.diagnosis.levels import WORTH

SCALES = np.geomspace(1e-4, 1.0, 9)  # of the unit of a function, the standard deviation of its corners
PLACES, SPEEDS, TIMES, FORCES = 25, 9, 9, 13  # knots: few enough to be smooth, dense enough for a chip on the guide
PROCESSES = (1.0, 0.1, 0.01)  # times the forces that the filter of the fit may invent: it is known to a decade
PAST = (1, 2, 3, 4, 6)  # samples ago, of commands that may act late: a delay or a lag is a sum of these
MICROMETRE = 1e-6
SLOW = 1e-3  # m/s: knots of speed are dense below it, where friction falls
MOST = 0.9  # of its energy, that lies in the range in which a function is said to be large

Signal = Float[np.ndarray, "lanes n"]
Basis = Float[np.ndarray, "lanes n c"]


class Family(NamedTuple):
    """Functions of one kind: of what, what they are, and what each corner adds."""

    of: str  # "position", "speed", "time", "command" or "past commands"
    kind: str  # "force", "friction" or "scale": what it adds to, by `FIELDS`
    unit: float  # N or m
    basis: Basis  # the corners' hats


class Dependence(NamedTuple):
    """A function that would explain what is left, and what it is worth.

    `rms` (N, or m of the scale) is over the samples that move; `low` and `high` are the ends of the range of what it
    depends on in which most of it lies (SI). Times are those of the log in which most of it lies: `log`, from 1.
    """

    of: str
    kind: str
    evidence: float
    rms: float
    low: float | None
    high: float | None
    log: int | None


def dependences(fitter: Fitter, fitted: Fitted, at: Setting) -> list[Dependence] | None:
    """What would explain what a fit leaves, the likeliest first; those that bring what an effect must.

    With a function that explains it, the filter need not invent a force: it is tried with less, too. None of a fit
    whose effect is stepped within the filter: there each corner would take a filter of its own.
    """
    if fitted.model.coupled:
        return None
    best: dict[tuple[str, str], Dependence] = {}
    for share in PROCESSES:
        under = fitter.under(fitted, np.maximum(share * fitted.process_noise, fitter.floor))
        slope = under.jacobian.T @ under.residual + under.theta
        moved = float(slope @ solved(under.hessian, slope))  # what is free gains by itself in this filter
        dearer = under.evidence - moved - fitted.evidence
        if not np.isfinite(dearer):
            continue
        for family, abscissa in families(under, at):
            found = _judged(under, family, abscissa)
            found = found._replace(evidence=found.evidence - dearer)
            if found.evidence > best.get((found.of, found.kind), found._replace(evidence=WORTH)).evidence:
                best[found.of, found.kind] = found
    return sorted(best.values(), key=lambda one: -one.evidence)


def hats(values: Signal, knots: Float[np.ndarray, " c"]) -> Basis:
    """Each knot's polygon: one there, zero at its neighbours; beyond the ends as at the ends."""
    inside = np.clip(values, knots[0], knots[-1])
    return np.stack([np.interp(inside, knots, corner) for corner in np.eye(len(knots))], axis=-1)


def families(fitted: Fitted, at: Setting) -> Iterator[tuple[Family, Signal]]:
    """The functions that may be free beside a fit, and what each is of."""
    logged, trajectory = fitted.model.logged, fitted.filtered.trajectory
    position, velocity = np.asarray(trajectory.position), np.asarray(trajectory.velocity)
    command = np.asarray(logged.lanes.command)
    samples = np.arange(position.shape[1])
    time = np.asarray(logged.starts)[:, None] + samples * logged.sampling.period
    owner = np.asarray(logged.owner)

    def log_by_log(basis: Basis) -> Basis:
        return np.concatenate([basis * (owner == log)[:, None, None] for log in range(logged.logs)], axis=-1)

    fastest = np.arcsinh(at.speed / SLOW)
    speeds = SLOW * np.sinh(np.linspace(0.0, fastest, SPEEDS))
    by_speed = hats(np.abs(velocity), speeds)
    both_ways = np.concatenate(
        [by_speed * (velocity >= 0.0)[..., None], by_speed * (velocity < 0.0)[..., None]], axis=-1
    )
    places = hats(position, np.linspace(at.low, at.high, PLACES))
    times = log_by_log(hats(time, np.linspace(0.0, at.duration, TIMES)))
    forces = hats(command, at.command * np.linspace(-1.0, 1.0, FORCES))
    past = np.stack([_late(command, by) - command for by in PAST], axis=-1) / at.friction
    newton = at.friction
    yield Family("position", "force", newton, places), position
    yield Family("position", "friction", newton, places), position
    yield Family("speed", "friction", newton, both_ways), np.abs(velocity)
    yield Family("time", "force", newton, times), time
    yield Family("time", "friction", newton, times), time
    yield Family("command", "force", newton, forces), command
    yield Family("past commands", "force", newton, past), command
    yield Family("position", "scale", MICROMETRE, places), position


def _late(signal: Signal, samples: int) -> Signal:
    return np.concatenate([np.repeat(signal[:, :1], samples, axis=1), signal[:, :-samples]], axis=1)


FIELDS = {"force": "force", "friction": "coulomb", "scale": "scale"}


def corner_answers(fitted: Fitted, family: Family) -> Float[np.ndarray, "m c"]:
    """Derivatives of the residuals by each corner."""
    acts = jnp.asarray(family.unit * family.basis)
    still = jnp.zeros_like(acts)
    bend = EffectSignals(*(still for _ in range(7)))._replace(**{FIELDS[family.kind]: acts})
    return residual_jvp(fitted, bend)


def _judged(fitted: Fitted, family: Family, abscissa: Signal) -> Dependence:
    curvature, slope, _, _ = reduced(fitted, corner_answers(fitted, family))
    evidences, corners = zip(*(_at_scale(curvature, slope, scale) for scale in SCALES), strict=True)
    weights = 0.5 * np.array(evidences)
    evidence = 2.0 * float(logsumexp(weights) - np.log(len(SCALES)))
    shares = np.exp(weights - logsumexp(weights))
    function = family.basis @ (family.unit * np.einsum("s,sc->c", shares, np.array(corners)))
    return Dependence(family.of, family.kind, evidence, *_size(fitted, function, abscissa, family.of == "time"))


def _at_scale(
    curvature: Float[np.ndarray, "c c"], slope: Float[np.ndarray, " c"], scale: float
) -> tuple[float, Float[np.ndarray, " c"]]:
    """Evidence, and the corners, where their prior has this scale."""
    with_prior = scale**2 * curvature + np.eye(len(slope))
    corners = -scale * solved(with_prior, scale * slope)
    return float(-slope @ corners) - log_volume(with_prior), corners


def _size(
    fitted: Fitted, function: Signal, abscissa: Signal, log_by_log: bool
) -> tuple[float, float | None, float | None, int | None]:
    """RMS of a function of time while the table moves, where most of its energy lies, and the log, if of one."""
    counts = np.asarray(fitted.model.logged.lanes.counts) > 0.0
    moving = counts & (np.abs(np.asarray(fitted.filtered.trajectory.velocity)) > SLOW)
    energy = np.where(moving, function**2, 0.0)
    if not energy.any():
        return 0.0, None, None, None
    rms, log = float(np.sqrt(energy.sum() / moving.sum())), None
    if log_by_log:
        owner = np.asarray(fitted.model.logged.owner)
        most = int(np.argmax([energy[owner == one].sum() for one in range(fitted.model.logged.logs)]))
        moving, log = moving & (owner == most)[:, None], most + 1
    order = np.argsort(abscissa[moving])
    where, shares = abscissa[moving][order], energy[moving][order]
    return rms, *_shortest(where, shares, MOST * float(shares.sum())), log


def _shortest(where: Float[np.ndarray, " k"], energy: Float[np.ndarray, " k"], enough: float) -> tuple[float, float]:
    """The shortest range of `where`, which is sorted, that holds so much energy."""
    total = np.r_[0.0, np.cumsum(energy)]
    ends = np.searchsorted(total, total[:-1] + enough)
    there = np.flatnonzero(ends < len(total))
    first = there[int(np.argmin(where[ends[there] - 1] - where[there]))]
    return float(where[first]), float(where[ends[first] - 1])
