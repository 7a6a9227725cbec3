"""What is printed is read by people: digits, units, and tables that no terminal breaks within a name."""

import io
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from experiments.reports import readable
from experiments.reports.report import Report


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0"), (1.0, "1"), (10000.0, "10000"), (12345.6, "12.35e3"), (33.5e6, "33.5e6"), (2.887e-8, "28.87e-9"),
        (0.03982, "0.03982"), (9999.96, "10e3"), (-0.26756, "-0.2676"), (0.00099987, "999.9e-6"),
        (math.inf, "infinite"), (-math.inf, "-infinite"), (math.nan, "-"),
        (-0.0, "0"),
    ],
)  # fmt: skip
def test_numbers_have_four_digits_and_exponents_of_three(value, shown):
    assert readable.significant(value) == shown


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e30, max_value=1e30), st.integers(1, 8))
def test_a_number_that_is_printed_is_the_number(value, digits):
    read = float(readable.significant(value, digits))
    assert read == pytest.approx(value, rel=0.5 * 10.0 ** (1 - digits) * (1 + 1e-9), abs=1e-300)


def test_an_interval_shows_however_narrow_it_is():
    assert readable.interval(33497500.0, 33453800.0, 33541100.0) == ("33.498e6", "33.454e6 to 33.541e6")
    assert readable.interval(99.9993, 99.9844, 100.014) == ("99.999", "99.984 to 100.014")


def test_an_interval_without_an_end_is_in_words():
    assert readable.interval(5.0, -100.0, math.inf) == ("5", "at least -100")
    assert readable.interval(5.0, -math.inf, 7.0) == ("5", "at most 7")
    assert readable.interval(5.0, -math.inf, math.inf) == ("5", "without limits")


def test_what_infinity_means_stands_in_a_column_of_numbers():
    [block] = readable.table(("loop", "gain, dB"), [["model", math.inf], ["measured", 6.02]], 80, infinite="no limit")
    assert block[-2:] == ["model     no limit", "measured      6.02"]


@pytest.mark.parametrize(
    ("name", "heading"),
    [
        ("RMS um", ("RMS", "µm")), ("peak_error_um", ("peak error", "µm")), ("force, N", ("force", "N")),
        ("um where low", ("where low", "µm")), ("3.0 s", ("3.0 s", "")), ("viscous_Ns_per_m", ("viscous", "N s/m")),
        ("coulomb_screw.positive", ("coulomb_screw.positive", "")), ("mm/s", ("", "mm/s")), ("+-", ("±", "")),
        ("diverged, the earliest first", ("diverged, the earliest first", "")), ("phase deg", ("phase", "°")),
    ],
)  # fmt: skip
def test_a_heading_has_its_unit(name, heading):
    assert readable.heading(name) == heading


@pytest.mark.parametrize("text", ["--tolerance 2um", "sine:amplitude=5um", "unit um=5", "'um'", "maximum"])
def test_what_is_for_a_command_line_stays_as_it_is(text):
    assert readable.readable(text) == text


@pytest.mark.parametrize(
    "text", ["0.3 um of error", "log, um RMS", "density, 1/um", "3 (um)", "22.8 (22.7 to 22.9) um"]
)
def test_micrometres_are_written_as_people_write_them(text):
    assert "µm" in readable.readable(text)


WORDS = st.lists(st.sampled_from(["friction.bristle_stiffness", "not", "determined", "a", "held", "out"]), min_size=1)
ROWS = st.lists(
    st.tuples(WORDS.map(" ".join), st.floats(-1e9, 1e9), st.none() | WORDS.map(" ".join), st.booleans()), max_size=4
)


@given(ROWS, st.integers(60, 140))
def test_a_table_is_as_wide_as_the_terminal_and_breaks_no_name(rows, width):
    blocks = readable.table(("name of the row", "value, um", "what was said of it", "kept"), rows, width)
    lines = [line for block in blocks for line in block]
    assert all(len(line) <= width for line in lines)
    printed = {word for line in lines for word in line.split()}
    assert {word for row in rows for cell in (row[0], row[2]) if cell for word in cell.split()} <= printed
    assert {readable.significant(row[1]) for row in rows} <= printed


def printed(width, work):
    file = io.StringIO()
    work(Report("title", None, Console(file=file, width=width, force_terminal=False, legacy_windows=False)))
    return file.getvalue()


def test_the_result_comes_first_and_nothing_is_lost_where_none_comes():
    def work(report):
        with report.result_first() as result:
            report.values("basis", rms_um=0.5)
            result("The result.")

    text = printed(80, work)
    assert text.index("The result.") < text.index("Basis: RMS 0.5 µm")

    report = Report("title", None, Console(file=io.StringIO()))
    report.say("Before.")
    with report.result_first() as result:
        report.say("How it came about.")
        result("The result.")
    assert report.data["notes"] == ["Before.", "The result.", "How it came about."]

    def failing(report):
        with report.result_first():
            report.values("basis", rms_um=0.5)
            raise ValueError("late")

    file = io.StringIO()
    with pytest.raises(ValueError, match="late"):
        failing(Report("title", None, Console(file=file, width=80)))
    assert "Basis: RMS 0.5 µm" in file.getvalue()


def test_no_value_is_printed_as_python_has_it():
    text = printed(80, lambda report: report.values("verdict", accepted=np.bool_(True), cost=[1.0, 2.5], none=None))
    assert "Verdict: accepted yes, cost 1, 2.5, none -" in text
