"""What may have happened to a log: each hypothesis as the log without it, for the checks to judge.

A hypothesis is judged by how well the drive file's controller gives the command in the log as it would be without what
happened. For a linear controller a filter on one channel is undone by the same filter on the other two: they belong
together again.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import equinox as eqx
import numpy as np
from scipy.signal import lfilter, savgol_filter

from diffdrive.controllers import Cascade, UnknownController
from diffdrive.logs.checks.dynamics import NOMINAL_STD
from diffdrive.logs.checks.factors import FACTORS
from diffdrive.logs.checks.grid import COARSER, coarse_step, fit_count_grid
from diffdrive.logs.checks.relation import ControllerRelation, LoopSignals
from diffdrive.logs.checks.repair import RepairStep, ScaleChannel, ShiftChannel, SwapChannels, shift_signal
from diffdrive.logs.checks.replay import is_linear, is_memoryless
from diffdrive.logs.checks.statistics import RobustFit, window_length
from diffdrive.logs.log import Signal

REACH = 8  # whole samples by which a channel is moved
REACH_OF_BOTH = 2  # whole samples by which two channels are moved by different amounts
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
    """A cause, and the signals as they would be without it; `steps` lead there, where a log can be mended.

    `columns` stand in the place of the controller's command where the hypothesis is about the controller itself, or
    adds what it does not give.
    """

    cause: str
    channel: str
    signals: LoopSignals
    steps: tuple[RepairStep, ...] = ()
    numbers: dict[str, float] = field(default_factory=dict)
    columns: tuple[Signal, ...] = ()
    gains: int = 0  # how many of the columns are parts of the controller's command
    control: LoopSignals | None = (
        None  # what must explain less: all channels through the filter that one is said to have
    )


def _match_filtered_channel(signals: LoopSignals, channel: str, through: "ChannelFilter") -> LoopSignals:
    """The channel as it is, the two others through the filter that it has passed."""
    others = {name: through.apply(getattr(signals, name)) for name in ("reference", "position", "command")}
    return signals._replace(**others | {channel: getattr(signals, channel)})


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

    @property
    def delay(self) -> float:
        """Samples by which it is late."""
        return self.lag or (0.0 if self.centred else (self.length - 1) / 2)


def candidate_filters() -> Iterator[ChannelFilter]:
    """Those that are tried."""
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
    now = relation.logged
    mended = now._replace(reference=now.position, position=now.reference)
    yield Hypothesis("swapped", "position", mended, (SwapChannels("reference", "position"),))


def position_and_reference(relation: ControllerRelation, ratio: float) -> Iterator[Hypothesis]:
    """One of the two has a wrong unit or sign: `ratio` is that of position to reference, as far as the loop follows."""
    now = relation.logged
    ratio = _exact_ratio(relation, ratio) if is_linear(relation.description.controller) else ratio
    cause = "reversed" if abs(ratio + 1) < 0.5 else "gain"
    for channel, factor in (("position", 1 / ratio), ("reference", ratio)):
        factor = float(np.sign(factor)) if cause == "reversed" else factor
        mended = now._replace(**{channel: factor * getattr(now, channel)})
        yield Hypothesis(cause, channel, mended, (ScaleChannel(channel, factor),), {"ratio": ratio})


def _exact_ratio(relation: ControllerRelation, ratio: float) -> float:
    """The ratio at which the controller gives the command: it is linear in reference and position, each by itself."""
    now = relation.logged
    still = np.zeros_like(now.position)
    both, ahead = relation.outputs([now._replace(position=now.position / ratio), now._replace(position=still)])
    of_reference, of_position = relation.fit(now.command, ahead, both - ahead).coefficients[:2]
    found = ratio * float(of_reference / of_position) if of_position else ratio
    return found if 0.8 < found / ratio < 1.25 else ratio


def whole_shifts(relation: ControllerRelation) -> Iterator[Hypothesis]:
    """Channels that were recorded some samples early or late."""
    pairs = {(i, j) for i in range(-REACH_OF_BOTH, REACH_OF_BOTH + 1) for j in range(-REACH_OF_BOTH, REACH_OF_BOTH + 1)}
    for by in range(-REACH, REACH + 1):
        pairs |= {(by, by), (by, 0), (0, by)}
    for i, j in sorted(pairs - {(0, 0)}, key=lambda pair: abs(pair[0]) + abs(pair[1])):
        yield shift(relation, i, j)


def shift(relation: ControllerRelation, i: float, j: float) -> Hypothesis:
    """Reference and position belong i and j samples later than they were recorded; i = j: the command earlier."""
    now = relation.logged
    mended = now._replace(reference=shift_signal(now.reference, i), position=shift_signal(now.position, j))
    if i == j:
        channel, steps = "command", (ShiftChannel("command", -i),)
    else:
        channel = "position" if i == 0 else "reference" if j == 0 else "command"
        steps = tuple(ShiftChannel(name, by) for name, by in (("reference", i), ("position", j)) if by)
    if i % 1 or j % 1:  # what was interpolated is not brought back by interpolation
        steps = ()
    return Hypothesis("shifted", channel, mended, steps, {"reference": i, "position": j})


def filtered(relation: ControllerRelation) -> Iterator[Hypothesis]:
    """One channel was averaged or low-passed before it was logged."""
    for one in candidate_filters():
        for channel in ("position", "command", "reference"):
            numbers = {"length": float(one.length), "lag": one.lag, "delay": one.delay, "centred": float(one.centred)}
            mended = _match_filtered_channel(relation.logged, channel, one)
            # the filter alone makes all channels smoother, and so more alike
            control = mended._replace(**{channel: one.apply(getattr(relation.logged, channel))})
            yield Hypothesis("filtered", channel, mended, (), numbers, control=control)


def decimated(relation: ControllerRelation) -> Iterator[Hypothesis]:
    """Only one row in n was kept, and the time was counted at the full rate: the mass looks n^2 times too small."""
    now = relation.dynamics(relation.logged)
    mass = None if now is None else now.mass
    for skipped in DECIMATION_FACTORS:
        # each costs a replay of n times as many samples: only those that leave a mass within four deviations
        if mass is not None and mass.determined and abs(np.log(skipped**2 * abs(mass.value))) > 4 * NOMINAL_STD:
            continue
        mended = relation.logged._replace(period=skipped * relation.logged.period)
        yield Hypothesis(
            "decimated", "time", mended, (ScaleChannel("time", float(skipped)),), {"skipped": float(skipped)}
        )


def rounded(relation: ControllerRelation) -> Iterator[Hypothesis]:
    """The position, or the reference, has coarser steps than the scale: smoothed, all channels agree again."""
    now, stated = relation.logged, relation.description.drive.sensor.resolution
    if stated is None:
        return
    for channel in ("position", "reference"):
        signal = getattr(now, channel)
        grid = fit_count_grid(signal)
        if grid is not None and grid.step > COARSER * float(stated) and is_on_grid(signal, grid.step):
            numbers = {"step": grid.step, "ratio": grid.step / float(stated)}
            for seconds in SMOOTHING_WINDOWS:
                length = min(window_length(1.0 / now.period, seconds), len(now.position) // 2 * 2 - 1)
                mended = LoopSignals(*(savgol_filter(signal, length, 2) for signal in now[:3]), now.period)
                yield Hypothesis("rounded", channel, mended, (), numbers)


def rounded_command(relation: ControllerRelation, fit: RobustFit) -> Iterator[tuple[Hypothesis, RobustFit]]:
    """The command has coarse steps: what is left is then the error of rounding, and the rest of it the misfit."""
    command = relation.logged.command
    step = coarse_step(command)
    if step is None:
        return
    explained = step / np.sqrt(12.0) / float(np.std(command))
    left = float(np.sqrt(max(fit.error**2 - explained**2, 0.0)))
    # a residual of many steps is not that of rounding, however little of it remains
    if explained > 0.5 * fit.error:
        yield (
            Hypothesis("rounded", "command", relation.logged, (), {"step": step}),
            fit._replace(error=left),
        )


def is_on_grid(signal: Signal, step: float) -> bool:
    """Whether the values lie on the grid, as after rounding.

    A set-point of constant speed, acceleration or jerk has a grid as well, since it advances by whole multiples of one
    increment. Rounding is noise: its third differences alternate, with a correlation of -0.75 from one to the next.
    """
    counts = (signal - signal[0]) / step
    third = np.diff(counts, 3)
    uneven = np.abs(third) > 1e-3
    power = float(third @ third)
    if np.sum(uneven) < FEWEST or float(third[1:] @ third[:-1]) > ALTERNATING * power:
        return False
    inner = counts[2:-1][uneven]
    return float(np.quantile(np.abs(inner - np.round(inner)), 0.9)) < ROUNDED


def lengths(relation: ControllerRelation) -> Iterator[Hypothesis]:
    """Position and reference have one wrong unit, where the controller is not linear: then no factor says so."""
    if is_linear(relation.description.controller) or relation.late:  # an observer fed by the log follows any lengths
        return
    now = relation.logged
    for size in FACTORS:
        for factor in (size, 1 / size):
            mended = now._replace(reference=factor * now.reference, position=factor * now.position)
            steps = (ScaleChannel("position", factor), ScaleChannel("reference", factor))
            yield Hypothesis("gain", "position", mended, steps, {"ratio": 1 / factor, "both": 1.0})


def offset(relation: ControllerRelation, output: Signal) -> Iterator[Hypothesis]:
    """The reference has another zero, which a controller with an integral turns into a ramp of its command."""
    controller = relation.description.controller
    if is_memoryless(controller) or not is_linear(controller):
        return
    now, small = relation.logged, 1e-6
    moved = relation.outputs([now._replace(reference=now.reference + small)])[0]
    yield Hypothesis("offset", "reference", now, (), {}, (output, (moved - output) / small))


def rectified(relation: ControllerRelation, output: Signal) -> Iterator[Hypothesis]:
    """Only the absolute value of the command was logged."""
    now = relation.logged
    if np.min(now.command) >= 0 and np.min(output) < 0 < np.max(output):
        signed = now._replace(command=np.copysign(now.command, output))
        yield Hypothesis("rectified", "command", signed, (), {}, (output,))


GAINS = ("kp", "kd", "kv", "ki")


def other_gains(relation: ControllerRelation, output: Signal) -> Iterator[Hypothesis]:
    """The same controller with other gains: its command is linear in each of the parts that they make."""
    controller = relation.description.controller
    if isinstance(controller, UnknownController):
        return
    holder = controller if isinstance(controller, Cascade) else controller.tracking.gains  # type: ignore[attr-defined]
    names = [name for name in GAINS if float(getattr(holder, name, 0.0) or 0.0) != 0.0]
    parts = [output - _output_without(relation, (name,)) for name in names]
    if len(names) == 3:  # the products of a cascade with an integral
        parts = [parts[0], output - _output_without(relation, ("ki",)), _output_without(relation, ("kp", "ki"))]
    rest = output - sum(parts)
    columns = [one for one in [*parts, rest] if np.std(one) > 1e-9 * np.std(output)]
    yield Hypothesis("other controller", "command", relation.logged, (), {}, tuple(columns), len(parts))


def _output_without(relation: ControllerRelation, gains: tuple[str, ...]) -> Signal:
    """The controller's command with some of its gains at zero."""
    description = relation.description

    def of(controller: object) -> list[object]:
        holder = controller if isinstance(controller, Cascade) else controller.tracking.gains  # type: ignore[attr-defined]
        return [getattr(holder, name) for name in gains]

    changed = eqx.tree_at(of, description.controller, [0.0] * len(gains))
    without = replace(relation, description=replace(description, controller=changed))
    return without.outputs([relation.logged])[0]


