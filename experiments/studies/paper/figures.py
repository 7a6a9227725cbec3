"""The paper's figures, drawn from our runs, with the paper's numbers beside ours."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from diffdrive.loop.run import Run
from experiments.reports.theme import (
    BLACK,
    BLUE,
    DASHES,
    GREY,
    PALE,
    SMALL,
    VERMILION,
    drawing,
    legend_below,
    new_figure,
    say,
    shades,
    style,
)
from experiments.studies.paper import scenario as paper

Curve = tuple[np.ndarray, np.ndarray]  # position (m) and friction (N)
SLOW = 5e-3  # m/s, below which the Stribeck curve bends: five Stribeck velocities of the paper's Table 3
AT_REVERSALS = ((1.95, 2.30), (3.95, 4.30))  # s of Fig. 7: both of Table 1's windows with the reversals at 2.05, 4.05 s
OBSERVERS = ("PD+FC", "PD+FC+LE", "PD+FC+LS")
TURN = (4.94, 5.12)  # s of Fig. 10, around the reversal at 5 s
EXPERIMENT = (4.0, 6.0)  # s of Fig. 10 that are drawn: one stroke each way, when the load estimators have settled


@drawing
def figure_4(rows: np.ndarray) -> Figure:
    """Coulomb friction of screw and guide over the applied load."""
    figure, axes = new_figure(1, 2)
    loads = 1e-3 * rows[:, 0]
    for axis, column, name in ((axes[0], 1, "(a) ball screw"), (axes[1], 2, "(b) LM guide")):
        forwards, backwards = rows[:, column], rows[:, column + 2]
        if np.allclose(forwards, backwards):  # one would cover the other
            axis.plot(loads, forwards, "o-", color=BLACK, label="both directions")
        else:
            axis.plot(loads, forwards, "o-", color=BLUE, label="positive direction")
            axis.plot(loads, backwards, "s--", color=VERMILION, label="negative direction")
        axis.set(xlabel="applied load, kN", ylabel="Coulomb friction, N", title=name)
        axis.set_ylim(0, 1.25 * max(forwards.max(), backwards.max()))
    legend_below(figure)
    guide, slope = rows[:, 2], (rows[-1, 2] - rows[0, 2]) / loads[-1]
    say(figure, f"The guide's Coulomb friction grows with the load, {guide[0]:.3g} to {guide[-1]:.3g} N "
                f"({slope:.3g} N per kN; paper: 0.366), the screw's stays at {rows[0, 1]:.3g} N")  # fmt: skip
    return figure


@drawing
def figure_5(speeds: np.ndarray, stribeck: dict[float, np.ndarray], loops: dict[float, Curve]) -> Figure:
    """Stribeck and hysteresis curves of the guide under load; insets magnify the slow ends of the Stribeck curve."""
    figure, (whole, hysteresis) = new_figure(2, 1, height=3.0, share_x=False)
    forwards, backwards = _inset(whole, (0.585, 0.09, 0.40, 0.38)), _inset(whole, (0.065, 0.59, 0.40, 0.38))
    for (weight, friction), colour in zip(stribeck.items(), shades(len(stribeck)), strict=True):
        for slow, side in ((forwards, speeds > 0), (backwards, speeds < 0)):
            whole.plot(1e3 * speeds[side], friction[side], color=colour)
            shown = side & (np.abs(speeds) <= SLOW)
            slow.plot(1e3 * speeds[shown], friction[shown], color=colour)
        position, force = loops[weight]
        hysteresis.plot(1e6 * position, force, label=f"{weight / 1e3:g} kN", color=colour)
    for slow in (forwards, backwards):
        low, high = slow.get_ylim()
        left, right = slow.get_xlim()
        # the frame alone: lines to the inset would cross the curves
        whole.indicate_inset((left, low, right - left, high - low), edgecolor=GREY, alpha=1.0)
    whole.set(
        xlabel="velocity, mm/s", ylabel="guide friction, N", title="(a) Stribeck curve, magnified at the reversals"
    )
    hysteresis.set(xlabel="position, µm", ylabel="guide friction, N", title="(b) hysteresis")
    legend_below(figure, hysteresis, title="applied load")
    least, most = min(stribeck), max(stribeck)
    shift = np.abs(stribeck[most] - stribeck[least])
    ends = dict.fromkeys(f"{end:.3g}" for end in (shift.min(), shift.max()))  # one number where they agree
    say(figure, f"{1e-3 * most:g} kN of load shift the guide's friction by {' to '.join(ends)} N at every speed: "
                f"{1e3 * shift.mean() / (most - least):.3g} N per kN (paper: 0.366)")  # fmt: skip
    return figure


@drawing
def figure_7(scenario: paper.PaperScenario, runs: dict[str, Run]) -> Figure:
    """Position, load and tracking errors of all controllers; insets magnify both reversals, without PD."""
    figure, axes = new_figure(3, 1, height=2.9, height_ratios=(2, 3, 9))
    reference, load, error = axes
    looks = {name: style(k) for k, name in enumerate(runs)}
    time, shown = scenario.motion.time, (AT_REVERSALS[0][0] - 0.45, scenario.motion.time[-1])
    reference.plot(time, 1e3 * scenario.motion.position, color=BLACK)
    reference.set(ylabel="position, mm", title="(a) reference")
    load.plot(time, 1e-3 * scenario.load, color=BLACK, lw=2.0, label="applied load")
    for name in ("PD+FC+LE", "PD+FC+LS"):
        load.plot(time, 1e-3 * np.asarray(runs[name].load_estimate), lw=1.0, **looks[name])
    load.set(ylabel="load, kN", title="(b) load, applied and estimated")
    for name, run in runs.items():
        error.plot(time, 1e6 * run.error, **looks[name])
    largest = 1e6 * runs["PD"].peak_error(*shown)
    error.set(ylabel="error, µm", xlabel="time, s", title="(c) tracking error; insets: reversals; shaded: counted",
              xlim=shown, ylim=(-1.2 * largest, 1.2 * largest))  # fmt: skip
    # between the two reversals PD is at the bottom, all others at zero: above and between there is room
    for bottom, height, names in ((0.62, 0.32, set(runs) - {"PD"}), (0.185, 0.245, set(OBSERVERS))):
        for left, between, counted, what in (
            (0.27, AT_REVERSALS[0], paper.BEFORE_LOAD, "no load"),
            (0.57, AT_REVERSALS[1], paper.AFTER_LOAD, f"{1e-3 * scenario.load[-1]:g} kN"),
        ):
            inset = _inset(error, (left, bottom, 0.225, height))
            for name in runs:
                if name in names:
                    inset.plot(time, 1e6 * runs[name].error, **{**looks[name], "lw": 1.0})
            most = 1e6 * max(runs[name].peak_error(*ends) for name in names for ends in AT_REVERSALS)
            inset.axvspan(*counted, color=PALE, lw=0)
            inset.set(xlim=between, ylim=(-1.1 * most, 1.1 * most))
            inset.set_title(
                what if len(names) > len(OBSERVERS) else f"{what}, with the observer", fontsize=SMALL, pad=3
            )
    handles = [Line2D([], [], label=_table_1(name, run), **looks[name]) for name, run in runs.items()]
    handles.append(Line2D([], [], label="applied load", color=BLACK, lw=2.0))
    legend_below(figure, handles=handles, columns=2, title="tracking error at the reversal under load, peak / RMS, µm")
    ours, theirs = 1e6 * runs["PD+FC+LE"].rms_error(*paper.AFTER_LOAD), paper.TABLE_1["PD+FC+LE"][1]
    say(figure, f"At the reversal under load PD leaves {1e6 * runs['PD'].rms_error(*paper.AFTER_LOAD):.3g} µm RMS "
                f"(paper: {paper.TABLE_1['PD'][1]}), compensation with the load estimated {ours:.2g} µm "
                f"(paper: {theirs})")  # fmt: skip
    return figure


def _inset(axis: Axes, place: tuple[float, float, float, float]) -> Axes:
    """Axes within axes, at `place` (left, bottom, width, height, as shares), which hides the grid behind it."""
    inset: Axes = axis.inset_axes(place)
    inset.tick_params(pad=2, length=2)
    inset.patch.set_alpha(1.0)
    for spine in inset.spines.values():
        spine.set(visible=True, color=GREY)
    return inset


def _table_1(name: str, run: Run) -> str:
    ours = f"{1e6 * run.peak_error(*paper.AFTER_LOAD):.2f} / {1e6 * run.rms_error(*paper.AFTER_LOAD):.2f}"
    theirs = paper.TABLE_1.get(name)
    return f"{name}: {ours} (paper: {'none' if theirs is None else f'{theirs[0]} / {theirs[1]}'})"


@drawing
def figure_8(speeds: np.ndarray, stribeck: np.ndarray, loop: Curve) -> Figure:
    """Stribeck and hysteresis curves of the whole drive from the identified parameters."""
    figure, (left, right) = new_figure(1, 2, height=2.8, share_x=False)
    for side in (speeds < 0, speeds > 0):
        left.plot(1e3 * speeds[side], stribeck[side], color=BLUE)
    left.set(xlabel="velocity, mm/s", ylabel="friction, N", title="(a) Stribeck curve")
    position, force = loop
    right.plot(1e6 * position, force, color=BLUE)
    right.set(xlabel="position, µm", ylabel="friction, N", title="(b) hysteresis")
    forwards = np.where(speeds > 0, stribeck, np.inf)
    slowest, least = np.argmin(np.where(speeds > 0, speeds, np.inf)), np.argmin(forwards)
    say(figure, f"Friction falls from {stribeck[slowest]:.0f} N at break-away to {stribeck[least]:.0f} N at "
                f"{1e3 * speeds[least]:.2g} mm/s, and rises with the speed beyond")  # fmt: skip
    return figure


@drawing
def figure_9(runs: dict[str, Run]) -> Figure:
    """Friction estimated by the observer, and tracking errors, without load."""
    figure, axes = new_figure(4, 1, height=1.6)
    observed = runs["PD+FC"]
    estimate = np.asarray(observed.friction_estimate)
    axes[0].plot(observed.time, 1e3 * observed.reference, color=BLACK)
    axes[0].set(ylabel="position, mm", title="(a) reference")
    axes[1].plot(observed.time, observed.friction, color=BLACK, label="true friction")
    axes[1].plot(observed.time, estimate, color=VERMILION, ls=DASHES[1], label="estimated friction")
    axes[1].set(ylabel="friction, N", title="(b, c) friction, screw and guide together")
    for k, (name, run) in enumerate(runs.items()):
        label = f"{name}: {1e6 * run.rms_error():.2g} µm RMS"
        axes[2].plot(run.time, 1e6 * run.error, lw=1.0, label=label, **style(k + 2))
        if name != "DOBVSC":
            axes[3].plot(run.time, 1e6 * run.error, lw=1.0, **style(k + 2))
    axes[2].set(ylabel="error, µm", title="(d) tracking error")
    axes[3].set(xlabel="time, s", ylabel="error, µm", title="(d) magnified, without DOBVSC")
    figure.align_ylabels()
    legend_below(figure)
    miss = np.linalg.norm(estimate - observed.friction) / np.linalg.norm(observed.friction)
    say(
        figure,
        f"Without load the observer estimates the friction to {100 * (1 - float(miss)):.1f} % (paper: 93 % or better)",
    )
    return figure


@drawing
def figure_10(experiments: dict[float, dict[str, Run]]) -> Figure:
    """Friction, its estimation error, tracking error and load under both loads of Table 4; insets at a reversal."""
    figure, axes = new_figure(4, 2, height=2.1, share_x=False, share_y="row")
    largest = 0.0  # N, estimation error at constant speed: what is far beyond is of the reversals, and cut off
    for column, (kilonewtons, runs) in enumerate(experiments.items()):
        whole, missed, error, load = axes[:, column]
        # above the second stroke, whose friction and error are negative
        turn, error_turn = (_inset(axis, (0.645, 0.50, 0.345, 0.46)) for axis in (whole, error))
        first = next(iter(runs.values()))
        part, turning = (_between(first, ends) for ends in (EXPERIMENT, TURN))
        ripple = 1e-3 * first.load[part]
        load.axhspan(ripple.min(), ripple.max(), color=PALE, lw=0, label="range of the true load with its ripple")
        load.axhline(kilonewtons, color=BLACK, lw=1.8)
        for axis, shown in ((whole, part), (turn, turning)):
            axis.plot(first.time[shown], first.friction[shown], color=BLACK, lw=1.8, label="true")
        for k, (name, run) in enumerate(runs.items()):
            look: dict[str, Any] = {**style(k), "lw": 1.0, "label": name}
            estimate, tracking = np.asarray(run.friction_estimate), 1e6 * run.error
            largest = max(largest, paper.settled_rms(estimate - run.friction, run))
            for axis, values, shown in (
                (whole, estimate, part),
                (turn, estimate, turning),
                (missed, estimate - run.friction, part),
                (error, tracking, part),
                (error_turn, tracking, turning),
            ):
                axis.plot(run.time[shown], values[shown], **look)
            if run.load_estimate is not None:
                load.plot(run.time[part], 1e-3 * run.load_estimate[part], zorder=3 - 0.1 * k, **look)
        for axis in axes[:, column]:
            axis.set_xlim(EXPERIMENT)
            axis.tick_params(labelbottom=axis is load)
        for axis in (turn, error_turn):
            axis.set(xlim=TURN, xticks=(4.95, 5.0, 5.05, 5.1))
        turn.set_yticks((-100.0, 0.0, 100.0))
        error_turn.set_yticks((-1.0, 0.0, 1.0))
        load.set_xlabel("time, s")
        whole.set_title(f"{kilonewtons} kN, RMS at constant speed: ours (paper)")
        missed.set_title(f"{_table_4(kilonewtons, runs, 'e')} N RMS")
        error.set_title(f"{_table_4(kilonewtons, runs, 't')} µm RMS")
        load.set_title(f"{_table_4(kilonewtons, runs, 'w')} kN RMS")
    axes[1, 0].set_ylim(-3.0 * largest, 3.0 * largest)
    labels = ("friction, N", "estimate - true, N", "error, µm", "load, kN")
    for axis, label in zip(axes[:, 0], labels, strict=True):
        axis.set_ylabel(label)
    figure.align_ylabels(axes[:, 0])
    legend_below(figure, axes[0, 0], axes[3, 0])
    most = max(experiments)
    without, estimated = (
        1e6 * paper.settled_rms(experiments[most][name].error, experiments[most][name])
        for name in ("PD+FC", "PD+FC+LE")
    )
    say(figure, f"Under {most} kN the load estimator cuts the tracking error from {without:.3g} to {estimated:.3g} µm "
                f"RMS (paper: {paper.TABLE_4[most][2]} to {paper.TABLE_4[most][3]})")  # fmt: skip
    return figure


def _between(run: Run, ends: tuple[float, float]) -> np.ndarray:
    return np.asarray((run.time >= ends[0]) & (run.time <= ends[1]))


def _table_4(kilonewtons: float, runs: dict[str, Run], what: str) -> str:
    """Table 4: the RMS at constant speed of the estimation error (e), tracking error (t), load (w), and the paper's."""
    published = dict(zip(("eFC", "eLE", "tFC", "tLE", "wLE"), paper.TABLE_4[kilonewtons], strict=True))
    found = []
    for name, run in runs.items():
        if what == "w":
            signal = None if run.load_estimate is None else 1e-3 * run.load_estimate
        else:
            signal = 1e6 * run.error if what == "t" else np.asarray(run.friction_estimate) - run.friction
        if signal is not None:
            theirs = published.get(what + name[-2:])
            found.append(
                f"{name[-2:]} {paper.settled_rms(signal, run):.3g}" + ("" if theirs is None else f" ({theirs})")
            )
    return ", ".join(found)
