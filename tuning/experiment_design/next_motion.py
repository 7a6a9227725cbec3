"""Which motion would determine what these logs leave open.

Each candidate is simulated on the drive as identified, through its controller, and differentiated with respect to every
unknown along its filtered prediction. Its Fisher information, added to that of the logs at hand, gives how sharply each
open parameter would be known; for each the sharpest candidate is named.
"""

import contextlib
import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Array, Float

from diffdrive import motion
from diffdrive.controllers import Controller, UnknownController
from diffdrive.errors import MotionError
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.smooth import smooth
from diffdrive.loop.step import Frame, Inputs
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.motion.motion import Limits, Motion, require_within
from diffdrive.numerics.arrays import as_arrays
from tuning.identification.estimates import ReportedParameter, reported_parameters
from tuning.identification.filter_gain import filter_lanes
from tuning.identification.identify import UNDETERMINED, Identification
from tuning.identification.parameters import axis_path
from tuning.identification.prediction import Lanes
from tuning.identification.problem import IdentificationProblem
from tuning.identification.refinement import RefinedFit, linearised
from tuning.identification.uncertainty import LEVEL

DURATION = 3.0  # s, of each candidate
CLEARANCE = 1e-3  # m, from the ends of the axis
SPEED, ACCELERATION = 0.1, 2.0  # m/s and m/s^2, where the axis allows as much


class Proposal(NamedTuple):
    """A motion for one parameter that the logs leave open."""

    parameter: str  # path in an axis
    motion: str  # what to run, in the form that `diffdrive simulate --motion` takes; "" where none of them helps
    unit: str
    before: float  # half-width of the 95 % interval, with the logs at hand; infinite where they say nothing
    after: float  # with that motion logged as well; NaN where that was not simulated


def candidates(drive: Drive, limits: Limits, rate: float, about: float = 0.0) -> dict[str, Motion]:
    """Motions of this drive's own scales about a position (m), by how they are written.

    Those that the axis cannot do are left out.
    """
    friction = drive.friction
    bend = float(friction.breakaway_at(0.0).positive) / float(friction.bristle_stiffness.positive)
    slow = float(friction.stribeck_velocity.positive)
    fast = min(SPEED, 0.8 * limits.speed)
    strong = min(ACCELERATION, 0.8 * limits.acceleration)

    def start_for(travel: float) -> float:
        """Where to begin so that the motion lies about that position, away from the ends of the axis; whole um."""
        low, high = limits.stroke[0] + CLEARANCE, limits.stroke[1] - CLEARANCE - travel
        return round(float(np.clip(about - 0.5 * travel, low, max(low, high))), 6)

    sines = [(0.15 * bend, 5.0), (0.15 * bend, 40.0), (2.0 * bend, 2.0), (strong / (2 * np.pi * 5.0) ** 2, 5.0)]
    strokes = [(slow / 3, 0.5), (slow, 0.5), (3 * slow, 0.5), (fast, 0.7)]
    found = {}
    for wanted, frequency in sines:
        amplitude = _rounded(wanted)
        start = start_for(2.0 * amplitude)
        name = (
            f"sine:amplitude={_length(amplitude)},frequency={frequency:g}Hz,duration={DURATION:g}s,"
            f"start={1e3 * start:.6g}mm"
        )
        with contextlib.suppress(MotionError):
            candidate = motion.sine(amplitude=amplitude, frequency=frequency, duration=DURATION, rate=rate, start=start)
            found[name] = require_within(candidate, limits)
    for wanted, time in strokes:
        speed, rounding = _rounded(wanted), _rounded(max(0.1, wanted / strong))
        stroke = _rounded(speed * (time - rounding / 2.0))
        start = start_for(stroke)
        name = (
            f"triangular:speed={1e3 * speed:.3g}mm/s,stroke={1e3 * stroke:.3g}mm,rounding={rounding:.3g}s,"
            f"duration={DURATION:g}s,start={1e3 * start:.6g}mm"
        )
        with contextlib.suppress(MotionError):
            candidate = motion.triangular(
                speed=speed, stroke=stroke, rounding=rounding, duration=DURATION, rate=rate, start=start
            )
            found[name] = require_within(candidate, limits)
    return found


def available_limits(lanes: Lanes, limits: Limits) -> tuple[Limits, float]:
    """The limits that a next motion keeps, and the position (m) about which the logs moved.

    An axis whose ends nobody gave goes no further than it went in the logs.
    """
    position = np.asarray(lanes.position)[np.asarray(lanes.counts) > 0]
    low, high = float(position.min()), float(position.max())
    ends = np.where(np.isfinite(limits.stroke), limits.stroke, (low - CLEARANCE, high + CLEARANCE))
    return dataclasses.replace(limits, stroke=(float(ends[0]), float(ends[1]))), 0.5 * (low + high)


def _length(value: float) -> str:
    return f"{1e3 * value:.3g}mm" if value >= 1e-3 else f"{1e6 * value:.3g}um"


