"""What was found in words that an engineer uses: amplitudes and phases in the place of cosines and sines, factors."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from diffdrive.effects.machine import AS_LOGARITHMS, FrictionShape
from diffdrive.support.spans import Span, format_spans

HEAD = 2  # numbers in a headline
PLAIN = 10.0  # half-widths of its interval off zero: a number that tells as much as any
WAVES = {"": "", "2": "second harmonic: ", "6": "sixth harmonic: "}  # as their cosines and sines are named


class Told(NamedTuple):
    """One number in words, and how many half-widths of its interval it is off zero, at most `PLAIN`."""

    says: str
    telling: float


def numbers(cause: dict[str, Any]) -> list[str]:
    """The numbers of a cause with their 95 % intervals and units, log by log where the logs differ in them; of waves
    those that are told from none, and the largest.

    A wave is told by amplitude and phase, A cos(x - phase), x counted from where position or time is zero. The interval
    of its amplitude takes those of cosine and sine as independent, which makes it too wide where a period that is not
    well known moves both. What the effect holds as a logarithm is told as a factor.
    """
    return [one.says for one in _numbers(cause)]


def headlines(causes: list[dict[str, Any]]) -> list[str]:
    """What was found, how sure that is, and the numbers that are furthest from none: a line each."""
    return [
        f"{one['effect']}, {100.0 * one['confidence']:.0f} % sure: {'; '.join(_foremost(one))}"
        for one in causes
        if one["found"]
    ]


def parameter(name: str, cause: dict[str, Any]) -> str:
    """A parameter of a cause with its interval and unit; log by log where the logs differ in it."""
    spans = _spans(name, cause)
    if cause["effect"] == FrictionShape.name and name in AS_LOGARITHMS:
        return f"{name} {format_spans([_factors(one) for one in spans], '1')} times the recalibrated"
    return f"{name} {format_spans(spans, cause['units'][name])}"


def _numbers(cause: dict[str, Any]) -> list[Told]:
    given = cause["parameters"]
    harmonics = [one for one in WAVES if f"cosine{one}" in given and f"sine{one}" in given]
    shown = [_wave(cause, one) for one in harmonics]
    largest = max((one.telling for one in shown), default=0.0)
    waves = [one for one in shown if one.telling > 1.0 or one.telling == largest]
    parts = {f"{part}{one}" for one in harmonics for part in ("cosine", "sine")}
    plain = [Told(parameter(name, cause), _telling(_spans(name, cause))) for name in given if name not in parts]
    return [*waves, *plain]


def _foremost(cause: dict[str, Any]) -> Iterator[str]:
    numbers = _numbers(cause)
    first = sorted(range(len(numbers)), key=lambda k: -numbers[k].telling)[:HEAD]
    return (numbers[k].says for k in sorted(first))


def _spans(name: str, cause: dict[str, Any]) -> list[Span]:
    """Value, low and high, of each log where they differ."""
    value, interval = cause["parameters"][name], cause["intervals"][name]
    return list(zip(value, *interval, strict=True)) if isinstance(value, list) else [(value, *interval)]


def _telling(spans: list[Span]) -> float:
    halves = [(abs(at), 0.5 * (high - low)) for at, low, high in spans if low is not None and high is not None]
    return max((PLAIN if half * PLAIN <= at else at / half for at, half in halves), default=0.0)


def _factors(logarithm: Span) -> Span:
    at, low, high = (None if one is None else float(np.exp(one)) for one in logarithm)
    assert at is not None
    return at, low, high


def _wave(cause: dict[str, Any], harmonic: str) -> Told:
    """Amplitude and phase of one harmonic."""
    amplitudes, phases = list[Span](), []
    for cosine, sine in zip(*(_spans(f"{part}{harmonic}", cause) for part in ("cosine", "sine")), strict=True):
        (c, half_c), (s, half_s) = (
            (at, None if low is None or high is None else 0.5 * (high - low)) for at, low, high in (cosine, sine)
        )
        amplitude = float(np.hypot(c, s))
        phases.append(f"{np.degrees(np.arctan2(s, c)):.0f}")
        if half_c is None or half_s is None:
            amplitudes.append((amplitude, None, None))
            continue
        half = float(np.hypot(c * half_c, s * half_s) / amplitude if amplitude else np.hypot(half_c, half_s))
        amplitudes.append((amplitude, max(0.0, amplitude - half), amplitude + half))
    size = format_spans(amplitudes, cause["units"][f"cosine{harmonic}"])
    return Told(f"{WAVES[harmonic]}amplitude {size}, phase {', '.join(phases)} deg", _telling(amplitudes))
