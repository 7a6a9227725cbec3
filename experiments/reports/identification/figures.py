"""The figures of `diffdrive identify`: friction curves, what is missing, parameters, innovations."""

from collections.abc import Sequence

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import scipy.stats
from matplotlib.figure import Figure

from diffdrive.errors import DiffdriveError
from diffdrive.logs import Log
from diffdrive.model.friction import steady_friction
from diffdrive.model.parameters import Drive
from experiments.reports.identification.forest import forest
from experiments.reports.report import Report, new_figure, plain_logarithmic
from tuning.identification.curves import hysteresis_curves, stribeck_curves
from tuning.identification.identify import Identification
from tuning.identification.modelled_friction import gap_free_pieces, modelled_hysteresis
from tuning.identification.uncertainty import autocorrelation

LAGS = 100
MOST_POINTS = 20_000  # of a signal in a figure


def save_identification_figures(report: Report, found: Identification, before: Drive, logs: Sequence[Log]) -> None:
    """Save every figure; one whose data the logs do not hold is left out, and said so."""
    stretches = gap_free_pieces(logs)
    for name, make in (("stribeck", _stribeck), ("hysteresis", _hysteresis)):
        try:
            figure, notes = make(found, before, stretches)
        except DiffdriveError as problem:
            figure, notes = None, (str(problem),)
        if figure is None:
            report.say(f"{name}.png is left out: {'; '.join(notes)}")
        else:
            report.figure(name, figure)
    report.figure("missing_force", _missing_force(found, stretches))
    report.figure("parameters", forest(found.estimates))
    report.figure("innovations", _innovations(found, stretches))


def _shades(count: int) -> list[str | tuple[float, float, float, float]]:
    """One colour per load."""
    return ["C0"] if count == 1 else [mpl.colormaps["viridis"](k / count) for k in range(count)]


def _stribeck(found: Identification, before: Drive, stretches: Sequence[Log]) -> tuple[Figure | None, tuple[str, ...]]:
    """Friction over speed, one panel per direction: measured with error bars, drive file's and identified.

    Less the constant force, as the motor meets it: what of it is friction each drive says otherwise.
    """
    curves = stribeck_curves(stretches, found.drive)
    if not curves.curves:
        return None, curves.notes
    figure, axes = new_figure(1, 2, width=11.0, height=4.2, share_x=False)
    for axis, side, title in ((axes[0], 1.0, "forwards"), (axes[1], -1.0, "backwards")):
        for curve, shade in zip(curves.curves, _shades(len(curves.curves)), strict=True):
            at = side * curve.velocity > 0
            if not at.any():
                continue
            speed, friction = side * curve.velocity[at], side * (curve.friction[at] - _pull(found.drive))
            error = 1.96 * np.nan_to_num(curve.standard_error[at])
            under = f", {1e-3 * curve.load:.3g} kN" if len(curves.curves) > 1 else ""
            axis.errorbar(
                1e3 * speed, friction, error, fmt="o", ms=4, capsize=2, color=shade, label=f"measured{under}", zorder=3
            )
            along = np.geomspace(0.5 * speed.min(), 1.5 * speed.max(), 200)
            for drive, style, name in ((before, ":", "drive file"), (found.drive, "-", "identified")):
                model = _steady(drive, side * along, curve.load)
                axis.plot(1e3 * along, side * model, style, color=shade, label=f"{name}{under}")
        axis.set(xscale="log", xlabel="speed, mm/s", ylabel="friction less constant force, N", title=title)
        plain_logarithmic(axis.xaxis)
        axis.legend(fontsize=8)
    figure.suptitle("Steady friction: mean and 95 % over passes, and the models", fontsize=10)
    return figure, curves.notes


def _steady(drive: Drive, velocity: np.ndarray, load: float) -> np.ndarray:
    """The force (N) that a steady motion takes."""
    at = jnp.asarray(velocity)
    friction = steady_friction(drive.friction, at, load) + drive.plant.damping.towards(at) * at
    return np.asarray(friction) - _pull(drive)


def _pull(drive: Drive) -> float:
    return float(drive.plant.constant_force)


