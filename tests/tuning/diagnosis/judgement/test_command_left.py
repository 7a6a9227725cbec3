"""Residual analysis: an actuator that is as late as the right one and yet another, and what only looks like it."""

import dataclasses
import itertools
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.effects.actuator import ActuatorLag, LoopDelay
from diffdrive.effects.forces import Cogging
from tests.support.perturbed_machine import catalogue, fitter_of
from tests.support.sound_log import axis_of, simulate_log, two_sines
from tuning.diagnosis.diagnose import logged_of
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.hypotheses.calibration import TOLERANCE
from tuning.diagnosis.judgement import command_left
from tuning.diagnosis.judgement.command_left import (
    CLOCKS,
    FOLLOWING,
    FOLLOWS,
    TAPS,
    downgraded_by_command,
    follows_command,
)
from tuning.diagnosis.judgement.verdict import Belief, Verdict
from tuning.diagnosis.levels import WORTH
from tuning.diagnosis.selection.explain import explain
from tuning.diagnosis.selection.explanation import Explanation
from tuning.diagnosis.selection.search import Round, recalibrated

LATE = {"actuator_lag": ActuatorLag(6e-4), "loop_delay": LoopDelay(1.2)}


def explained(late, seed):
    """A machine whose actuator is late, with the noise of a seed: explained as it is, and as what it is not."""
    fitter = fitter_of(LATE[late], seed=seed)
    base = recalibrated(fitter, TOLERANCE)
    known = {one.name: one for one in catalogue(fitter, base)}
    told = {name: explain(fitter, base, [known[name]], lambda *_: None, 1) for name in LATE}
    right = told.pop(late)
    return right, next(iter(told.values()))


@pytest.fixture(scope="module", params=sorted(LATE))
def late(request):
    return explained(request.param, seed=2)


@pytest.mark.long
def test_a_delay_is_told_from_a_lag_by_what_follows_the_command(late):
    for found in late:
        assert found.base.evidence - found.best.evidence > 1000.0  # either explains much
    right, wrong = (follows_command(found.best) for found in late)
    assert right < 0.5 * FOLLOWING
    assert wrong > max(FOLLOWING, FOLLOWS * (late[1].base.evidence - late[1].best.evidence))


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(LATE))
def test_it_is_told_whatever_the_noise(name):
    """What the wrong one leaves hangs on it: 30 with one of these for the lag, too little, 61 and more else."""
    told = [[follows_command(found.best) for found in explained(name, seed)] for seed in range(1, 6)]
    assert max(right for right, _ in told) < 0.5 * FOLLOWING
    assert sum(wrong > 1.5 * FOLLOWING for _, wrong in told) >= 4


@pytest.mark.long
def test_to_first_order_it_is_what_those_commands_explain(late):
    """Against the filter itself, run with the commands added to what acts on the table."""
    best = late[1].best
    logged, amounts = best.model.logged, np.full(TAPS, 1e-4) * np.array([1.0, -2.0, 1.0, 0.5, -0.5])
    added = command_left._last_commands(best) @ amounts
    lanes = logged.lanes._replace(disturbance=logged.lanes.disturbance + added)
    moved = (
        Fitter(logged._replace(lanes=lanes))
        .at(best.model, best.theta, best.process_noise, best.filtered.trajectory)
        .filtered
    )
    change = (np.asarray(moved.innovation) - np.asarray(best.filtered.innovation)) / np.asarray(
        best.filtered.innovation_std
    )
    answers = command_left._answers(best).reshape(*change.shape, TAPS)
    expected = answers @ amounts * np.sqrt(float(best.filtered.noise_scale_sq))
    assert np.linalg.norm(change - expected) < 0.05 * np.linalg.norm(expected)


@pytest.mark.long
def test_one_event_that_goes_wrong_is_no_answer_to_commands(late):
    """As much as a wrong actuator leaves all along, in one tenth of a second."""
    best = late[0].best
    rate = best.model.logged.sampling.rate
    answers = command_left._answers(best) @ np.array([1.0, -1.0, 0.0, 0.0, 0.0])
    answers = answers.reshape(best.filtered.trajectory.velocity.shape)
    quick = int(np.argmax(np.abs(np.asarray(best.filtered.trajectory.velocity[0]))))
    there = np.abs(np.arange(answers.shape[1]) - quick) < 0.05 * rate
    blow = np.where(there, answers, 0.0)
    struck = best._replace(residual=best.residual + 30.0 * (blow / np.linalg.norm(blow)).ravel())
    told = follows_command(struck) - follows_command(best)
    assert abs(told) < 3 * WORTH < 0.1 * 30.0**2


