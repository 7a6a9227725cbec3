"""Replay of logs against the simulations that they came from, and the fit that rests on it."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.controllers import DOBVSC, PD, Cascade, DisturbanceObserver
from diffdrive.controllers.base import PDGains, Tracking
from diffdrive.errors import LogError, ParameterError
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.parameters import Actuator, Drive, Friction, Plant, Sampling
from diffdrive.motion.builders import sine
from diffdrive.numerics.arrays import as_arrays
from experiments.studies.emps.closed_loop_fit import fit_closed_loop
from tuning.identification.replay import drift_note, replay, replay_closed_loop, replay_inputs, replay_open_loop

SAMPLING = Sampling(1_000.0, 40)
MOTION = sine(amplitude=0.02, frequency=1.0, duration=1.5, rate=SAMPLING.rate)
LOAD = np.linspace(0.0, 500.0, len(MOTION.time))


def axis(gap=5.0, **actuator):
    friction = Friction(
        coulomb_screw=(20.0, 22.0),
        load_coefficient=0.01,
        initial_load=0.0,
        breakaway_gap=gap,
        stribeck_velocity=5e-3,
        viscous=(150.0, 230.0),
        bristle_stiffness=1e6,
        bristle_damping=3e3,
    )
    return Drive(Plant(mass=95.0, damping=10.0, constant_force=2.0), friction, Actuator(**actuator))


PD_CONTROL = PD(Tracking(PDGains(1e6, 8e3)))
CONTROLLERS = {
    "pd": PD_CONTROL,
    "cascade": Cascade(kp=160.0, kv=8_500.0, velocity_samples=2),
    "dobvsc": DOBVSC(PD_CONTROL.tracking, DisturbanceObserver.of(axis().plant, 30.0)),
}


def logged(drive, controller, load=LOAD):
    return simulate_loop(drive, controller, MOTION, load, sampling=SAMPLING).require_ok().log()


def part(log, piece, **changed):
    signals = {name: signal[piece] for name, signal in log.channels.items()}
    return dataclasses.replace(log, **signals, **changed)


@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("actuator", [{}, {"delay_samples": 1, "delay_fraction": 0.3}], ids=["prompt", "late"])
def test_a_simulated_log_is_replayed_to_itself(name, actuator):
    drive = axis(**actuator)
    found = replay_closed_loop(drive, CONTROLLERS[name], logged(drive, CONTROLLERS[name]), SAMPLING)
    assert found.status.ok
    # not exactly: in a log the table has been moving before, in a simulation it begins at rest on a moving reference
    late = found.time > 0.5
    assert np.max(np.abs(found.command_error[late])) < (1e-3 if name != "dobvsc" else 0.1)


@pytest.mark.parametrize("begin", [120, 430, 780])
@pytest.mark.parametrize("actuator", [{}, {"delay_samples": 1, "delay_fraction": 0.3}], ids=["prompt", "late"])
def test_a_log_that_begins_in_motion_begins_without_a_jolt(begin, actuator):
    drive, controller = axis(**actuator), CONTROLLERS["cascade"]
    log = part(logged(drive, controller), slice(begin, None))
    found = replay_closed_loop(drive, controller, log, SAMPLING)
    assert found.force_percent < 0.2
    assert found.position_rms < 1e-7
    assert found.command_rms == pytest.approx(np.sqrt(np.mean(found.command_error**2)))


def test_each_piece_begins_anew_and_short_ones_are_left_out():
    drive, controller = axis(), CONTROLLERS["cascade"]
    log = logged(drive, controller)
    kept = np.r_[100:600, 700:750, 900:1400]
    found = replay_closed_loop(drive, controller, part(log, kept, gaps=(500, 550)), SAMPLING)
    np.testing.assert_array_equal(found.time, log.time[np.r_[100:600, 900:1400]])
    assert found.force_percent < 0.2
    whole = replay_closed_loop(drive, controller, part(log, slice(900, 1400)), SAMPLING)
    np.testing.assert_allclose(found.command[500:], whole.command, rtol=1e-9)


def test_a_known_disturbance_counts_in_both_forces():
    drive, controller = axis(), CONTROLLERS["cascade"]
    log = logged(drive, controller)
    wrong = eqx.tree_at(lambda d: d.plant.constant_force, drive, 12.0)
    pulses = np.where(MOTION.time % 0.5 < 0.25, 100.0, 0.0)
    plain = replay_closed_loop(wrong, controller, log, SAMPLING)
    pushed = replay_closed_loop(wrong, controller, dataclasses.replace(log, disturbance=pulses), SAMPLING)
    assert np.mean(plain.command_error[200:]) == pytest.approx(-10.0, rel=0.01)
    ratio = pushed.force_percent / pushed.command_rms
    assert ratio == pytest.approx(100 / np.sqrt(np.mean((log.command + pulses) ** 2)))


def test_a_loop_that_runs_away_has_a_status_and_no_nan():
    drive = axis()
    unstable = Cascade(kp=160.0, kv=1e6)
    found = replay_closed_loop(drive, unstable, logged(drive, PD_CONTROL), SAMPLING)
    assert not found.status.ok
    assert "diverged: run: the simulated position leaves the reference" in found.status.message
    assert found.force_percent == found.command_rms == found.position_rms == np.inf


def test_open_loop_follows_an_exact_model_and_drifts_from_a_wrong_one():
    drive, controller = axis(gap=-5.0), CONTROLLERS["cascade"]
    log = logged(drive, controller)
    settled = part(log, slice(250, None))  # at the top of the sine
    exact = replay_open_loop(drive, settled, SAMPLING)
    off = replay_open_loop(eqx.tree_at(lambda d: d.plant.constant_force, drive, 3.0), settled, SAMPLING)
    assert exact.status.ok
    assert exact.position_rms_mm < 0.05
    assert off.position_rms_mm > 1.0
    assert np.sqrt(np.mean((off.position - settled.position) ** 2)) == pytest.approx(1e-3 * off.position_rms_mm)


def test_the_note_tells_how_fast_an_error_grows():
    assert "falling Stribeck curve" not in drift_note(axis(gap=-5.0))
    # 5 N over 5 mm/s less 160 N s/m, on 95 kg
    assert "grows by a factor e in 1.1e+02 ms" in drift_note(axis(gap=5.0))


def test_what_cannot_be_replayed_is_said():
    drive, controller = axis(), CONTROLLERS["cascade"]
    log = logged(drive, controller)
    with pytest.raises(LogError, match="run: has no reference"):
        replay_closed_loop(drive, controller, dataclasses.replace(log, reference=None))
    with pytest.raises(ParameterError, match="sampled at 1000 Hz"):
        replay_closed_loop(drive, controller, log, Sampling(2_000.0))
    with pytest.raises(LogError, match="no stretch of 200 samples"):
        replay_closed_loop(drive, controller, part(log, slice(0, 150)))


def test_the_replay_is_differentiable():
    drive, controller = axis(), CONTROLLERS["cascade"]
    log = logged(drive, controller)
    at = replay_inputs([log])
    models = as_arrays((drive, controller))

    def command(mass):
        changed = eqx.tree_at(lambda d: d.plant.mass, models[0], mass)
        return replay(changed, models[1], at, SAMPLING).command

    mass = jnp.asarray(95.0)
    slope = jax.jacfwd(command)(mass)
    numeric = (command(mass + 0.01) - command(mass - 0.01)) / 0.02
    np.testing.assert_allclose(slope, numeric, atol=1e-4)


@pytest.mark.long
def test_the_closed_loop_fit_finds_the_drive_behind_a_log():
    truth, controller = axis(gap=(-6.0, -8.0), delay_samples=1, delay_fraction=0.3), CONTROLLERS["cascade"]
    log = part(logged(truth, controller, 0.0), slice(100, None))  # a fit sees no start from rest
    believed = axis(gap=1e-3, delay_samples=1)
    believed = eqx.tree_at(lambda d: (d.plant.mass, d.plant.constant_force), believed, (120.0, 0.0))
    found, search = fit_closed_loop([log], believed, controller)
    assert search.cost < 0.05 < 1.0 < search.initial_cost
    assert search.cost == pytest.approx(replay_closed_loop(found, controller, log).force_percent, abs=0.03)
    assert found.plant.mass == pytest.approx(95.0, rel=0.01)
    assert found.friction.viscous.negative == pytest.approx(230.0, rel=0.02)
    assert found.friction.breakaway_gap.negative == pytest.approx(-8.0, rel=0.1)
    assert found.actuator.delay_samples == 1
    assert found.actuator.delay_fraction == pytest.approx(0.3, abs=0.05)
    assert found.friction.load_coefficient == believed.friction.load_coefficient  # one load: not free


@pytest.mark.long
def test_a_fit_leaves_what_is_fixed():
    truth, controller = axis(gap=-6.0), CONTROLLERS["cascade"]
    log = part(logged(truth, controller, 0.0), slice(100, None))
    fixed = ("breakaway_gap", "stribeck_velocity", "bristle_stiffness", "bristle_damping", "delay", "mass")
    found, search = fit_closed_loop([log], axis(gap=-3.0), controller, axis(gap=-3.0), fixed=fixed, max_steps=4)
    assert search.cost < search.initial_cost
    assert found.plant.mass == 95.0
    assert found.friction.breakaway_gap.positive == pytest.approx(-3.0)
    assert found.friction.bristle_damping.negative == 3e3
    assert found.actuator.delay_fraction == 0.0
    assert found.friction.coulomb_screw.positive != 20.0


def test_what_cannot_be_fitted_is_said():
    drive, controller = axis(), CONTROLLERS["cascade"]
    log = logged(drive, controller)
    with pytest.raises(ParameterError, match="cannot fix 'weight'; known: mass,"):
        fit_closed_loop([log], drive, controller, fixed=["weight"])
    with pytest.raises(LogError, match="all of one rate"):
        fit_closed_loop([log, part(log, slice(None, None, 2))], drive, controller)
