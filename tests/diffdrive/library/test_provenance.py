"""[provenance] of a drive file: texts of one line by known keys, about that file alone."""

import pytest

from diffdrive.axis_file.drive_file import axis_tables, parse_axis
from diffdrive.errors import DriveFileError
from diffdrive.library.provenance import MEANINGS, Provenance
from diffdrive.paper import paper_axis

TABLES = axis_tables(paper_axis())
WHOLE = {"title": "a table", "source": "a data sheet", "measured": "its mass, weighed", "assumed": "its friction"}


def test_it_holds_what_the_table_says():
    assert Provenance.of(WHOLE, "drive.toml") == Provenance(**WHOLE)
    assert Provenance.of({"source": "a data sheet"}, "drive.toml") == Provenance(source="a data sheet")
    assert Provenance.of({}, "drive.toml") == Provenance("", "", "", "")
    assert list(WHOLE) == list(MEANINGS)


def test_any_drive_file_may_have_it_and_no_axis_carries_it_on():
    """What a program writes is not from there any more: it says in its comments where it is from."""
    with_it, without = parse_axis(TABLES | {"provenance": WHOLE}), parse_axis(TABLES)
    assert axis_tables(with_it) == axis_tables(without) == TABLES


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ("a data sheet", r"\[provenance\] must be a table, got 'a data sheet'"),
        (["a data sheet"], r"\[provenance\] must be a table"),
        ({"sources": "a data sheet"}, r"\[provenance\] sources: unknown key; did you mean 'source'\?"),
        ({"year": 2015}, r"\[provenance\] year: unknown key; known: title, source, measured, assumed"),
        ({"source": 2015}, r"\[provenance\] source: must be a text of one line in quotation marks, got 2015"),
        ({"source": " "}, r"\[provenance\] source: must be a text of one line"),
        ({"source": "a\nb"}, r"\[provenance\] source: must be a text of one line"),
        ({"title": "\x1b[31mred"}, r"\[provenance\] title: must be a text of one line"),
    ],
)
def test_what_is_none_is_refused_with_the_file_and_the_key(table, told):
    with pytest.raises(DriveFileError, match=rf"^mine\.toml: {told}"):
        parse_axis(TABLES | {"provenance": table}, "mine.toml")