@pytest.mark.long
@pytest.mark.parametrize(
    ("speed", "noise", "told"), [(1e-3, 3e-8, False), (1e-3, 3e-9, True), (4e-4, 3e-9, False), (0.1, 3e-8, True)]
)
def test_a_table_that_is_slow_for_its_scale_or_hardly_slides_tells_nothing(late, speed, noise, told):
    best = late[1].best
    there = best.filtered.trajectory._replace(velocity=jnp.full_like(best.filtered.trajectory.velocity, speed))
    model = dataclasses.replace(best.model, logged=best.model.logged._replace(noise=noise))
    follows = follows_command(best._replace(model=model, filtered=best.filtered._replace(trajectory=there)))
    assert (abs(follows) > 1e-6) == told


def test_the_commands_are_those_that_act_by_the_model_and_the_one_before():
    """Of two thinned logs with a claimed delay, of three samples with what was found: from the second sample on."""
    late = axis_of(rate=4000.0, delay=3)
    both = logged_of(late.drive, [simulate_log(late, two_sines(0.8, 4000.0), seed=k) for k in (1, 2)])
    assert both.thinning == 2
    found = SimpleNamespace(
        model=SimpleNamespace(effects=lambda theta: (LoopDelay(np.array([1.6, 1.6])),), logged=both),
        theta=None,
        recalibrated_drive=late.drive,
    )
    asked = command_left._last_commands(found)
    assert asked.shape == (*both.lanes.command.shape, TAPS)
    for k in range(TAPS):
        assert np.array_equal(asked[:, 10:, k], both.lanes.command[:, 10 - 2 - k : -2 - k])
        assert np.array_equal(asked[:, 0, k], both.lanes.command[:, 0])


@pytest.mark.parametrize(
    ("follows", "chain", "details", "verdict"),
    [
        (2.0 * FOLLOWING, ((LoopDelay, 1e3),), None, "unknown"),
        (0.9 * FOLLOWING, ((LoopDelay, 1e3),), None, "effect"),
        (2.0 * FOLLOWING, ((LoopDelay, 4.0 * FOLLOWING / FOLLOWS),), None, "effect"),
        (2.0 * FOLLOWING, ((Cogging, 4.0 * FOLLOWING / FOLLOWS), (LoopDelay, 1e3)), None, "unknown"),
        (0.9 * CLOCKS, ((Cogging, 1e3),), None, "effect"),
        (1.1 * CLOCKS, ((Cogging, 1e3),), None, "unknown"),
        (1.1 * CLOCKS, ((Cogging, 2.0 * CLOCKS / FOLLOWS),), None, "effect"),
        (2.0 * FOLLOWING, ((LoopDelay, 1e3),), "coarse", "effect"),
        (2.0 * FOLLOWING, ((LoopDelay, 1e3),), "coupled", "effect"),
        (np.nan, ((LoopDelay, 1e3),), None, "effect"),
    ],
)
def test_no_cause_is_sure_that_leaves_what_follows_the_command(monkeypatch, follows, chain, details, verdict):
    """More than beside right ones, and no trifle of what the effect between command and force explained; without one,
    more than clocks make that are a little apart."""
    monkeypatch.setattr("tuning.diagnosis.judgement.command_left.follows_command", lambda _: follows)
    fits = [SimpleNamespace(cost=0.0)]
    for effect, gain in chain:
        member = SimpleNamespace(candidate=SimpleNamespace(effect=effect))
        model = SimpleNamespace(
            members=(member,), added=len(chain), coarse=details == "coarse", coupled=details == "coupled"
        )
        fits.append(SimpleNamespace(cost=fits[-1].cost - gain, model=model))
    rounds = [Round(before, [], [one], 1, 0.0) for before, one in itertools.pairwise(fits)]
    believed = Verdict(
        "effect", [Belief("loop_delay", 0.9, True, 0, 1e3, None, [])], 0.0, "loop_delay explains the gap"
    )
    judged = downgraded_by_command(believed, Explanation(fits[0], rounds, fits[-1]))
    assert judged.verdict == verdict
    assert judged.beliefs[0].confidence == (0.9 if verdict == "effect" else 0.5)
