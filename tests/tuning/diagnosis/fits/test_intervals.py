"""95 % intervals of what was fitted: against repeated noise, wrong forms, coarse effects and rests."""

from types import SimpleNamespace

import numpy as np
import pytest

from diffdrive.effects.forces import EDGE_TIME, ConstantForce, ProcessForce
from diffdrive.effects.friction import AppliedLoad, FrictionDwell
from diffdrive.effects.transmission import Backlash
from tuning.diagnosis.fits.intervals import deviations, parameters
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.priors import LOGARITHM, Parameter

RATE, LANES, SAMPLES = 1000.0, 2, 4000
COUNT = len(NAMES) + 2


def fitted(colour=0.0, seed=0, candidate=None, theta=0.0, velocity=None, beside=()):
    """A fit of random columns to noise; `colour` makes neighbours alike over some 50 samples, in both.

    Of several effects, those `beside` the candidate have nothing free.
    """
    room = np.random.default_rng(seed)
    white = room.standard_normal((COUNT + 1, LANES * SAMPLES))
    if colour:
        kernel = np.exp(-np.arange(200) / 50.0)
        white = np.stack([np.convolve(one, kernel, mode="same") for one in white])
        white /= white.std(axis=1, keepdims=True)
    residual, jacobian = white[0], white[1:].T
    logged = SimpleNamespace(
        lanes=SimpleNamespace(position=np.zeros((LANES, SAMPLES)), counts=np.ones((LANES, SAMPLES))),
        sampling=SimpleNamespace(rate=RATE), owner=(0, 1), starts=np.zeros(LANES), thinning=1,
    )  # fmt: skip
    named = candidate.parameters if candidate else ()
    slots = [(0, one.name, log) for one in named for log in (range(2) if one.session else [None])]
    model = SimpleNamespace(
        logged=logged, slots=slots, prior=np.eye(len(NAMES)),
        members=[SimpleNamespace(candidate=one) for one in (candidate, *beside)],
        values=lambda _: [{"edge": np.array([0.05, 0.05])} if candidate and candidate.effect is AppliedLoad else {}],
    )  # fmt: skip
    velocity = np.ones((LANES, SAMPLES)) if velocity is None else velocity
    return SimpleNamespace(
        model=model, jacobian=jacobian, residual=residual, hessian=jacobian.T @ jacobian + np.eye(COUNT),
        theta=np.full(COUNT, theta), filtered=SimpleNamespace(trajectory=SimpleNamespace(velocity=velocity)),
    )  # fmt: skip


def test_white_residuals_leave_the_curvatures_deviations():
    curved = 1.0 / np.sqrt(LANES * SAMPLES)
    np.testing.assert_allclose(deviations(fitted()), curved, rtol=0.6)
    assert np.mean(deviations(fitted())) == pytest.approx(curved, rel=0.25)


@pytest.mark.long
def test_deviations_are_those_of_repeated_coloured_noise():
    estimates = []
    for seed in range(200):
        one = fitted(colour=1.0, seed=seed)
        estimates.append(np.linalg.solve(one.hessian, one.jacobian.T @ one.residual))
    true = np.std(estimates, axis=0).mean()
    told = np.mean([deviations(fitted(colour=1.0, seed=seed)).mean() for seed in range(20)])
    assert true > 4.0 / np.sqrt(LANES * SAMPLES)  # far more than the curvature says
    assert told == pytest.approx(true, rel=0.2)


@pytest.mark.parametrize(("effect", "spread"), [(Backlash, 0.1), (FrictionDwell, 0.03)])
def test_the_numbers_of_an_effect_whose_details_differ_are_trusted_to_some_per_cent(effect, spread):
    size = Parameter("size", 1e-5, 0.1, LOGARITHM)
    value, (low, high) = parameters(fitted(candidate=Candidate(effect, (size,))), 0)["size"]
    assert value == pytest.approx(1e-5)
    assert (np.log(high / value), np.log(value / low)) == pytest.approx((1.96 * spread,) * 2, rel=0.01)


def test_an_amount_beside_such_an_effect_is_trusted_no_more_than_that_and_its_period_is():
    """A tilt that was fitted beside a play which is not quite the machine's makes up for some of that."""
    named = (Parameter("force", 0.0, 10.0, amplitude=True), Parameter("period", 1e-3, 0.1, LOGARITHM))
    tilt, play = Candidate(ConstantForce, named), Candidate(Backlash, ())
    alone, beside = (parameters(fitted(candidate=tilt, theta=0.7, beside=more), 0) for more in ((), (play,)))
    value, (low, high) = beside["force"]
    assert value == pytest.approx(7.0)
    trusted = np.hypot(1.96 * 0.1 * 7.0, 0.5 * np.ptp(alone["force"][1]))
    assert 0.5 * (high - low) == pytest.approx(trusted, rel=0.01)
    assert np.ptp(alone["force"][1]) < 0.2 * (high - low)
    assert beside["period"] == alone["period"]


def test_a_process_sets_in_over_a_while_and_unseen_while_the_table_sticks():
    velocity = np.ones((LANES, SAMPLES))
    velocity[1, 1000:1509] = 0.0
    start, cosine = (Parameter(name, 1.51, 1e-4, session=True) for name in ("start", "cosine"))
    lows, highs = parameters(fitted(candidate=Candidate(ProcessForce, (start,)), velocity=velocity), 0)["start"][1]
    assert (lows[0], highs[0]) == pytest.approx((1.51 - 0.5 * EDGE_TIME, 1.51 + 0.5 * EDGE_TIME), abs=1e-4)
    assert (lows[1], highs[1]) == pytest.approx((1.0, 1.51 + 0.5 * EDGE_TIME), abs=2e-3)
    amplitudes = parameters(fitted(candidate=Candidate(ProcessForce, (cosine,)), velocity=velocity), 0)["cosine"]
    assert np.ptp(amplitudes[1]) < 1e-3  # it is no time


def test_a_load_put_on_at_rest_is_not_seen_before_the_table_slides():
    velocity = np.ones((LANES, SAMPLES))
    velocity[0, 800:1500] = 0.0
    velocity[1, 3000:3200] = 0.0
    start = Parameter("start", 1.51, 0.01, session=True)
    one = fitted(candidate=Candidate(AppliedLoad, (start,)), velocity=velocity)
    times, (lows, highs) = parameters(one, 0)["start"]
    assert times == [1.51, 1.51]
    assert (lows[0], highs[0]) == pytest.approx((0.8, 1.535), abs=2e-3)
    assert (lows[1], highs[1]) == pytest.approx((1.485, 1.535), abs=2e-3)  # that rest is another time
