"""Counters that overflow: jumps back by the whole span of the counter."""

from collections.abc import Iterator

import numpy as np

from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.grid import grid_of
from diffdrive.logs.checks.repair import Add, Repair, Unwrap
from diffdrive.logs.log import Log, Signal

# A jump is one only where the channel otherwise moves less than half of it a sample: else it could be either way.
JUMP = 2.0
# All jumps are the span, but for the motion or the noise meanwhile.
ALIKE = 0.02
WIDTHS = (8, 10, 12, 14, 15, 16, 18, 20, 22, 24, 32)  # bits


def span_of(signal: Signal) -> float | None:
    """The span of a counter that overflows within a signal; None where there is none."""
    steps = np.diff(signal)
    size = np.abs(steps)
    jumps = size > 0.5 * size.max(initial=0.0)
    others = size[~jumps]
    if not jumps.any() or len(others) < 100 or size.max() <= JUMP * max(others.max(), 1e-300):
        return None
    # the span is the jump and the motion that goes on through it
    before = np.clip(np.flatnonzero(jumps) - 1, 0, None)
    spans = np.abs(steps[jumps] - steps[before] * ~jumps[before])
    span = float(np.median(spans))
    # it jumps where it reaches its end, and only there
    full = np.ptp(signal) < span * (1 + ALIKE) and np.ptp(signal) > span * (1 - ALIKE)
    meanwhile = max(ALIKE * span, 2 * float(others.max()))
    return span if full and np.all(np.abs(spans - span) < meanwhile) else None


def wrapped(log: Log, resolution: float | None) -> Iterator[Finding]:
    """Position, reference, motor position or command whose counter overflows; `resolution` (m) is that of the scale."""
    for name in ("reference", "position", "motor_position"):
        signal = log.channels.get(name)
        span = None if signal is None else span_of(signal)
        if span is None:
            continue
        counts = "" if resolution is None else _bits(span / resolution)
        span = span if resolution is None else resolution * _whole(span / resolution)
        turns = _turns(log, name, span)
        steps = (Unwrap(name, span), *((Add(name, turns * span),) if turns else ()))
        yield Finding(
            "fatal",
            name,
            f"the {name} jumps by {span:.6g} m and back{counts}: its counter overflows",
            f"add {span:.9g} m at each jump, or log a wider counter",
            "wrapped",
            repair=Repair(steps),
        )


def wrapped_command(log: Log) -> Iterator[Finding]:
    """A command that overflows: by a power of two of its own steps, since a force that is switched jumps as well."""
    span, steps = span_of(log.command), grid_of(log.command)
    bits = None if span is None or steps is None else _width(span / steps.step)
    if steps is None or bits is None:
        return
    span = 2.0**bits * steps.step
    yield Finding(
        "fatal",
        "command",
        f"the command jumps by {span:.6g} N and back, 2^{bits} of its steps: its integer overflows",
        f"add {span:.9g} N at each jump, or log a wider integer",
        "wrapped",
        repair=Repair((Unwrap("command", span),)),
    )


def _turns(log: Log, name: str, span: float) -> int:
    """How many spans the channel lies off its partner, once its jumps are taken out."""
    other = "position" if name == "reference" else "reference"
    signal, partner = log.channels[name], log.channels.get(other)
    if partner is None or span_of(partner) is not None:
        return 0
    return round(float(np.median(partner - np.unwrap(signal, period=span))) / span)


def _bits(counts: float) -> str:
    bits = _width(counts)
    return "" if bits is None else f", 2^{bits} counts"


def _width(counts: float) -> int | None:
    return next((bits for bits in WIDTHS if abs(counts / 2**bits - 1) < ALIKE), None)


def _whole(counts: float) -> float:
    """The span in counts: a power of two where it is near one."""
    bits = _width(counts)
    return float(2**bits) if bits is not None else float(round(counts))
