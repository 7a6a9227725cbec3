"""A motion from which a drive's friction, mass and delay can all be identified, such as a servo engineer would run.

Every parameter is visible in one regime and not in the others: the motion passes through all of them, slowest first,
from rest to rest in strokes of limited jerk:

- creeping, 1 to 20 um: the bristle bends, breaks away and bends back: its stiffness, and the breakaway force;
- a multisine to 150 Hz of about 1 um, within the bristle's reach: the table swings on the bristle, at 92 Hz on the
  paper's drive, which separates stiffness, bristle damping and mass, and shows the delay;
- slow reversals, 0.1 to 3 mm/s, a few around the Stribeck velocity of 1 mm/s: how friction falls from breakaway to
  Coulomb, each way;
- medium strokes, 5 to 30 mm/s: the lowest friction, at which Coulomb and viscous friction part;
- fast strokes, 50 to 150 mm/s: viscous friction, each way;
- short strokes at 3 m/s^2: the mass, against friction that is known by then.
"""

from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from diffdrive.motion.builders import from_array, jerk_limited, multisine
from diffdrive.motion.motion import Limits, Motion, require_within

LIMITS = Limits(stroke=(-0.075, 0.075), speed=0.150, acceleration=3.0)
REST = 0.1  # s, before and after, and between the multisine and its neighbours

# distance m, speed m/s, acceleration m/s^2, jerk m/s^3: out and back, one after the other without rest
CREEPING = tuple((2 * amplitude, 2e-4, 0.01, 2.0) for amplitude in (1e-6, 2e-6, 5e-6, 10e-6, 20e-6))
SLOW = (
    (5e-5, 1e-4, 0.02, 4.0),
    (6e-5, 2e-4, 0.02, 4.0),
    (1e-4, 5e-4, 0.05, 10.0),
    (1.6e-4, 8e-4, 0.05, 10.0),
    (2.4e-4, 1.2e-3, 0.05, 10.0),
    (4e-4, 2e-3, 0.1, 20.0),
    (6e-4, 3e-3, 0.1, 20.0),
)
MEDIUM = ((1e-3, 0.005, 0.3, 30.0), (2e-3, 0.010, 0.5, 50.0), (4e-3, 0.020, 0.5, 50.0), (6e-3, 0.030, 0.8, 80.0))
FAST = ((1.2e-2, 0.050, 1.5, 100.0), (2.4e-2, 0.100, 2.0, 100.0), (4e-2, 0.150, 2.5, 100.0))
STRONG = ((5e-3, 0.150, 3.0, 300.0),) * 4

TONES = np.array([10, 20, 30, 40, 55, 70, 85, 100, 125, 150])  # Hz: whole periods in 0.2 s, densest at the resonance
TONE_AMPLITUDE = 4e-7  # m
MULTISINE_DURATION, FADING = 1.4, 0.1  # s


def concatenate(parts: Sequence[Motion], name: str) -> Motion:
    """One after the other, each beginning where the last one ended; all at rest at both ends, at one rate."""
    starts = accumulate((part.position[-1] - part.position[0] for part in parts), initial=parts[0].position[0])
    position = [part.position - part.position[0] + start for part, start in zip(parts, starts, strict=False)]
    signals = [position, [part.velocity for part in parts], [part.acceleration for part in parts]]
    # the last sample of a part is the first one of the next
    joined = [np.concatenate([signal[0], *(piece[1:] for piece in signal[1:])]) for signal in signals]
    return Motion(np.arange(len(joined[0])) / parts[0].rate, joined[0], joined[1], joined[2], name)


def resting(duration: float, rate: float) -> Motion:
    """Standing still for `duration` (s)."""
    still = np.zeros(round(duration * rate) + 1)
    return Motion(np.arange(len(still)) / rate, still, still, still, "rest")


def strokes(rows: Sequence[tuple[float, float, float, float]], rate: float) -> list[Motion]:
    """Out and back for each row of distance (m), speed (m/s), acceleration (m/s^2), jerk (m/s^3), without rest."""
    return [
        jerk_limited(distance=distance, speed=speed, acceleration=acceleration, jerk=jerk, rate=rate, dwell=0.0)
        for distance, speed, acceleration, jerk in rows
    ]


def small_multisine(rate: float) -> Motion:
    """The multisine, faded in and out over `FADING` so that it begins and ends at rest."""
    tones = multisine(
        amplitudes=[TONE_AMPLITUDE] * len(TONES),
        frequencies=TONES.tolist(),
        duration=MULTISINE_DURATION,
        rate=rate,
    )
    edge = np.minimum(tones.time, MULTISINE_DURATION - tones.time) / FADING
    share = np.clip(edge, 0.0, 1.0)
    fade = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)  # acceleration continuous
    return from_array(tones.time, fade * (tones.position - np.mean(tones.position)), name="multisine")


def identification_motion(rate: float = 10_000.0) -> Motion:
    """The whole motion, about 10 s at `rate` (Hz), from rest at 0, within 40 mm, 150 mm/s and 3 m/s^2."""
    rest = resting(REST, rate)
    parts = [
        rest, *strokes(CREEPING, rate), rest, small_multisine(rate), rest,
        *strokes((*SLOW, *MEDIUM, *FAST, *STRONG), rate), rest,
    ]  # fmt: skip
    return require_within(concatenate(parts, "identification"), LIMITS)
