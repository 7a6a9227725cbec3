"""What `real-axes` withholds of a published model, and what it says of what came of it."""

from types import SimpleNamespace

import pytest
from rich.console import Console
from typer.testing import CliRunner

from diffdrive.errors import ParameterError
from experiments.cli import main as cli
from experiments.reports.report import Report
from experiments.studies import real_axes
from tuning.diagnosis.judgement.verdict import Belief


def test_one_term_is_withheld_and_nothing_found_is_no_error(monkeypatch):
    nothing = SimpleNamespace(verdict=SimpleNamespace(verdict="unknown", beliefs=[], says="nothing explains it"))
    record = SimpleNamespace(log=SimpleNamespace(command=0.0))
    stubs = {"identify_axis": SimpleNamespace(drive=real_axes.emps.reference_drive()), "force_error": 5.0}
    stubs |= {"_scaled": None, "_diagnose": nothing, "registered": None, "augmented_drive": None}
    for name, value in stubs.items():
        monkeypatch.setattr(real_axes, name, lambda *_, value=value, **__: value)
    monkeypatch.setattr(real_axes.emps, "find_folder", lambda: "here")
    monkeypatch.setattr(real_axes.emps, "read_all", lambda _: {"estimation": record, "pulses": record})
    monkeypatch.setattr(real_axes.emps, "controller", lambda _: None)
    report = Report("axes", None, Console(quiet=True))
    real_axes.real_axes(report, "emps", ["delay"])
    assert list(report.data["tables"]) == ["emps_withheld"]
    assert report.data["tables"]["emps_withheld"]["rows"] == [["delay", "unknown", "", "", "not", 5.0, 5.0, 5.0]]
    nothing.verdict.beliefs = [Belief("loop_delay", 0.2, False, 0, 3.0, None, [])]  # tried, not found
    real_axes.real_axes(report, "emps", ["delay"])
    assert report.data["tables"]["emps_withheld"]["rows"][0][2:5] == ["", "", "not"]
    nothing.verdict.beliefs = [Belief("cogging", 0.9, True, 0, 90.0, None, ["loop_delay"])]
    real_axes.real_axes(report, "emps", ["delay"])
    assert report.data["tables"]["emps_withheld"]["rows"][0][2:5] == ["cogging", "loop_delay", "as a rival"]


def test_what_was_diagnosed_of_real_axes_is_kept_when_it_is_interrupted(monkeypatch):
    done = []

    def one(report, records, term, *_):
        if done:
            raise KeyboardInterrupt
        done.append(term)
        return [term, "effect", "", "", True, 1.0, 2.0, 1.0]

    monkeypatch.setattr(real_axes, "_withheld_row", one)
    report = Report("axes", None, Console(quiet=True))
    with pytest.raises(KeyboardInterrupt):
        real_axes._emps_withheld(report, None, {"delay": None, "gain": None}, None)
    assert [row[0] for row in report.data["tables"]["emps_withheld"]["rows"]] == ["delay"]


@pytest.mark.parametrize(("axis", "says"), [("emps", "no such term"), ("all", "--axis emps")])
def test_a_term_that_is_not_there_is_refused(axis, says):
    result = CliRunner().invoke(cli.app, ["real-axes", "--axis", axis, "--term", "nonsense"])
    assert isinstance(result.exception, ParameterError)
    assert says in str(result.exception)
