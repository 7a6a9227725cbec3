"""One look for every figure, so that it stands alone: in a paper, in grey, or beside the machine.

A figure is drawn by a function under `@drawing`, which draws in this look and makes the figure known to the tests. Its
title is what was found, its axes say their units, its legends stand outside the axes. Nothing is set globally.
"""

import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import IO, TYPE_CHECKING, Any, ParamSpec, TypeVar

from experiments.reports.readable import UNITS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

Arguments = ParamSpec("Arguments")
Drawn = TypeVar("Drawn")

DRAWINGS: dict[str, Callable[..., Any]] = {}  # every function of the package that draws a figure, by module and name

WIDTH = 190.0 / 25.4  # in: two columns of a journal's page, and what an A4 page holds; printed as drawn
TITLE, TEXT, SMALL = 10.5, 9.0, 8.0  # pt; journals ask for 7 or more as printed
BETWEEN_WORDS = re.compile(rf"(?<!\d) +| +(?!(?:{'|'.join(map(re.escape, {*UNITS.values(), 'deg'}))})(?![\w/]))")
RESOLUTION = 150  # dpi of a PNG: a hundred would blur the small print, and a page of a paper takes the PDF

# Okabe and Ito 2008: eight colours that all kinds of colour vision tell apart
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
GREY, PALE = "0.45", "0.93"
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)  # of curves; yellow is lost on white
DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)), (0, (10, 2)), (0, (3, 1, 1, 1, 1, 1)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X")

REFERENCE: dict[str, Any] = {"color": GREY, "lw": 0.9, "gid": "reference"}  # a line to read against, not a curve
REGION: dict[str, Any] = {"color": VERMILION, "alpha": 0.13, "lw": 0.0}  # where nothing should be

_LOOK: Any = {  # a dictionary; Matplotlib states its keys one by one
    "font.size": TEXT, "axes.titlesize": TEXT, "axes.labelsize": TEXT, "legend.fontsize": SMALL,
    "legend.title_fontsize": SMALL, "xtick.labelsize": SMALL, "ytick.labelsize": SMALL, "figure.titlesize": TITLE,
    "figure.titleweight": "bold", "axes.titlelocation": "left", "axes.grid": True, "grid.alpha": 0.3,
    "lines.linewidth": 1.2, "axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True,
    "legend.frameon": False, "legend.handlelength": 2.8,  # a full period of the longest dashes
    "savefig.dpi": RESOLUTION, "figure.dpi": RESOLUTION,
    "pdf.fonttype": 42,  # letters stay letters, which publishers ask for
    "svg.hashsalt": "diffdrive",  # the same figure is the same file
}  # fmt: skip
UNDATED: dict[str, Mapping[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}


def theme() -> AbstractContextManager[None]:
    """The look, within a `with`."""
    import matplotlib as mpl  # a third of a second to import, and no figure is drawn without a folder to write it to
    from cycler import cycler

    return mpl.rc_context({**_LOOK, "axes.prop_cycle": cycler(color=COLOURS)})


def drawing(function: Callable[Arguments, Drawn]) -> Callable[Arguments, Drawn]:
    """Decorator of a function that draws: in the look of the package, and known to the tests of all figures."""

    @functools.wraps(function)
    def drawn(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Drawn:
        with theme():
            return function(*args, **kwargs)

    DRAWINGS[f"{function.__module__}.{function.__qualname__}"] = drawn
    return drawn


def new_figure(
    rows: int = 1,
    columns: int = 1,
    *,
    width: float = WIDTH,
    height: float = 2.6,
    share_x: bool = True,
    share_y: Any = False,
    **grid: Any,
) -> tuple["Figure", Any]:
    """A figure and its axes ([rows, columns] squeezed), drawn without a display; `height` (in) is that of a row."""
    from matplotlib.figure import Figure

    with theme():
        figure = Figure(figsize=(width, height * rows), layout="constrained")
        axes = figure.subplots(rows, columns, sharex="col" if share_x else False, sharey=share_y, **grid)
    return figure, axes


def save(figure: "Figure", file: IO[bytes] | str, ending: str = "png") -> None:
    """Write a figure as `ending` (png, svg, pdf) says; of the same figure the same file."""
    with theme():
        figure.savefig(file, format=ending, metadata=dict(UNDATED.get(ending, {})))


def style(k: int) -> dict[str, Any]:
    """Colour and dashes of the k-th curve: either distinguishes it from the others, so that a print in grey does."""
    return {"color": COLOURS[k % len(COLOURS)], "ls": DASHES[k % len(DASHES)]}


def shades(count: int) -> list[Any]:
    """Colours of ordered quantities, light to dark in grey, too: one for each."""
    import matplotlib as mpl

    return [BLUE] if count == 1 else [mpl.colormaps["cividis_r"](0.15 + 0.85 * k / (count - 1)) for k in range(count)]


def say(figure: "Figure", finding: str) -> None:
    """Have the title say what was found, in as many lines as it takes."""
    with theme():
        figure.suptitle("\n".join(_wrapped(finding, 72.0 * figure.get_figwidth())), x=0.01, ha="left")


def _wrapped(text: str, width: float) -> list[str]:
    """Lines of a title no wider than `width` (pt)."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    bold = FontProperties(weight="bold", size=TITLE)
    lines = [""]
    for word in BETWEEN_WORDS.split(text):
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and TextPath((0.0, 0.0), longer, prop=bold).get_extents().width > 0.97 * width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def legend_beside(axis: "Axes", **options: Any) -> "Legend":
    """The legend to the right of an axes, where it covers nothing."""
    with theme():
        return axis.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, **options)


def legend_below(
    figure: "Figure", *axes: "Axes", handles: Sequence[Any] | None = None, columns: int | None = None, **options: Any
) -> "Legend":
    """One legend below all axes, of what `axes` (all, if none is named) label, each label once; as wide as fits."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    found: dict[str, Any] = {}
    if handles is None:
        for axis in axes or figure.axes:
            found |= {label: handle for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
                      if label not in found}  # fmt: skip
    else:
        found = {handle.get_label(): handle for handle in handles}
    renderer = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]
    with theme():
        for count in range(columns or max(1, len(found)), 0, -1):
            legend = figure.legend(found.values(), found.keys(), loc="outside lower center", ncols=count, **options)
            if count == 1 or legend.get_window_extent(renderer).width < 0.98 * figure.bbox.width:
                break
            legend.remove()
    return legend


def plain_logarithmic(axis: "Axis") -> None:
    """Label one axis of a logarithmic plot 0.1, 1, 20 in place of powers of ten, fewer of them the more it spans."""
    from matplotlib.ticker import FuncFormatter

    def between(value: float, _: object) -> str:
        low, high = axis.get_view_interval()
        decades, digit = math.log10(high / low), round(value / 10.0 ** math.floor(math.log10(value) + 1e-9))
        shown = range(2, 10) if decades < 1.0 else (2, 5) if decades < 2.0 else ()
        return f"{value:g}" if digit in shown else ""

    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(FuncFormatter(between))
