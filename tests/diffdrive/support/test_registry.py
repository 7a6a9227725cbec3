"""What programs add by name: one rule for effects, controllers, formats, checks and aggregations."""

import pytest

from diffdrive.errors import ParameterError
from diffdrive.support.registry import Registry


@pytest.fixture
def shapes():
    return Registry("shape", {"circle": 0, "square": 4}, pattern="[a-z]+", hint="a word in small letters")


def test_what_is_added_joins_what_there_is_in_order(shapes):
    shapes.add("triangle", 3)
    assert dict(shapes) == {"circle": 0, "square": 4, "triangle": 3}
    assert list(shapes) == ["circle", "square", "triangle"]
    assert shapes["triangle"] == 3
    assert len(shapes) == 3


def test_what_was_added_is_replaced_in_its_place_by_what_has_its_name(shapes):
    shapes.add("triangle", 3)
    shapes.add("hexagon", 6)
    shapes.add("triangle", 33)
    assert list(shapes.items())[2:] == [("triangle", 33), ("hexagon", 6)]


def test_what_was_there_is_not_replaced(shapes):
    with pytest.raises(ParameterError, match=r"shape 'square': there is one of this name; choose another"):
        shapes.add("square", 5)
    with pytest.raises(ParameterError, match=r"shape 'square': is not yours to remove"):
        shapes.remove("square")
    assert shapes["square"] == 4


def test_what_is_removed_is_gone(shapes):
    shapes.add("triangle", 3)
    shapes.remove("triangle")
    assert "triangle" not in shapes
    with pytest.raises(ParameterError, match=r"shape 'triangle': is not yours to remove"):
        shapes.remove("triangle")


@pytest.mark.parametrize("name", ["", "Circle", "a b", "a\n", None, 3, ("a",)])
def test_a_name_that_nobody_could_use_is_refused(shapes, name):
    with pytest.raises(ParameterError, match=r"shape .*: its name must be a word in small letters"):
        shapes.add(name, 1)


def test_any_printable_name_is_one_where_no_pattern_says_more():
    names = Registry("name")
    names.add("sum of squares", 1)
    for name in ("", " a", "a ", "a\tb"):
        with pytest.raises(ParameterError, match="must be printable"):
            names.add(name, 1)
