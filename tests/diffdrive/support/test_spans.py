"""A number with its interval in words: the interval shows, the unit is one that an engineer reads."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffdrive.support.spans import format_span, format_spans


@pytest.mark.parametrize(
    ("span", "unit", "says"),
    [
        ((4.0, 3.997, 4.003), "N", "4.0000 (3.9970 to 4.0030) N"),
        ((0.004, 0.0039994, 0.0040006), "m", "4.00000 (3.99940 to 4.00060) mm"),
        ((1e-8, 1e-9, 1e-7), "m", "0.010 (0.001 to 0.100) um"),
        ((6e-4, 5.99e-4, 6.01e-4), "s", "0.6000 (0.5990 to 0.6010) ms"),
        ((3.2, 3.1, 3.3), "s", "3.20 (3.10 to 3.30) s"),
        ((0.2, 0.1, 0.3), "m/s", "200 (100 to 300) mm/s"),
        ((1900.0, 1700.0, 2100.0), "N s/m", "1900 (1700 to 2100) N s/m"),
        ((4.2e7, 4.1e7, 4.3e7), "N/m", "42.0e6 (41.0e6 to 43.0e6) N/m"),
        ((0.3, -0.1, 0.7), "1", "0.30 (-0.10 to 0.70)"),
        ((0.0, 0.0, 0.0), "N", "0 (0 to 0) N"),
        ((-0.0, -0.0, 0.0), "N", "0 (0 to 0) N"),
        ((-0.001, -0.5, 0.5), "N", "0.00 (-0.50 to 0.50) N"),
        ((1900.0, 1700.0, 2100.0), "N*s/m", "1900 (1700 to 2100) N s/m"),
        ((5.0, None, 6.0), "m", "5 (- to 6) m"),
        ((3.35e7, None, None), "N/m", "33.5e6 (- to -) N/m"),
        ((5.0, 4.0, math.inf), "N", "5 (4 to inf) N"),
        ((5e-5, 0.0, 9e-5), "N", "50e-6 (0 to 90e-6) N"),
        ((1e-12, 0.0, 2e-12), "m", "1.0e-6 (0 to 2.0e-6) um"),
        ((None, None, None), "m", "- (- to -) m"),
        ((math.nan, 0.0, 1.0), "N", "nan (0 to 1) N"),
    ],
)
def test_a_number_has_the_digits_that_its_interval_calls_for(span, unit, says):
    assert format_spans([span], unit) == says


def test_logs_are_told_one_by_one_in_one_unit():
    assert (
        format_spans([(0.5, 0.4, 0.6), (2e-3, 1e-3, 3e-3)], "m")
        == "log 1: 500 (400 to 600) mm, log 2: 2.0 (1.0 to 3.0) mm"
    )


@given(
    st.floats(-1e9, 1e9).filter(lambda at: at == 0.0 or abs(at) > 1e-9),
    st.floats(-5.0, 1.0).map(lambda power: 10.0**power),
)
def test_the_interval_always_shows_and_no_end_is_off_by_more_than_a_tenth_of_it(at, relative):
    half = relative * (abs(at) or 1.0)
    said = format_span((at, at - half, at + half))
    assert len(set(said)) == 3
    assert [float(one) for one in said] == pytest.approx([at, at - half, at + half], abs=0.051 * half)


@given(st.floats(1e-9, 0.9), st.sampled_from(["m", "s"]))
def test_a_unit_is_changed_with_its_number(at, unit):
    number, given_in = re.fullmatch(
        r"(\S+) \(.* to .*\) (\w+)", format_spans([(at, 0.9 * at, 1.1 * at)], unit)
    ).groups()
    scale = {unit: 1.0, f"m{unit}": 1e-3, f"u{unit}": 1e-6}[given_in]
    assert float(number) * scale == pytest.approx(at, rel=0.01)
    assert 0.01 <= float(number) < 1000.0 or at < 1e-7
