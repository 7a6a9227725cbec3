"""Numbers with a unit: what is read, and that an error's example would have been."""

import re

import pytest

from diffdrive.support.units import to_si


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("1.5 mm", "m", 1.5e-3), ("20 dB", "dB", 20.0), ("1.5 1/m", "1/m", 1.5), ("1.5/m", "1/m", 1.5),
        ("0.5 /mm", "1/m", 500.0), ("15 1/s", "1/s", 15.0), ("3 %", "1", 0.03), (" 4 ms ", "s", 4e-3),
        ("2e3", "1", 2e3),
    ],
)  # fmt: skip
def test_a_number_and_its_unit(text, unit, value):
    assert to_si(text, unit) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    "text", ["100 200 kg", "3 1/2 m", "1.5 1 m", "100,5 kg", "kg", "2 * 3 m", "5 1/", "5 //m", "1 2"]
)
@pytest.mark.parametrize("unit", ["1", "m", "kg", "1/s", "dB", "N*s/m"])
def test_what_is_no_number_with_a_unit_is_refused_with_an_example_that_is_one(text, unit):
    with pytest.raises(ValueError, match="cannot read") as refused:
        to_si(text, unit)
    example = re.search(r"write for example (?:'(?P<quoted>.+)'|(?P<plain>[\d.]+))", str(refused.value))
    assert to_si(example["quoted"] or example["plain"], unit) > 0.0
