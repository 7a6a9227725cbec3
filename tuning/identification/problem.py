"""The identification problem: stretches of logs, what is free, and residuals in units of the measuring noise."""

from dataclasses import dataclass
from math import comb
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.errors import LogError
from diffdrive.logs import Log
from diffdrive.model.parameters import Drive, Sampling, Sensor
from diffdrive.numerics.arrays import Scalar
from tuning.identification.prediction import FilterGains, Lanes, Prediction, initial_velocity, predict
from tuning.identification.row_force import BetweenRows
from tuning.identification.symmetry import departure_from_symmetry
from tuning.identification.unknowns import Unknowns
from tuning.optimisation.space import Coordinate, inserted, values_at

SLOW_LOG = 999.0  # Hz, below which motion shows in third differences
WINDOW = 50
MIN_LANE_SAMPLES = 200  # samples of a stretch that is worth a lane
COARSE_SUBSTEP, FINE_SUBSTEP, FINEST_SUBSTEP = 100e-6, 25e-6, 6.25e-6  # s, at most


def long_pieces(log: Log) -> list[slice]:
    """The gap-free stretches that are worth a lane."""
    return [piece for piece in log.pieces() if piece.stop - piece.start >= MIN_LANE_SAMPLES]


def lanes_of(logs: list[Log]) -> Lanes:
    """The gap-free stretches of the logs side by side."""
    stretches = [(log, piece) for log in logs for piece in long_pieces(log)]
    if not stretches:
        raise LogError(
            f"no stretch of {MIN_LANE_SAMPLES} samples without a gap in {', '.join(log.name for log in logs)}"
        )
    longest = max(piece.stop - piece.start for _, piece in stretches)

    def padded(signal: np.ndarray | None, log: Log, piece: slice) -> np.ndarray:
        values = np.zeros(len(log.time)) if signal is None else signal
        return np.pad(values[piece], (0, longest - (piece.stop - piece.start)), mode="edge")

    def rows(name: str) -> np.ndarray:
        return np.stack([padded(getattr(log, name), log, piece) for log, piece in stretches])

    counts = np.stack([np.arange(longest) < piece.stop - piece.start for _, piece in stretches]).astype(float)
    begins = [initial_velocity(jnp.asarray(log.position[piece]), log.rate) for log, piece in stretches]
    position, command, disturbance, load = (
        jnp.asarray(rows(name)) for name in ("position", "command", "disturbance", "load")
    )
    return Lanes(position, command, disturbance, load, jnp.asarray(counts), jnp.asarray(np.array(begins)))


def noise_floor(drive: Drive, lanes: Lanes, rate: float) -> float:
    """Standard deviation (m) of the measured position about the true one; `rate` (Hz) is that of the lanes.

    From the drive's sensor where it states one, and at least what the log itself shows: see `encoder_noise`.
    """
    return encoder_noise(drive.sensor, lanes.position, lanes.counts, rate)


def encoder_noise(
    encoder: Sensor, position: Float[Array, "lanes n"], counts: Float[Array, "lanes n"], rate: float
) -> float:
    """Standard deviation (m) of an encoder's readings where they count.

    As stated, and at least the scatter of its third differences, which smooth motion leaves alone, in the median
    stretch of `WINDOW` samples. Of a slow log the fifth: a motion of a few hertz shows in the third there.
    """
    resolution = 0.0 if encoder.resolution is None else float(encoder.resolution)
    stated = np.hypot(resolution / np.sqrt(12), float(encoder.noise))
    shown = shown_noise(position, counts, 3 if rate >= SLOW_LOG else 5)
    return float(max(stated, shown, 1e-12))


