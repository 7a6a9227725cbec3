"""Nyquist and Bode diagrams of a loop at its operating points, beside the margins required of it.

Each function takes its loops by name, {"given": {...}, "tuned": {...}}, each a mapping from an operating point to the
response there, and draws them over one another: a colour for each loop, dashes for each velocity. Velocities whose
curves cover one another are one entry of the legend. The phase is that of L under negative feedback.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from diffdrive.controllers import Controller
from diffdrive.loop.linearise import OperatingPoint, Response, open_loop, response
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import as_arrays
from experiments.reports.theme import (
    BLACK,
    BLUE,
    DASHES,
    REFERENCE,
    REGION,
    VERMILION,
    drawing,
    legend_below,
    legend_beside,
    new_figure,
    plain_logarithmic,
    say,
)
from tuning.gains.requirements import LoopLimits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Responses = Mapping[OperatingPoint, Response]
Loops = Mapping[str, Responses]
Coordinates = Callable[[Response], tuple[Any, Any]]  # what is drawn over what
LOWEST = 0.5  # Hz
POINTS = 1500
COLOUR = (BLACK, BLUE, VERMILION)  # of the loops, in their order
LINE = 1.2  # pt
BEYOND = 60.0  # dB on either side of 0, where no margin is
CENTRE, REACH = -1.0, 2.0  # of the complex plane: -1, and what is within 2 of it


def responses(
    drive: Drive, controller: Controller, sampling: Sampling, points: Sequence[OperatingPoint]
) -> dict[OperatingPoint, Response]:
    """The loop's response at each operating point."""
    drive, controller = as_arrays(smooth((drive, controller)))
    frequency = np.geomspace(LOWEST, 0.4999 * sampling.rate, POINTS)

    @jax.jit
    @jax.vmap
    def found(at: OperatingPoint) -> Response:
        return response(open_loop(drive, controller, sampling, at), frequency)

    together = found(jax.tree.map(lambda *values: np.array(values, float), *points))
    split = [jax.tree.map(lambda leaf, k=k: np.asarray(leaf[k]), together) for k in range(len(points))]
    return dict(zip(points, split, strict=True))


@drawing
def nyquist(loops: Loops, limits: LoopLimits = LoopLimits(sensitivity=2.0)) -> "Figure":
    """L in the complex plane near -1, the margins that `limits` asks for marked."""
    figure, axis = new_figure(height=4.6)
    axis.set(xlim=(CENTRE - REACH, CENTRE + REACH), ylim=(-REACH, REACH), aspect="equal")
    axis.set(xlabel="real part of L (no unit)", ylabel="imaginary part of L (no unit)")
    _required(axis, limits)
    _draw(loops, {axis: lambda one: (one.loop.real, one.loop.imag)})
    legend_beside(axis, title=_loads(loops))
    distances = {
        name: min(float(np.min(np.abs(1.0 + one.loop))) for one in many.values()) for name, many in loops.items()
    }
    allowed = "" if limits.sensitivity is None else f", at least {1.0 / limits.sensitivity:.3g} required"
    say(figure, f"The loop's distance from -1 is {_each(distances, '')}{allowed}: least of {_points(loops)}")
    return figure


def _required(axis: "Axes", limits: LoopLimits) -> None:
    """The unit circle, the ends of the gain margins, the rays of the phase margin, the circle of Ms."""
    turn = np.linspace(0.0, 2.0 * np.pi, 400)
    axis.plot(np.cos(turn), np.sin(turn), label="|L| = 1", **REFERENCE)
    if limits.phase is not None:
        arc = np.linspace(-limits.phase, limits.phase, 50)
        axis.fill(np.append(0.0, -np.cos(arc)), np.append(0.0, np.sin(arc)), **REGION)
        for k, sign in enumerate((1.0, -1.0)):
            ray = -3.0 * np.exp(1j * sign * limits.phase)
            label = None if k else f"phase margin {np.degrees(limits.phase):.3g} deg"
            axis.plot([0.0, ray.real], [0.0, ray.imag], ls=":", label=label, **REFERENCE)
    up, down = (20.0 * np.log10(float(gain)) for gain in (limits.gain_up, limits.gain_down))
    margin: dict[str, Any] = {"ms": 9, "color": VERMILION, "lw": 1.5, "gid": "reference"}
    label = f"gain margin {up:.3g} dB up, {down:.3g} dB down"
    axis.plot([-limits.gain_down, -1.0 / limits.gain_up], [0.0, 0.0], "|-", label=label, **margin)
    axis.plot(CENTRE, 0.0, "+", color=BLACK, ms=9, gid="reference")
    if limits.sensitivity is not None:
        circle = -1.0 + np.exp(1j * turn) / limits.sensitivity
        axis.plot(circle.real, circle.imag, ls="--", label=f"sensitivity {limits.sensitivity:.3g}", **REFERENCE)
        axis.fill(circle.real, circle.imag, **REGION)


