"""The cascade in drive files: read in manufacturers' terms, written and read back, refused."""

import re
import tomllib
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest

import diffdrive as dd
from diffdrive import motion as motions
from diffdrive.axis_file.drive_file import axis_tables, parse_axis
from diffdrive.controllers import PT1, PT2, Cascade, Notch
from diffdrive.errors import DriveFileError, ParameterError
from diffdrive.model.parameters import Actuator, Sampling
from tests.support.cascades import FILTERS, IDEAL, ONE_EACH, RATE, WHOLE


def tables_with(**keys):
    tables = axis_tables(dd.paper_axis(controller="cascade"))
    tables["controller"] = {"kind": "cascade", "kp": 50.0, "kv": 2e4} | keys
    return tables


def test_what_is_stated_in_the_terms_of_manufacturers_is_read_in_si():
    axis = parse_axis(
        tables_with(
            kp="3 m/min/mm", reset_time="10 ms", velocity_filter_time="0.2 ms", force_limit="1.5 kN",
            filters=[{"kind": "notch", "frequency": "0.8 kHz", "width": "150 Hz", "depth": "30 dB"},
                     {"kind": "pt1", "time": "100 us"}],
        )
    )  # fmt: skip
    expected = Cascade(
        kp=50.0, kv=2e4, reset_time=0.01, velocity_filter_time=2e-4, force_limit=1_500.0,
        filters=(Notch(800.0, 150.0, 30.0), PT1(1e-4)),
    )  # fmt: skip
    assert jax.tree.structure(axis.controller) == jax.tree.structure(expected)
    np.testing.assert_allclose(jax.tree.leaves(axis.controller), jax.tree.leaves(expected), rtol=1e-12)


def test_the_example_of_the_page_on_cncs_is_read():
    page = Path(__file__).parents[3] / "docs" / "how-to" / "state-a-cnc-controller.md"
    stated = tomllib.loads(re.search(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)[1])
    axis = parse_axis(axis_tables(dd.paper_axis(controller="cascade")) | stated)
    assert axis.rate == 8_000.0
    assert axis.drive.actuator == Actuator(delay_fraction=0.5, current_loop_frequency=900.0, current_loop_damping=0.8)
    assert float(axis.controller.kp) == pytest.approx(50.0)
    assert axis.controller.filters == (Notch(640.0, 200.0, 30.0), PT2(1_999.0, 0.7))
    assert (axis.controller.position_every, axis.controller.reset_time) == (8, 0.01)


@pytest.mark.parametrize("name", [*ONE_EACH, "whole"])
def test_a_cascade_is_written_and_read_back(name):
    controller = ONE_EACH.get(name, WHOLE)
    axis = dd.Axis(IDEAL, controller.with_model(IDEAL), Sampling(RATE))
    read = parse_axis(axis_tables(axis))
    assert bool(eqx.tree_equal(read.controller, axis.controller))


@pytest.mark.parametrize("name", ["feedforward", "velocity_samples", "kp", "kv", "ki", "velocity_feedforward"])
def test_a_plain_cascade_s_table_has_no_further_keys(name):
    assert name in Cascade(50.0, 2e4).table()
    assert len(Cascade(50.0, 2e4).table()) == 6


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"ki": 1e6, "reset_time": 0.01}, r"reset_time: stands in the place of ki: give either, not both"),
        ({"reset_time": 0.0}, r"controller\.reset_time must be above 0 s"),
        ({"force_feedforward": 0.5}, r"force_feedforward: is a share of the feed-forward of inertia and damping"),
        ({"position_every": 0}, r"\[controller\] position_every: must be a whole number of at least 1, got 0"),
        ({"position_every": 2.0}, r"\[controller\] position_every: must be a whole number"),
        ({"reference_delay_samples": -1}, r"\[controller\] reference_delay_samples: must be a whole number of at"),
        ({"filters": {"kind": "pt1"}}, r"\[controller\] filters: must be an array of tables, \[\[controller"),
        ({"filters": [3]}, r"\[controller\.filters\.1\] must be a table, got 3"),
        ({"filters": [{"time": 1e-3}]}, r"\[controller\.filters\.1\] kind: is missing"),
        ({"filters": [{"kind": "lead"}]}, r"\[controller\.filters\.1\] kind: unknown filter 'lead'; known: pt1, pt2"),
        ({"filters": [{"kind": "pt1", "time": 1e-3}, {"kind": "pt1"}]}, r"\[controller\.filters\.2\] time: is missing"),
        (
            {"filters": [{"kind": "notch", "frequency": 800.0, "width": 50.0, "dept": 20.0}]},
            r"\[controller\.filters\.1\] dept: unknown key; did you mean 'depth'\?",
        ),
        (
            {"filters": [{"kind": "notch", "frequency": 6_000.0, "width": 50.0}]},
            r"controller\.filters\.1\.frequency: 6000 Hz is not below half the control rate of 10000 Hz",
        ),
        ({"filters": [{"kind": "pt2", "frequency": "1 ms"}]}, r"\[controller\.filters\.1\] frequency: '1 ms' has the"),
    ],
)  # fmt: skip
def test_what_no_cascade_can_be_is_refused(keys, says):
    with pytest.raises(DriveFileError, match=says):
        parse_axis(tables_with(**keys))


def test_a_filter_above_half_the_rate_is_refused_wherever_it_is_used():
    axis = dd.Axis(IDEAL, Cascade(50.0, 2e4, filters=(Notch(3_000.0, 100.0),)), Sampling(5_000.0))
    move = motions.sine(amplitude=1e-4, frequency=5.0, duration=0.1, rate=5_000.0)
    for use in (lambda: dd.simulate(axis, move), lambda: dd.linearise(axis, velocity=0.01)):
        with pytest.raises(ParameterError, match=r"controller\.filters\.1\.frequency: 3000 Hz is not below half"):
            use()


def test_gains_are_those_that_are_stated():
    axis = dd.Axis(IDEAL, WHOLE, Sampling(RATE))
    assert {"kp", "kv", "reset_time", "filter1_frequency", "filter1_depth", "filter3_time"} <= axis.gains.keys()
    assert "ki" not in axis.gains
    moved = axis.with_gains(filter1_frequency=650.0, reset_time=0.03).controller
    assert (moved.filters[0].frequency, moved.reset_time, moved.filters[1:]) == (650.0, 0.03, FILTERS[1:])
    assert "filter1_depth" not in dd.Axis(IDEAL, Cascade(50.0, 2e4, filters=(Notch(99.0, 9.0),)), Sampling(RATE)).gains
    with pytest.raises(ParameterError, match=re.escape("filter1_frequence: no such gain")):
        axis.with_gains(filter1_frequence=1.0)
