"""What every figure holds: labels with units, legends that cover nothing, a finding with numbers, readable print."""

import ast
import dataclasses
import itertools
import re
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import Collection
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from diffdrive.loop.linearise import OperatingPoint
from diffdrive.results import Status
from experiments.reports import theme
from experiments.reports.comparison import changes_figure
from experiments.reports.loop_figures import nyquist
from experiments.reports.simulation import run_figure
from tests.support.figure_examples import EXAMPLES, changes, loops, run_of
from tuning.comparison.changes import Interval

PACKAGE = Path(theme.__file__).parents[2]
UNITS = r"(µm|mm|mm/s|s|ns|N|kN|N/m|N/µm|dB|deg|Hz|%|1/µm|samples|kg)"
LABEL = re.compile(rf".*(, {UNITS}|\((no unit|ratio|count|0 to 1)\))$")
NUMBER = re.compile(r"\d")
LEAST = 8.0  # pt, of print at arm's length
GREY_STEP = 0.1  # of lightness, that a print in grey keeps apart


def name_of(function):
    return f"{function.__module__}.{function.__qualname__}"


FIGURES = {name_of(function): example for function, example in EXAMPLES.items()}


@pytest.fixture(scope="module", params=FIGURES, ids=lambda name: name.removeprefix("experiments."))
def figure(request):
    drawn = FIGURES[request.param]()
    with theme.theme():
        FigureCanvasAgg(drawn).draw()
    return drawn


def drawing_functions():
    """Every function of the package that makes a figure, by module and name."""
    found = set()
    for path in (PACKAGE / "experiments").rglob("*.py"):
        module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef):
                calls = (one.func for one in ast.walk(function) if isinstance(one, ast.Call))
                if any(isinstance(one, ast.Name) and one.id == "new_figure" for one in calls):
                    found.add(f"{module}.{function.name}")
    return found


def test_every_figure_is_looked_at_here():
    """A function that draws is under `@drawing`, and has its example in tests/support/figure_examples.py."""
    assert drawing_functions() == set(theme.DRAWINGS) == set(FIGURES)


def test_every_figure_of_the_package_has_a_caption():
    calls = [
        (path, call)
        for path in (PACKAGE / "experiments").rglob("*.py")
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(call, ast.Call) and ast.unparse(call.func) in ("report.figure", "writer.figure")
    ]
    assert len(calls) > 20
    assert [f"{path.name}:{call.lineno}" for path, call in calls if len(call.args) < 3] == []


def test_every_axis_says_what_it_is_and_in_which_unit(figure):
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            ticks = [one.get_text() for one in axis.get_ticklabels() if one.get_visible() and one.get_text()]
            shown = axis.get_tick_params().get("labelbottom" if axis is axes.xaxis else "labelleft", True)
            if not shown or not ticks or any(re.match(r"[a-zA-Z+]", one) for one in ticks):
                continue  # those of another panel, or names
            assert LABEL.match(axis.get_label_text()), (axis.get_label_text(), ticks)


def legends(figure):
    return [*figure.legends, *(axes.get_legend() for axes in figure.axes if axes.get_legend() is not None)]


def covered(artist, box, axes, renderer):
    """Whether what is drawn of an artist reaches into a box."""
    if isinstance(artist, Line2D):
        path = artist.get_transform().transform_path(artist.get_path())
        vertices = path.vertices[np.isfinite(path.vertices).all(axis=1)]
        hit = len(vertices) > 0 and path.cleaned(remove_nans=True).intersects_bbox(box, filled=False)
    else:
        window = artist.get_window_extent(renderer)
        hit = window.overlaps(box)
    if artist.get_clip_on() and not axes.bbox.overlaps(box):
        return False  # it is cut off before
    return hit


def test_no_legend_covers_what_is_drawn(figure):
    renderer = FigureCanvasAgg(figure).get_renderer()
    for legend in legends(figure):
        box = legend.get_window_extent(renderer)
        for axes in figure.axes:
            drawn = [*axes.lines, *axes.patches, *axes.collections, *axes.texts]
            over = [one for one in drawn if one.get_visible() and covered(one, box, axes, renderer)]
            assert not over, (axes.get_title(loc="left"), over)


def test_the_title_is_a_finding_with_numbers(figure):
    assert NUMBER.search(figure.get_suptitle())
    assert "nan" not in figure.get_suptitle()


def look_of(artist):
    """What tells it from others beside its colour, and its lightness."""
    if isinstance(artist, Line2D):
        has_line = artist.get_linestyle() not in ("None", "")
        dashes = artist._unscaled_dash_pattern[1] if has_line else "none"
        width = round(artist.get_linewidth(), 1) if has_line else 0
        return (str(dashes), str(artist.get_marker()), width), artist.get_color()
    if isinstance(artist, Collection):
        filled = len(artist.get_facecolor()) > 0  # else error bars
        return ("filled" if filled else "bars",), (artist.get_facecolor() if filled else artist.get_edgecolor())[0]
    return ("patch", artist.get_hatch()), artist.get_facecolor()


def lightness(colour):
    return float(np.dot(to_rgb(colour), (0.299, 0.587, 0.114)))


