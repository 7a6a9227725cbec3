"""Fits as far as the search and the verdict look at them."""

from types import SimpleNamespace

import numpy as np
import pytest

from tuning.diagnosis.fits import goodness_of_fit
from tuning.diagnosis.fits.fitted import last_candidate
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.hypotheses.calibration import NAMES, tolerated
from tuning.diagnosis.selection import explain

SEARCHED = ("backlash", "compliance")


class FakeFitter(SimpleNamespace):
    """A fitter of some methods, by which a true one's others are made."""

    refit, again = Fitter.refit, Fitter.again


def fake_fit(*effects, evidence, max_prior_deviation=0.0, coarse=False):
    """A fit with these effects, of this evidence, that moves a nominal parameter by so many tolerances."""
    members = tuple(
        SimpleNamespace(candidate=SimpleNamespace(name=one, searched=one in SEARCHED, parameters=(one,)))
        for one in effects
    )
    model = SimpleNamespace(
        members=members, added_candidates=[one.candidate for one in members], added=len(effects), coarse=coarse,
        coupled=coarse, possible=lambda theta: True, prior=tolerated(0.02),
        logged=SimpleNamespace(of_snapshots=False, command_std=0.0),
    )  # fmt: skip
    return SimpleNamespace(
        model=model, evidence=evidence, cost=evidence, theta=np.r_[max_prior_deviation, np.zeros(len(NAMES) - 1)]
    )


@pytest.fixture
def no_filter_lost(monkeypatch):
    """No filter is lost, and no effect can be done without."""
    monkeypatch.setattr(explain, "drop_effect", lambda *_: None)
    for module in (explain, goodness_of_fit):
        monkeypatch.setattr(module, "is_lost_throughout", lambda *_: False)


def names(looked):
    """The effects that a round added, best first."""
    return [last_candidate(one).name for one in looked.fits]
