"""No finding on sound logs, no certain mend where another explanation stands, and numbers in the unit of the mend."""

import dataclasses

import numpy as np
import pytest

from diffdrive.logs.checks.examine import examine
from tests.diffdrive.logs.checks.test_log_hypotheses import DRIVE, SOUND, UNKNOWN, but, complaints, rounded
from tests.support.sound_log import described, logged

COUNT = len(SOUND.time)
STEPS = 1e-4 * (np.arange(COUNT) // 1000 % 2)


def wrapped(findings):
    return [one for one in findings if one.cause == "wrapped"]


def lagging(signal, samples=8.0):
    """The signal behind a first-order lag, as a loop follows it."""
    after = np.exp(-np.arange(100) / samples)
    return np.convolve(np.pad(signal, (99, 0), mode="edge"), after / after.sum(), "valid")


TWO_LEVELS = {
    "a reference of steps": {"reference": STEPS, "position": rounded(lagging(STEPS), 1e-7)},
    "noise on it": {"reference": STEPS + 1e-8 * np.random.default_rng(0).standard_normal(COUNT)},
    "a sawtooth": {"reference": SOUND.time % 0.5 * 0.01, "position": lagging(SOUND.time % 0.5 * 0.01)},
    "a resting table that flickers": {"position": 1e-7 * np.random.default_rng(0).integers(0, 2, COUNT)},
    "flicker below the resolution": {"position": 4e-8 * (np.arange(COUNT) // 7 % 2)},
}


@pytest.mark.parametrize("name", TWO_LEVELS)
@pytest.mark.parametrize("drive", [UNKNOWN, None])
def test_steps_and_flicker_are_no_overflow(name, drive):
    assert not wrapped(examine(but(**TWO_LEVELS[name]), drive))


@pytest.mark.parametrize("bits", [14, 16])
def test_a_counter_that_overflows_once_each_way_is_unwrapped(bits):
    counts = np.round(SOUND.position / 1e-7)
    log = but(position=((counts + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)) * 1e-7)
    [finding] = wrapped(examine(log, UNKNOWN))
    np.testing.assert_allclose(finding.repair.apply(log).position, 1e-7 * counts, atol=1e-9)
