"""The linear recursion ranks the points of a grid as differences of the filter do."""

import numpy as np
import pytest

from diffdrive.effects.forces import Cogging, ConstantForce
from diffdrive.effects.friction import PreslidingHysteresis
from diffdrive.effects.transmission import Backlash, Compliance
from tests.support.perturbed_machine import catalogue, fitter_of
from tuning.diagnosis.hypotheses.calibration import NAMES, TOLERANCE
from tuning.diagnosis.selection.screening import _screened, _without_answers, begin, joined, sensitivities
from tuning.diagnosis.selection.search import recalibrated
from tuning.diagnosis.selection.starting_points import starting_points

BRINGS = 20.0  # of evidence: what brings less hardly counts
WITHIN = [
    Compliance(frequency=313.0, damping=0.03, motor_share=0.36, table_friction=0.61),
    Backlash(gap=5e-6, frequency=450.0, damping=0.08, motor_share=0.4, table_friction=0.4),
    PreslidingHysteresis(share=0.95, longest=1e-5, shortest=0.2),
]


@pytest.mark.slow  # minutes: the filter for every point of every grid
@pytest.mark.parametrize("beside", [Cogging(0.00125, 2.0, 1.0), ConstantForce(6.0)], ids=lambda one: one.name)
@pytest.mark.parametrize("within", WITHIN, ids=lambda one: one.name)
def test_the_best_point_of_what_brings_much_is_among_the_first_two(within, beside):
    fitter = fitter_of(within, beside)
    base = recalibrated(fitter, TOLERANCE)
    known = {one.name: one for one in catalogue(fitter, base)}[within.name]
    model = joined(base.model, known)
    values = {one.name: np.array([float(getattr(within, one.name))]) for one in known.parameters}
    first = fitter.fit(model, np.r_[np.zeros(len(NAMES)), begin(model, values)], None, base.filtered.trajectory, 4)
    brought = 0
    for candidate in catalogue(fitter, first):
        if candidate.excludes(known) or not any(one.amplitude for one in candidate.parameters):
            continue
        points = starting_points(first, candidate)
        ranked, exact = (
            np.array([_screened(first, candidate, point, by).evidence for point in points])
            for by in (_without_answers, sensitivities)
        )
        if exact.max() > BRINGS:
            brought += 1
            assert np.argmax(exact) in np.argsort(-ranked)[:2], candidate.name
    assert brought
