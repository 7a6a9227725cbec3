"""What was found in words that an engineer uses: amplitudes and phases in the place of cosines and sines, factors."""

from typing import Any

import numpy as np

from diffdrive.effects.machine import FACTORS

HEAD = 2  # parameters in a headline
WAVES = {"": "first", "2": "second", "6": "sixth"}  # harmonics, as their cosines and sines are named

Span = tuple[float, float | None, float | None]


def numbers(cause: dict[str, Any]) -> list[str]:
    """Each number of a cause with its 95 % interval and unit; log by log where the logs differ in it.

    A wave is told by amplitude and phase, A cos(x - phase), where its amplitude is told from none; its interval takes
    those of cosine and sine as independent. What the effect holds as a logarithm is told as a factor.
    """
    shown, told = [], set[str]()
    for name in cause["parameters"]:
        harmonic = name.removeprefix("cosine")
        if name in told:
            continue
        if name.startswith("cosine") and harmonic in WAVES and f"sine{harmonic}" in cause["parameters"]:
            told.add(f"sine{harmonic}")
            shown += _wave(cause, harmonic)
        else:
            shown.append(parameter(name, cause))
    return shown


def headline(causes: list[dict[str, Any]]) -> str:
    """What was found, how sure that is, and how large: a line each."""
    return "\n".join(
        f"{one['effect']}, {100.0 * one['confidence']:.0f} % sure: {'; '.join(numbers(one)[:HEAD])}"
        for one in causes
        if one["found"]
    )


def parameter(name: str, cause: dict[str, Any]) -> str:
    """A parameter of a cause with its interval and unit; log by log where the logs differ in it."""
    unit = cause["units"][name]
    if cause["effect"] == "friction_shape" and name in FACTORS:
        return f"{name} {_listed([_factors(one) for one in _spans(name, cause)], '')} of the drive file's"
    return f"{name} {_listed(_spans(name, cause), '' if unit == '1' else unit)}"


def _spans(name: str, cause: dict[str, Any]) -> list[Span]:
    """Value, low and high, of each log where they differ."""
    value, interval = cause["parameters"][name], cause["intervals"][name]
    return list(zip(value, *interval, strict=True)) if isinstance(value, list) else [(value, *interval)]


def _factors(logarithm: Span) -> Span:
    at, low, high = (None if one is None else float(np.exp(one)) for one in logarithm)
    assert at is not None
    return at, low, high


def _listed(spans: list[Span], unit: str) -> str:
    shown = [f"{_number(at)} ({_number(low)} to {_number(high)})" for at, low, high in spans]
    if len(shown) > 1:
        shown = [f"log {k} {one}" for k, one in enumerate(shown, start=1)]
    return f"{', '.join(shown)}{unit and ' ' + unit}"


def _wave(cause: dict[str, Any], harmonic: str) -> list[str]:
    """Amplitude and phase of one harmonic, or nothing where no log tells its amplitude from none."""
    names = f"cosine{harmonic}", f"sine{harmonic}"
    parts = [_spans(name, cause) for name in names]
    if any(None in span for spans in parts for span in spans):
        return [parameter(name, cause) for name in names]
    amplitudes, phases = [], []
    for (c, c_low, c_high), (s, s_low, s_high) in zip(*parts, strict=True):
        amplitude = float(np.hypot(c, s))
        half = np.hypot(c * (c_high - c_low), s * (s_high - s_low)) / (2.0 * amplitude) if amplitude else c_high - c
        amplitudes.append((amplitude, max(0.0, amplitude - float(half)), amplitude + float(half)))
        phases.append(f"{np.degrees(np.arctan2(s, c)):.0f}")
    if not any(low > 0.0 for _, low, _ in amplitudes):
        return []
    which = f"{WAVES[harmonic]} harmonic: " if harmonic else ""
    size = _listed(amplitudes, cause["units"][names[0]])
    return [f"{which}amplitude {size}, phase {', '.join(phases)} deg"]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
