"""What a parameter is expected to be: its three scales, and that no effect leaves its range on any of them."""

import pytest

from tuning.diagnosis.hypotheses.priors import ITSELF, LOG_ODDS, LOGARITHM, Parameter

SCALES = {"itself": ITSELF, "logarithm": LOGARITHM, "log-odds": LOG_ODDS}


@pytest.mark.parametrize("scale", SCALES.values(), ids=SCALES.keys())
@pytest.mark.parametrize("theta", [-3.0, -0.2, 0.0, 1.6])
def test_a_value_and_its_standard_are_inverse_and_its_slope_is_the_derivative(scale, theta):
    one = Parameter("x", 0.4, 0.7, scale)
    assert one.value(0.0) == pytest.approx(0.4)
    assert one.standard(one.value(theta)) == pytest.approx(theta, abs=1e-12)
    h = 1e-5
    assert one.slope(theta) == pytest.approx((one.value(theta + h) - one.value(theta - h)) / (2 * h), rel=1e-8)


def test_a_deviation_is_a_difference_a_factor_or_odds():
    one = Parameter("x", 0.5, 0.1)
    assert one.value(2.0) == pytest.approx(0.7)
    assert one._replace(scale=LOGARITHM, spread=1.0).value(1.0) == pytest.approx(0.5 * 2.718281828)
    share = one._replace(scale=LOG_ODDS, spread=1.0)
    assert share.value(1.0) / (1.0 - share.value(1.0)) == pytest.approx(2.718281828)
    assert 0.0 < share.value(-9.0) < share.value(9.0) < 1.0
