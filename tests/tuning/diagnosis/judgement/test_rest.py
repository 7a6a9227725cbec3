"""What was found in some stretches, held against the others."""

import dataclasses

import numpy as np
import pytest

from diffdrive.logs import Log
from tests.support.perturbed_machine import recalibrated_of
from tests.support.sound_log import DRIVE, RATE
from tuning.diagnosis.diagnose import logged_of
from tuning.diagnosis.gap.gap import ForceGap
from tuning.diagnosis.judgement.rest import _by_stretch, _rms, held_against
from tuning.diagnosis.selection.explanation import Explanation
from tuning.identification.informative import cut

FORCE = 3.0  # N


def twice(log, more):
    """The log, and after a pause once more with another force in its command."""
    late = log.time + log.time[-1] + 1.0
    return dataclasses.replace(
        log, name="twice", time=np.r_[log.time, late], position=np.r_[log.position, log.position],
        command=np.r_[log.command, log.command + more], gaps=(len(log.time),),
    )  # fmt: skip


@pytest.fixture(scope="module")
def base():
    return recalibrated_of()[1]


@pytest.fixture(scope="module")
def log(base):
    """The log that the fit is of."""
    lanes = base.model.logged.lanes
    time = np.arange(lanes.position.shape[1]) / RATE
    return Log("once", time=time, position=np.asarray(lanes.position[0]), command=np.asarray(lanes.command[0]))


@pytest.mark.long
@pytest.mark.parametrize("more", [0.0, FORCE])
def test_a_force_that_acts_in_the_rest_alone_is_seen_there(base, log, more):
    whole = twice(log, more)
    once = dataclasses.replace(log, name="twice")
    found = held_against(
        logged_of(DRIVE.drive, [whole]), [whole], [once], Explanation(base, [], base), np.array([1.0, 1e-3])
    )
    assert found.seconds == pytest.approx(len(log.time) / RATE)
    if more:
        assert 0.75 * FORCE < found.missing < 1.05 * FORCE  # a filter that expects a newton makes less of it
        assert found.missing > 10.0 * found.diagnosed
        assert found.start >= log.time[-1]
    else:
        assert found.missing == pytest.approx(found.diagnosed, rel=0.05)
    assert f"{found.missing:.3g} N" in found.says


@pytest.mark.parametrize("thinning", [1, 2])
def test_what_is_missing_stretch_by_stretch_adds_up(thinning):
    rng = np.random.default_rng(3)
    time = np.arange(20_000) / RATE
    log = Log("long", time=time, position=0.0 * time, command=0.0 * time, gaps=(9_000,))
    counts = np.zeros((2, 11_000 // thinning))
    counts[0, : 9_000 // thinning] = counts[1] = 1.0
    force = rng.standard_normal(counts.shape) * counts
    sums = _by_stretch(ForceGap(force, None, None, counts), [log], thinning)
    assert len(sums) == len(cut(log)) > 2
    np.testing.assert_allclose(sums[:, 0].sum(), np.sum(force**2), rtol=1e-3 * thinning)
    assert sums[:, 1].sum() == pytest.approx(counts.sum(), abs=2 * len(sums))
    assert _rms(sums) == pytest.approx(1.0, rel=0.02)
