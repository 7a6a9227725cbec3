"""Shares as users write them: per cent or a number."""

import pytest

from diffdrive.errors import ParameterError
from diffdrive.motion.text import share


@pytest.mark.parametrize("value", ["3%", "0.03", 0.03, " 3 %"])
def test_a_share_is_per_cent_or_a_number(value):
    assert share(value, "spread", at_most=0.5) == 0.03


@pytest.mark.parametrize("value", ["abc", "%", "nan", "inf", "-3%", "0%", 0.0, "51%", True])
def test_what_is_no_share_is_refused(value):
    with pytest.raises(ParameterError, match=f"spread {value}: give a share above 0 and up to 50%, as 3% or 0.03"):
        share(value, "spread", at_most=0.5)


def test_a_share_of_nothing_may_be_meant():
    assert share("0%", "spread", at_most=0.5, may_be_zero=True) == 0.0
    with pytest.raises(ParameterError, match="give a share from 0 to 50%"):
        share("-1%", "spread", at_most=0.5, may_be_zero=True)
