"""`diffdrive compare` as a user types it: two lists of logs with -- between them."""

import pytest

from tests.support.command_line import refused, run


@pytest.fixture
def asked(monkeypatch):
    """What the command would compare."""
    seen = {}

    def compare_logs(before, after, drive, out, **more):
        seen.update(before=before, after=after, drive=drive, out=out, **more)
        return True

    monkeypatch.setattr("experiments.reports.comparison.compare_logs", compare_logs)
    return seen


@pytest.mark.parametrize(
    "arguments",
    [
        ("a.csv", "b.csv", "--", "c.csv", "--drive", "d.toml", "--out", "found", "--fixed", "mass"),
        ("--drive", "d.toml", "--fixed", "mass", "--out", "found", "a.csv", "b.csv", "--", "c.csv"),
        ("a.csv", "--drive", "d.toml", "b.csv", "--out", "found", "--", "--fixed", "mass", "c.csv"),
    ],
)
def test_options_stand_on_either_side_of_the_logs(asked, arguments):
    assert run("compare", *arguments).exit_code == 0
    assert [path.name for path in asked["before"]] == ["a.csv", "b.csv"]
    assert [path.name for path in asked["after"]] == ["c.csv"]
    assert asked["drive"].name == "d.toml"
    assert asked["out"].name == "found"
    assert asked["fixed"] == ["mass"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("a.csv", "b.csv"), "compare: no -- between the logs; write the logs before, then --"),
        (("a.csv", "--", "b.csv", "--", "c.csv"), "compare: more than one -- between the logs"),
        (("a.csv", "--"), "compare: no log after the --"),
        (("--", "a.csv"), "compare: no log before the --"),
    ],
)
def test_two_lists_are_asked_for_in_one_line(arguments, says):
    assert refused("compare", *arguments, "--drive", "d.toml").startswith(says)


def test_a_doubtful_comparison_ends_with_code_3(asked, monkeypatch):
    monkeypatch.setattr("experiments.reports.comparison.compare_logs", lambda *_, **__: False)
    assert run("compare", "a.csv", "--", "b.csv", "--drive", "d.toml").exit_code == 3


def test_a_level_that_is_none_is_refused():
    said = refused("compare", "a.csv", "--", "b.csv", "--drive", "d.toml", "--level", "0.7")
    assert said.startswith("level: must be a share of false alarms")