def shown_noise(
    signal: Float[np.ndarray, "lanes n"] | Float[Array, "lanes n"],
    counts: Float[np.ndarray, "lanes n"] | Float[Array, "lanes n"],
    order: int,
) -> float:
    """Standard deviation of white noise in a signal where it counts.

    From the scatter of its differences of that order in the median stretch of `WINDOW` samples.
    """
    differences = np.diff(np.asarray(signal), order, axis=1) * np.asarray(counts)[:, order:]
    windows = differences[:, : differences.shape[1] // WINDOW * WINDOW].reshape(-1, WINDOW)
    squares = np.mean(windows[np.any(windows != 0.0, axis=1)] ** 2, axis=1)
    return float(np.sqrt(np.median(squares) / comb(2 * order, order))) if len(squares) else 0.0


class IdentificationProblem(NamedTuple):
    """What is fitted to what."""

    believed: Drive
    believed_unknowns: Unknowns
    unknowns: Unknowns  # where the search starts
    lanes: Lanes
    gains: FilterGains
    origin: Float[np.ndarray, " free"]  # of the search space
    bounds: Float[np.ndarray, "2 free"]  # of what is free, lowest and highest
    prior: Float[
        np.ndarray, " free"
    ]  # how many units of belief (a factor of five) one unit of theta is; 1 in usual bounds


@dataclass(frozen=True)
class Innovations:
    """Residuals of an `IdentificationProblem` as a function of theta.

    Hashed by value, so that the same question is compiled once, whatever the machine and its bounds.

    Innovations over their expected scatter, each `stride`-th, those of two encoders in turn; then two priors: the
    distance of theta from its start in units of belief, a factor of five, and how much more the directions differ than
    believed (`symmetry`). They are next to nothing where the log says something about a parameter, and decide where it
    says nothing.
    """

    free: tuple[Coordinate, ...]
    sampling: Sampling
    stride: int = 1
    between: BetweenRows = BetweenRows.HELD

    def unpack(self, theta: Float[Array, " k"], problem: IdentificationProblem) -> tuple[Drive, Unknowns]:
        """The drive and the unknowns at theta."""
        values = values_at(theta + problem.origin, self.free, problem.bounds)
        unknowns = inserted(problem.unknowns, self.free, values)
        return unknowns.drive(problem.believed), unknowns

    def evaluate(
        self, theta: Float[Array, " k"], problem: IdentificationProblem
    ) -> tuple[Float[Array, " m"], Prediction]:
        """The residuals at theta, and what the drive there predicts."""
        drive, unknowns = self.unpack(theta, problem)
        lanes, gains = problem.lanes, problem.gains
        predicted = predict(drive, unknowns.delay, gains, lanes, self.sampling, compliance_of(unknowns), self.between)

        def weighed(
            innovation: Float[Array, "lanes n"], counts: Float[Array, "lanes n"], std: Float[Array, "lanes n"]
        ) -> Float[Array, "lanes m"]:
            return (innovation * counts / std)[:, :: self.stride] * np.sqrt(self.stride)

        rows = weighed(predicted.innovation, lanes.counts, gains.innovation_std)
        if lanes.motor is not None:
            assert predicted.motor_innovation is not None
            assert gains.motor is not None
            motor = weighed(predicted.motor_innovation, lanes.motor.counts, gains.motor.innovation_std)
            rows = jnp.stack([rows, motor], axis=-1)
        symmetry = departure_from_symmetry(unknowns, problem.believed_unknowns)
        return jnp.concatenate([rows.ravel(), problem.prior * theta, symmetry]), predicted

    def __call__(self, theta: Float[Array, " k"], problem: IdentificationProblem) -> Float[Array, " m"]:
        return self.evaluate(theta, problem)[0]


def compliance_of(unknowns: Unknowns) -> Scalar:
    """That of the screw (m/N), 0 where it is not looked for."""
    return 0.0 if unknowns.compliance is None else unknowns.compliance


def sampling_of(rate: float, substep: float) -> Sampling:
    """The sampling at which no substep of the plant is longer than `substep` (s)."""
    return Sampling(rate, int(np.ceil(round(1.0 / (rate * substep), 6))))
