"""Logs of a trace that is slower than the control: taken at their own rate, and what they do not show is said."""

import dataclasses

import numpy as np
import pytest

import diffdrive as dd
import tuning
from diffdrive.controllers import Cascade
from diffdrive.errors import LogError
from diffdrive.logs.checks.examine import examine
from diffdrive.model.parameters import Actuator, Sampling, Sensor
from experiments.reports.simulation import write_run
from tuning.checked_logs import CheckedLogs, check_logs
from tuning.identification.workflow import identify_checked

RATE = 4000.0
PLAIN = dataclasses.replace(
    dd.paper_axis("cascade").with_controller(Cascade(60.0, 3e4, 2e5, 1.0)), sampling=Sampling(RATE)
)
DRIVE = dataclasses.replace(PLAIN.drive, sensor=Sensor(1e-8, 2e-9), actuator=Actuator(delay_samples=1))
AXIS = PLAIN.with_drive(DRIVE)
SLOW = dataclasses.replace(AXIS, trace=dd.Trace(rate=1000.0, sample="mean"))
LAP = dd.motion.staircase(speeds=(0.01, 0.05), travel=0.004, acceleration=2.0, dwell=0.05, rate=RATE)


@pytest.fixture(scope="module")
def run():
    return dd.simulate(SLOW, LAP).require_ok()


def test_a_log_is_taken_at_the_rate_of_the_trace_and_what_it_does_not_show_is_said(run, tmp_path):
    log = run.log("slow")
    found = [finding for finding in examine(log, SLOW) if finding.cause == "trace"]
    assert [finding.severity for finding in found] == ["note"]
    assert "the mean of 4 samples of the controller, 1000 of 4000 Hz" in found[0].message
    assert not [finding for finding in examine(log, SLOW) if finding.cause in ("decimated", "other controller", "rate")]
    assert any(finding.cause == "decimated" for finding in examine(log, AXIS))
    write_run(tmp_path / "run.csv", run)
    np.testing.assert_allclose(dd.read_log(tmp_path / "run.csv", SLOW).position, log.position, rtol=1e-12)


def test_a_log_at_another_rate_than_the_traces_is_refused(run):
    log = dataclasses.replace(run, trace=dd.Trace()).log("fast")
    with pytest.raises(LogError, match=r"fast: is sampled at 4000 Hz, \[trace\] rate of the drive file is 1000 Hz"):
        check_logs(SLOW, [log])
    with pytest.raises(LogError, match=r"slow: is sampled at 1000 Hz, .* controller runs at 4000 Hz.* \[trace\] rate"):
        check_logs(AXIS, [run.log("slow")])


@pytest.mark.long
def test_an_axis_is_identified_from_its_slower_trace(run):
    believed = SLOW.replace({"plant.mass": 120.0})
    fixed = ("load_coefficient", "breakaway_gap", "stribeck_velocity", "bristle_stiffness", "bristle_damping")
    checked = check_logs(believed, [run.log("slow")])
    found = identify_checked(
        believed, checked, CheckedLogs((), ()), fixed=fixed, bounds={}, starts=1, seed=0,
        store=None, progress=lambda what, done, most: None,
    )  # fmt: skip
    assert found.axis.value("plant.mass") == pytest.approx(100.0, rel=0.05)
    assert found.axis.drive.actuator == SLOW.drive.actuator
    assert found.axis.trace == SLOW.trace
    assert found.axis.rate == RATE
    assert any("the delay found is that of the trace" in note for note in found.notes)
    assert found.gaps[0].log == "slow"
    assert isinstance(found, tuning.IdentificationResult)
