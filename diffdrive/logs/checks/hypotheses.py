"""What may have happened to a log: each hypothesis with the log as it would be without it.

A hypothesis is judged by how well the drive file's controller gives the command in the log as it would be without what
happened. For a linear controller a filter on one channel is undone by the same filter on the other two: then they
agree again.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import lfilter, savgol_filter

from diffdrive.controllers import Cascade
from diffdrive.logs.checks.dynamics import NOMINAL_STD
from diffdrive.logs.checks.factors import FACTORS
from diffdrive.logs.checks.grid import COARSER, coarse_step, fit_count_grid
from diffdrive.logs.checks.relation import ControllerRelation, ControllerSignals
from diffdrive.logs.checks.repair import RepairStep, ScaleChannel, ShiftChannel, SwapChannels, shift_signal
from diffdrive.logs.checks.statistics import RobustFit, window_length
from diffdrive.logs.log import Signal

REACH = 8  # whole samples by which a channel is shifted
REACH_OF_BOTH = 2  # whole samples by which two channels are shifted by different amounts
LONGEST_AVERAGE = 48  # samples
SLOWEST_LAG = 48.0  # samples
DECIMATION_FACTORS = range(2, 11)  # rows of which one was kept
SMOOTHING_WINDOWS = (0.02, 0.04, 0.08)  # s: as long as an acceleration of a feed axis takes, and longer
ALTERNATING = -0.375  # half of what rounding has: a smooth motion has more than 0
FEWEST = 50  # samples that show whether there is a grid
ROUNDED = 0.05  # of a step: what digits and the estimate of the step leave of a rounded value
SLOWEST_VELOCITY = 16  # samples
TAPS = 9  # samples over which a controller may form its velocity


@dataclass(frozen=True)
class Hypothesis:
    """A cause, and the signals as they would be without it; `steps` lead there, where a log can be repaired.

    `regressors` replace the controller's command where the hypothesis is about the controller itself, or adds to it.
    """

    cause: str
    channel: str
    signals: ControllerSignals
    steps: tuple[RepairStep, ...] = ()
    parameters: dict[str, float] = field(default_factory=dict)
    regressors: tuple[Signal, ...] = ()
    gain_count: int = 0  # how many of the regressors are parts of the controller's command
    # which must explain less: all channels through the filter that one channel is supposed to have passed
    control_signals: ControllerSignals | None = None


@dataclass(frozen=True)
class ChannelFilter:
    """A moving average over `length` samples, centred or of the last ones; or a first-order lag of `lag` samples."""

    length: int = 0
    centred: bool = False
    lag: float = 0.0

    def apply(self, signal: Signal) -> Signal:
        """The signal through it, begun at rest."""
        first = signal[0]
        if self.lag:
            pole = np.exp(-1.0 / self.lag)
            return first + lfilter([1.0 - pole], [1.0, -pole], signal - first)
        after = self.length // 2 if self.centred else 0
        padded = np.concatenate([np.full(self.length - 1 - after, first), signal, np.full(after, signal[-1])]) - first
        sums = np.concatenate([[0.0], np.cumsum(padded)])
        return first + (sums[self.length :] - sums[: -self.length]) / self.length

    def apply_to_all(self, signals: ControllerSignals) -> ControllerSignals:
        """All channels through it."""
        return ControllerSignals(
            self.apply(signals.reference), self.apply(signals.position), self.apply(signals.command), signals.period
        )

    @property
    def delay(self) -> float:
        """Samples by which it is late."""
        return self.lag or (0.0 if self.centred else (self.length - 1) / 2)


def candidate_filters() -> Iterator[ChannelFilter]:
    """The filters that are tried."""
    for length in range(2, LONGEST_AVERAGE + 1):
        yield ChannelFilter(length)
        if length % 2:
            yield ChannelFilter(length, centred=True)
    for lag in np.geomspace(1.0, SLOWEST_LAG, 16):
        yield ChannelFilter(lag=float(lag))


def as_logged(relation: ControllerRelation) -> Hypothesis:
    """Nothing happened."""
    return Hypothesis("", "command", relation.logged)


def swapped(relation: ControllerRelation) -> Iterator[Hypothesis]:
    """Reference and position are exchanged."""
    logged = relation.logged
    repaired = logged._replace(reference=logged.position, position=logged.reference)
    yield Hypothesis("swapped", "position", repaired, (SwapChannels("reference", "position"),))


def position_and_reference(relation: ControllerRelation, ratio: float) -> Iterator[Hypothesis]:
    """One of the two has a wrong unit or sign: `ratio` is that of position to reference, as far as the loop follows."""
    logged = relation.logged
    ratio = ratio if relation.axis.controller.has_friction_observer else _exact_ratio(relation, ratio)
    cause = "reversed" if abs(ratio + 1) < 0.5 else "gain"
    for channel, factor in (("position", 1 / ratio), ("reference", ratio)):
        factor = float(np.sign(factor)) if cause == "reversed" else factor
        repaired = logged._replace(**{channel: factor * getattr(logged, channel)})
        yield Hypothesis(cause, channel, repaired, (ScaleChannel(channel, factor),), {"ratio": ratio})


def _exact_ratio(relation: ControllerRelation, ratio: float) -> float:
    """The ratio at which the controller gives the command, as far as that is linear in the position."""
    logged = relation.logged
    zeros = np.zeros_like(logged.position)
    tracking, feedforward = relation.controller_commands(
        [logged._replace(position=logged.position / ratio), logged._replace(position=zeros)]
    )
    of_reference, of_position = relation.fit(logged.command, feedforward, tracking - feedforward).coefficients[:2]
    exact = ratio * float(of_reference / of_position) if of_position else ratio
    return exact if 0.8 < exact / ratio < 1.25 else ratio


def whole_shifts(relation: ControllerRelation) -> Iterator[Hypothesis]:
    """Channels that were recorded some samples early or late."""
    pairs = {
        (reference_shift, position_shift)
        for reference_shift in range(-REACH_OF_BOTH, REACH_OF_BOTH + 1)
        for position_shift in range(-REACH_OF_BOTH, REACH_OF_BOTH + 1)
    }
    for samples in range(-REACH, REACH + 1):
        pairs |= {(samples, samples), (samples, 0), (0, samples)}
    for reference_shift, position_shift in sorted(pairs - {(0, 0)}, key=lambda pair: abs(pair[0]) + abs(pair[1])):
        yield shift(relation, reference_shift, position_shift)


def shift(relation: ControllerRelation, reference_shift: float, position_shift: float) -> Hypothesis:
    """Reference and position shifted to later times (samples); the command to earlier ones where both are equal."""
    logged = relation.logged
    repaired = logged._replace(
        reference=shift_signal(logged.reference, reference_shift),
        position=shift_signal(logged.position, position_shift),
    )
    steps: tuple[RepairStep, ...]
    if reference_shift == position_shift:
        channel, steps = "command", (ShiftChannel("command", -reference_shift),)
    else:
        channel = "position" if reference_shift == 0 else "reference" if position_shift == 0 else "command"
        steps = tuple(
            ShiftChannel(name, samples)
            for name, samples in (("reference", reference_shift), ("position", position_shift))
            if samples
        )
    if reference_shift % 1 or position_shift % 1:  # what was interpolated is not brought back by interpolation
        steps = ()
    return Hypothesis("shifted", channel, repaired, steps, {"reference": reference_shift, "position": position_shift})


def filtered(relation: ControllerRelation) -> Iterator[Hypothesis]:
    """One channel was averaged or low-passed before it was logged."""
    for channel_filter in candidate_filters():
        # the filter alone makes all channels smoother, and so more alike
        control_signals = channel_filter.apply_to_all(relation.logged)
        for channel in ("position", "command", "reference"):
            parameters = {
                "length": float(channel_filter.length),
                "lag": channel_filter.lag,
                "delay": channel_filter.delay,
                "centred": float(channel_filter.centred),
            }
            repaired = control_signals._replace(**{channel: getattr(relation.logged, channel)})
            yield Hypothesis("filtered", channel, repaired, (), parameters, control_signals=control_signals)


def decimated(relation: ControllerRelation) -> Iterator[Hypothesis]:
    """Only one row in n was kept, and the time was counted at the full rate: the mass looks n^2 times too small."""
    dynamics = relation.dynamics(relation.logged)
    mass = None if dynamics is None else dynamics.mass
    for factor in DECIMATION_FACTORS:
        # each costs a replay of n times as many samples: only those that leave a mass within four deviations
        if mass is not None and mass.is_determined and abs(np.log(factor**2 * abs(mass.value))) > 4 * NOMINAL_STD:
            continue
        repaired = relation.logged._replace(period=factor * relation.logged.period)
        yield Hypothesis(
            "decimated", "time", repaired, (ScaleChannel("time", float(factor)),), {"skipped": float(factor)}
        )


def rounded(relation: ControllerRelation) -> Iterator[Hypothesis]:
    """The position, or the reference, has coarser steps than the scale: smoothed, all channels agree again."""
    logged, resolution = relation.logged, relation.axis.drive.sensor.resolution
    if resolution is None:
        return
    for channel in ("position", "reference"):
        signal = getattr(logged, channel)
        grid = fit_count_grid(signal)
        if grid is not None and grid.step > COARSER * float(resolution) and is_on_grid(signal, grid.step):
            parameters = {"step": grid.step, "ratio": grid.step / float(resolution)}
            for seconds in SMOOTHING_WINDOWS:
                length = min(window_length(1.0 / logged.period, seconds), len(logged.position) // 2 * 2 - 1)
                repaired = ControllerSignals(
                    savgol_filter(logged.reference, length, 2),
                    savgol_filter(logged.position, length, 2),
                    savgol_filter(logged.command, length, 2),
                    logged.period,
                )
                yield Hypothesis("rounded", channel, repaired, (), parameters)


def rounded_command(relation: ControllerRelation, fit: RobustFit) -> Iterator[tuple[Hypothesis, RobustFit]]:
    """The command has coarse steps: what is left is then the error of rounding, and the rest of it the misfit."""
    command = relation.logged.command
    step = coarse_step(command)
    if step is None:
        return
    rounding_error = step / np.sqrt(12.0) / float(np.std(command))
    remaining_error = float(np.sqrt(max(fit.error**2 - rounding_error**2, 0.0)))
    # a residual of many steps is not that of rounding, however little of it remains
    if rounding_error > 0.5 * fit.error:
        yield (
            Hypothesis("rounded", "command", relation.logged, (), {"step": step}),
            fit._replace(error=remaining_error),
        )


def is_on_grid(signal: Signal, step: float) -> bool:
    """Whether the values lie on the grid, as after rounding.

    A set-point of constant speed, acceleration or jerk has a grid as well, since it advances by whole multiples of one
    increment. Rounding is noise: its third differences alternate, with a correlation of -0.75 from one to the next.
    """
    counts = (signal - signal[0]) / step
    third_differences = np.diff(counts, 3)
    is_uneven = np.abs(third_differences) > 1e-3
    power = float(third_differences @ third_differences)
    if np.sum(is_uneven) < FEWEST or float(third_differences[1:] @ third_differences[:-1]) > ALTERNATING * power:
        return False
    counts_inside = counts[2:-1][is_uneven]
    return float(np.quantile(np.abs(counts_inside - np.round(counts_inside)), 0.9)) < ROUNDED


def lengths(relation: ControllerRelation) -> Iterator[Hypothesis]:
    """Position and reference have one wrong unit, where the controller is not linear: then no factor says so."""
    # an observer fed by the log follows any lengths
    if relation.axis.controller.is_linear or relation.feeds_logged_command:
        return
    logged = relation.logged
    for unit_factor in FACTORS:
        for factor in (unit_factor, 1 / unit_factor):
            repaired = logged._replace(reference=factor * logged.reference, position=factor * logged.position)
            steps = (ScaleChannel("position", factor), ScaleChannel("reference", factor))
            yield Hypothesis("gain", "position", repaired, steps, {"ratio": 1 / factor, "both": 1.0})


def offset(relation: ControllerRelation, output: Signal) -> Iterator[Hypothesis]:
    """The reference has another zero, which a controller with an integral turns into a ramp of its command."""
    controller = relation.axis.controller
    if controller.is_memoryless or controller.has_friction_observer:
        return
    # of a law that is not linear this is the tangent, and the misfit says how far that goes
    logged, displacement = relation.logged, 1e-6
    displaced = relation.controller_commands([logged._replace(reference=logged.reference + displacement)])[0]
    yield Hypothesis("offset", "reference", logged, (), {}, (output, (displaced - output) / displacement))


def rectified(relation: ControllerRelation, output: Signal) -> Iterator[Hypothesis]:
    """Only the absolute value of the command was logged."""
    logged = relation.logged
    if np.min(logged.command) >= 0 and np.min(output) < 0 < np.max(output):
        repaired = logged._replace(command=np.copysign(logged.command, output))
        yield Hypothesis("rectified", "command", repaired, (), {}, (output,))


def other_gains(relation: ControllerRelation, output: Signal) -> Iterator[Hypothesis]:
    """The same controller with other gains: its command is linear in each of the parts that they make."""
    gains = relation.axis.gains
    parts = [
        (_output_without(relation, part.without) if part.without else output)
        - _output_without(relation, (*part.without, part.gain))
        for part in relation.axis.controller.command_parts
        if float(gains[part.gain] or 0.0) != 0.0
    ]
    if not parts:
        return
    rest = output - sum(parts)
    regressors = [part for part in [*parts, rest] if np.std(part) > 1e-9 * np.std(output)]
    yield Hypothesis("other controller", "command", relation.logged, (), {}, tuple(regressors), len(parts))


def _output_without(relation: ControllerRelation, gains: tuple[str, ...]) -> Signal:
    """The controller's command with some of its gains at zero."""
    modified = replace(relation, axis=relation.axis.with_gains(**dict.fromkeys(gains, 0.0)))
    return modified.controller_commands([relation.logged])[0]


