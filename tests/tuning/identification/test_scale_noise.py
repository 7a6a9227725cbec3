"""Noise that a drive file does not state: said with what it is made of, and mended by what is said."""

import dataclasses
import re

import numpy as np
import pytest

from tests.support.sound_log import DRIVE
from tuning.identification.scale_noise import NOTABLE, unstated_noise

STEP = 1e-7  # m


def drive(noise, resolution=STEP):
    """A drive whose scale states so much noise (m)."""
    sensor = dataclasses.replace(DRIVE.drive.sensor, noise=noise, resolution=resolution)
    return dataclasses.replace(DRIVE.drive, sensor=sensor)


@pytest.mark.parametrize(("stated", "resolution"), [(0.0, STEP), (1e-8, STEP), (2e-8, None)])
def test_the_noise_that_is_to_be_written_makes_up_what_the_logs_show(stated, resolution):
    shown = 60e-9
    said = unstated_noise(drive(stated, resolution), shown)
    (mend,) = re.findall(r'noise = "(\S+) nm"', said)
    steps = 0.0 if resolution is None else resolution / np.sqrt(12.0)
    assert np.hypot(1e-9 * float(mend), steps) == pytest.approx(shown, rel=0.005)
    assert not unstated_noise(drive(1e-9 * float(mend), resolution), shown)
    assert f"states {1e9 * stated:.3g} nm of noise" in said
    assert ("the scale's steps make 28.9 nm of it, added in squares" in said) == (resolution is not None)


def test_what_is_stated_or_nearly_so_is_no_matter():
    stated = np.hypot(2e-8, STEP / np.sqrt(12.0))
    assert not unstated_noise(drive(2e-8), 0.99 * NOTABLE * stated)
    assert unstated_noise(drive(2e-8), 1.01 * NOTABLE * stated)
