"""A trace that is slower than its loop: read as snapshots, and its mass found."""

import dataclasses

import numpy as np
import pytest

from experiments.studies.recovery.excitation import identification_motion
from experiments.studies.recovery.truth import truth_log
from tests.support.known_machine import BELIEVED, GAINS, MACHINE
from tuning.identification.identify import identify
from tuning.identification.row_force import BetweenRows

RATE, RATIO = 4_000.0, 4


def every(log, ratio):
    """Each so many rows of a log."""
    names = [one.name for one in dataclasses.fields(log) if isinstance(getattr(log, one.name), np.ndarray)]
    return dataclasses.replace(log, **{name: getattr(log, name)[::ratio] for name in names})


@pytest.fixture(scope="module")
def log():
    return truth_log(MACHINE, GAINS, identification_motion(RATE), 0.0, seed=3)


@pytest.mark.slow
def test_a_slow_trace_is_read_as_snapshots_and_its_mass_is_the_machines(log):
    found = identify([every(log, RATIO)], BELIEVED, starts=2)
    assert found.between is BetweenRows.SMOOTH
    assert any("snapshots" in note for note in found.notes)
    mass, delay = (next(one for one in found.estimates if one.name == name) for name in ("mass", "delay"))
    assert mass.value == pytest.approx(float(MACHINE.plant.mass), rel=2e-3)
    assert mass.low <= float(MACHINE.plant.mass) <= mass.high
    assert delay.value == pytest.approx(0.5 / RATIO, abs=0.05)  # a held command acts half a period of its loop later


@pytest.mark.slow
def test_a_trace_of_every_sample_is_read_as_held(log):
    found = identify([log], BELIEVED, starts=2)
    assert found.between is BetweenRows.HELD
    assert not any("snapshots" in note for note in found.notes)
