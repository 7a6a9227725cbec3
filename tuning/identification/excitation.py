"""What logs can determine of a machine, judged before anything is fitted, and what motion would add.

By what the scale shows for certain (how fast, which way, for how long) and by least squares on inverse dynamics: a
second or two of work, for logs of any length. What the fit itself leaves open is judged by its covariance.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive.errors import DiffdriveError
from diffdrive.logs import Log
from diffdrive.model.parameters import Drive
from tuning.identification import inverse_dynamics
from tuning.identification.inverse_dynamics import MIN_SPEED
from tuning.identification.problem import lanes_of, noise_floor
from tuning.identification.regressors import DIRECTIONAL
from tuning.identification.seed import SIGNIFICANT
from tuning.identification.shown_motion import ExcitationDeficit, shown_velocity

SHORTEST = 1.0  # s of motion
ONE_WAY = 0.02  # of the motion, less than which the other way is none
SPEEDS = 2.0  # ratio of the fast to the slow part of the motion, below which it is one speed
SECOND_SPEED = 5.0  # times the only one, or a fifth of it
# times the Stribeck velocity, beyond which the curve is flat: with an exponent of 1, 2 % of the gap are left
FLAT = 4.0


class ShownMotion(NamedTuple):
    """The motion that logs show for certain."""

    window: int  # samples over which the velocity is differenced
    velocity: Float[np.ndarray, " m"]  # m/s, of the samples at which the table moves
    slowest: float  # m/s, above which it counts as moving
    rate: float  # Hz

    @property
    def seconds(self) -> float:
        """How long the table moves."""
        return len(self.velocity) / self.rate

    @property
    def share_forwards(self) -> float:
        """Of the motion."""
        return float(np.mean(self.velocity > 0))

    @property
    def speeds(self) -> tuple[float, float]:
        """The slow and the fast part of the motion, m/s: the 10th and the 95th percentile."""
        slow, fast = np.percentile(np.abs(self.velocity), [10, 95])
        return float(slow), float(fast)

    @property
    def sentence(self) -> str:
        """How far the logs reach."""
        slow, fast = self.speeds
        forwards = 100.0 * self.share_forwards
        return (
            f"these logs move for {self.seconds:.3g} s at {1e3 * slow:.3g} to {1e3 * fast:.3g} mm/s, "
            f"{forwards:.0f} % of it forwards"
        )


def shown_motion(logs: Sequence[Log], drive: Drive) -> ShownMotion:
    """The motion of logs of one rate, beyond the noise of the drive's scale and of the logs."""
    lanes, rate = lanes_of(list(logs)), float(logs[0].rate)
    counts = np.asarray(lanes.counts) > 0
    window, velocity, slowest = shown_velocity(
        np.asarray(lanes.position), counts, noise_floor(drive, lanes, rate), rate
    )
    return ShownMotion(window, velocity[counts[:, window:] & (np.abs(velocity) > slowest)], slowest, rate)


def shortcomings(logs: Sequence[Log], drive: Drive, fixed: Collection[str] = ()) -> list[ExcitationDeficit]:
    """What these logs do not determine of a drive, why, and the motion that would; empty where nothing is missing.

    `fixed` names unknowns that are held, of which nothing is asked. Raises `LogError` where no log can be used.
    """
    shown = shown_motion(logs, drive)
    if len(shown.velocity) < shown.window:  # any motion shows for as long as the velocity is differenced over
        return [
            ExcitationDeficit(
                "mass and friction",
                f"the table is nowhere faster than the {1e3 * shown.slowest:.2g} mm/s that would stand out from noise",
                "a faster motion to and fro, at two speeds at least",
            )
        ]
    found = [*_short(shown), *_one_way(shown), *_one_speed(shown, fixed), *_no_slow_part(shown, drive, fixed)]
    return [*found, *_no_inertia(logs, drive, fixed)]


def _short(shown: ShownMotion) -> list[ExcitationDeficit]:
    if shown.seconds >= SHORTEST:
        return []
    why = f"the table moves for {shown.seconds:.2g} s only"
    return [ExcitationDeficit("mass and friction", why, "several seconds of motion to and fro, with pauses")]


def _one_way(shown: ShownMotion) -> list[ExcitationDeficit]:
    forwards = shown.share_forwards
    if min(forwards, 1.0 - forwards) >= ONE_WAY:
        return []
    way, other = ("forwards", "backwards") if forwards > 0.5 else ("backwards", "forwards")
    return [
        ExcitationDeficit(
            f"friction {other}, and a constant force beside friction", f"the table moves {way} only",
            "the same motion to and fro",
        )
    ]  # fmt: skip


def _one_speed(shown: ShownMotion, fixed: Collection[str]) -> list[ExcitationDeficit]:
    slow, fast = shown.speeds
    if fast >= SPEEDS * slow or not {"viscous", "coulomb"}.isdisjoint(fixed):
        return []
    speed = float(np.median(np.abs(shown.velocity)))
    return [
        ExcitationDeficit(
            "viscous and Coulomb friction apart but by starts and reversals: of steady sliding, only their sum at "
            f"{1e3 * speed:.3g} mm/s",
            "the table runs at one speed",
            f"strokes at {1e3 * SECOND_SPEED * speed:.3g} or at {1e3 * speed / SECOND_SPEED:.3g} mm/s beside them",
        )
    ]


def _no_slow_part(shown: ShownMotion, drive: Drive, fixed: Collection[str]) -> list[ExcitationDeficit]:
    """No sliding at speeds at which friction falls, although a scale as good as this one would show it."""
    pair = drive.friction.stribeck_velocity
    falls = FLAT * max(float(pair.positive), float(pair.negative))
    if "stribeck_velocity" in fixed or shown.slowest > falls:
        return []
    if np.count_nonzero(np.abs(shown.velocity) < falls) >= shown.window:
        return []
    slowest = float(np.min(np.abs(shown.velocity)))
    return [
        ExcitationDeficit(
            "the Stribeck curve: breakaway_gap and stribeck_velocity",
            f"the table slides at {1e3 * slowest:.3g} mm/s and more, where the drive file's curve is flat",
            f"strokes at {1e3 * falls / FLAT:.2g} mm/s, and reversals",
        )
    ]


def _no_inertia(logs: Sequence[Log], drive: Drive, fixed: Collection[str]) -> list[ExcitationDeficit]:
    """A mass that least squares on inverse dynamics does not find two standard errors from zero."""
    if "mass" in fixed:
        return []
    try:
        found = inverse_dynamics.identify(list(logs), DIRECTIONAL, min_speed=MIN_SPEED)
    except DiffdriveError:  # too slow or too torn for inverse dynamics: nothing is known before the fit
        return []
    if found.mass > SIGNIFICANT * found.standard_errors["mass"]:
        return []
    pieces = found.fit.pieces
    largest = max(float(np.max(np.abs(piece.acceleration[piece.used]), initial=0.0)) for piece in pieces)
    enough = float(drive.friction.coulomb_at(found.load).positive) / float(drive.plant.mass)
    return [
        ExcitationDeficit(
            "mass",
            f"at {largest:.2g} m/s2 and less its force does not stand out from what friction leaves over",
            f"accelerations of {enough:.2g} m/s2 and more, at which inertia is as large as friction",
        )
    ]
