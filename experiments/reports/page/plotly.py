"""A chart as a figure of plotly.js: a dict that JSON can hold, in which no name is read as markup."""

import base64
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from experiments.reports.page.chart import MOST_POINTS, Chart, Line, thinned
from experiments.reports.page.text import visible

PANEL, GAP, ABOVE, BELOW = 220, 50, 20, 64  # px: height of a panel, room for numbers between two and around all
TITLE = 26  # px more, where between two panels stands the label of x
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
SYMBOLS = ("circle", "square", "diamond", "cross", "x", "triangle-up")
FEW, LARGE, SMALL = 100, 7, 3  # points up to which each is seen as a symbol; px of such, and of those of a cloud
COLOURS = 6  # that the style of the page defines; beyond them the dashes tell lines apart
FEW_DECADES = 2.5  # up to which seven numbers fit below the width of a phone
SPAN = 1e-3  # of a step of x: how far a rounded x may be off


def figure(chart: Chart, most: int = MOST_POINTS) -> dict[str, Any]:
    """Traces and layout; colours are left open, since they follow the reader's light or dark screen.

    A trace's `meta` is the number of its colour.
    """
    gaps = [GAP + (TITLE if one.x != below.x else 0) for one, below in pairwise(chart.panels)]
    inner = PANEL * len(chart.panels) + sum(gaps)
    layout: dict[str, Any] = {
        "height": inner + ABOVE + BELOW, "margin": {"l": 64, "r": 12, "t": ABOVE, "b": BELOW},
    }  # fmt: skip
    traces: list[dict[str, Any]] = []
    axes: dict[str, str] = {}  # of x, by label: panels that share it zoom together
    numbers = _numbers(chart)
    for k, panel in enumerate(chart.panels):
        number = "" if k == 0 else str(k + 1)
        top = 1.0 - (k * PANEL + sum(gaps[:k])) / inner
        x, y = (np.concatenate([np.ravel(getattr(line, name)) for line in panel.lines]) for name in "xy")
        is_last = k + 1 == len(chart.panels) or chart.panels[k + 1].x != panel.x  # of those that share it
        layout[f"xaxis{number}"] = _axis(panel.x if is_last else "", panel.log_x, x) | {"anchor": f"y{number}"}
        if panel.x in axes:
            layout[f"xaxis{number}"]["matches"] = axes[panel.x]
        axes.setdefault(panel.x, f"x{number}")
        domain = [max(0.0, top - PANEL / inner), top]
        layout[f"yaxis{number}"] = _axis(panel.y, panel.log_y, y) | {"domain": domain, "anchor": f"x{number}"}
        traces += [_trace(line, numbers[line.name], number, most) for line in panel.lines]
    return {"data": traces, "layout": layout}


def legend(chart: Chart) -> list[dict[str, Any]]:
    """Of each panel with several lines its `label` and `entries`: name, colour, dash, and all traces of that name.

    Names that an earlier panel has are not listed again: they look the same, and are hidden together.
    """
    numbers, traces = _numbers(chart), _traces(chart)
    groups, listed = [], set()
    for panel in (panel for panel in chart.panels if len(panel.lines) > 1):
        new = [line for line in panel.lines if line.name not in listed]
        listed |= {line.name for line in new}
        entries = [
            {
                "name": line.name, "colour": numbers[line.name] % COLOURS, "dash": _dash(numbers[line.name]),
                "points": line.style == "points", "traces": traces[line.name],
            }
            for line in new
        ]  # fmt: skip
        if entries:
            groups.append({"label": panel.y.rpartition(", ")[0] or panel.y, "entries": entries})
    return groups


def _traces(chart: Chart) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for k, line in enumerate(line for panel in chart.panels for line in panel.lines):
        found.setdefault(line.name, []).append(k)
    return found


