"""Machines side by side are those that one would write by hand, one by one."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive import motion
from diffdrive.controllers import PD
from diffdrive.controllers.base import paper_tracking
from diffdrive.effects.transmission import Backlash
from diffdrive.errors import ParameterError
from diffdrive.loop.costs import running_costs
from diffdrive.loop.rollout import loop_inputs
from diffdrive.model.data_sheet import DataSheet
from diffdrive.model.parameters import Sampling
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.model.quantity import Directional, node_at
from diffdrive.motion import load
from diffdrive.motion.load import Ramp
from diffdrive.numerics.arrays import as_arrays
from tuning.sweeps.machines import lane, machines
from tuning.sweeps.varied import parse_varied

DRIVE = paper_drive()
HALF = 0.25 + 0.5 * np.random.default_rng(0).random((3, 6))


def drawn(*texts, drive=DRIVE):
    varied = [parse_varied(text, drive) for text in texts]
    return varied, *machines(drive, varied, HALF[:, : len(varied)])


def test_each_quantity_meets_the_drive_files_value_as_it_says():
    varied, machine, ramp, values = drawn(
        "plant.mass=uniform:-5%..5%", "plant.constant_force=normal:-3..2 N", "friction.viscous=lognormal:10%",
        "friction.coulomb_screw.negative=normal:4 N", "effects.backlash.gap=uniform:0..10 um", "load=uniform:1..5 kN",
    )  # fmt: skip
    numbers = [one.quantile(HALF[:, k]) for k, one in enumerate(varied)]
    for k in range(3):
        one = lane(machine, k)
        plant = dataclasses.replace(DRIVE.plant, mass=100.0 * numbers[0][k], constant_force=numbers[1][k])
        friction = dataclasses.replace(
            DRIVE.friction,
            viscous=Directional(1826.5 * numbers[2][k], 1673.5 * numbers[2][k]),
            coulomb_screw=Directional(63.43, 64.95 + numbers[3][k]),
        )
        expected = dataclasses.replace(DRIVE, plant=plant, friction=friction, effects=(Backlash(gap=numbers[4][k]),))
        found, wanted = jax.tree.leaves(one), jax.tree.leaves(as_arrays(expected))
        assert np.allclose(found, wanted, rtol=1e-14, atol=0.0)
    assert np.array_equal(ramp.load, numbers[5])
    assert np.all(np.asarray(ramp.change) == 0.0)
    assert list(values) == [one.name for one in varied]
    assert values["friction.viscous"] == pytest.approx(1826.5 * numbers[2])


def test_a_machine_that_cannot_be_is_named():
    with pytest.raises(ParameterError, match=r"plant\.mass must be above 0 kg"):
        drawn("plant.mass=uniform:-60..-50 kg")


@pytest.mark.parametrize("ends", [(0.01, 0.03), (0.02, 0.02)])
def test_a_ramp_is_the_piecewise_load_of_its_four_numbers(ends):
    time = 1e-4 * np.arange(500)
    change = Ramp(*(jnp.asarray(x) for x in (2e3, -1.5e3, *ends)))
    expected = (
        load.ramp(time, start=ends[0], end=ends[1], before=2e3, to=500.0)
        if ends[0] < ends[1]
        else load.step(time, at=ends[0] + 1e-9, before=2e3, to=500.0)
    )
    assert np.allclose(jax.vmap(change.at)(jnp.asarray(time)), expected, rtol=1e-12, atol=1e-6)


def test_costs_under_a_ramp_are_those_under_its_load():
    there = motion.sine(amplitude=1e-3, frequency=5.0, duration=0.05, rate=1e4)
    models = as_arrays((DRIVE, PD(paper_tracking(DRIVE, PAPER_KP, PAPER_KD))))
    change, counts = Ramp(*map(jnp.asarray, (1e3, 5e3, 0.01, 0.03))), jnp.ones(len(there.time))
    none, applied = (
        loop_inputs(there, one)
        for one in (np.zeros(len(there.time)), load.ramp(there.time, start=0.01, end=0.03, before=1e3, to=6e3))
    )
    by_ramp = running_costs(*models, none, counts, Sampling(), ramp=change)
    assert float(by_ramp.rms) == pytest.approx(float(running_costs(*models, applied, counts, Sampling()).rms), rel=1e-9)
    assert float(by_ramp.rms) != pytest.approx(float(running_costs(*models, none, counts, Sampling()).rms), rel=0.01)


def test_a_neutral_effect_has_what_the_data_sheet_states():
    sheet = DataSheet(lead=10e-3, rated_torque=5.0)
    varied = [
        parse_varied(text, DRIVE, sheet=sheet)
        for text in ("effects.lead_error.sine=uniform:0..1 um", "friction.coulomb_screw=uniform:0.1..0.2 N*m")
    ]
    machine, _, values = machines(DRIVE, varied, HALF[:, :2], sheet)
    assert node_at(machine, "effects.lead_error.lead") == 10e-3
    force = 2.0 * np.pi / 10e-3  # N per N m
    assert values["friction.coulomb_screw"] == pytest.approx(force * (0.1 + 0.1 * HALF[:, 1]))
