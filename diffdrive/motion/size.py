"""Checks of a motion before it is built: samples, memory, and numbers within the range of floats."""

import contextlib
from collections.abc import Iterator

import numpy as np

from diffdrive.errors import MotionError
from diffdrive.support.resources import format_count, require_memory

# Bytes at the worst moment of making a motion (tests/test_motion_size.py measures them): arrays of doubles for each
# sample, beside these some for each wave of a multisine, and what a piece of constant jerk takes in a list.
ARRAYS_PER_SAMPLE, ARRAYS_PER_WAVE, DOUBLE_BYTES, PIECE_BYTES = 15, 2, 8, 280


def require_motion_memory(name: str, duration: float, rate: float, *, pieces: int = 0, waves: int = 0) -> None:
    """Raise `MotionError` where a motion of `duration` (s) at `rate` (Hz) does not fit into memory.

    `pieces` counts those of constant jerk, `waves` the sines.
    """
    samples = duration * rate
    needed = samples * DOUBLE_BYTES * (ARRAYS_PER_SAMPLE + ARRAYS_PER_WAVE * waves) + PIECE_BYTES * pieces
    require_memory(
        MotionError,
        f"{name}: {duration:.6g} s at {rate:g} Hz are {format_count(round(samples))} samples, which",
        needed,
        "shorten or speed up the motion, or lower sampling.rate",
    )


@contextlib.contextmanager
def guarded_arithmetic(name: str) -> Iterator[None]:
    """Raise `MotionError` where arithmetic in the block overflows or is undefined."""
    try:
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            yield
    except ArithmeticError:
        raise MotionError(
            f"{name}: its settings are so large or so small that their quotients leave the range of floating-point "
            "numbers: check their units"
        ) from None


def require_resolved_positions(name: str, position: np.ndarray, velocity: np.ndarray) -> None:
    """Raise `MotionError` where the motion is lost in the rounding of its own positions (m), as from 1e300 m on."""
    travel, farthest = float(np.ptp(position)), float(np.max(np.abs(position)))
    # at most a per mille of the motion may be rounding
    if not np.any(velocity):  # standing still, as specified
        return
    if not travel >= 1e3 * np.spacing(farthest):
        raise MotionError(
            f"{name}: a travel of {travel:g} m at {farthest:g} m is lost in the rounding of positions, which are "
            f"{np.spacing(farthest):.2g} m apart there: lengthen it, or start nearer to 0"
        )
