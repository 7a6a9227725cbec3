"""The identification motion keeps what it promises, and random drives stay in their range."""

import numpy as np
import pytest

from diffdrive.model.parameters import check_drive
from diffdrive.model.presets import paper_drive
from diffdrive.model.quantity import quantities
from experiments.studies.recovery.excitation import LIMITS, TONES, identification_motion, small_multisine
from experiments.studies.recovery.random_drive import random_drive


@pytest.mark.parametrize("rate", [2_000.0, 4_000.0, 10_000.0])
def test_the_motion_is_smooth_and_within_the_limits(rate):
    reference = identification_motion(rate)
    assert reference.rate == pytest.approx(rate, rel=1e-9)
    assert 8.0 < reference.duration < 12.0
    assert np.max(np.abs(reference.velocity)) <= LIMITS.speed * (1 + 1e-9)
    assert np.max(np.abs(reference.acceleration)) <= LIMITS.acceleration * (1 + 1e-9)
    assert reference.velocity[0] == reference.velocity[-1] == 0.0
    # velocity is the position's derivative: the trapezoidal rule errs by jerk / 12 rate^3
    middle = (reference.velocity[1:] + reference.velocity[:-1]) / 2
    assert np.max(np.abs(np.diff(reference.position) - middle / rate)) < 1000.0 / rate**3
    assert np.max(np.abs(np.diff(reference.acceleration))) * rate < 1000.0


def test_every_regime_is_there_both_ways():
    reference = identification_motion()
    steady = np.abs(reference.acceleration) < 1e-9
    for speed in (1e-4, 2e-4, 5e-4, 1.2e-3, 3e-3, 0.01, 0.03, 0.05, 0.1, 0.15):
        for way in (1, -1):
            held = steady & (np.abs(reference.velocity - way * speed) < 1e-6 * speed)
            assert np.count_nonzero(held) / reference.rate > 0.05, (way, speed)


def test_the_multisine_is_small_begins_at_rest_and_has_its_tones():
    tones = small_multisine(10_000.0)
    assert 0.5e-6 < np.std(tones.position) < 1.5e-6
    assert np.max(np.abs(tones.position)) < 3e-6
    assert np.max(np.abs(tones.velocity[[0, -1]])) < 1e-9
    whole = slice(2_000, 12_000)  # 1 s: a line of the spectrum per hertz
    lines = 2 * np.abs(np.fft.rfft(tones.position[whole])) / 10_000
    assert np.allclose(lines[TONES], 4e-7, rtol=0.01)
    assert np.max(np.delete(lines[1:], TONES - 1)) < 4e-9


def test_random_drives_vary_every_parameter_in_its_range():
    rng = np.random.default_rng(0)
    nominal = {name: value for name, _, value in quantities(paper_drive())}
    factors = []
    for _ in range(200):
        drive = random_drive(rng)
        check_drive(drive)
        friction = drive.friction
        assert friction.bristle_stiffness.positive == friction.bristle_stiffness.negative
        assert friction.bristle_damping.positive == friction.bristle_damping.negative
        assert friction.initial_load == nominal["friction.initial_load"]
        here = [drive.plant.mass / nominal["plant.mass"]]
        for part, names in (
            (drive.plant, ["damping"]),
            (friction, ["coulomb_screw", "load_coefficient", "breakaway_gap", "stribeck_velocity", "viscous"]),
        ):
            prefix = "plant" if part is drive.plant else "friction"
            for name in names:
                pair, of = getattr(part, name), nominal[f"{prefix}.{name}"]
                here += [pair.positive / of.positive, pair.negative / of.negative]
        here += [friction.bristle_stiffness.positive / 3.35e7, friction.bristle_damping.positive / 4.54e3]
        factors.append(here)
    factors = np.array(factors)
    assert np.min(factors) >= 0.6
    assert np.max(factors) <= 1.4
    assert np.allclose(np.mean(factors, axis=0), 1.0, atol=0.07)
    assert np.max(np.abs(np.corrcoef(factors.T) - np.eye(factors.shape[1]))) < 0.35
