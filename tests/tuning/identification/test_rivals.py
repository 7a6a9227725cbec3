"""Starts that end elsewhere: which of them is looked at again, and when it is as good."""

from types import SimpleNamespace

import numpy as np

from tuning.identification.doubts import doubts
from tuning.identification.refinement import normalised_innovations
from tuning.identification.rivals import APART, WITHIN, RivalValue, is_as_good, rival_start

RATE = 1_000.0
PRIOR = np.array([1.0, 1.0, 1.0])


def test_the_best_of_those_that_ended_elsewhere_is_looked_at_again():
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.9 * APART, 0.0], [2.0, 0.0, 0.0], [0.0, -1.0, 0.0], [9.0, 0.0, 0.0]])
    costs = np.array([10.0, 10.1, 12.0, 11.0, np.inf])
    np.testing.assert_array_equal(rival_start(points, costs, PRIOR), points[3])
    np.testing.assert_array_equal(rival_start(points, costs, np.array([1.0, 0.1, 1.0])), points[2])


def test_starts_that_agree_and_a_single_one_have_no_rival():
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    assert rival_start(points, np.array([1.0, 2.0]), PRIOR) is None
    assert rival_start(points[:1], np.array([1.0]), PRIOR) is None
    far = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    assert rival_start(far, np.array([1.0, 1.01 * WITHIN]), PRIOR) is None  # stuck, not a rival
    assert rival_start(far, np.array([1.0, 0.99 * WITHIN]), PRIOR) is not None


def test_innovations_of_the_same_size_are_as_good_and_larger_ones_are_not():
    rng = np.random.default_rng(0)
    found, other = rng.standard_normal((2, 2, 10_000))
    assert is_as_good(other, found, RATE)
    assert is_as_good(0.9 * other, found, RATE)  # better, too
    assert not is_as_good(1.1 * other, found, RATE)
    assert is_as_good(found, found, RATE)


def test_a_rival_that_runs_off_in_a_few_blocks_is_not_as_good():
    """Its blocks scatter so much that their mean is no evidence against it; those of the answer scatter little."""
    rng = np.random.default_rng(3)
    found, rival = rng.standard_normal((2, 1, 20_000))
    rival[0, 4_000:4_400] *= 2_000.0
    assert not is_as_good(rival, found, RATE)
    assert is_as_good(found[:, ::-1], found, RATE)


def test_both_encoders_are_in_what_a_rival_is_judged_by():
    """In turn, each in its own standard deviations; one that is as good for the finer alone is none."""
    scale, motor = np.random.default_rng(2).standard_normal((2, 3, 400))
    noise = {"scale": 2e-7, "motor": 1e-8}
    gains = SimpleNamespace(innovation_std=noise["scale"], motor=SimpleNamespace(innovation_std=noise["motor"]))
    fit = SimpleNamespace(
        innovation=noise["scale"] * scale, motor_innovation=noise["motor"] * motor, problem=SimpleNamespace(gains=gains)
    )
    both = normalised_innovations(fit)
    np.testing.assert_allclose(both[:, 0::2], scale, rtol=1e-12)
    np.testing.assert_allclose(both[:, 1::2], motor, rtol=1e-12)
    fit.motor_innovation = None
    np.testing.assert_allclose(normalised_innovations(fit), scale, rtol=1e-12)


def test_in_so_many_logs_chance_is_as_it_is_said_to_be():
    """Two equal answers differ by chance: one in a hundred is taken for worse."""
    rng = np.random.default_rng(1)
    worse = [not is_as_good(*rng.standard_normal((2, 1, 8_000)), RATE, chance=0.1) for _ in range(400)]
    assert abs(np.mean(worse) - 0.1) < 4 * np.sqrt(0.1 * 0.9 / 400)


def test_an_answer_with_a_rival_is_doubted_with_both_values():
    rival = (RivalValue("stribeck_velocity.positive", "m/s", 3.5e-3, 2.1e-2), RivalValue("delay", "1", 1.0, 2.0))
    found = SimpleNamespace(rival=rival, drive=None, estimates=[])
    (against,) = doubts(found, SimpleNamespace(plant=SimpleNamespace(constant_force=0.0)), [], [])
    assert "stribeck_velocity.positive 0.0035 or 0.021 m/s, delay 1 or 2" in against
    assert "starts disagree" in against
