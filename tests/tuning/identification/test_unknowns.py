"""The unknowns of a search, and the drive that they stand for."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffdrive.model.parameters import Actuator, check_drive
from diffdrive.model.quantity import Directional, quantities
from experiments.studies.recovery.random_drive import random_drive
from tests.support.known_machine import BELIEVED
from tuning.identification.unknowns import unknowns_of

drives = st.builds(lambda seed: random_drive(np.random.default_rng(seed)), st.integers(0, 10_000))


@settings(max_examples=12)
@given(
    drives, st.tuples(st.floats(-0.9, 2.0), st.floats(-0.9, 2.0)), st.tuples(st.floats(0.0, 3.0), st.floats(0.0, 3.0))
)
def test_unknowns_are_another_way_to_say_a_drive(drive, gaps, dampings):
    """Also where friction rises from standstill, and whatever share of the viscous friction is called damping."""
    level = unknowns_of(drive, 0.0).coulomb
    drive = eqx.tree_at(
        lambda d: (d.friction.breakaway_gap, d.plant.damping),
        drive,
        (
            Directional(gaps[0] * level.positive, gaps[1] * level.negative),
            Directional(500.0 * dampings[0], 500.0 * dampings[1]),
        ),
    )
    again = unknowns_of(drive, 0.7).drive(drive)
    for (name, _, ours), (_, _, theirs) in zip(quantities(again), quantities(drive), strict=True):
        if ours is None:
            assert theirs is None
        elif isinstance(ours, Directional):
            for side in ("positive", "negative"):
                expected = float(getattr(theirs, side))
                assert float(getattr(ours, side)) == pytest.approx(expected, rel=1e-9, abs=1e-9), name
        else:
            assert float(ours) == pytest.approx(float(theirs), rel=1e-12), name
    check_drive(eqx.tree_at(lambda d: d.actuator, again, Actuator()))


def test_less_viscous_friction_than_the_file_has_damping_takes_it_from_the_damping():
    unknowns = replace(unknowns_of(BELIEVED, 0.0), viscous=Directional(100.0, 3000.0))
    drive = unknowns.drive(BELIEVED)
    assert (drive.plant.damping.positive, drive.friction.viscous.positive) == (100.0, 0.0)
    assert (drive.plant.damping.negative, drive.friction.viscous.negative) == (260.0, 2740.0)


def test_a_held_gap_stays_in_newtons_and_a_free_one_in_proportion_when_the_coulomb_friction_changes():
    unknowns = unknowns_of(BELIEVED, 0.0)
    doubled = replace(
        unknowns, coulomb=Directional(*(2 * x for x in (unknowns.coulomb.positive, unknowns.coulomb.negative)))
    )
    free, held = doubled.drive(BELIEVED), replace(doubled, breakaway=None).drive(BELIEVED)
    assert held.friction.breakaway_gap.positive == 30.0
    assert held.friction.breakaway_gap.negative == 22.98
    assert free.friction.breakaway_gap.positive == pytest.approx(60.0)
    assert free.friction.breakaway_gap.negative == pytest.approx(45.96)