@drawing
def bode(loops: Loops, limits: LoopLimits = LoopLimits()) -> "Figure":
    """Gain and phase of L over frequency, with the bands within which the other one must not cross."""
    figure, (gain, phase) = new_figure(2, 1, height=2.4)
    every = [one for many in loops.values() for one in many.values()]
    seen = np.concatenate([_phase(one)[np.abs(_decibels(one.loop)) < BEYOND] for one in every])
    low, high = 90.0 * np.floor(np.min(seen) / 90.0), 90.0 * np.ceil(np.max(seen) / 90.0)
    frequency = every[0].frequency
    gain.set(xscale="log", ylabel="gain of L, dB", xlim=(frequency[0], frequency[-1]), ylim=(-BEYOND, BEYOND))
    phase.set(
        ylabel="phase of L, deg", xlabel="frequency, Hz", yticks=np.arange(low, high + 1.0, 90.0), ylim=(low, high)
    )
    between = (-_decibels(limits.gain_up), _decibels(limits.gain_down))
    gain.axhspan(*between, **REGION)
    gain.set_title("shaded: the margins that are required, where the other curve is at its line")
    gain.axhline(0.0, **REFERENCE)
    for turned in np.arange(low, high + 1.0, 90.0):
        if turned % 360.0 == 180.0:
            if limits.phase is not None:
                phase.axhspan(turned - np.degrees(limits.phase), turned + np.degrees(limits.phase), **REGION)
            phase.axhline(turned, **REFERENCE)
    _draw(loops, {
        gain: lambda one: (one.frequency, _decibels(one.loop)),
        phase: lambda one: (one.frequency, _phase(one)),
    })  # fmt: skip
    plain_logarithmic(phase.xaxis)
    legend_below(figure, gain, columns=len(loops), title=_loads(loops))
    figure.align_ylabels()
    margins = {name: min(_phase_margin(one) for one in many.values()) for name, many in loops.items()}
    required = "" if limits.phase is None else f", {np.degrees(limits.phase):.3g} deg required"
    say(figure, f"Phase margin {_each(margins, ' deg')}{required}: least of {_points(loops)}")
    return figure


def _draw(loops: Loops, drawn: Mapping["Axes", Coordinates]) -> None:
    """Each loop's curves on all axes, in one look for each velocity; the first of a look has the label."""
    for colour, (name, many) in zip(COLOUR, loops.items(), strict=False):
        families: dict[float, list[Response]] = {}
        for at, one in many.items():
            families.setdefault(float(at.velocity), []).append(one)
        merged: list[tuple[list[float], list[Response]]] = []
        for velocity, family in families.items():
            like = next((one for one in merged if not _is_apart(one[1], family, drawn)), None)
            if like is None:
                merged.append(([velocity], family))
            else:
                like[0].append(velocity)
        for dashes, (velocities, family) in zip(DASHES, merged, strict=False):
            label = f"{name}: {', '.join(map(_motion, velocities))}"
            for axis, coordinates in drawn.items():
                for k, one in enumerate(family):
                    axis.plot(*coordinates(one), color=colour, ls=dashes, lw=LINE, label=None if k else label)


def _is_apart(family: Sequence[Response], other: Sequence[Response], drawn: Mapping["Axes", Coordinates]) -> bool:
    """Whether their curves are further apart anywhere in the pictures than a line is wide."""
    for axis, coordinates in drawn.items():
        points = 72.0 / axis.figure.dpi
        for one, two in zip(family, other, strict=True):
            here, there = (points * axis.transData.transform(np.transpose(coordinates(at))) for at in (one, two))
            (left, low), (right, high) = points * axis.bbox.get_points()
            inside = (here[:, 0] >= left) & (here[:, 0] <= right) & (here[:, 1] >= low) & (here[:, 1] <= high)
            if np.any(np.hypot(*(here - there)[inside].T) > LINE):
                return True
    return False


def _motion(velocity: float) -> str:
    return "standstill" if velocity == 0 else f"{1e3 * velocity:g} mm/s"


def _loads(loops: Loops) -> str:
    """Under which loads each look is drawn, once for each."""
    loads = sorted({float(at.load) for many in loops.values() for at in many})
    return f"each under {', '.join(f'{1e-3 * load:g}' for load in loads)} kN"


def _points(loops: Loops) -> str:
    count = len(next(iter(loops.values())))
    return f"the {count} operating points drawn" if count > 1 else "the one operating point drawn"


def _each(values: Mapping[str, float], unit: str) -> str:
    """One value with its unit for each loop: `31 deg given, 36 deg tuned`."""
    named = len(values) > 1
    return ", ".join(f"{value:.3g}{unit}" + (f" {name}" if named else "") for name, value in values.items())


def _decibels(gain: Any) -> np.ndarray:
    return np.asarray(20.0 * np.log10(np.abs(gain)))


def _phase(found: Response) -> np.ndarray:
    """Degrees without jumps, brought to between -360 and 0 at the crossover, by which it is judged."""
    phase = np.degrees(np.unwrap(np.angle(found.loop)))
    crossing = np.flatnonzero(np.abs(found.loop) > 1.0)
    at = phase[crossing[-1] if len(crossing) else 0]
    return np.asarray(phase - 360.0 * np.ceil(at / 360.0))


def _phase_margin(found: Response) -> float:
    """The least angle (deg) between L and -1 where |L| is 1, between the frequencies drawn; infinite without any."""
    gain, angle = _decibels(found.loop), np.unwrap(np.angle(found.loop))
    before = np.flatnonzero(np.diff(np.sign(gain)) != 0)
    share = gain[before] / (gain[before] - gain[before + 1])
    at = angle[before] + share * (angle[before + 1] - angle[before])
    return float(np.min(np.degrees(np.abs(np.angle(-np.exp(1j * at)))), initial=np.inf))
