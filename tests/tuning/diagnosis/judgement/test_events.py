"""What happens once and briefly, told from noise."""

from types import SimpleNamespace

import numpy as np
import pytest

from tuning.diagnosis.judgement.events import downgraded_by_event, least_foreseen
from tuning.diagnosis.judgement.verdict import Verdict
from tuning.diagnosis.levels import CHANCE

RATE, LANES, SAMPLES = 2000.0, 2, 20_000
NONE = Verdict("none", [], 0.0, "no effect is missing")
NOISE = np.random.default_rng(5).standard_normal((LANES, SAMPLES))


def fitted(innovation, counts=None, position=None, resolution=None):
    """A fit whose innovations, expected to scatter by 2 um with noises three times what was thought, are these."""
    position = 1e-6 * np.arange(innovation.shape[1]) + np.zeros_like(innovation) if position is None else position
    lanes = SimpleNamespace(counts=np.ones_like(innovation) if counts is None else counts, position=position)
    sampling = SimpleNamespace(rate=RATE, period=1.0 / RATE)
    drive = SimpleNamespace(sensor=SimpleNamespace(resolution=resolution))
    logged = SimpleNamespace(lanes=lanes, sampling=sampling, starts=np.array([0.0, 30.0]), owner=(0, 1), drive=drive)
    filtered = SimpleNamespace(
        innovation=innovation * 6e-6, innovation_std=np.full_like(innovation, 2e-6), noise_scale_sq=9.0
    )
    return SimpleNamespace(model=SimpleNamespace(logged=logged), filtered=filtered)


def test_noise_is_no_event_however_long_the_log():
    """By its chance: about as likely as not, and seldom much less."""
    decades = [
        least_foreseen(fitted(np.random.default_rng(seed).standard_normal((LANES, SAMPLES)))).decades
        for seed in range(50)
    ]
    assert min(decades) > -3.0
    assert max(decades) == 0.0
    assert downgraded_by_event(NONE, fitted(NOISE)) == NONE


def test_a_moment_is_named_with_its_log_and_time():
    off = NOISE.copy()
    off[1, 4000:4010] += 4.0
    event = least_foreseen(fitted(off))
    assert event.decades < np.log10(CHANCE)
    assert (event.lane, event.samples) == (1, 10)
    assert event.begins == pytest.approx(4000, abs=3)
    told = downgraded_by_event(NONE, fitted(off))
    assert told.verdict == "unknown"
    assert "about 32.00" in told.says
    assert "into log 2" in told.says
    assert "no effect is missing" not in told.says
    found = Verdict("effect", [], 0.0, "cogging explains the gap")
    assert downgraded_by_event(found, fitted(off)) == found


def test_one_sample_that_went_astray_is_none_nor_what_does_not_count():
    off = NOISE.copy()
    off[0, 700] = 1e4
    assert downgraded_by_event(NONE, fitted(off)) == NONE
    off[0, 700] = np.nan
    assert downgraded_by_event(NONE, fitted(off)) == NONE
    off = NOISE.copy()
    off[0, 700:720] = 5.0
    counts = np.ones_like(off)
    counts[0, 700:720] = 0.0
    assert downgraded_by_event(NONE, fitted(off, counts)) == NONE
    assert downgraded_by_event(NONE, fitted(off)).verdict == "unknown"


def test_a_table_that_rests_most_of_the_time_makes_no_event_of_its_motion():
    """A scale of whole counts says the same number at rest: no noise there, and less than expected on the whole."""
    off = NOISE.copy()
    off[:, :16_000] = 0.0
    quiet = fitted(off)
    quiet.filtered.innovation /= 3.0  # as much as expected where it moves
    quiet.filtered.noise_scale_sq = 0.2
    assert least_foreseen(quiet).decades > -3.0
    quiet.filtered.innovation[0, 18_000:18_010] += 8e-6
    assert least_foreseen(quiet).decades < np.log10(CHANCE)


def test_a_count_that_flips_at_rest_is_no_event_and_a_table_that_is_pushed_is():
    """Beside the edge of a count the same count returns again and again: chance would not do so, and nothing moves."""
    count, off = 20e-6, NOISE.copy()  # a step of the scale is 3.3 of its scatters
    position = np.tile(count * np.floor(0.25 * np.arange(SAMPLES)), (LANES, 1))
    position[:, 7_900:8_100] = position[:, 7_900:7_901] + count * (np.arange(200) % 2)
    off[0, 8_000:8_010] = 3.3
    assert least_foreseen(fitted(off)).decades < np.log10(CHANCE)
    assert downgraded_by_event(NONE, fitted(off, position=position, resolution=count)) == NONE
    pushed = position.copy()
    pushed[0, 8_000:8_010] += 2.0 * count
    assert least_foreseen(fitted(off, position=pushed, resolution=count)).decades < np.log10(CHANCE)
    off[0, 8_000:8_010] = 4.8  # two neighbours, and neither is where it is foreseen
    assert least_foreseen(fitted(off, position=position, resolution=count)).decades < np.log10(CHANCE)


def test_a_log_shorter_than_a_moment_has_its_chance_too():
    assert least_foreseen(fitted(NOISE[:, :4])).samples == 4
