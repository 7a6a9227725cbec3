"""The figures of a sweep show every machine, those that diverged too."""

import numpy as np
import pyarrow as pa
import pytest

from experiments.reports.sweep import figures
from tuning.sweeps.summary import Group

TOLERANCE = 3e-6


def group(errors, controller="one"):
    """Machines with these errors (m); of infinite ones the loop diverged."""
    errors = np.asarray(errors, float)
    lost = np.isinf(errors)
    columns = {"machine": np.arange(errors.size), "peak_m": np.where(lost, np.nan, errors), "diverged": lost}
    return Group(controller, "lap", pa.table(columns | {"load": np.linspace(0.0, 1e4, errors.size)}))


SOUND = group(np.linspace(1e-7, 1e-6, 100))
PARTLY = group(np.r_[np.linspace(1e-7, 1e-6, 80), np.full(20, np.inf)], "partly")
WILD = group(np.full(100, np.inf), "wild")


def told(figure):
    """The curves with a name, by it."""
    return {line.get_label(): line for line in figure.axes[0].lines if not line.get_label().startswith("_")}


def test_machines_that_diverged_miss_every_tolerance():
    found = told(figures.exceedance_figure([SOUND, PARTLY, WILD], TOLERANCE, "peak"))
    at, misses = found["partly"].get_data()
    assert at[-1] > 1e6 * TOLERANCE
    assert misses[-1] == pytest.approx(20.0)
    assert found["one"].get_data()[1][-1] == 0.0
    assert set(found["wild, all diverged"].get_data()[1]) == {100.0}


def test_a_distribution_with_machines_that_diverged_ends_below_all_of_them():
    found = told(figures.distribution([SOUND, PARTLY, WILD], TOLERANCE, "peak"))
    assert found["one"].get_data()[1][-1] == 100.0
    at, share = found["partly"].get_data()
    assert (at[-1] > 1e6 * TOLERANCE, share[-1]) == (True, 80.0)
    assert set(found["wild, all diverged"].get_data()[1]) == {0.0}


@pytest.mark.parametrize("tolerance", [None, TOLERANCE])
def test_an_axis_that_holds_still_has_no_error_and_is_drawn(tolerance):
    still = group(np.zeros(100), "still")
    for groups in ([still], [still, SOUND]):
        misses = told(figures.exceedance_figure(groups, tolerance, "peak"))["still"].get_data()[1]
        assert set(misses) == {0.0}
        assert told(figures.distribution(groups, tolerance, "peak"))["still"].get_data()[1][-1] == 100.0
        figures.error_against(groups, "load", "N", tolerance, "peak").canvas.draw()


def test_machines_that_diverged_are_marked_and_count_in_the_slices():
    partly = group(np.r_[np.linspace(1e-7, 1e-6, 800), np.full(200, np.inf)], "partly")
    figure = figures.error_against([partly, WILD], "load", "N", TOLERANCE, "peak")
    found = told(figure)
    assert found["partly: diverged"].get_data()[0] == pytest.approx(np.linspace(0.0, 10.0, 1000)[800:])
    assert len(found["wild: diverged"].get_data()[0]) == 100
    medians = found["partly: median"].get_data()[1]
    assert np.isfinite(medians[0])
    assert np.isnan(medians[-1])  # most of those there diverged
    figure.canvas.draw()


@pytest.mark.parametrize(("machines", "bins"), [(60, 1), (150, 2), (5_000, 12)])
def test_a_bin_has_enough_machines_to_bound_its_high_quantile_and_is_as_wide_as_it_is(machines, bins):
    """Of 72 independent machines the largest is below the 95 % quantile in 2.5 % of the cases."""
    assert 0.95**figures.ENOUGH <= 0.025 < 0.95 ** (figures.ENOUGH - 1)
    found = told(figures.error_against([group(np.linspace(1e-7, 1e-6, machines))], "load", "N", None, "peak"))
    edges = found["one: median"].get_data()[0]
    assert edges == pytest.approx(np.linspace(0.0, 10.0, bins + 1), abs=10.0 * bins / machines)
    assert ("one: 95 % of them" in found) is (machines >= figures.ENOUGH)
