"""Charts that one zooms into: which panels they have, and which lines."""

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.reports.charts.circle import circle_chart
from experiments.reports.charts.encoders import encoders_chart
from experiments.reports.charts.missing_force import of_comparison
from experiments.reports.charts.signals import errors_chart
from experiments.reports.charts.stretches import PIXELS, as_lines
from experiments.reports.page.plotly import figure
from tests.support.figure_examples import run_of, two_encoders
from tests.support.sound_log import SOUND


def lines_of(chart):
    figure(chart)  # it can be drawn
    return [(panel.y, [line.name for line in panel.lines]) for panel in chart.panels]


def test_the_circle_has_a_panel_for_each_sense_and_a_line_for_each_machine():
    deviations = 1e-6 * np.arange(8.0).reshape(2, 4)
    chart = circle_chart({"as it is": deviations, "sound": 0.1 * deviations})
    names = ["as it is", "sound"]
    assert lines_of(chart) == [("radius, counter-clockwise, µm", names), ("radius, clockwise, µm", names)]
    np.testing.assert_allclose(chart.panels[1].lines[0].y, [4.0, 5.0, 6.0, 7.0])
    np.testing.assert_allclose(chart.panels[0].lines[1].x, [0.0, 90.0, 180.0, 270.0])


def test_what_is_known_now_and_then_is_drawn_as_lines_that_are_seen():
    time, force = np.arange(2000) / 1000.0, np.sin(np.arange(2000.0))
    flickering = np.where(np.arange(2000) % 2, force, np.nan)  # each second sample: a blank that nobody sees
    at, line = as_lines(time, flickering, 2.0)
    np.testing.assert_array_equal(line, [*force[1::2], np.nan])
    np.testing.assert_array_equal(at, [*time[1::2], np.nan])
    lone = np.where(np.isin(np.arange(2000), (500, *range(800, 1200))), force, np.nan)
    at, line = as_lines(time, lone, 2.0)
    np.testing.assert_array_equal(line, [force[500], force[500], np.nan, *force[800:1200], np.nan])
    assert at[1] - at[0] == pytest.approx(2.0 / PIXELS)
    assert as_lines(time, np.full(2000, np.nan), 2.0)[1].tolist() == pytest.approx([np.nan], nan_ok=True)


def test_before_and_after_lie_over_each_other_by_direction():
    velocity = np.gradient(SOUND.position) * SOUND.rate
    fits = {
        name: (SimpleNamespace(missing_force=[force * np.sign(velocity)], velocity=[velocity]), [SOUND])
        for name, force in (("before", 2.0), ("after", 5.0))
    }
    chart = of_comparison(fits)
    names = ["before", "after"]
    assert lines_of(chart) == [("missing force, forwards, N", names), ("missing force, backwards, N", names)]
    forwards, backwards = chart.panels
    assert set(forwards.lines[0].y[:-1][velocity > 0]) == {2.0}
    assert np.isnan(forwards.lines[0].y[:-1][velocity <= 0]).all()
    assert set(backwards.lines[1].y[:-1][velocity < 0]) == {-5.0}
    assert len({panel.x for panel in chart.panels}) == 1  # they zoom together


def test_two_encoders_are_shown_along_the_stroke_and_over_time():
    directions = ["forwards", "backwards", "model"]
    assert lines_of(encoders_chart(two_encoders())) == [
        ("motor - table, µm", directions),
        ("reversal error, µm", ["of each reversal", "along the stroke"]),
        ("motor - table, µm", directions),
    ]


@pytest.mark.parametrize("estimate", [None, 0.9])
def test_the_load_is_shown_where_a_controller_estimates_it(estimate):
    runs = {"PD": run_of(4e-6), "PD+FC": run_of(1e-6)}
    if estimate is None:
        for run in runs.values():
            object.__setattr__(run, "load_estimate", None)
    shown = [("position, mm", ["reference"]), ("tracking error, µm", ["PD", "PD+FC"])]
    with_load = [("load, kN", ["PD", "PD+FC", "applied"])]
    assert lines_of(errors_chart("errors", runs)) == shown + (with_load if estimate else [])