def _hysteresis(
    found: Identification, before: Drive, stretches: Sequence[Log]
) -> tuple[Figure | None, tuple[str, ...]]:
    """Friction over the way since a reversal, as in the paper's Fig. 8: measured and, filtered alike, modelled."""
    measured = hysteresis_curves(stretches, found.drive)
    if not measured.curves:
        return None, measured.notes
    velocities = [row[: len(one.time)] for row, one in zip(found.velocity, stretches, strict=True)]
    models = [modelled_hysteresis(drive, found.drive, stretches, velocities) for drive in (before, found.drive)]
    loads = sorted({curve.load for curve in measured.curves})
    figure, axes = new_figure(1, len(loads), width=max(7.0, 5.0 * len(loads)), height=4.2, share_x=False)
    for axis, load in zip(np.atleast_1d(axes), loads, strict=True):
        for curve, *modelled in zip(measured.curves, *(model.curves for model in models), strict=True):
            if curve.load != load:
                continue
            shade, name = ("C0", "forwards") if curve.direction > 0 else ("C1", "backwards")
            way, pull = 1e6 * curve.displacement, _pull(found.drive)
            axis.fill_between(way, curve.lower - pull, curve.upper - pull, color=shade, alpha=0.25, lw=0)
            axis.plot(
                way,
                curve.median - pull,
                color=shade,
                lw=2.5,
                alpha=0.6,
                label=f"measured {name}, {curve.reversals} reversal{'s' * (curve.reversals > 1)}",
            )
            for model, style, named in zip(modelled, (":", "-"), ("drive file", "identified"), strict=True):
                axis.plot(
                    way, model.median - pull, style, color="k", lw=1.0, label=named if curve.direction > 0 else None
                )
        # the first point but one is at a ten-thousandth of the reach
        linear, reach = 1e6 * measured.curves[0].displacement[-1] * np.array([1e-3, 1.0])
        axis.set_xscale("symlog", linthresh=linear)
        decades = 10.0 ** np.arange(np.ceil(np.log10(linear)), np.log10(reach) + 1e-9)
        axis.set_xticks([0.0, *decades], ["0", *(f"{decade:g}" for decade in decades)])
        axis.set(xlabel="way since the reversal, µm", ylabel="friction less constant force, N", xlim=(0, None))
        under = f", {1e-3 * load:.3g} kN" if len(loads) > 1 else ""
        axis.set_title(f"after a reversal{under}: median and quartiles over reversals", fontsize=10)
        axis.legend(fontsize=8)
    return figure, measured.notes


def _missing_force(found: Identification, stretches: Sequence[Log]) -> Figure:
    """Over time, the stretches one after another, beside the position; and over the position, by direction."""
    figure, axes = new_figure(3, 1, width=10.0, height=2.4, share_x=False)
    axes[1].sharex(axes[0])
    begin, largest = 0.0, 0.0
    for k, (one, missing, velocity) in enumerate(zip(stretches, found.missing_force, found.velocity, strict=True)):
        force, speed = missing[: len(one.time)], velocity[: len(one.time)]
        largest = max(largest, float(np.max(np.abs(force[np.isfinite(force)]), initial=0.0)))
        step = max(1, len(force) * len(stretches) // MOST_POINTS)
        time = begin + one.time - one.time[0]
        begin = time[-1] + 1.0 / one.rate
        axes[0].plot(time[::step], 1e3 * one.position[::step], "C0", lw=0.8)
        axes[1].plot(time[::step], force[::step], "C3", lw=0.6)
        for side, shade, name in ((1, "C0", "forwards"), (-1, "C1", "backwards")):
            at = side * speed > 0
            label = name if k == 0 else None
            axes[2].plot(1e3 * one.position[at][::step], force[at][::step], ".", ms=1.5, color=shade, label=label)
        if k:
            for axis in axes[:2]:
                axis.axvline(time[0], color="k", lw=0.8, ls=":")
    axes[0].set(ylabel="position, mm", title="Missing force")
    axes[1].set(ylabel="missing force, N", xlabel="time, s")
    axes[2].set(ylabel="missing force, N", xlabel="position, mm")
    for axis in axes[1:]:
        axis.set_ylim(-1.1 * (largest or 1.0), 1.1 * (largest or 1.0))
    axes[0].tick_params(labelbottom=False)
    axes[2].legend(fontsize=8, markerscale=6, loc="upper right")
    return figure


def _innovations(found: Identification, stretches: Sequence[Log]) -> Figure:
    """Are they white, and how are they spread?"""
    counted = np.concatenate([row[: len(one.time)] for row, one in zip(found.innovation, stretches, strict=True)])
    lags = min(LAGS, found.innovation.shape[1] // 10)
    band = 1.96 / np.sqrt(len(counted))
    figure, (left, right) = new_figure(1, 2, width=11.0, height=3.6, share_x=False)
    left.axhspan(-band, band, color="C2", alpha=0.3, lw=0, label="95 % of white noise")
    left.vlines(np.arange(1, lags + 1), 0.0, autocorrelation(found.innovation, lags), color="C0", lw=1.2)
    left.axhline(0.0, color="k", lw=0.6)
    left.set(xlabel="lag, samples", ylabel="autocorrelation", title="innovations: how predictable from earlier ones")
    left.legend(fontsize=8)
    spread = float(np.std(counted))
    edge = 5.0 * spread
    right.hist(1e6 * np.clip(counted, -edge, edge), bins=80, density=True, color="C0", alpha=0.6)
    along = np.linspace(-edge, edge, 300)
    normal = scipy.stats.norm.pdf(along, scale=spread) * 1e-6
    right.plot(1e6 * along, normal, "k", lw=1.0, label=f"normal, {1e6 * spread:.3g} µm")
    right.set(xlabel="innovation, µm", ylabel="density, 1/µm", title="their distribution")
    right.legend(fontsize=8)
    return figure
