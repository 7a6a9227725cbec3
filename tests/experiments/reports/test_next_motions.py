"""What `diffdrive identify` says of the motions that would determine the rest."""

import dataclasses
import io
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

import diffdrive as dd
from diffdrive.controllers import UnknownController
from experiments.reports.identification.identification import _next_motions
from experiments.reports.report import Report
from tuning.experiment_design.next_motion import Proposal

KNOWN = dd.paper_axis("pd")
UNKNOWN = dataclasses.replace(KNOWN, controller=UnknownController())
SECOND_LOAD = Proposal("friction.load_coefficient", "any sliding motion under a second load", "1", np.inf, np.nan)
SINE = Proposal("friction.bristle_damping", "sine:amplitude=5um,frequency=5Hz,duration=3s", "N*s/m", np.inf, 12.0)


@pytest.mark.parametrize(
    ("axis", "offers", "undetermined", "said", "can_be_tried"),
    [
        (UNKNOWN, (SECOND_LOAD,), 1, None, False),
        (UNKNOWN, (SECOND_LOAD,), 2, "No motion is proposed for the others: without a controller", False),
        (UNKNOWN, (), 1, "No motion is proposed: without a controller", None),
        (KNOWN, (), 1, "No motion is proposed: the axis limits", None),
        (KNOWN, (SECOND_LOAD, SINE), 2, None, True),
    ],
)
def test_a_motion_is_offered_to_be_tried_only_where_one_can_be_simulated(
    axis, offers, undetermined, said, can_be_tried
):
    written = io.StringIO()
    fit = SimpleNamespace(open_unknowns=frozenset(str(k) for k in range(undetermined)))
    result = SimpleNamespace(fit=fit, next_motions=offers, initial_axis=axis)
    with Report("identification", None, Console(file=written, width=200)) as report:
        _next_motions(report, result)
    text = written.getvalue()
    assert ("No motion is proposed" not in text) if said is None else (said in text)
    assert ("What would determine the rest" in text) is (can_be_tried is not None)
    assert ("simulate --motion" in text) is bool(can_be_tried)
