"""Fits as far as the search and the verdict look at them."""

from types import SimpleNamespace

import numpy as np

from tuning.diagnosis.calibration import NAMES

SEARCHED = ("backlash", "compliance")


def hypothesis(*effects, evidence, strain=0.0, coarse=False):
    """A fit with these effects, of this evidence, that moves a nominal parameter by `strain` tolerances."""
    members = tuple(
        SimpleNamespace(candidate=SimpleNamespace(name=one, searched=one in SEARCHED, parameters=(one,)))
        for one in effects
    )
    model = SimpleNamespace(members=members, added=len(effects), coarse=coarse, possible=lambda u: True)
    return SimpleNamespace(model=model, evidence=evidence, cost=evidence, u=np.r_[strain, np.zeros(len(NAMES) - 1)])
