"""A chart to zoom into, as data: panels of lines. How it is drawn, and in which colours, is the page's affair."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

MOST_POINTS = 6000  # of a line: three for each pixel of a wide screen, so that one step of zooming still shows more


@dataclass(frozen=True)
class Line:
    """Values over x; as a line, as steps that hold their value, or as points."""

    name: str
    x: np.ndarray
    y: np.ndarray
    style: Literal["line", "steps", "points"] = "line"


@dataclass(frozen=True)
class Panel:
    """Axes with their labels, the unit behind a comma: `missing force, N`. Panels with one label of x zoom together."""

    x: str
    y: str
    lines: Sequence[Line]
    log_x: bool = False
    log_y: bool = False


@dataclass(frozen=True)
class Chart:
    """Panels, one below the other, and in words what they show: for a caption, and for who cannot see them."""

    caption: str
    panels: Sequence[Panel]

    @property
    def lines(self) -> int:
        """How many lines all panels have."""
        return sum(len(panel.lines) for panel in self.panels)


def thinned(line: Line, most: int = MOST_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """At most so many points, in their order, with every peak: of each stretch its least and its largest value."""
    x, y = np.asarray(line.x, float).ravel(), np.asarray(line.y, float).ravel()
    if len(y) <= most:
        return x, y
    size = -(-len(y) // (most // 2))  # samples of a stretch, each of which keeps two
    count = len(y) // size
    stretches = y[: count * size].reshape(count, size)
    start = size * np.arange(count)
    # where a stretch is blank throughout, argmin finds its first sample: the gap stays a gap
    low = start + np.argmin(np.where(np.isnan(stretches), np.inf, stretches), axis=1)
    high = start + np.argmax(np.where(np.isnan(stretches), -np.inf, stretches), axis=1)
    kept = np.unique(np.concatenate([low, high, [0, len(y) - 1]]))
    return x[kept], y[kept]