def slower_velocity(relation: ControllerRelation, output: Signal) -> Iterator[Hypothesis]:
    """A cascade with an integral forms its velocity over more samples, which is that of an averaged position."""
    description = relation.description
    cascade = description.controller
    if not isinstance(cascade, Cascade) or is_memoryless(cascade):
        return
    now = relation.logged
    base = replace(description, controller=replace(cascade, velocity_samples=1))
    inner = replace(relation, description=replace(base, controller=replace(base.controller, kp=0.0)))
    numbers = [n for n in range(1, SLOWEST_VELOCITY + 1) if n != cascade.velocity_samples]
    cases = [now._replace(position=ChannelFilter(n).apply(now.position)) for n in (cascade.velocity_samples, *numbers)]
    stated, *others = inner.outputs(cases)
    for n, other in zip(numbers, others, strict=True):
        yield Hypothesis(
            "other controller", "command", now, (), {"samples": float(n)}, (output + other - stated,), gains=1
        )


def filtered_velocity(relation: ControllerRelation, output: Signal) -> Iterator[Hypothesis]:
    """The controller forms its velocity over several samples: the command is a combination of the last errors."""
    if not is_memoryless(relation.description.controller):
        return
    now = relation.logged
    error = now.reference - now.position
    ahead = relation.outputs([now._replace(position=now.reference)])[0]
    columns = [shift_signal(error, float(k)) for k in range(TAPS)]
    if np.std(ahead) > 1e-9 * np.std(output):
        columns.append(ahead)
    yield Hypothesis("other controller", "command", now, (), {"taps": float(TAPS)}, tuple(columns))
