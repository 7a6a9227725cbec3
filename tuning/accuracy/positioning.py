"""The positioning test of a linear axis (ISO 230-2): where the table comes to rest, from both sides, several times.

At each of m targets P_i the deviation x_ij is measured n times forwards (up) and n times backwards (down), at rest.
With the mean x_i and the standard deviation s_i of either direction,

    A = max(x_i + 2 s_i) - min(x_i - 2 s_i)      positioning accuracy, over all i and both directions
    E = max(x_i) - min(x_i)                      systematic deviation
    R = max(4 s_up, 4 s_down, 2 s_up + 2 s_down + |B_i|)   repeatability
    B = max |x_i up - x_i down|                  reversal error
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from diffdrive.errors import ParameterError
from diffdrive.motion.motion import Motion
from diffdrive.motion.pieces import Piece, dwell_pieces, motion_of_pieces, stroke_pieces

NAME = "positioning test"
PER_METRE, FEWEST_TARGETS = 5, 5  # ISO 230-2, 5.3.2: at least five to a metre, and at least five
FEWEST_ANGLES = ((0.5 * np.pi, 3), (np.pi, 5), (np.inf, 8))  # 5.3.4: of a rotary axis that turns by so much (rad)
RUNS = 5  # ISO 230-2, 5.3.3: approaches of each target from each side
UNEVEN = 0.5 * (5.0**0.5 - 1.0)  # the golden ratio, whose multiples fall on no grid: targets are not evenly spaced
DWELL, MEASURED = 0.3, 0.1  # s of rest at a target, at least, and the last of it over which the position is averaged


class Visits(NamedTuple):
    """When each target is measured: so many samples from `begin` on; [m, 2, n], forwards and backwards."""

    targets: Float[np.ndarray, " m"]  # m
    begin: Int[np.ndarray, "m 2 n"]
    samples: int


class Positioning(NamedTuple):
    """What the test says of an axis, in m."""

    accuracy: float  # A, bidirectional
    systematic: float  # E, bidirectional
    repeatability: float  # R, bidirectional
    reversal_error: float  # B


def targets_within(low: float, high: float, is_rotary: bool = False) -> Float[np.ndarray, " m"]:
    """Targets from `low` to `high` (m; rad of a rotary axis), each at another place of its share of the stroke, so that
    no period hides.
    """
    count = max(FEWEST_TARGETS, int(np.ceil(PER_METRE * (high - low))))
    if is_rotary:
        count = next(fewest for most, fewest in FEWEST_ANGLES if high - low <= most)
    share = (high - low) / count
    return low + share * (np.arange(count) + np.mod(UNEVEN * np.arange(1, count + 1), 1.0))


def positioning_motion(
    targets: Float[np.ndarray, " m"],
    low: float,
    high: float,
    speed: float,
    acceleration: float,
    rate: float,
    dwell: float = DWELL,
) -> tuple[Motion, Visits]:
    """The standard cycle: from `low` (m) through all targets up to `high`, and downwards again, `RUNS` times.

    It overruns the outermost targets, so that each is approached from both sides, and rests for `dwell` (s) at each.
    Raises `MotionError` for limits that no motion can have, `ParameterError` where the axis is sampled too slowly to be
    measured at rest.
    """
    count = int(MEASURED * rate)
    if count < 1:
        raise ParameterError(f"{NAME}: a rate of {rate:g} Hz has no sample within {MEASURED:g} s of rest")
    pieces: list[Piece] = dwell_pieces(NAME, dwell)
    elapsed, place = dwell, low
    begin = np.zeros((len(targets), 2, RUNS), int)

    def go(to: float) -> None:
        nonlocal elapsed, place
        added = stroke_pieces(to - place, speed, acceleration) + dwell_pieces(NAME, dwell)
        pieces.extend(added)
        elapsed, place = elapsed + sum(piece[0] for piece in added), to

    for run in range(RUNS):
        for direction, order in enumerate((range(len(targets)), reversed(range(len(targets))))):
            for target in order:
                go(float(targets[target]))
                begin[target, direction, run] = int(elapsed * rate) - count
            go(high if direction == 0 else low)
    return motion_of_pieces(NAME, pieces, rate, low), Visits(targets, begin, count)


def deviations(position: Float[np.ndarray, " n"], visits: Visits) -> Float[np.ndarray, "m 2 n"]:
    """How far (m) the table rests from each target, averaged."""
    samples = visits.begin[..., None] + np.arange(visits.samples)
    return position[samples].mean(axis=-1) - visits.targets[:, None, None]


def positioning(deviation: Float[np.ndarray, "m 2 n"]) -> Positioning:
    """ISO 230-2 of deviations (m) at m targets, forwards and backwards, n times each."""
    mean, spread = deviation.mean(axis=2), 2.0 * deviation.std(axis=2, ddof=1)
    reversal = np.abs(mean[:, 0] - mean[:, 1])
    repeated = np.maximum(2.0 * spread.max(axis=1), spread.sum(axis=1) + reversal)
    return Positioning(
        accuracy=float((mean + spread).max() - (mean - spread).min()),
        systematic=float(np.ptp(mean)),
        repeatability=float(repeated.max()),
        reversal_error=float(reversal.max()),
    )