def test_each_entry_of_a_legend_is_told_from_the_others_in_grey_too(figure):
    for legend in legends(figure):
        texts = [one.get_text() for one in legend.get_texts()]
        assert len(set(texts)) == len(texts)
        looks = [look_of(one) for one in legend.legend_handles]
        for ((one, colour), name), ((two, other), another) in itertools.combinations(zip(looks, texts, strict=True), 2):
            assert one != two or abs(lightness(colour) - lightness(other)) >= GREY_STEP, (name, another)


def curves(axes):
    """The lines that are data, and within sight."""
    return [
        one for one in axes.lines
        if one.get_gid() != "reference" and len(one.get_xdata()) and Bbox(axes.bbox).overlaps(one.get_window_extent())
    ]  # fmt: skip


def test_a_legend_has_an_entry_for_each_look_that_is_drawn(figure):
    """As many entries as curves that can be told apart: of a panel with more than one look every one is named."""
    named = {(look, to_rgb(colour)) for one in legends(figure) for look, colour in map(look_of, one.legend_handles)}
    entries = sum(len(one.get_texts()) for one in legends(figure))
    assert len(named) == entries
    for axes in figure.axes:
        looks = {(look, to_rgb(colour)) for look, colour in map(look_of, curves(axes))}
        colours = {colour for _, colour in looks}
        assert len(colours) < 2 or colours <= {colour for _, colour in named}


def test_no_labelled_curve_lies_hidden_under_another(figure):
    for axes in figure.axes:
        labelled = [
            one for one in curves(axes) if not one.get_label().startswith("_") and one.get_linestyle() != "None"
        ]
        for one, two in itertools.combinations(labelled, 2):
            (here, there) = (line.get_transform().transform(line.get_xydata()) for line in (one, two))
            if here.shape != there.shape or max(one.get_linewidth(), two.get_linewidth()) >= 2 * min(
                one.get_linewidth(), two.get_linewidth()
            ):
                continue
            inside = np.isfinite(here).all(axis=1) & np.isfinite(there).all(axis=1)
            inside &= (here >= axes.bbox.min).all(axis=1) & (here <= axes.bbox.max).all(axis=1)
            apart = np.hypot(*(here - there)[inside].T)
            assert not apart.size or apart.max() > 1.0, (one.get_label(), two.get_label())


def test_all_print_is_readable_and_on_the_page(figure):
    renderer = FigureCanvasAgg(figure).get_renderer()
    page = Bbox.from_extents(-1.0, -1.0, figure.bbox.width + 1.0, figure.bbox.height + 1.0)
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip():
            assert text.get_fontsize() >= LEAST, text
    titles = [figure._suptitle, *(axes._left_title for axes in figure.axes)]
    titles += [axis.label for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]
    titles = [one for one in titles if one.get_visible() and one.get_text()]
    boxes = [(one.get_text(), one.get_window_extent(renderer)) for one in titles]
    for text, box in boxes:
        assert box.x0 >= page.x0, text
        assert box.y0 >= page.y0, text
        assert box.x1 <= page.x1, text
        assert box.y1 <= page.y1, text
    for (one, box), (two, other) in itertools.combinations(boxes, 2):
        assert not box.overlaps(other), (one, two)


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_the_same_figure_is_the_same_file_and_leaves_no_setting_behind(tmp_path, ending):
    before = dict(mpl.rcParams)
    files = [tmp_path / f"{k}.{ending}" for k in range(2)]
    for file in files:
        theme.save(run_figure(run_of()), str(file), ending)
    assert files[0].read_bytes() == files[1].read_bytes()
    assert dict(mpl.rcParams) == before


def test_a_run_that_failed_says_so():
    failed = dataclasses.replace(run_of(), status=Status(False, "position diverged at 0.25 s"))
    assert run_figure(failed).get_suptitle() == "Position diverged at 0.25 s"


def test_velocities_whose_curves_cover_one_another_are_one_entry():
    both = loops()
    given = {OperatingPoint(velocity, 0.0): both["given"][OperatingPoint(0.0, 0.0)] for velocity in (0.0, 1e-3)}
    texts = [one.get_text() for one in nyquist({"given": given}).axes[0].get_legend().get_texts()]
    assert [one for one in texts if one.startswith("given")] == ["given: standstill, 1 mm/s"]


@pytest.mark.parametrize("unit", ["µm", "N", "%", "kN", "mm/s"])
def test_no_line_of_a_title_begins_with_the_unit_of_a_number(unit):
    for words in range(1, 12):
        lines = theme._wrapped("word " * words + f"0.77 {unit}, 0.201 {unit} without cogging", 200.0)
        assert not any(line.startswith(unit) for line in lines), lines


def test_ticks_of_changes_do_not_hide_each_other():
    """Friction down by ten thousand times what would have been seen, as of two logs without noise."""
    few, *others = changes()
    drawn = changes_figure([few._replace(change=Interval(-300.0, -310.0, -290.0)), *others])
    with theme.theme():
        canvas = FigureCanvasAgg(drawn)
        canvas.draw()
    [axis] = drawn.axes
    low, high = axis.get_xlim()
    boxes = [
        label.get_window_extent(canvas.get_renderer())
        for tick, label in zip(axis.get_xticks(), axis.get_xticklabels(), strict=True)
        if low <= tick <= high
    ]
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))
