"""`diffdrive margins`: margins of a loop, with a measured frequency response beside the model's."""

from typing import TYPE_CHECKING, cast

import numpy as np

from diffdrive.axis import Axis
from diffdrive.frequency.response import FrequencyResponse
from diffdrive.linearisation import StabilityMargins, linearise
from diffdrive.measured_loop import FrequencyComparison, compare_frequency_response, margins_as_dict
from experiments.reports.charts.responses import measured_chart
from experiments.reports.readable import shown
from experiments.reports.report import Report
from experiments.reports.theme import (
    BLACK,
    BLUE,
    DASHES,
    REFERENCE,
    VERMILION,
    drawing,
    legend_below,
    new_figure,
    plain_logarithmic,
    say,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ("loop", "gain up dB", "gain down dB", "phase deg", "peak sensitivity", "crossover Hz", "stable")

NO_LIMIT = "no limit"  # a loop that no change of its gain or phase that way makes unstable


def report_margins(
    report: Report, axis: Axis, measured: FrequencyResponse | None, *, velocity: float, load: float
) -> bool:
    """The margins of the model's loop, and of the loop with what was measured; whether all loops are stable."""
    if measured is None:
        with report.working("linearising the loop"):
            margins = linearise(axis, velocity=velocity, load=load).margins()
        report.conclude(_in_words("The model's loop", margins), good=bool(margins.stable))
        report.table("margins", COLUMNS, [_row("model", margins)], _title(velocity, load), infinite=NO_LIMIT)
        return bool(margins.stable)
    with report.working("linearising the loop"):
        comparison = compare_frequency_response(axis, measured, velocity=velocity, load=load)
    report_comparison(report, comparison, _title(velocity, load))
    return comparison.status.ok and bool(comparison.model_margins.stable)


def report_comparison(report: Report, comparison: FrequencyComparison, title: str = "Margins") -> None:
    """Margins and resonances of both loops, where they part, and the picture."""
    departure, at = comparison.largest_departure
    if not comparison.status.ok:
        report.print(comparison.status.message, style="bold")
    both = (("The loop with what was measured", comparison.margins), ("The model's loop", comparison.model_margins))
    report.conclude(*(_in_words(*one) for one in both), good=all(bool(one.stable) for _, one in both))
    rows = [_row("measured", comparison.margins), _row("model", comparison.model_margins)]
    report.table("margins", COLUMNS, rows, title, notes=list(comparison.notes), infinite=NO_LIMIT)
    peaks = [
        [name, one.frequency, one.damping, one.gain]
        for name, found in (("measured", comparison.resonances), ("model", comparison.model_resonances))
        for one in found
    ]
    if peaks:
        report.table("resonances", ("loop", "Hz", "damping", "|L|"), peaks, "Peaks of |L| above the crossover")
    report.keep("comparison", of=comparison.measured.of, largest_departure=departure, largest_departure_Hz=at)
    share = "one may be stable where the other is not" if departure >= 1.0 else "either is stable if the other is"
    report.say(
        f"The loops differ most at {at:.4g} Hz, by {departure:.2g} times the model's distance to -1; by such a "
        f"difference alone {share}."
    )
    report.record("frequency_response", (
        "Hz", "measured dB", "measured deg", "model dB", "model deg", "share of the distance to -1",
    ), [list(row) for row in zip(
        comparison.frequency, *_gain_and_phase(comparison.loop), *_gain_and_phase(comparison.model_loop),
        comparison.departure, strict=True,
    )])  # fmt: skip
    chart = measured_chart(comparison)
    report.figure("frequency_response", comparison_figure(comparison), chart.caption)
    report.chart("frequency_response", chart)


@drawing
def comparison_figure(comparison: FrequencyComparison) -> "Figure":
    """Gain and phase of the open loop, measured over model, the share of the distance to -1, and the coherence."""
    coherence = comparison.measured.coherence
    figure, axes = new_figure(3 if coherence is None else 4, 1, height=1.8)
    frequency = comparison.frequency
    gain, phase, share = axes[:3]
    for label, loop, look in (
        ("model", comparison.model_loop, {"color": BLACK, "ls": DASHES[1], "lw": 1.6, "zorder": 2.5}),
        ("measured", comparison.loop, {"color": BLUE, "lw": 0.9}),
    ):
        decibels, degrees = _gain_and_phase(loop)
        gain.semilogx(frequency, decibels, label=label, **look)
        phase.semilogx(frequency, degrees, **look)
    gain.axhline(0.0, **REFERENCE)
    phase.axhline(-180.0, **REFERENCE)
    gain.set(ylabel="gain of L, dB")
    phase.set(ylabel="phase of L, deg")
    share.loglog(frequency, comparison.departure, color=VERMILION, lw=0.9)
    plain_logarithmic(share.yaxis)
    share.axhline(1.0, **REFERENCE)
    share.set(ylabel="departure (ratio)", title="departure: measured less model, over the model's distance to -1")
    if coherence is not None:
        within = comparison.measured.frequency <= frequency[-1]
        axes[3].semilogx(comparison.measured.frequency[within], coherence[within], color=BLACK, lw=0.9)
        axes[3].set(ylabel="coherence (ratio)", ylim=(0.0, 1.05))
    axes[-1].set(xlabel="frequency, Hz", xlim=(frequency[0], frequency[-1]))
    plain_logarithmic(axes[-1].xaxis)
    figure.align_ylabels()
    legend_below(figure, gain)
    most, at = comparison.largest_departure
    phases = ", ".join(
        f"{margins_as_dict(found)['phase_margin_deg']:.3g} deg {name}"
        for name, found in (("measured", comparison.margins), ("of the model", comparison.model_margins))
    )
    say(figure, f"Phase margin {phases}; the loops part most at {at:.4g} Hz, by {most:.2g} of the distance to -1")
    return figure


def _gain_and_phase(loop: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """In dB, and in degrees between -270 and 90, so that the line does not jump where it passes -180 or 0."""
    degrees = np.degrees(np.angle(loop))
    return 20.0 * np.log10(np.abs(loop)), np.where(degrees > 90.0, degrees - 360.0, degrees)


def _row(name: str, margins: StabilityMargins) -> list[object]:
    found = margins_as_dict(margins)
    return [
        name, found["gain_margin_up_dB"], found["gain_margin_down_dB"], found["phase_margin_deg"],
        found["peak_sensitivity"], found["crossover_Hz"], "yes" if found["stable"] else "NO",
    ]  # fmt: skip


def _in_words(name: str, margins: StabilityMargins) -> str:
    if not bool(margins.stable):
        return f"{name} is NOT STABLE."
    found = margins_as_dict(margins)
    up, down, phase = (
        cast(float, found[key]) for key in ("gain_margin_up_dB", "gain_margin_down_dB", "phase_margin_deg")
    )
    texts = [
        "no limit " + way if np.isinf(gain) else f"{shown(gain)} dB {way}" for gain, way in ((up, "up"), (down, "down"))
    ]
    texts.append("no limit of phase" if np.isinf(phase) else f"{shown(phase)} degrees of phase")
    return f"{name} is stable; its margins: {', '.join(texts)}."


def _title(velocity: float, load: float) -> str:
    return f"Margins at {1e3 * velocity:g} mm/s under {1e-3 * load:g} kN"
