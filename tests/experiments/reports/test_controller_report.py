"""What `diffdrive check --controller` prints and writes."""

from dataclasses import replace

import diffdrive as dd
from diffdrive.axis import Sampling
from diffdrive.controllers import UnknownController
from diffdrive.logs import write_log
from diffdrive.model.trace import Trace
from experiments.reports.controller import _row
from experiments.reports.log_checks import check_logs
from experiments.studies.controller_study import NaiveCascade
from tuning.identification.controller.gains import Gain

CASCADE = NaiveCascade()


def test_gains_are_printed_and_written_into_the_drive_file(tmp_path, capsys):
    log, drive, out = tmp_path / "lap.csv", tmp_path / "drive.toml", tmp_path / "out"
    write_log(log, CASCADE.log(4.0, seed=1))
    axis = replace(dd.paper_axis(), controller=UnknownController(), sampling=Sampling(4000.0), trace=Trace(rate=1000.0))
    axis.write(drive)
    check_logs([log], drive, out, controller=True)
    assert "reset_time" in capsys.readouterr().out
    assert (out / "controller.csv").exists()
    written = dd.read_axis(out / "controller.toml").controller
    assert abs(float(written.kp) / CASCADE.kp - 1.0) < 0.02


def test_a_gain_that_may_be_zero_has_an_interval_and_no_value():
    assert _row(Gain("ki", "N/m", 3.0, -21.0, 27.0, False)) == ["ki", "N/m", None, "-21 to 27"]
    assert _row(Gain("kv", "N*s/m", 12170.0, 12150.0, 12190.0, True)) == ["kv", "N s/m", "12170", "12150 to 12190"]
    assert _row(Gain("reset_time", "s", 0.5, 0.25, float("inf"), False))[2:] == [None, "at least 0.25"]
