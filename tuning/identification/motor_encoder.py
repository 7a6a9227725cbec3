"""The motor's encoder beside the scale: one more reading of the table's position.

What the two are apart is taken apart first (`diffdrive.compare_encoders`), and the coarser one is freed of all of it
but the lost motion: of the zero, the errors of the screw, the time between the readings, and what acceleration and
viscous friction wind up. It is then a reading of what the finer one reads. What so few numbers err by is far less than
the noise of the coarser encoder, and would not be beside that of the finer.

The wind-up of the screw under the friction that changes in reversals stays. The fit finds it, as `compliance`, for it
is as much a part of what the motor sees in a reversal as the bristle is. What is left beyond that is counted as noise
of the coarser encoder: where the model of the difference does not hold, that one loses its weight, and the finer is
fitted as if it were alone.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from diffdrive.errors import ParameterError
from diffdrive.logs import Log
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.encoders.comparison import compare_encoders
from diffdrive.logs.encoders.result import EncoderComparison
from diffdrive.model.parameters import Drive, Sensor
from tuning.identification.prediction import Lanes, MotorReadings, initial_velocity
from tuning.identification.problem import encoder_noise, long_pieces


class BothEncoders(NamedTuple):
    """Lanes with the readings of both encoders."""

    lanes: Lanes
    noise: float  # m, of the scale beside the motor's encoder
    compliance: float | None  # m/N, to start from; None where no log has both directions, which show it


def with_motor_encoder(
    logs: Sequence[Log], drive: Drive, lanes: Lanes, noise: float, rate: float
) -> BothEncoders | None:
    """The lanes, made of `logs`, with the motor's readings; None where no log shows how motor and table compare.

    `noise` (m) is the scale's; that of the motor's encoder is found as the scale's is.
    """
    compared = [_compared(log) for log in logs]
    if not any(compared):
        return None
    shape = lanes.position.shape
    scale, motor, counts, apart = np.array(lanes.position), np.zeros(shape), np.zeros(shape), np.zeros(shape)
    pieces = [(log, one, piece) for log, one in zip(logs, compared, strict=True) for piece in long_pieces(log)]
    for lane, (log, comparison, piece) in enumerate(pieces):
        if comparison is None or log.motor_position is None:
            continue
        samples, between = comparison.samples, np.full(len(log.time), np.nan)
        between[samples.rows] = log.motor_position[samples.rows] - samples.as_table
        filled, zero = slice(0, piece.stop - piece.start), float(np.nanmean(between))
        motor[lane, filled], counts[lane, filled] = log.motor_position[piece] - zero, np.isfinite(between[piece])
        apart[lane, filled] = np.nan_to_num(between[piece] - zero)
    motor_noise = encoder_noise(drive.motor_encoder or Sensor(), jnp.asarray(motor), jnp.asarray(counts), rate)
    left, leads = _left_over([one for one in compared if one is not None]), motor_noise < noise
    if leads:
        noise, scale = max(noise, left), scale + apart
    else:
        motor_noise, motor = max(motor_noise, left), motor - apart
    of_motor = MotorReadings(
        position=jnp.asarray(motor),
        counts=jnp.asarray(counts),
        noise=jnp.full(shape[0], motor_noise),
        leads=jnp.full(shape[0], float(leads)),
    )
    begins = jnp.where(of_motor.leads * counts[:, 0] > 0, initial_velocity(of_motor.position, rate), lanes.velocity)
    both = lanes._replace(position=jnp.asarray(scale), velocity=begins, motor=of_motor)
    return BothEncoders(both, noise, _compliance(logs, compared, drive))


def _compared(log: Log) -> EncoderComparison | None:
    if log.motor_position is None:
        return None
    try:
        return compare_encoders(log)
    except ParameterError:  # the table hardly moves
        return None


def _left_over(compared: Sequence[EncoderComparison]) -> float:
    """Standard deviation (m) of motor minus table beyond all that it is taken apart into, where the table slides."""
    rest = []
    for one in compared:
        samples, error = one.samples, one.reversal_error
        between = samples.as_table - samples.position
        lost = 0.0 if error is None else 0.5 * error.value * samples.direction
        rest.append((between - lost)[np.isfinite(samples.fitted)])
    return float(np.sqrt(np.mean(np.concatenate(rest) ** 2)))


def _compliance(logs: Sequence[Log], compared: Sequence[EncoderComparison | None], drive: Drive) -> float | None:
    """The wind-up per newton (m/N) that the drive's friction makes of the reversal errors."""
    found = []
    for log, one in zip(logs, compared, strict=True):
        if one is None or one.reversal_error is None:
            continue
        level = drive.friction.coulomb_at(0.0 if log.load is None else float(np.mean(log.load)))
        found.append(one.reversal_error.value / float(level.positive + level.negative))
    return float(np.mean(found)) if found else None


def without_doubtful_encoder(
    logs: Sequence[Log], findings: Sequence[tuple[str, Finding]]
) -> tuple[tuple[Log, ...], list[str]]:
    """The logs without motor encoders of which the checks say more than a note, and what is to be said of that.

    Lost motion that may be backlash is such a finding. Friction acts on the table, so it is the scale that is fitted.
    """
    kept, notes = [], []
    for log in logs:
        against = [
            finding.message
            for name, finding in findings
            if name == log.name and finding.channel == "motor_position" and finding.severity != "note"
        ]
        if log.motor_position is not None and against:
            notes.append(f"{log.name}: the scale alone is fitted, and not the motor's encoder: {against[0]}")
            kept.append(log.replace(motor_position=None))
        else:
            kept.append(log)
    return tuple(kept), notes
