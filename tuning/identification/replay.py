"""A measured log replayed by a drive: in closed loop through its controller, and in open loop under the logged command.

In closed loop the drive is given what the log was: reference, load and known disturbance. Its controller then answers
the simulated position as the machine's answered the measured one, and the two commands are compared: over a cruise they
differ by what the model's friction lacks. A log may begin in motion, and may have gaps: each piece is replayed alone.
"""

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, PyTree

from diffdrive.controllers import Controller, Reference
from diffdrive.effects import stages
from diffdrive.errors import LogError, ParameterError
from diffdrive.logs import Log
from diffdrive.loop.rollout import rollout_loop
from diffdrive.loop.step import Inputs, LoopState
from diffdrive.model.actuator import saturate, steady_state
from diffdrive.model.friction import steepest_stribeck_slope
from diffdrive.model.parameters import Drive, Sampling, check_drive
from diffdrive.model.quantity import check
from diffdrive.motion.builders import from_array
from diffdrive.numerics.arrays import Scalar, as_arrays, require_double_precision
from diffdrive.numerics.pipeline import require_shorter
from diffdrive.results import Status
from diffdrive.support.rates import is_same_rate
from tuning.identification.prediction import FilterGains, Lanes, initial_state, predict
from tuning.identification.problem import FINE_SUBSTEP, lanes_of, long_pieces, sampling_of

WARM_UP = 10  # samples before the log over which the controller is warmed up
INITIAL_WINDOW = 5e-3  # s, and PAST samples at least: through so much the parabola at the first sample is laid


class ReplayInputs(NamedTuple):
    """What a replay is given: the pieces of logs side by side, the reference of each, and what came before them."""

    lanes: Lanes  # `velocity` is that of the parabola through the first samples
    reference: Reference  # [lanes, n] each
    past_reference: Reference  # [lanes, PAST] each, extrapolated
    past_position: Float[Array, "lanes past"]  # m, extrapolated


class ReplayOutput(NamedTuple):
    """What came out, [lanes, n] each; meaningless where the lanes' `counts` are 0."""

    position: Float[Array, "lanes n"]  # m
    command: Float[Array, "lanes n"]  # N


def replay_inputs(logs: list[Log]) -> ReplayInputs:
    """The pieces of the logs as `replay` takes them; raises `LogError` where there is no reference or no long piece."""
    lanes = lanes_of(logs)
    rows = [_row(log, piece, lanes.position.shape[1]) for log in logs for piece in long_pieces(log)]
    reference, past, position, velocity = zip(*rows, strict=True)
    return ReplayInputs(
        lanes._replace(velocity=jnp.asarray(velocity)),
        Reference(*(jnp.stack(signals) for signals in zip(*reference, strict=True))),
        Reference(*(jnp.stack(signals) for signals in zip(*past, strict=True))),
        jnp.stack(position),
    )


def _row(log: Log, piece: slice, longest: int) -> tuple[Reference, Reference, np.ndarray, float]:
    """One piece: reference, padded to `longest`, and before it; position before it; velocity at its first sample."""
    if log.reference is None:
        raise LogError(f"{log.name}: has no reference, without which no loop can be closed: name its column")
    # not the log's own times: the controller ran on a uniform clock
    motion = from_array(np.arange(piece.stop - piece.start) / log.rate, log.reference[piece], name=log.name)
    signals = (motion.position, motion.velocity, motion.acceleration)
    past_time = np.arange(-WARM_UP, 0.0) / log.rate
    position, speed, acceleration = (signal[0] for signal in signals)
    past = Reference(
        jnp.asarray(position + speed * past_time + 0.5 * acceleration * past_time**2),
        jnp.asarray(speed + acceleration * past_time),
        jnp.full(WARM_UP, acceleration),
    )
    first = log.position[piece][: max(WARM_UP, round(INITIAL_WINDOW * log.rate))]
    bend, slope, _ = np.polyfit(np.arange(len(first)) / log.rate, first, 2)
    padded = Reference(*(jnp.asarray(np.pad(signal, (0, longest - len(signal)), mode="edge")) for signal in signals))
    return padded, past, first[0] + slope * past_time + bend * past_time**2, float(slope)


