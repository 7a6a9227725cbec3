"""The declared parameters of a module, by their paths."""

import jax.numpy as jnp
import pytest

from diffdrive.effects.forces import Cogging, ConstantForce
from diffdrive.model.quantity import Directional, node_at, quantities, with_nodes
from diffdrive.paper import paper_axis
from tuning.optimisation.space import FreeParameter, search_space

DRIVE = paper_axis().with_effects(Cogging(cosine=2.0), ConstantForce(1.0)).drive


def test_every_declared_parameter_is_found_and_changed_by_its_path():
    for path, _, value in quantities(DRIVE):
        assert node_at(DRIVE, path) is value
        changed = with_nodes(DRIVE, {path: 7.0})
        assert [name for name, _, value in quantities(changed) if value == 7.0] == [path]
    assert node_at(DRIVE, "friction.viscous.negative") == 1673.5
    both = with_nodes(DRIVE, {"effects.cogging.cosine": 5.0, "friction.viscous": Directional(1.0, 2.0)})
    assert (both.effects[1].cosine, both.friction.viscous.negative) == (5.0, 2.0)
    assert with_nodes(DRIVE, {}) == DRIVE


def test_a_search_may_free_a_parameter_of_an_effect():
    space = search_space(
        DRIVE, [FreeParameter("effects.cogging.cosine", 1.0, 4.0), FreeParameter("plant.mass", 50.0, 200.0)]
    )
    there = space.insert(DRIVE, jnp.zeros(2))
    assert float(node_at(there, "effects.cogging.cosine")) == pytest.approx(2.0)
    assert float(there.plant.mass) == pytest.approx(100.0)


def test_friction_under_a_load_is_that_of_eq_6_in_each_direction():
    friction = DRIVE.friction
    level, breakaway = friction.coulomb_at(8_000.0), friction.breakaway_at(8_000.0)
    assert level == Directional(63.43 + 3.66e-4 * 23_200.0, 64.95 + 3.66e-4 * 23_200.0)
    assert (
        breakaway
        == level.map(lambda coulomb, gap: coulomb + gap, friction.breakaway_gap)
        == level + friction.breakaway_gap
    )
    assert Directional(1.0, 2.0) + 3.0 == Directional(4.0, 5.0)