def _rounded(value: float) -> float:
    """To three figures, as it is written: who runs what is written runs the same."""
    return float(f"{value:.3g}")


@eqx.filter_jit
def _simulated(drive: Drive, controller: Controller, inputs: Inputs, sampling: Sampling) -> Frame:
    return jax.lax.map(lambda lane: rollout_loop(drive, controller, lane, sampling), inputs)


def propose_motions(
    identified: Identification, controller: Controller, sampling: Sampling, limits: Limits = Limits()
) -> list[Proposal]:
    """For each parameter that the logs do not determine, the candidate that would determine it best.

    A coefficient of load needs no search: any sliding motion under a second load. For the others a motion must be
    simulated, and without a controller none can be.
    """
    wide = identified.full_fit
    found = [
        Proposal(axis_path(path), "any sliding motion under a second load", "1", np.inf, np.nan)
        for path in sorted(identified.open_unknowns)
        if path.startswith("load_coefficient")
    ]
    open_ones = [(k, free) for k, free in enumerate(wide.residuals.free) if free.path in identified.open_unknowns]
    limits, about = available_limits(wide.problem.lanes, limits)
    motions = candidates(identified.drive, limits, sampling.rate, about)
    if not open_ones or not motions or isinstance(controller, UnknownController):
        return found
    width = float(scipy.stats.norm.ppf(0.5 * (1 + LEVEL)))
    known = _prior_information(wide) + _information(wide, wide.problem, 1)[0]
    offered = _candidate_information(identified, controller, sampling, list(motions.values()))
    for k, free in open_ones:
        informed = (known, *(known + more for more in offered))
        before, *after = (_width(information, k) for information in informed)
        best = int(np.argmin(np.where(np.isfinite(after), after, np.inf)))
        unit, slope = _slope(wide, free.path, k)
        scale = width * abs(slope)
        helps = wide.problem.prior[k] * after[best] < UNDETERMINED
        name = list(motions)[best] if helps else ""
        found.append(Proposal(axis_path(free.path), name, unit, scale * before, scale * after[best]))
    return found


def _slope(wide: RefinedFit, path: str, k: int) -> tuple[str, float]:
    """Unit of what is reported of an unknown, and its derivative along the k-th coordinate of the search."""

    def row(theta: Float[Array, " k"]) -> ReportedParameter:
        drive, unknowns = wide.residuals.unpack(theta, wide.problem)
        together = frozenset({path} if "." not in path else ())
        return next(row for row in reported_parameters(drive, unknowns, together) if row.unknown == path)

    theta = jnp.asarray(wide.search.theta).at[k].set(0.0)  # where it started, not where an open search wandered to
    return row(theta).parameter.unit, float(jax.grad(lambda theta: row(theta).value)(theta)[k])


def _width(information: Float[np.ndarray, "k k"], k: int) -> float:
    return float(np.sqrt(np.linalg.inv(information)[k, k]))


def _information(fit: RefinedFit, problem: IdentificationProblem, lanes: int) -> Float[np.ndarray, "lanes k k"]:
    """Fisher information of each lane at the end of a fit, without what was believed before."""
    _, slope = linearised(fit.residuals, jnp.asarray(fit.search.theta), as_arrays(problem))
    rows = np.asarray(slope)[: problem.lanes.position.size * problem.lanes.encoders].reshape(lanes, -1, slope.shape[1])
    return np.einsum("lnk,lnj->lkj", rows, rows)


def _prior_information(fit: RefinedFit) -> Float[np.ndarray, "k k"]:
    """That of what was believed before any log."""
    _, slope = linearised(fit.residuals, jnp.asarray(fit.search.theta), as_arrays(fit.problem))
    rows = np.asarray(slope)[fit.problem.lanes.position.size * fit.problem.lanes.encoders :]
    return rows.T @ rows


def _candidate_information(
    identified: Identification, controller: Controller, sampling: Sampling, motions: list[Motion]
) -> Float[np.ndarray, "lanes k k"]:
    """Information of each motion about every unknown, as far as the model has proved itself on the logs at hand."""
    wide = identified.full_fit
    load = np.zeros(len(motions[0].time))
    stack = [loop_inputs(motion, load) for motion in motions]
    inputs = jax.tree.map(lambda *leaves: jnp.stack(leaves), *stack)
    frames = _simulated(*as_arrays((smooth(identified.drive), smooth(controller))), inputs, sampling)
    position, command = jnp.asarray(frames.table_position), jnp.asarray(frames.command)
    shape = position.shape
    lanes = Lanes(position, command, jnp.zeros(shape), jnp.zeros(shape), jnp.ones(shape), jnp.zeros(shape[0]))
    drive, unknowns = wide.residuals.unpack(jnp.asarray(wide.search.theta), wide.problem)
    fine = wide.residuals.sampling
    filtered = filter_lanes(
        drive, unknowns.delay, identified.process_force, identified.noise, lanes, fine, between=identified.between
    )
    problem = wide.problem._replace(lanes=lanes, gains=jax.tree.map(np.asarray, filtered.gains))
    return _information(wide, problem, shape[0])