def initial_loop_state(drive: Drive, controller: Controller, lane: ReplayInputs, period: float) -> LoopState:
    """The loop at the first sample of one lane, in motion.

    The table is where it was measured, the bristle in the steady state of its velocity. The controller has seen
    `WARM_UP` samples of table and reference extrapolated backwards, under the first command: that fills difference
    quotients and short filters. What a controller remembers for longer, an integral or a slow observer, begins as at
    rest.
    """
    force = saturate(drive.actuator, lane.lanes.command[0])

    def before(state: PyTree, sample: tuple[Reference, Scalar]) -> tuple[PyTree, None]:
        return controller.step(state, *sample, force, period)[0], None

    warm, _ = lax.scan(before, controller.init(lane.past_position[0]), (lane.past_reference, lane.past_position))
    effects = stages.initial_states(drive.effects, force)
    return LoopState(
        initial_state(drive, lane.lanes), steady_state(drive.actuator, force), warm, jnp.zeros((), jnp.uint32), effects
    )


def replay(drive: Drive, controller: Controller, given: ReplayInputs, sampling: Sampling) -> ReplayOutput:
    """Simulated position and command of each piece in closed loop. Pure: for use under `jit`, `vmap` and `jacfwd`."""
    require_double_precision()

    def replay_lane(lane: ReplayInputs) -> ReplayOutput:
        inputs = Inputs(lane.reference, lane.lanes.load, lane.lanes.disturbance)
        begin = initial_loop_state(drive, controller, lane, sampling.period)
        frame = rollout_loop(drive, controller, inputs, sampling, begin=begin)
        return ReplayOutput(jnp.asarray(frame.table_position), jnp.asarray(frame.command))

    return lax.map(replay_lane, given)


@dataclass(frozen=True)
class ClosedLoopReplay:
    """A log beside its replay in closed loop; arrays over the samples replayed, the pieces one after the other.

    Where `status` is not ok the simulation ran away: its figures are infinite.
    """

    time: Float[np.ndarray, " n"]  # s
    position: Float[np.ndarray, " n"]  # m, simulated
    command: Float[np.ndarray, " n"]  # N, simulated, without the known disturbance
    command_error: Float[np.ndarray, " n"]  # N, simulated minus logged command
    force_percent: float  # 100 |F_sim - F_log| / |F_log|, F the command and the known disturbance
    command_rms: float  # N, of `missing`
    position_rms: float  # m, of simulated minus measured position
    status: Status


@dataclass(frozen=True)
class OpenLoopReplay:
    """A log beside the drive's answer to the logged command alone; `note` says what that figure is worth."""

    time: Float[np.ndarray, " n"]  # s
    position: Float[np.ndarray, " n"]  # m, simulated
    position_rms_mm: float  # of simulated minus measured position
    status: Status
    note: str


_replay = eqx.filter_jit(replay)
_predict = eqx.filter_jit(predict)


def replay_closed_loop(
    drive: Drive, controller: Controller, log: Log, sampling: Sampling | None = None
) -> ClosedLoopReplay:
    """Replay `log` in closed loop. `sampling`: by default the log's rate, with substeps of 25 us.

    Raises `LogError` where the log has no reference or no piece of `MIN_LANE_SAMPLES` samples, and `ParameterError`
    for a drive, controller or sampling that is out of range. A loop that diverges does not raise: see `status`.
    """
    check_drive(drive)
    check(controller)
    require_shorter(len(log.time), (*drive.actuator.pipelines, *controller.pipelines))
    pieces = replay_inputs([log])
    found = _replay(*as_arrays((drive, controller)), pieces, _sampling(log, sampling))
    counted = np.asarray(pieces.lanes.counts) > 0
    position, command = (np.asarray(signal)[counted] for signal in found)
    measured, logged, added = (np.asarray(signal)[counted] for signal in pieces.lanes[:3])
    status = _status(log, position - np.asarray(pieces.reference.position)[counted], "reference")
    missing = command - logged
    rms = np.sqrt(np.mean(missing**2)) if status.ok else np.inf
    return ClosedLoopReplay(
        time=_time(log),
        position=position,
        command=command,
        command_error=missing,
        force_percent=float(100 * rms / max(np.sqrt(np.mean((logged + added) ** 2)), np.finfo(float).tiny)),
        command_rms=float(rms),
        position_rms=_rms(position - measured, status),
        status=status,
    )


