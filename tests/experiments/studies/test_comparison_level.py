"""The study of the comparison's level: a machine without a change is left alone, one with a change mostly found."""

from experiments.studies.comparison_level import measured


def test_unchanged_machines_are_left_alone_and_changes_of_the_stated_size_found():
    found = measured(pairs=60)
    assert found.below[0] <= 0.05
    assert found.below[2] <= 0.3
    assert 0.9 < found.holds < 0.99
    assert found.found > 0.8
