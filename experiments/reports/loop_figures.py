"""Nyquist and Bode diagrams of a loop at its operating points, beside the margins required of it.

Each function takes its panels by title, each a mapping from a label to a response: {"before": {...}, "after": {...}}
draws the two side by side. The gain of the loop is |L| throughout, its phase that of L under negative feedback.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from diffdrive.controllers import Controller
from diffdrive.loop.linearise import OperatingPoint, Response, open_loop, response
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import as_arrays
from experiments.reports.report import new_figure, plain_logarithmic
from tuning.gains.requirements import LoopLimits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Panels = Mapping[str, Mapping[str, Response]]
LOWEST = 0.5  # Hz
POINTS = 1500
LIMIT: dict[str, Any] = {"color": "0.35", "lw": 0.9}
REGION: dict[str, Any] = {"color": "C3", "alpha": 0.12, "lw": 0}


def responses(
    drive: Drive, controller: Controller, sampling: Sampling, points: Sequence[OperatingPoint]
) -> dict[str, Response]:
    """The loop's response at each operating point, labelled by its velocity and load."""
    drive, controller = as_arrays(smooth((drive, controller)))
    frequency = np.geomspace(LOWEST, 0.4999 * sampling.rate, POINTS)

    @jax.jit
    @jax.vmap
    def found(at: OperatingPoint) -> Response:
        return response(open_loop(drive, controller, sampling, at), frequency)

    together = found(jax.tree.map(lambda *values: np.array(values, float), *points))
    split = [jax.tree.map(lambda leaf, k=k: np.asarray(leaf[k]), together) for k in range(len(points))]
    return {_label(at): one for at, one in zip(points, split, strict=True)}


def _label(at: OperatingPoint) -> str:
    motion = "standstill" if at.velocity == 0 else f"{1e3 * at.velocity:g} mm/s"
    return f"{motion}, {1e-3 * at.load:g} kN"


def nyquist(panels: Panels, limits: LoopLimits = LoopLimits(sensitivity=2.0)) -> "Figure":
    """L in the complex plane near -1, the margins that `limits` asks for marked."""
    figure, axes = new_figure(1, len(panels), width=5.0 * len(panels), height=4.8, share_x=False)
    for axis, (title, labelled) in zip(np.atleast_1d(axes), panels.items(), strict=True):
        _required(axis, limits)
        for label, found in labelled.items():
            axis.plot(found.loop.real, found.loop.imag, lw=1.2, label=label)
        axis.set(xlim=(-3.0, 1.0), ylim=(-2.0, 2.0), aspect="equal", xlabel="Re L", ylabel="Im L", title=title)
        axis.legend(fontsize=7, loc="upper left")
    return figure


def _required(axis: "Axes", limits: LoopLimits) -> None:
    """The unit circle, the ends of the gain margins, the rays of the phase margin, the circle of Ms."""
    turn = np.linspace(0.0, 2.0 * np.pi, 400)
    axis.plot(np.cos(turn), np.sin(turn), **LIMIT)
    if limits.phase is not None:
        arc = np.linspace(-limits.phase, limits.phase, 50)
        axis.fill(np.append(0.0, -np.cos(arc)), np.append(0.0, np.sin(arc)), **REGION)
        for sign in (1.0, -1.0):
            ray = -3.0 * np.exp(1j * sign * limits.phase)
            axis.plot([0.0, ray.real], [0.0, ray.imag], ls=":", **LIMIT)
    axis.plot([-limits.gain_down, -1.0 / limits.gain_up], [0.0, 0.0], "|-", ms=9, color="C3", lw=1.5)
    axis.plot(-1.0, 0.0, "+", color="k", ms=9)
    if limits.sensitivity is not None:
        circle = -1.0 + np.exp(1j * turn) / limits.sensitivity
        axis.plot(circle.real, circle.imag, ls="--", **LIMIT)
        axis.fill(circle.real, circle.imag, **REGION)


def bode(panels: Panels, limits: LoopLimits = LoopLimits()) -> "Figure":
    """|L| and its phase over frequency, with the bands within which the other one must not cross."""
    figure, axes = new_figure(2, len(panels), width=5.0 * len(panels), height=2.6)
    axes = np.reshape(axes, (2, len(panels)))
    for (gain, phase), (title, labelled) in zip(axes.T, panels.items(), strict=True):
        for label, found in labelled.items():
            gain.loglog(found.frequency, np.abs(found.loop), lw=1.2, label=label)
            phase.semilogx(found.frequency, _phase(found), lw=1.2)
        gain.axhspan(1.0 / limits.gain_up, limits.gain_down, **REGION)
        gain.axhline(1.0, **LIMIT)
        for turned in (-180.0, 180.0):
            if limits.phase is not None:
                phase.axhspan(turned - np.degrees(limits.phase), turned + np.degrees(limits.phase), **REGION)
            phase.axhline(turned, **LIMIT)
        gain.set(ylabel="|L|", title=title, ylim=(1e-3, 1e3))
        phase.set(ylabel="phase of L, deg", xlabel="frequency, Hz", ylim=(-390, 300), yticks=range(-360, 300, 90))
        plain_logarithmic(phase.xaxis)
        gain.legend(fontsize=7)
    return figure


def _phase(found: Response) -> np.ndarray:
    """Degrees without jumps, brought to between -360 and 0 at the crossover, by which it is judged."""
    phase = np.degrees(np.unwrap(np.angle(found.loop)))
    crossing = np.flatnonzero(np.abs(found.loop) > 1.0)
    at = phase[crossing[-1] if len(crossing) else 0]
    return phase - 360.0 * np.ceil(at / 360.0)
