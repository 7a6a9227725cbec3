"""What closing the gap pays: a lag that the nominal drive does not have costs gains tuned on it their margins."""

import dataclasses

import pytest
from rich.console import Console

from diffdrive.effects.actuator import ActuatorLag
from experiments.reports.diagnosis.payoff import payoff
from experiments.reports.report import Report
from tests.support.sound_log import axis_of
from tuning.gains.plan import TuningPlan

DRIVE = axis_of(rate=4000.0, noise=2e-8)
PLAN = TuningPlan(loads=(0.0, 0.0), machines=1)


@pytest.mark.slow
def test_gains_tuned_on_what_was_found_keep_their_margins_where_others_lose_them(tmp_path):
    lagging = dataclasses.replace(DRIVE, drive=dataclasses.replace(DRIVE.drive, effects=(ActuatorLag(8e-4),)))
    found = payoff(Report("payoff", tmp_path, Console(quiet=True)), DRIVE, lagging, PLAN)
    nominal, augmented = found["tuned on nominal"], found["tuned on augmented"]
    assert augmented["requirements_kept_where_tuned"]
    assert augmented["phase_deg"] > 29.0
    assert nominal["phase_deg"] < 29.0
    assert (tmp_path / "tuned-augmented" / "tuned.toml").exists()
    assert (tmp_path / "payoff.csv").exists()
