"""The random axes of the identification study: their own numerics against exact solutions, and what is written."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import diffdrive as dd
from experiments.studies import random_axes
from experiments.studies.random_axes import FAMILIES, draw, log_columns, run, write_axes


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    where = tmp_path_factory.mktemp("axes")
    write_axes(where, len(FAMILIES), seed=3, seconds=1.5)
    return where


@pytest.mark.long
def test_every_family_is_written_with_its_truth_and_read_as_any_log_is(folder):
    key = json.loads((folder / "key.json").read_text())
    assert [one["family"] for one in key.values()] == list(FAMILIES)
    for name, one in key.items():
        axis = dd.read_axis(folder / name / "rough.toml")
        log = dd.read_log(folder / name / "healthy-1.parquet", axis)
        assert log.rate == pytest.approx(one["trace_rate"])
        assert (log.motor_position is not None) == (one["family"] == "gantry")
        assert abs(float(axis.drive.plant.mass) / one["healthy"]["mass"] - 1.0) <= random_axes.OFF


def test_the_same_seed_draws_the_same_axis(folder, tmp_path):
    write_axes(tmp_path, 1, seed=3, seconds=1.5)
    for file in ("rough.toml", "healthy-2.parquet"):
        assert (tmp_path / "000" / file).read_bytes() == (folder / "000" / file).read_bytes()


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_sliding_takes_the_force_of_the_stribeck_curve(way):
    """At a constant speed the command is Coulomb friction, what is left of breakaway, and viscous friction."""
    axis = draw("cnc", np.random.default_rng(5))
    friction, period, count = axis.machine.friction, 1.0 / axis.rate, 6_000
    machine = axis.machine._replace(resolution=1e-12, noise=0.0)
    speed = 0.01 * way
    reference = jnp.asarray(speed * period * np.arange(count))
    command = run(machine, reference, jnp.full(count, speed), jnp.zeros((count, 2)), period, 16, 1)[1]
    side = 0 if way > 0 else 1
    left = float(friction.gap[side]) * np.exp(-((abs(speed) / float(friction.stribeck[side])) ** friction.exponent))
    expected = way * (float(friction.coulomb[side]) + left + float(friction.viscous[side]) * abs(speed))
    assert float(command[-1]) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("family", FAMILIES)
def test_steps_of_half_the_length_change_nothing_that_is_seen(family, monkeypatch):
    axis = draw(family, np.random.default_rng(7))
    fine = axis.machine._replace(resolution=1e-13)  # rounding would make of any change a count
    found = []
    for least in (random_axes.LEAST_STEPS, 2 * random_axes.LEAST_STEPS):
        bent = random_axes.BENT * random_axes.LEAST_STEPS / least
        monkeypatch.setattr(random_axes, "BENT", bent)
        monkeypatch.setattr(random_axes, "LEAST_STEPS", least)
        found.append(log_columns(axis._replace(machine=fine), 1.0, np.random.default_rng(1)))
    change = np.abs(found[1]["position"] - found[0]["position"])
    assert np.max(change) < 0.05 * float(axis.machine.resolution)
