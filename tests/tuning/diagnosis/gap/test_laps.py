"""What repeats from lap to lap: periods of references, and the scatter between laps."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.sound_log import RATE, SOUND
from tuning.diagnosis.gap.laps import laps, pairs_of, period_of

rng = np.random.default_rng(4)


@pytest.fixture(autouse=True)
def begun_anew():
    """No test draws what another left."""
    rng.bit_generator.state = np.random.default_rng(4).bit_generator.state


def lapped(count, period, noise=0.0, force=0.0):
    """A log of so many laps of a motion there and back, with noise on position and command."""
    n, time = count * period, np.arange(count * period) / RATE
    phase = 2 * np.pi * np.arange(n) / period
    reference = 0.01 * (1 - np.cos(phase)) + 0.001 * np.sin(3 * phase)
    return dataclasses.replace(
        SOUND,
        time=time,
        reference=reference,
        position=reference + noise * rng.standard_normal(n),
        command=np.sin(phase) + force * rng.standard_normal(n),
    )


@given(st.integers(450, 1500), st.integers(2, 5))
def test_a_period_is_found_to_the_sample(period, count):
    assert period_of(lapped(count, period).reference, RATE) == period


@pytest.mark.parametrize("reference", [np.zeros(4000), np.linspace(0, 1, 4000), np.cumsum(rng.standard_normal(4000))])
def test_what_does_not_repeat_has_no_period(reference):
    assert period_of(reference, RATE) is None


def test_the_scatter_is_that_of_one_lap():
    log = lapped(5, 1000, noise=2e-7, force=3.0)
    unlike, same = 2.0 * rng.standard_normal((1, 5000)), np.tile(5.0 * rng.standard_normal(1000), 5)[None]
    found = laps([log], unlike + same, np.ones((1, 5000)), (0,), 1)
    assert found.pairs == 4
    assert found.position == pytest.approx(2e-7, rel=0.05)
    assert found.command == pytest.approx(3.0, rel=0.05)
    assert found.force == pytest.approx(2.0, rel=0.05)
    assert any(f"{percent} % of the latter repeats" in found.says for percent in (85, 86, 87))


def test_two_logs_of_one_reference_are_laps_and_others_are_not():
    one, other = lapped(1, 1500), lapped(1, 1500)
    assert [lap.logs for lap in pairs_of([one, other])] == [(0, 1)]
    longer = lapped(1, 1600)
    assert pairs_of([one, longer]) == []
    assert laps([one, longer], np.zeros((2, 1600)), np.ones((2, 1600)), (0, 1), 1) is None
    unknown = dataclasses.replace(one, reference=None)
    assert pairs_of([unknown, other]) == []
    assert pairs_of([dataclasses.replace(lapped(3, 1000), gaps=(500,))]) == []


def test_thinned_forces_are_compared_at_the_same_place_of_the_lap():
    log = lapped(4, 1000)
    force = np.tile(rng.standard_normal(200), 4)[None]
    assert laps([log], force, np.ones((1, 800)), (0,), 5).force == 0.0