def _numbers(chart: Chart) -> dict[str, int]:
    """Each name's number, by which it looks the same in all panels, and unlike all others of its panels."""
    numbers: dict[str, int] = {}
    for panel in chart.panels:
        taken = {numbers[line.name] for line in panel.lines if line.name in numbers}
        for line in panel.lines:
            if line.name not in numbers:
                numbers[line.name] = next(k for k in range(len(taken) + 1) if k not in taken)
                taken.add(numbers[line.name])
    return numbers


def _dash(number: int) -> str:
    """Not by colour alone: 36 lines differ in colour, dash or both."""
    return DASHES[(number + number // COLOURS) % len(DASHES)]


def _axis(label: str, logarithmic: bool, values: np.ndarray) -> dict[str, Any]:
    # by itself plotly.js writes 50µ for 50e-6, whatever the unit in the label
    axis: dict[str, Any] = {"title": {"text": plain(label)}, "automargin": True, "exponentformat": "power"}
    return axis | ({"type": "log"} | _ticks(values) if logarithmic else {})


def _ticks(values: np.ndarray) -> dict[str, Any]:
    """Ticks of an axis of logarithms at 1, 2 and 5, in plain numbers; plotly.js writes 2 for 0.2, 2 and 20 alike.

    Over many decades those at 2 and 5 have no number, since they would hide each other.
    """
    at = values[np.isfinite(values) & (values > 0.0)]
    if not at.size:
        return {}
    low, high = math.floor(math.log10(np.min(at))), math.ceil(math.log10(np.max(at)))
    spread = math.log10(np.max(at) / np.min(at))
    ticks = [(digit, digit * 10.0**decade) for decade in range(low, high + 1) for digit in (1, 2, 5)]
    texts = [f"{value:g}" if digit == 1 or spread < FEW_DECADES else "" for digit, value in ticks]
    return {"tickmode": "array", "tickvals": [value for _, value in ticks], "ticktext": texts}


def _trace(line: Line, number: int, axes: str, most: int) -> dict[str, Any]:
    x, y = thinned(line, most)
    trace: dict[str, Any] = {
        "type": "scatter", "name": plain(line.name), "x": _array(x, _as_single(x)), "y": _array(y, True),
        "xaxis": f"x{axes}", "yaxis": f"y{axes}", "showlegend": False, "meta": number % COLOURS,
        "mode": "markers" if line.style == "points" else "lines", "hovertemplate": "%{x:.6~g}<br>%{y:.4~g}",
    }  # fmt: skip
    if line.style == "points":
        size = SMALL if len(y) > FEW else LARGE
        return trace | {"marker": {"size": size, "symbol": SYMBOLS[number % len(SYMBOLS)]}}
    shape = {"shape": "hv"} if line.style == "steps" else {}
    return trace | {"line": {"width": 1.4, "dash": _dash(number)} | shape}


def _as_single(x: np.ndarray) -> bool:
    """Whether single precision keeps the steps of x apart: hours of a fast signal need double."""
    steps = np.abs(np.diff(x))
    steps = steps[steps > 0.0]
    largest = np.max(np.abs(x), initial=0.0)
    return not steps.size or bool(np.finfo(np.float32).eps * largest < SPAN * np.min(steps))


def _array(values: np.ndarray, single: bool) -> dict[str, str]:
    """As plotly.js reads binary arrays: a quarter of the size of digits. A loop that runs away may need double."""
    finite = np.where(np.isfinite(values), values, np.nan)
    single = single and not bool(np.any(np.abs(finite) > np.finfo(np.float32).max))
    data = finite.astype("<f4" if single else "<f8")
    return {"dtype": "f4" if single else "f8", "bdata": base64.b64encode(data.tobytes()).decode("ascii")}


def plain(text: str) -> str:
    """A text in which plotly.js, which reads a few tags of HTML, finds none."""
    return visible(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def share(charts: Sequence[Chart], total: int) -> int:
    """How many points each line of these charts may have, so that all together have no more than `total`."""
    return min(MOST_POINTS, max(200, total // max(1, sum(chart.lines for chart in charts))))