def slower_velocity(relation: ControllerRelation, output: Signal) -> Iterator[Hypothesis]:
    """A cascade with an integral forms its velocity over more samples, which is that of an averaged position."""
    axis = relation.axis
    cascade = axis.controller
    if not isinstance(cascade, Cascade) or cascade.is_memoryless:
        return
    logged = relation.logged
    inner_loop = replace(relation, axis=replace(axis, controller=replace(cascade, velocity_samples=1, kp=0.0)))
    window_lengths = [n for n in range(1, SLOWEST_VELOCITY + 1) if n != cascade.velocity_samples]
    variants = [
        logged._replace(position=ChannelFilter(n).apply(logged.position))
        for n in (cascade.velocity_samples, *window_lengths)
    ]
    stated, *others = inner_loop.controller_commands(variants)
    for n, other in zip(window_lengths, others, strict=True):
        yield Hypothesis(
            "other controller", "command", logged, (), {"samples": float(n)}, (output + other - stated,), gain_count=1
        )


def filtered_velocity(relation: ControllerRelation, output: Signal) -> Iterator[Hypothesis]:
    """The controller forms its velocity over several samples: the command is a combination of the last errors."""
    if not relation.axis.controller.is_memoryless:
        return
    logged = relation.logged
    error = logged.reference - logged.position
    feedforward = relation.controller_commands([logged._replace(position=logged.reference)])[0]
    regressors = [shift_signal(error, float(k)) for k in range(TAPS)]
    if np.std(feedforward) > 1e-9 * np.std(output):
        regressors.append(feedforward)
    yield Hypothesis("other controller", "command", logged, (), {"taps": float(TAPS)}, tuple(regressors))
