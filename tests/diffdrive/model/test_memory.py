"""What a controller remembers says what it is, in the unit that it has."""

from typing import Annotated, NamedTuple

import jax
import numpy as np
import pint
import pytest

from diffdrive.model.memory import Memory, memories
from tests.support.exported import VARIANTS

REGISTRY = pint.UnitRegistry()


class Inner(NamedTuple):
    low: Annotated[float, Memory("", "low-pass")]
    other: float


class Outer(NamedTuple):
    filters: Annotated[tuple, Memory("N", "a filter")]
    vector: Annotated[tuple, (Memory("m", "first"), (Memory("s", "second"),))]
    unknown: float


def test_the_innermost_statement_counts_and_a_unit_holds_within():
    state = Outer(filters=(1.0, Inner(2.0, 3.0)), vector=(4.0, (5.0,)), unknown=6.0)
    assert memories(state) == [
        Memory("N", "a filter"), Memory("N", "low-pass"), Memory("N", "a filter"),
        Memory("m", "first"), Memory("s", "second"), Memory("", ""),
    ]  # fmt: skip


def test_of_what_states_nothing_nothing_is_said():
    assert memories((1.0, {"a": 2.0})) == [Memory("", "")] * 2
    assert memories(3.0) == [Memory("", "")]


@pytest.mark.parametrize("name", VARIANTS)
def test_every_controller_says_of_each_number_what_it_is(name):
    state = VARIANTS[name].controller.init(np.float64(0.0))
    for memory, leaf in zip(memories(state), jax.tree.leaves(state), strict=True):
        assert memory.meaning
        if np.asarray(leaf).dtype == bool:
            assert memory.unit == ""
        else:
            assert REGISTRY.Quantity(1.0, memory.unit).magnitude == 1.0  # a unit that is known


@pytest.mark.parametrize("name", ["pd+fc", "pd+fc+ls"])
def test_a_covariance_has_the_unit_of_the_product(name):
    """That of row i, from the diagonal on."""
    observer = VARIANTS[name].controller.init(np.float64(0.0)).observer
    size = len(observer.covariance)
    units = [memory.unit for memory in memories(observer)]
    of_estimates = [REGISTRY.Unit(unit) for unit in (*units[:3], units[-1])][:size]
    of_covariance = iter(units[3:-1])
    for row in range(size):
        for column in range(row, size):
            assert REGISTRY.Unit(next(of_covariance)) == of_estimates[row] * of_estimates[column]


def test_a_filter_at_rest_has_the_unit_of_its_signal():
    """The state of a settled filter is its signal: what a force settles is a force, by the statement of the cascade."""
    state = VARIANTS["cascade, all parts"].controller.init(np.float64(0.0))
    said = dict(zip([jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_flatten_with_path(state)[0]],
                    memories(state), strict=True))  # fmt: skip
    assert {said[path].unit for path in said if path.startswith(".filters")} == {"N"}
    assert said[".velocity_lag"].unit == "m/s"
    assert said[".set_point.lag"].unit == "m"