def replay_open_loop(drive: Drive, log: Log, sampling: Sampling | None = None) -> OpenLoopReplay:
    """The drive's response to the logged command, without any correction; raises as `replay_closed_loop`.

    It needs no reference. The figure that a benchmark usually asks for, and a poor one: see `drift_note`.
    """
    check_drive(drive)
    lanes = lanes_of([log])
    actuator = drive.actuator
    delay = actuator.delay_samples + float(actuator.delay_fraction or 0.0)
    none = jnp.zeros_like(lanes.position)
    no_gains = FilterGains(none, none, none, none)
    found = _predict(as_arrays(drive), jnp.asarray(delay), no_gains, lanes, _sampling(log, sampling))
    counted = np.asarray(lanes.counts) > 0
    measured, missed = np.asarray(lanes.position)[counted], -np.asarray(found.innovation)[counted]
    status = _status(log, missed, "measured position")
    return OpenLoopReplay(_time(log), measured + missed, 1e3 * _rms(missed, status), status, drift_note(drive))


def drift_note(drive: Drive) -> str:
    """Why an open-loop position error says little about this drive."""
    friction, damping = drive.friction, drive.plant.damping
    falls, resistances = [], []
    for side in ("positive", "negative"):
        resistance = float(getattr(friction.viscous, side)) + float(getattr(damping, side))
        falls.append(steepest_stribeck_slope(friction, side) - resistance)
        resistances.append(resistance)
    speed = 1e3 / np.mean(resistances)
    drifts = f"a force that is off by 1 N moves the table by {speed:.2g} mm/s, and nothing brings it back"
    if max(falls) > 0:
        grows = max(falls) / float(drive.plant.mass)
        drifts += f"; on the falling Stribeck curve an error grows by a factor e in {1e3 / grows:.2g} ms"
    return (
        f"open loop: {drifts}. A small figure shows that the errors of the forces cancel over the strokes, a large one "
        "that they do not; neither shows a model that predicts the force"
    )


def _sampling(log: Log, sampling: Sampling | None) -> Sampling:
    if sampling is None:
        return sampling_of(float(round(log.rate, 6)), FINE_SUBSTEP)
    if not is_same_rate(log.rate, sampling.rate):
        raise ParameterError(f"{log.name} is sampled at {log.rate:g} Hz, sampling.rate is {sampling.rate:g} Hz")
    return sampling


def _time(log: Log) -> np.ndarray:
    return np.concatenate([log.time[piece] for piece in long_pieces(log)])


def _rms(signal: np.ndarray, status: Status) -> float:
    return float(np.sqrt(np.mean(signal**2))) if status.ok else float("inf")


def _status(log: Log, distance: np.ndarray, off: str) -> Status:
    """Whether the table stayed within ten times the log's travel, and at least 0.1 m, of where it should be."""
    reach = max(10 * float(np.ptp(log.position)), 0.1)
    is_away: Bool[np.ndarray, " n"] = ~(np.abs(distance) <= reach)
    if not is_away.any():
        return Status(True)
    time = float(_time(log)[int(np.argmax(is_away))])
    message = (
        f"diverged: {log.name}: the simulated position leaves the {off} by more than {reach:g} m at t = {time:g} s"
    )
    return Status(False, message, "position", time, "diverged")
