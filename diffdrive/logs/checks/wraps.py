"""Counters that overflow: jumps back by the whole span of the counter."""

from collections.abc import Iterator

import numpy as np

from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.grid import fit_count_grid, noise_std
from diffdrive.logs.checks.repair import AddToChannel, Repair, UnwrapChannel
from diffdrive.logs.log import Log, Signal

# A jump is one only where the channel otherwise moves less than half of it a sample: else it could be either way.
JUMP = 2.0
# All jumps are the span, but for the motion or the noise meanwhile.
ALIKE = 0.02
# Through an overflow the channel moves on, within so many samples by clearly more than its noise.
NEAR, CLEAR = 10, 5.0
NARROWEST = 2**8  # counts: no counter is narrower
WIDTHS = (8, 10, 12, 14, 15, 16, 18, 20, 22, 24, 32)  # bits


def counter_span(signal: Signal) -> float | None:
    """The span of a counter that overflows within a signal; None where there is none."""
    steps = np.diff(signal)
    magnitudes = np.abs(steps)
    is_jump = magnitudes > 0.5 * magnitudes.max(initial=0.0)
    others = magnitudes[~is_jump]
    if not is_jump.any() or len(others) < 100 or magnitudes.max() <= JUMP * max(others.max(), 1e-300):
        return None
    # the span is the jump and the motion that goes on through it
    before = np.clip(np.flatnonzero(is_jump) - 1, 0, None)
    spans = np.abs(steps[is_jump] - steps[before] * ~is_jump[before])
    span = float(np.median(spans))
    # it jumps where it reaches its end, and only there
    covers_span = np.ptp(signal) < span * (1 + ALIKE) and np.ptp(signal) > span * (1 - ALIKE)
    motion_allowance = max(ALIKE * span, 2 * float(others.max()))
    are_equal = covers_span and np.all(np.abs(spans - span) < motion_allowance)
    return span if are_equal and _continues_through(signal, np.flatnonzero(is_jump), span) else None


def _continues_through(signal: Signal, jumps: np.ndarray, span: float) -> bool:
    """Whether the channel without its jumps moves on through them, as a counter does: a step or a flicker rests.

    Jumps close to one another are one crossing; to and back is none.
    """
    unwrapped = np.unwrap(signal, period=span)
    motions = []
    for crossing in np.split(jumps, np.flatnonzero(np.diff(jumps) > NEAR) + 1):
        net_jump = float(np.sum(np.diff(signal)[crossing]))
        before, after = max(crossing[0] - NEAR, 0), min(crossing[-1] + 1 + NEAR, len(signal) - 1)
        if abs(net_jump) > 0.5 * span:  # downwards where it counts up
            motions.append(-np.sign(net_jump) * (unwrapped[after] - unwrapped[before]))
    return bool(motions) and float(np.median(motions)) > max(CLEAR * noise_std(unwrapped), 1e-9 * span)


def _is_closer_to_partner(log: Log, name: str, span: float) -> bool:
    """Whether the channel is closer to its partner without its jumps: a sawtooth is followed as it is."""
    partner = log.channels.get(_partner(name))
    if partner is None or counter_span(partner) is not None:
        return True
    signal = log.channels[name]
    return float(np.std(np.unwrap(signal, period=span) - partner)) < float(np.std(signal - partner))


def _partner(name: str) -> str:
    return "position" if name == "reference" else "reference"


def wrapped_positions(log: Log, resolution: float | None) -> Iterator[Finding]:
    """Position, reference, motor position or command whose counter overflows; `resolution` (m) is that of the scale."""
    for name in ("reference", "position", "motor_position"):
        signal = log.channels.get(name)
        span = None if signal is None else counter_span(signal)
        if span is None or not _is_closer_to_partner(log, name, span):
            continue
        if resolution is not None and span < NARROWEST * resolution:
            continue
        counts = "" if resolution is None else _bits_text(span / resolution)
        span = span if resolution is None else resolution * _whole_counts(span / resolution)
        turns = _turns(log, name, span)
        steps = (UnwrapChannel(name, span), *((AddToChannel(name, turns * span),) if turns else ()))
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
    span, steps = counter_span(log.command), fit_count_grid(log.command)
    bits = None if span is None or steps is None else _bit_width(span / steps.step)
    if steps is None or bits is None:
        return
    span = 2.0**bits * steps.step
    yield Finding(
        "fatal",
        "command",
        f"the command jumps by {span:.6g} N and back, 2^{bits} of its steps: its integer overflows",
        f"add {span:.9g} N at each jump, or log a wider integer",
        "wrapped",
        repair=Repair((UnwrapChannel("command", span),)),
    )


def _turns(log: Log, name: str, span: float) -> int:
    """How many spans the channel lies off its partner, once its jumps are taken out."""
    signal, partner = log.channels[name], log.channels.get(_partner(name))
    if partner is None or counter_span(partner) is not None:
        return 0
    return round(float(np.median(partner - np.unwrap(signal, period=span))) / span)


def _bits_text(counts: float) -> str:
    bits = _bit_width(counts)
    return "" if bits is None else f", 2^{bits} counts"


def _bit_width(counts: float) -> int | None:
    return next((bits for bits in WIDTHS if abs(counts / 2**bits - 1) < ALIKE), None)


def _whole_counts(counts: float) -> float:
    """The span in counts: a power of two where it is near one."""
    bits = _bit_width(counts)
    return float(2**bits) if bits is not None else float(round(counts))
