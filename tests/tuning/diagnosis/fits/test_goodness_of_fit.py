"""What a fit lacks, and how much of the gap it leaves."""

from types import SimpleNamespace

import numpy as np
import pytest

from diffdrive.model.parameters import Sampling
from tests.support.fake_fits import FakeFitter, fake_fit, no_filter_lost  # noqa: F401
from tests.support.sound_log import DRIVE
from tuning.diagnosis.fits import goodness_of_fit
from tuning.diagnosis.fits.goodness_of_fit import missing_evidence, share_left
from tuning.diagnosis.levels import LACKING

pytestmark = pytest.mark.usefixtures("no_filter_lost")


def test_what_a_fit_lacks_does_not_depend_on_where_its_effects_were_stepped():
    """An effect that remembers rest is another one along another course: that is no force that the filter invented."""

    def at(model, theta, process_noise, trajectory):
        return SimpleNamespace(cost=100.0 * trajectory - 7.0 * float(process_noise[0] > 0.5))

    fitted = SimpleNamespace(
        model=None,
        theta=None,
        recalibrated_drive=DRIVE.drive,
        process_noise=np.array([1.0, 0.1]),
        cost=3.0,
        filtered=SimpleNamespace(trajectory=5.0),
    )
    logged = SimpleNamespace(sampling=Sampling(1e3, 10), of_snapshots=False, command_std=0.0)
    assert missing_evidence(FakeFitter(at=at, logged=logged), fitted) == 7.0


def test_between_snapshots_a_sudden_force_is_none_that_a_model_lacks():
    """A fit that blames all on lasting forces is likelier by 3 than one that may blame each row for itself."""

    def at(model, theta, process_noise, trajectory):
        cost = 100.0 - 50.0 * float(process_noise[0] > 0.5) - 47.0 * float(0.5 < process_noise[1] < 50.0)
        return SimpleNamespace(
            cost=cost if process_noise[0] < 0.5 or process_noise[1] < 0.5 else 60.0, process_noise=process_noise
        )

    def with_process(there, model, processes):
        return min((at(model, None, one, None) for one in processes), key=lambda one: one.cost)

    filtered = SimpleNamespace(trajectory=5.0)
    fitted = SimpleNamespace(
        model=None,
        theta=None,
        recalibrated_drive=DRIVE.drive,
        process_noise=np.array([1.0, 1e-3]),
        cost=50.0,
        filtered=filtered,
    )
    for samples, lacks in ((1, 50.0), (4, 3.0)):
        logged = SimpleNamespace(sampling=Sampling(1e3, 10), of_snapshots=samples > 1, command_std=0.0)
        fitter = FakeFitter(at=at, with_process=with_process, logged=logged, least=1e-3)
        assert missing_evidence(fitter, fitted) == lacks


@pytest.mark.parametrize("base", [1e4, np.inf])
@pytest.mark.parametrize("after", [np.inf, np.nan])
def test_a_filter_that_runs_away_explains_nothing(monkeypatch, base, after):
    ran = {0.0: base, -1.0: after, -2.0: 100.0}
    monkeypatch.setattr(goodness_of_fit, "missing", lambda fitter, one: ran[one.evidence])
    before, runaway, sound = (fake_fit(evidence=one) for one in ran)
    for one, process_noise in ((before, 2.0), (runaway, 1.0), (sound, 0.1)):
        one.process_noise = np.array([process_noise, 0.0])
    assert share_left(None, before, runaway) == 1.0
    assert share_left(None, before, sound) == pytest.approx(1e-2 if np.isfinite(base) else 0.0025)


def test_of_the_forces_that_are_allowed_the_likeliest_counts(monkeypatch):
    """A log of a small force that lasts, which the fit told by a larger sudden one."""
    costs = {(0.0, 2.0): 0.0, (0.0, 1.0): 100.0, (1.0, 1.0): 10.0}
    fitter = FakeFitter(
        logged=SimpleNamespace(of_snapshots=False),
        at=lambda model, theta, forces, along: SimpleNamespace(cost=costs[tuple(forces)]),
    )
    monkeypatch.setattr(goodness_of_fit, "relevant_forces", lambda *_: np.array([1.0, 1.0]))
    fit = fake_fit(evidence=0.0)
    fit.process_noise, fit.filtered = np.array([0.0, 2.0]), SimpleNamespace(trajectory=None)
    assert missing_evidence(fitter, fit) == 10.0


@pytest.mark.parametrize(("after", "left"), [(LACKING, 0.0), (2.0 * LACKING, 0.5)])
def test_of_a_small_gap_nothing_is_left_where_nothing_is_missing_any_more(monkeypatch, after, left):
    """As a share of a gap that is hardly one, what chance leaves would be much."""
    monkeypatch.setattr(goodness_of_fit, "missing", lambda fitter, one: 4.0 * LACKING if not one.evidence else after)
    assert share_left(None, fake_fit(evidence=0.0), fake_fit("cogging", evidence=-80.0)) == left


def test_of_a_filter_that_was_lost_all_along_the_invented_force_counts(monkeypatch):
    monkeypatch.setattr(goodness_of_fit, "missing", lambda fitter, one: 1e4)
    before, after = fake_fit(evidence=0.0), fake_fit("cogging", evidence=-900.0)
    before.process_noise, after.process_noise = np.array([2.0, 0.0]), np.array([0.2, 0.0])
    assert share_left(None, before, after) == 1.0
    monkeypatch.setattr(goodness_of_fit, "is_lost_throughout", lambda *_: True)
    assert share_left(None, before, after) == pytest.approx(0.01)
