"""How far recalibration may move the nominal parameters: by a tolerance, and by what the drive file doubts."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffdrive as dd
from diffdrive.model.uncertainty import MAX_LOG_DEVIATION, Deviation, Uncertainty
from tuning.diagnosis.hypotheses.calibration import (
    DELAY,
    FORCE,
    NAMES,
    calibrated,
    fraction_of_delay,
    prior_root,
    tolerated,
)

DRIVE = dd.paper_axis().drive
STATED = Uncertainty.of(
    {
        "plant.constant_force": Deviation(40.0, is_relative=False),
        "friction.coulomb_screw.positive": Deviation(0.3),
        "friction.viscous": Deviation(0.05),
        "plant.mass": Deviation(3.0, is_relative=False),
        "friction.bristle_stiffness": Deviation(0.45),
    },
    {"plant.constant_force": {"friction.coulomb_screw.positive": 0.99}},
)


def covariance(root):
    return root @ root.T


def test_without_a_stated_uncertainty_each_parameter_has_its_tolerance_and_the_force_none():
    root = prior_root(DRIVE, 0.02)
    np.testing.assert_allclose(root, tolerated(0.02), rtol=1e-12, atol=0.0)
    for fixed in (FORCE, DELAY):
        assert not root[NAMES.index(fixed)].any()


def test_the_instant_of_a_snapshot_is_anywhere_within_a_sample_of_its_loop():
    root = prior_root(DRIVE, 0.02, loop_samples=5)
    late = np.random.default_rng(1).uniform(-0.5, 0.5, 100_000) / 5.0  # rows
    assert root[NAMES.index(DELAY), NAMES.index(DELAY)] == pytest.approx(np.std(late), rel=0.01)


def test_what_the_drive_file_states_comes_to_the_tolerance_with_its_correlation():
    found = covariance(prior_root(DRIVE, 0.02, STATED))
    at = {name: k for k, name in enumerate(NAMES)}
    force, friction = at[FORCE], at["coulomb_screw.positive"]
    assert found[force, force] == pytest.approx(40.0**2)
    assert found[friction, friction] == pytest.approx(0.3**2 + 0.02**2)
    assert found[force, friction] == pytest.approx(0.99 * 40.0 * 0.3)
    mass = float(DRIVE.plant.mass)
    assert found[at["mass"], at["mass"]] == pytest.approx((3.0 / mass) ** 2 + 0.02**2)
    assert found[at["bristle_stiffness"], at["bristle_stiffness"]] == pytest.approx(0.45**2 + 0.02**2)
    ways = at["viscous.positive"], at["viscous.negative"]  # one number in the drive file
    assert found[ways] == pytest.approx(0.05**2)
    assert found[at["bristle_damping"], at["bristle_damping"]] == pytest.approx(0.02**2)


def axis_with(path, value):
    return dd.paper_axis().replace({path: value}).drive


def deviation_of(drive, path, name, stated):
    found = covariance(prior_root(drive, 0.02, Uncertainty.of({path: stated})))
    return np.sqrt(found[NAMES.index(name), NAMES.index(name)])


def test_a_share_of_a_constant_force_is_one_of_its_newtons():
    tilted = axis_with("plant.constant_force", -300.0)
    assert deviation_of(tilted, "plant.constant_force", FORCE, Deviation(0.05)) == pytest.approx(15.0)


@pytest.mark.parametrize(("value", "expected"), [(0.0, 0.0), (0.5, MAX_LOG_DEVIATION), (30.0, 0.1)])
def test_newtons_of_a_gap_are_a_share_of_it_and_no_more_than_a_factor_that_can_be(value, expected):
    """A gap that is none has no logarithm; one that is known worse than itself has an unknown size, not any."""
    drive = axis_with("friction.breakaway_gap", value)
    found = deviation_of(drive, "friction.breakaway_gap.positive", "breakaway_gap.positive", Deviation(3.0, False))
    assert found == pytest.approx(np.hypot(expected, 0.02))


@pytest.mark.parametrize("load", [0.0, 400_000.0])
def test_under_one_load_the_sum_of_screw_and_load_friction_moves_as_both_did_and_nothing_else(load):
    """Whichever of the two is larger stands for both, to first order."""
    root = prior_root(DRIVE, 0.02, STATED, load=load)
    fixed = "load_coefficient" if load == 0.0 else "coulomb_screw"
    screw, guide = DRIVE.friction.coulomb_screw.positive, DRIVE.friction.load_coefficient.positive
    assert (screw > guide * (DRIVE.friction.initial_load + load)) == (fixed == "load_coefficient")
    for side in ("positive", "negative"):
        stays = NAMES.index(f"{fixed}.{side}")
        assert not root[stays].any()
        assert not root[:, stays].any()

    def shown(b):
        """The Coulomb friction (N) to either side, and all that is no part of it."""
        others = [k for k, name in enumerate(NAMES) if name.split(".")[0] not in ("coulomb_screw", "load_coefficient")]
        friction = calibrated(DRIVE, b).friction.coulomb_at(load)
        return jnp.r_[friction.positive, friction.negative, b[jnp.array(others)]]

    slopes = np.asarray(jax.jacfwd(shown)(jnp.zeros(len(NAMES))))
    free = prior_root(DRIVE, 0.02, STATED)
    np.testing.assert_allclose(covariance(slopes @ root), covariance(slopes @ free), rtol=1e-9, atol=1e-9)


def test_what_recalibration_does_not_move_is_no_part_of_it():
    known = Uncertainty.of({"friction.initial_load": Deviation(0.3), "friction.stribeck_exponent": Deviation(0.3)})
    np.testing.assert_allclose(prior_root(DRIVE, 0.02, known), tolerated(0.02), atol=1e-12)


def test_recalibration_moves_parameters_by_factors_and_the_force_by_newtons():
    b = np.zeros(len(NAMES))
    b[NAMES.index("mass")], b[NAMES.index(FORCE)], b[NAMES.index(DELAY)] = np.log(1.1), 7.0, 0.03
    tilted = dataclasses.replace(DRIVE, plant=dataclasses.replace(DRIVE.plant, constant_force=2.0))
    moved = calibrated(tilted, jnp.asarray(b))
    assert float(moved.plant.mass) == pytest.approx(1.1 * float(DRIVE.plant.mass))
    assert float(moved.plant.constant_force) == pytest.approx(9.0)
    assert float(fraction_of_delay(moved) - fraction_of_delay(tilted)) == pytest.approx(0.03)
