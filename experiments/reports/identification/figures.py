"""The figures of `diffdrive identify`: friction curves, what is missing, parameters, innovations."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
import scipy.stats
from matplotlib.figure import Figure

from diffdrive.errors import DiffdriveError
from diffdrive.logs import Log
from diffdrive.model.friction import steady_friction
from diffdrive.model.parameters import Drive
from experiments.reports.charts.missing_force import of_identification
from experiments.reports.charts.stretches import as_lines
from experiments.reports.identification.forest import forest
from experiments.reports.report import Report
from experiments.reports.theme import (
    BLACK,
    BLUE,
    DASHES,
    ORANGE,
    PALE,
    REFERENCE,
    SKY,
    drawing,
    legend_below,
    new_figure,
    plain_logarithmic,
    say,
    shades,
)
from tuning.identification.curves import hysteresis_curves, stribeck_curves
from tuning.identification.identify import Identification
from tuning.identification.modelled_friction import gap_free_pieces, modelled_hysteresis
from tuning.identification.uncertainty import autocorrelation

LAGS = 100
MOST_POINTS = 20_000  # of a signal in a figure


def save_identification_figures(report: Report, found: Identification, before: Drive, logs: Sequence[Log]) -> None:
    """Save every figure; one whose data the logs do not hold is left out, and said so."""
    stretches = gap_free_pieces(logs)
    names = ", ".join(log.name for log in logs)
    captions = {
        "stribeck": f"Friction over speed, forwards and backwards: measured in {names}, of the drive file, identified.",
        "hysteresis": f"Friction over the way since a reversal: measured in {names}, of the drive file, identified.",
    }
    for name, make in (("stribeck", _stribeck), ("hysteresis", _hysteresis)):
        try:
            figure, notes = make(found, before, stretches)
        except DiffdriveError as problem:
            figure, notes = None, (str(problem),)
        if figure is None:
            report.say(f"{name}.png is left out: {'; '.join(notes)}")
        else:
            report.figure(name, figure, captions[name])
    chart = of_identification(found, stretches, names)
    report.figure("missing_force", _missing_force(found, stretches), chart.caption)
    report.chart("missing_force", chart)
    report.figure("parameters", forest(found.estimates), (
        f"Each parameter identified from {names} over the drive file's value, with its 95 % interval."
    ))  # fmt: skip
    report.figure("innovations", _innovations(found, stretches), (
        f"Innovations, the errors of the one-step prediction of {names}: their autocorrelation and their distribution."
    ))  # fmt: skip


@drawing
def _stribeck(found: Identification, before: Drive, stretches: Sequence[Log]) -> tuple[Figure | None, tuple[str, ...]]:
    """Friction over speed, one panel per direction: measured with error bars, drive file's and identified.

    Less the constant force, as the motor meets it: what of it is friction each drive says otherwise.
    """
    curves = stribeck_curves(stretches, found.drive)
    if not curves.curves:
        return None, curves.notes
    figure, axes = new_figure(1, 2, height=3.6, share_x=False)
    apart: list[float] = []  # N, of the identified model from what was measured
    for axis, side, title in ((axes[0], 1.0, "forwards"), (axes[1], -1.0, "backwards")):
        for curve, shade in zip(curves.curves, shades(len(curves.curves)), strict=True):
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
            # a wide line below a dotted one: where they agree both are seen
            for drive, name, look in (
                (found.drive, "identified", {"lw": 3.0, "alpha": 0.4}),
                (before, "drive file", {"ls": DASHES[2]}),
            ):
                model = _steady(drive, side * along, curve.load)
                axis.plot(1e3 * along, side * model, color=shade, label=f"{name}{under}", **look)
            apart += list(friction - side * _steady(found.drive, side * speed, curve.load))
        axis.set(xscale="log", xlabel="speed, mm/s", ylabel="friction less constant force, N", title=title)
        plain_logarithmic(axis.xaxis)
    legend_below(figure)
    rms = float(np.sqrt(np.mean(np.square(apart))))
    say(figure, f"The identified friction is {rms:.3g} N RMS from the measured (means over passes, 95 % intervals)")
    return figure, curves.notes


def _steady(drive: Drive, velocity: np.ndarray, load: float) -> np.ndarray:
    """The force (N) that a steady motion takes."""
    at = jnp.asarray(velocity)
    friction = steady_friction(drive.friction, at, load) + drive.plant.damping.towards(at) * at
    return np.asarray(friction) - _pull(drive)


def _pull(drive: Drive) -> float:
    return float(drive.plant.constant_force)


@drawing
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
    figure, axes = new_figure(-(-len(loads) // 2), min(2, len(loads)), height=3.4, share_x=False, squeeze=False)
    for axis in axes.flat[len(loads) :]:
        axis.remove()
    pull, apart = _pull(found.drive), {"drive file": 0.0, "identified": 0.0}
    for axis, load in zip(axes.flat, loads, strict=False):
        for curve, *modelled in zip(measured.curves, *(model.curves for model in models), strict=True):
            if curve.load != load:
                continue
            shade, name = (SKY, "forwards") if curve.direction > 0 else (ORANGE, "backwards")
            way = 1e6 * curve.displacement
            axis.fill_between(way, curve.lower - pull, curve.upper - pull, color=shade, alpha=0.3, lw=0)
            axis.plot(way, curve.median - pull, color=shade, lw=3.0, label=f"measured {name}")
            for model, dashes, named in zip(modelled, (DASHES[2], "-"), apart, strict=True):
                axis.plot(way, model.median - pull, ls=dashes, color=BLACK, label=named)
                apart[named] = max(apart[named], float(np.max(np.abs(model.median - curve.median))))
        # the first point but one is at a ten-thousandth of the reach
        linear, reach = 1e6 * measured.curves[0].displacement[-1] * np.array([1e-3, 1.0])
        axis.set_xscale("symlog", linthresh=linear)
        decades = 10.0 ** np.arange(np.ceil(np.log10(linear)), np.log10(reach) + 1e-9)
        axis.set_xticks([0.0, *decades], ["0", *(f"{decade:g}" for decade in decades)])
        axis.set(xlabel="way since the reversal, µm", ylabel="friction less constant force, N", xlim=(0, None))
        counts = {curve.direction: curve.reversals for curve in measured.curves if curve.load == load}
        axis.set_title(f"{1e-3 * load:.3g} kN: median and quartiles over {sum(counts.values())} reversals")
    legend_below(figure)
    say(figure, f"After a reversal the identified friction is within {apart['identified']:.3g} N of the measured, the "
                f"drive file's within {apart['drive file']:.3g} N")  # fmt: skip
    return figure, measured.notes


@drawing
def _missing_force(found: Identification, stretches: Sequence[Log]) -> Figure:
    """Over time, the stretches one after another, beside the position; and over the position, by direction."""
    figure, axes = new_figure(3, 1, height=2.0, share_x=False)
    axes[1].sharex(axes[0])
    begin, largest, squares = 0.0, 0.0, []
    span = sum(len(one.time) / one.rate for one in stretches)
    named: set[str] = set()
    for k, (one, missing, velocity) in enumerate(zip(stretches, found.missing_force, found.velocity, strict=True)):
        force, speed = missing[: len(one.time)], velocity[: len(one.time)]
        known = force[np.isfinite(force)]
        largest = max(largest, float(np.max(np.abs(known), initial=0.0)))
        squares.append(known**2)
        step = max(1, len(force) * len(stretches) // MOST_POINTS)
        time = begin + one.time - one.time[0]
        begin = time[-1] + 1.0 / one.rate
        axes[0].plot(time[::step], 1e3 * one.position[::step], color=BLACK, lw=0.8)
        axes[1].plot(*as_lines(time, force, span), color=BLACK, lw=0.6)
        for side, shade, mark, name in ((1, BLUE, "o", "forwards"), (-1, ORANGE, "s", "backwards")):
            at = side * speed > 0
            if at.any():
                label = None if name in named else name
                named.add(name)
                place = 1e3 * one.position[at][::step]
                axes[2].plot(place, force[at][::step], mark, ms=1.2, mew=0, color=shade, label=label)
        if k:
            for axis in axes[:2]:
                axis.axvline(time[0], ls=":", **REFERENCE)
    axes[0].set(ylabel="position, mm")
    axes[1].set(ylabel="missing force, N", xlabel="time, s")
    axes[2].set(ylabel="missing force, N", xlabel="position, mm")
    for axis in axes[1:]:
        axis.set_ylim(-1.1 * (largest or 1.0), 1.1 * (largest or 1.0))
    axes[0].tick_params(labelbottom=False)
    figure.align_ylabels()
    legend_below(figure, axes[2], markerscale=5)
    rms = float(np.sqrt(np.mean(np.concatenate(squares)))) if largest else 0.0
    say(figure, f"The identified drive misses {rms:.3g} N RMS of force, {largest:.3g} N at most")
    return figure


@drawing
def _innovations(found: Identification, stretches: Sequence[Log]) -> Figure:
    """Are they white, and how are they spread?"""
    counted = np.concatenate([row[: len(one.time)] for row, one in zip(found.innovation, stretches, strict=True)])
    lags = min(LAGS, found.innovation.shape[1] // 10)
    band = 1.96 / np.sqrt(len(counted))
    figure, (left, right) = new_figure(1, 2, height=3.0, share_x=False)
    correlation = np.asarray(autocorrelation(found.innovation, lags))
    left.axhspan(-band, band, color=PALE, lw=0, label="95 % of white noise")
    left.vlines(np.arange(1, lags + 1), 0.0, correlation, color=BLUE, lw=1.2)
    left.axhline(0.0, **REFERENCE)
    left.set(xlabel="lag, samples", ylabel="autocorrelation (no unit)", title="predictable from earlier ones?")
    spread = float(np.std(counted))
    edge = 5.0 * spread
    right.hist(1e6 * np.clip(counted, -edge, edge), bins=80, density=True, color=SKY, label="innovations")
    along = np.linspace(-edge, edge, 300)
    normal = scipy.stats.norm.pdf(along, scale=spread) * 1e-6
    right.plot(1e6 * along, normal, color=BLACK, label="normal distribution")
    right.set(xlabel="innovation, µm", ylabel="density, 1/µm", title="their distribution")
    legend_below(figure)
    outside = 100.0 * float(np.mean(np.abs(correlation) > band)) if lags else 0.0
    say(figure, f"Innovations of {1e6 * spread:.3g} µm RMS: {outside:.0f} % of the lags are correlated beyond the "
                "band, 5 % would be by chance")  # fmt: skip
    return figure
