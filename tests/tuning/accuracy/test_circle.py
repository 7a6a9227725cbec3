"""ISO 230-4: how round a circle is, of paths that can be written down."""

import numpy as np
import pytest

from tuning.accuracy.circle import TURNS, circle_between, last_turn, radial_deviations, roundness

CIRCLE = circle_between(-0.1, 0.1, 0.05, 1.0, 1_000.0)
TURN = last_turn(CIRCLE.motion.position, CIRCLE)
VELOCITY = np.gradient(TURN)


def test_the_motion_is_whole_turns_within_its_limits():
    assert CIRCLE.samples % 4 == 0
    assert len(CIRCLE.motion.time) == TURNS * CIRCLE.samples + 1
    assert np.max(np.abs(CIRCLE.motion.velocity)) <= 0.025 * (1 + 1e-9)
    assert np.max(np.abs(CIRCLE.motion.acceleration)) <= 1.0
    assert (TURN.min(), TURN.max()) == pytest.approx((-CIRCLE.radius, CIRCLE.radius), rel=1e-9)


def test_a_perfect_axis_draws_a_perfect_circle_wherever_its_middle_is():
    assert max(roundness(TURN, TURN)) < 1e-15
    assert roundness(TURN + 1e-3, TURN).deviation < 1e-12


def test_a_wrong_scale_makes_an_oval_without_hysteresis():
    """r sqrt(1 + (2 e + e^2) cos^2): radii from r to r (1 + e)."""
    found = roundness((1 + 1e-4) * TURN, TURN)
    assert found.deviation == pytest.approx(1e-4 * CIRCLE.radius, rel=1e-3)
    assert found.hysteresis < 1e-12


def test_lost_motion_is_a_step_at_the_reversals_and_all_of_the_hysteresis():
    """Ahead of each reversal the table is half of it behind, and after it again, the other way."""
    lost = 4e-6
    found = roundness(TURN - 0.5 * lost * np.sign(VELOCITY), TURN)
    assert found.deviation == pytest.approx(lost, rel=0.02)
    assert found.hysteresis == pytest.approx(lost, rel=0.02)


def test_a_lag_that_both_axes_have_is_no_deviation():
    late = np.roll(0.999 * TURN, 3)
    assert max(roundness(late, late)) < 1e-12
    assert roundness(late, TURN).deviation > 1e-4 * CIRCLE.radius


def test_an_oval_that_lags_has_no_hysteresis_either():
    """Samples of the two senses are twice the lag apart in angle; the same radius stands at the same angle."""
    late = np.roll(TURN, CIRCLE.samples // 60)
    found = roundness((1 + 3e-4) * late, late)
    assert found.deviation == pytest.approx(3e-4 * CIRCLE.radius, rel=1e-3)
    assert found.hysteresis < 1e-4 * found.deviation


def test_the_range_of_the_drawn_radii_is_the_deviation_of_each_sense_and_a_step_is_where_the_axis_turns_back():
    lost = 4e-6
    path = TURN - 0.5 * lost * np.sign(VELOCITY)
    drawn = radial_deviations(path, TURN)
    assert np.max(np.ptp(drawn, axis=1)) == pytest.approx(roundness(path, TURN).deviation, rel=0.01)
    angles = np.linspace(0.0, 360.0, CIRCLE.samples, endpoint=False)
    steps = angles[np.argsort(-np.abs(np.diff(drawn[0], append=drawn[0][:1])))[:2]]
    np.testing.assert_allclose(np.sort((steps + 90.0) % 360.0), [90.0, 270.0], atol=1.0)
