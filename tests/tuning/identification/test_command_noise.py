"""The command of snapshots without its noise: what is smooth gets smoother, what is not stays."""

import numpy as np
import pytest

from tuning.identification.command_noise import without_noise

TIME = np.arange(3000) / 1000.0
ALL = np.ones((1, 3000))
SMOOTH = 200.0 * np.sin(2 * np.pi * 0.8 * TIME)  # as a command along a motion without a reversal


def noisy(signal, seed=0):
    return (signal + np.random.default_rng(seed).normal(scale=20.0, size=signal.shape))[None]


def test_the_noise_of_a_smooth_command_is_halved():
    left = without_noise(noisy(SMOOTH), ALL)[0] - SMOOTH
    assert np.std(left) < 0.55 * 20.0
    assert abs(np.mean(left)) < 1.0


def test_a_step_stays_where_it_is():
    """A reversal of friction: no further from it than its noise, nor earlier."""
    step = np.where(TIME < 1.5, -150.0, 150.0)
    found = without_noise(noisy(step), ALL)[0]
    assert np.max(np.abs(found - step)[1400:1600]) < 4.0 * 20.0
    assert np.std((found - step)[1450:1550]) < 20.0


def test_a_ringing_after_a_reversal_keeps_its_height():
    rings = 300.0 * np.exp(-np.abs(TIME - 1.5) / 0.05) * np.sin(2 * np.pi * 60.0 * (TIME - 1.5)) * (TIME > 1.5)
    found = np.mean([without_noise(noisy(rings, seed), ALL)[0] for seed in range(20)], axis=0)
    first = slice(1500, 1520)
    share = found[first] @ rings[first] / (rings[first] @ rings[first])
    assert share == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("power", [0, 1, 2])
def test_a_parabola_is_no_noise(power):
    signal = (100.0 * TIME**power)[None]
    np.testing.assert_allclose(without_noise(signal, ALL)[:, 24:-24], signal[:, 24:-24], atol=1e-9)


def test_every_lane_is_smoothed_by_itself():
    both = np.concatenate([noisy(SMOOTH), noisy(SMOOTH + 5_000.0, seed=1)])
    found = without_noise(both, np.ones(both.shape))
    assert np.std(found[1] - SMOOTH - 5_000.0) < 0.55 * 20.0
    assert np.std(found[0] - SMOOTH) < 0.55 * 20.0
