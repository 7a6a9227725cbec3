"""How far the comparing filter trusts a model, and whether it is lost with that."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.fake_fits import FakeFitter
from tuning.diagnosis.fits import reference_noise
from tuning.diagnosis.fits.fitting import LEAST
from tuning.diagnosis.judgement import ladder

SAMPLES = 1000


def lost_with(share, screw=False):
    """A fitter whose filter is lost at that share of the samples, by the process forces (N): lasting, then sudden."""
    counts = np.ones((1, SAMPLES))
    model = SimpleNamespace(logged=SimpleNamespace(lanes=SimpleNamespace(counts=counts)), screw=screw)

    def at(_, theta, process_noise, trajectory):
        innovation = np.zeros((1, SAMPLES))
        innovation[0, : round(share(*process_noise) * SAMPLES)] = np.nan if share(*process_noise) == 1.0 else 10.0
        return SimpleNamespace(filtered=SimpleNamespace(normalised_innovation=innovation, trajectory=None))

    base = SimpleNamespace(model=model, theta=None, filtered=SimpleNamespace(trajectory=None))
    base._replace = lambda filtered: SimpleNamespace(model=model, filtered=filtered)
    return FakeFitter(at=at, logged=model.logged), base


@pytest.mark.parametrize(
    ("share", "more"),
    [
        (lambda force, _: 0.0, 1.0),
        (lambda force, _: 0.2 if force < 5.0 else 0.001, 10.0),
        (lambda force, _: 1.0 if force < 50.0 else 0.0, 100.0),  # one that runs away is lost as well
        (lambda force, _: 0.2, 1.0),  # blows: no trust helps
    ],
)
def test_a_filter_is_trusted_as_far_as_it_is_not_lost(monkeypatch, share, more):
    monkeypatch.setattr(reference_noise, "least_trusted", lambda _: np.array([1.0, LEAST]))
    np.testing.assert_allclose(reference_noise.reference_process_noise(*lost_with(share)), [more, LEAST])


@pytest.mark.parametrize(("screw", "wanted"), [(True, [1.0, 1.0]), (False, [10.0, LEAST])])
def test_behind_a_screw_a_filter_may_be_told_of_blows(monkeypatch, screw, wanted):
    monkeypatch.setattr(reference_noise, "least_trusted", lambda _: np.array([1.0, LEAST]))
    given = lost_with(lambda lasting, sudden: 0.2 if lasting + 10.0 * sudden < 5.0 else 0.0, screw)
    np.testing.assert_allclose(reference_noise.least_following(*given), wanted)


@pytest.mark.parametrize(
    ("screw", "lost", "own", "told_with"),
    [
        (False, True, 2.0, 2.0),
        (False, False, 2.0, 200.0),
        (False, True, None, 200.0),
        (True, False, 2.0, 2.0),  # what it explains would drown in the noise of the other
        (True, False, 2000.0, 200.0),
        (True, False, None, 200.0),
    ],
)
def test_a_model_that_is_lost_in_the_others_filter_is_told_by_one_of_its_own(monkeypatch, screw, lost, own, told_with):
    """In that of the recalibrated drive, of 200 N; where none follows it, it is told to be lost."""

    def gap_of(fitter, one, process_noise):
        return SimpleNamespace(is_known=process_noise[0] < 200.0 or not lost)

    monkeypatch.setattr(ladder, "force_gap", gap_of)
    monkeypatch.setattr(ladder, "least_following", lambda *_: None if own is None else np.array([own, LEAST]))
    gap, process_noise = ladder._told_by(
        None, SimpleNamespace(model=SimpleNamespace(screw_found=screw), theta=None), np.array([200.0, LEAST])
    )
    assert process_noise[0] == told_with
    assert gap.is_known == (own is not None or not lost)
