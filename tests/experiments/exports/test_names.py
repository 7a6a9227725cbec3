"""Names that C, Structured Text and HAL take, none twice."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffdrive.errors import ParameterError
from experiments.exports.names import OWN, RESERVED, checked_name, ends_of, identifiers, name_of
from experiments.exports.templates import comment


@pytest.mark.parametrize("text", ["controller", "Sample", "ton", "class"])
def test_the_name_of_a_file_that_some_language_refuses_is_another(text):
    assert name_of(text) == f"axis_{text.lower()}"


@given(st.text(max_size=40))
def test_any_text_gives_a_name_that_is_taken(text):
    assert checked_name(name_of(text)) == name_of(text)


@pytest.mark.parametrize("name", ["", "9axis", "a__b", "a-b", "int", "TASK", "_a", "a_", "x" * 25, "a b", "é",
                                  "class", "TON", "method", "st", "controller", "done", "template", "con",
                                  "COM1"])  # fmt: skip
def test_a_name_that_some_language_refuses_is_refused(name):
    with pytest.raises(ParameterError, match="name"):
        checked_name(name)


@given(st.lists(st.text(alphabet="aAkti.[]'_0", max_size=6), max_size=12))
def test_no_identifier_comes_twice_and_none_is_reserved(paths):
    names = identifiers(paths, taken=["force"])
    lower = [name.lower() for name in names]  # Structured Text does not tell case
    assert len(set(lower)) == len(names) == len(paths)
    assert not set(lower) & (RESERVED | OWN | {"force"})
    assert all(re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) for name in names)


def test_the_end_of_a_path_is_as_long_as_it_must_be():
    paths = ["observer.plant.mass", "feedforward.plant.mass", "observer.tuning.load", "kp"]
    assert ends_of(paths) == ["observer.plant.mass", "feedforward.plant.mass", "tuning.load", "kp"]


@given(st.text(max_size=40))
def test_no_text_ends_a_comment_or_leaves_ascii(text):
    written = comment(f"{text}*/ {text} *) {text}")
    assert not re.search(r"\*/|/\*|\*\)|\(\*", written)
    assert written.isascii()
    assert written.isprintable()


def test_a_letter_that_turns_the_direction_is_seen_and_an_accent_is_left_out():
    assert comment("a\u202eb \uff0a\uff0f") == "a?b * /"
    assert comment("Fräsmaschine") == "Frasmaschine"
