"""How large the gap is: the force that a model lacks to move as its log does, and how far its simulation is off.

The force is that of a filter which trusts every model alike, so that models can be compared. The simulation runs
in closed loop through the machine's own controller, with the sensor's noise in its loop: two simulations that differ
in nothing but this noise differ by the floor.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.ndimage
from jax import lax
from jaxtyping import Array, Float, Key, PyTree

from diffdrive.controllers import Controller
from diffdrive.effects.actuator import LONGEST_DELAY, LoopDelay
from diffdrive.logs import Log
from diffdrive.loop.rollout import rollout_loop
from diffdrive.loop.step import Inputs
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import as_arrays
from tuning.diagnosis.blocks import block_sums
from tuning.diagnosis.filter.derivatives import StepJacobians, innovations_of_forcings
from tuning.diagnosis.filter.effect_signals import Trajectory
from tuning.diagnosis.filter.ekf import DISTURBANCE_TIME, EkfResult, force_per_innovation
from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.goodness_of_fit import BLIND
from tuning.diagnosis.fits.reference_noise import share_lost
from tuning.diagnosis.hypotheses.model import counted_in, delay_of
from tuning.diagnosis.levels import LOST
from tuning.identification.replay import ReplayInputs, initial_loop_state, replay_inputs

TRUSTING = 0.1  # of the likeliest process force
MOVING, SETTLED = 5e-4, 0.03  # m/s and s: a table that slides
SLID = 0.02  # of the samples
DRAWS = 400
NOISES = 8  # draws of the measuring noise
SEEDS = 3  # simulations with noise
DITHER = 0.3  # of the noise that quantisation makes: without any, simulations would not differ, and have no floor
NONE = 1e-24  # N^2, at least: a table that never moves lacks no force at all, and shares of nothing are undefined
APART = 10.0  # of the log's travel, that a simulation may be off before it counts as diverged


class ForceGap(NamedTuple):
    """The force that a model lacks along the logs, [lanes, n] each."""

    force: Float[np.ndarray, "lanes n"]  # N, zero where it does not count
    trajectory: Trajectory
    surprise: Float[np.ndarray, "lanes n"]  # energy of what a filter that trusts the model did not foresee
    counts: Float[np.ndarray, "lanes n"]  # ones where the table slides: at rest, its friction may be anything
    lost: float = 0.0  # share of the samples at which the filter was lost, whatever the table did

    @property
    def is_known(self) -> bool:
        """Whether the filter followed the logs: one that is lost again and again, or ran away, sees no force."""
        return self.lost <= BLIND and bool(np.isfinite(self.rms))

    @property
    def rms(self) -> float:
        """Root mean square (N)."""
        return float(np.sqrt(max(np.sum(self.force**2) / max(np.sum(self.counts), 1.0), NONE)))

    def interval(self, rate: float) -> tuple[float, float]:
        """95 % interval of `rms`, from whole blocks of the logs drawn anew."""
        low, high = np.sqrt(np.percentile(self.drawn(rate), [2.5, 97.5]))
        return float(low), float(high)

    def where(self, counts: Float[np.ndarray, "lanes n"]) -> "ForceGap":
        """The same, judged by these samples."""
        return self._replace(force=self.force * counts, counts=counts)

    def drawn(self, rate: float) -> Float[np.ndarray, " draws"]:
        """Mean squares (N^2) of logs made of blocks drawn anew; the same blocks for every model of the same logs."""
        squares, counts = (block_sums(each, rate).ravel() for each in (self.force**2, self.counts))
        squares, counts = squares[counts > 0], counts[counts > 0]
        picks = np.random.default_rng(0).integers(0, len(counts), (DRAWS, len(counts)))
        return np.maximum(squares[picks].sum(axis=1) / counts[picks].sum(axis=1), NONE)


def sliding(velocity: Float[np.ndarray, "lanes n"], rate: float) -> Float[np.ndarray, "lanes n"]:
    """Ones where the table has moved, and goes on to, for `SETTLED` s."""
    width = 2 * round(SETTLED * rate) + 1
    slow = (np.abs(velocity) < MOVING).astype(float)
    return 1.0 - scipy.ndimage.maximum_filter1d(slow, width, axis=1)


def sliding_samples(
    every: Float[np.ndarray, "lanes n"], filtered: EkfResult, rate: float
) -> Float[np.ndarray, "lanes n"]:
    """Of the samples `every` those at which the table slides; all of them, if it hardly ever does."""
    there = every * sliding(np.asarray(filtered.trajectory.velocity), rate)
    return there if there.sum() > SLID * every.sum() else every


def force_gap(fitter: Fitter, fitted: Fitted, process_noise: Float[np.ndarray, " 2"]) -> ForceGap:
    """The force that a model lacks for a filter with these process forces (`reference_process_noise`); the sudden one
    too, where it may invent more of that than it has to.
    """
    model, theta = fitted.model, fitted.theta
    filtered = fitter.at(model, theta, process_noise, fitted.filtered.trajectory).filtered
    rate = fitter.logged.sampling.rate
    every = np.asarray(fitter.logged.lanes.counts)
    counts = sliding_samples(every, filtered, rate)
    trusting = fitter.at(
        model, theta, np.maximum(fitted.process_noise * TRUSTING, fitter.floor), fitted.filtered.trajectory
    ).filtered
    surprise = np.minimum(np.asarray(trusting.normalised_innovation) ** 2, LOST**2)
    surprise = every * np.maximum(surprise - float(fitted.filtered.noise_scale_sq), 0.0)
    force = np.asarray(filtered.disturbance) + _per_sudden(fitter, fitted, filtered, process_noise) * np.asarray(
        filtered.innovation
    )
    return ForceGap(force * counts, filtered.trajectory, surprise, counts, share_lost(filtered, every))


def _per_sudden(
    fitter: Fitter, fitted: Fitted, filtered: EkfResult, process_noise: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, "lanes n"] | float:
    """The sudden force (N) that the filter invents per metre of its innovations; none where it may have the least."""
    if process_noise[1] <= fitter.least:
        return 0.0
    return force_per_innovation(filtered, fitted.drive, fitter.logged.sampling.rate)


class LoopGap(NamedTuple):
    """How far the simulation in closed loop is from the logs, and from itself with other noise."""

    position_rms: float  # m
    command_rms: float  # N
    position_floor: float  # m
    command_floor: float  # N
    says: str = ""  # where it could not be simulated


def drive_of(fitted: Fitted, log: int) -> Drive:
    """The drive of a fit as it was on one of the logs: with its effects, their parameters those of that log."""
    lane = fitted.model.logged.owner.index(log)
    thinning = fitted.model.logged.thinning
    mine = jax.tree.map(lambda leaf: leaf[lane], fitted.model.effects(fitted.theta))
    effects = [counted_in(one, 1.0 / thinning) for one in mine]
    apart = [one for one in effects if isinstance(one, LoopDelay) and not 0.0 <= one.delay <= LONGEST_DELAY]
    logged, own = fitted.model.logged, fitted.recalibrated_drive
    nominal, delay = thinning * float(logged.delay), thinning * float(delay_of(logged, own))
    late, actuator = delay + sum(float(one.delay) for one in apart), logged.drive.actuator
    if apart or delay != nominal:  # less delay than the drive file claims, or more than the effect can hold back
        whole, part = divmod(max(late, 0.0), 1.0)
        actuator = dataclasses.replace(actuator, delay_samples=int(whole), delay_fraction=part)
    # every fit holds the exponent as a number
    friction = dataclasses.replace(own.friction, stribeck_exponent=logged.drive.friction.stribeck_exponent)
    kept = tuple(one for one in effects if one not in apart)
    return dataclasses.replace(own, friction=friction, actuator=actuator, effects=kept)


@eqx.filter_jit
def _simulated(
    drive: Drive, controller: Controller, at: ReplayInputs, sampling: Sampling, keys: Key[Array, " seeds"]
) -> tuple[Float[Array, "lanes seeds n"], Float[Array, "lanes seeds n"]]:
    def one(each: ReplayInputs) -> PyTree:
        inputs = Inputs(each.reference, each.lanes.load, each.lanes.disturbance)
        begin = initial_loop_state(drive, controller, each, sampling.period)

        def noisy(key: Key[Array, ""]) -> PyTree:
            frame = rollout_loop(drive, controller, inputs, sampling, key=key, begin=begin)
            return frame.measured, frame.command

        return jax.vmap(noisy)(keys)

    return lax.map(one, at)


def loop_gap(
    drives: list[Drive],
    controller: Controller,
    logs: list[Log],
    counts: list[Float[np.ndarray, "lanes n"]],
    noise: float,
    sampling: Sampling,
) -> LoopGap:
    """Each log simulated by its drive, its sensor's noise in the loop; `noise` (m) is quantisation and all.

    `counts` says which samples of each log to judge by, padded or cut to the log's own.
    """
    off: list[list[np.ndarray]] = [[], [], [], []]
    keys = jax.random.split(jax.random.key(0), SEEDS)
    for drive, log, judged in zip(drives, logs, counts, strict=True):
        quantised = 0.0 if drive.sensor.resolution is None else float(drive.sensor.resolution) / np.sqrt(12)
        white = float(np.sqrt(max(noise**2 - quantised**2, (DITHER * quantised) ** 2)))
        noisy = dataclasses.replace(drive, sensor=dataclasses.replace(drive.sensor, noise=white))
        pieces = replay_inputs([log])
        position, command = _simulated(*as_arrays((noisy, controller)), pieces, sampling, keys)
        counted = np.asarray(pieces.lanes.counts)
        asked = np.zeros_like(counted)
        common = min(asked.shape[1], judged.shape[1])
        asked[:, :common] = judged[:, :common]
        counted = (counted > 0) & (asked > 0)
        found = [np.moveaxis(np.asarray(one), 1, 0)[:, counted] for one in (position, command)]
        true = [np.asarray(one)[counted] for one in (pieces.lanes.position, pieces.lanes.command)]
        away = np.max(np.abs(found[0] - true[0]), initial=0.0)
        if not away <= APART * max(np.ptp(true[0]), 1e-3):
            return LoopGap(np.inf, np.inf, np.inf, np.inf, f"{log.name}: the simulation in closed loop runs away")
        for k in range(2):
            off[k].append((found[k] - true[k]).ravel())
            off[k + 2].append(np.diff(found[k], axis=0).ravel())
    position_rms, command_rms, position_floor, command_floor = (
        float(np.sqrt(np.mean(np.concatenate(one) ** 2))) for one in off
    )
    return LoopGap(position_rms, command_rms, position_floor, command_floor)


@eqx.filter_jit
def _force_of_noise(
    filtered: EkfResult,
    step_jacobians: StepJacobians,
    off: Float[Array, "lanes n m"],
    sudden: Float[Array, "... 1"],
    period: float,
) -> Float[Array, "lanes n m"]:
    """The force that errors of the measurement, [lanes, n, m] (m), make a filter see, with `sudden` per innovation."""
    forcing = jnp.zeros((*off.shape[:2], 3, off.shape[2]))
    error = (
        innovations_of_forcings(filtered, step_jacobians, forcing, -off, period) * filtered.innovation_std[..., None]
    )
    ar1_coeff = float(np.exp(-period / DISTURBANCE_TIME))

    def one(pull: Float[Array, " n"], error: Float[Array, "n m"]) -> Float[Array, "n m"]:
        def body(force: Float[Array, " m"], at: PyTree) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
            own, e = at
            force = ar1_coeff * force + own * e
            return force, force

        return lax.scan(body, jnp.zeros(error.shape[-1]), (pull, error))[1]

    return jax.vmap(one)(filtered.kalman_gain[3], error) + sudden * error


def force_noise(
    fitter: Fitter, fitted: Fitted, process_noise: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, "lanes n draws"]:
    """The force (N) that a model without a gap would seem to lack, from the measuring noise."""
    logged = fitter.logged
    point = fitter.again(fitted, process_noise)
    step_jacobians = fitter.slopes(point)
    noise = float(logged.noise) * np.sqrt(float(fitted.filtered.noise_scale_sq))
    off = noise * np.random.default_rng(0).standard_normal((*logged.lanes.position.shape, NOISES))
    sudden = jnp.asarray(_per_sudden(fitter, fitted, point.filtered, process_noise))[..., None]
    return np.asarray(_force_of_noise(point.filtered, step_jacobians, jnp.asarray(off), sudden, logged.sampling.period))


def uncoupled(fitter: Fitter, base: Fitted) -> Fitted:
    """The recalibrated drive without the effects of its file that are stepped within the filter."""
    if not base.model.coupled:
        return base
    loose = tuple(one for one in base.model.members if not one.candidate.coupled)
    model = dataclasses.replace(base.model, logged=fitter.logged, members=loose)
    return fitter.refit(base, model, 0)


def force_floor(
    fitter: Fitter, fitted: Fitted, counts: Float[np.ndarray, "lanes n"], process_noise: Float[np.ndarray, " 2"]
) -> float:
    """Root mean square (N) of that force over the samples that count, and of what is not known of the command."""
    return floor_of(force_noise(fitter, fitted, process_noise), counts, float(fitter.logged.command_std))


def floor_of(
    noise: Float[np.ndarray, "lanes n draws"], counts: Float[np.ndarray, "lanes n"], command_std: float
) -> float:
    """Root mean square (N) of `force_noise` over the samples that count, and of what is not known of the command."""
    square = np.sum(noise**2 * counts[..., None]) / max(NOISES * counts.sum(), 1.0)
    return float(np.hypot(np.sqrt(square), command_std))
