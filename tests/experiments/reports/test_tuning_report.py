"""What `tune` prints and what its result says are the same sentences."""

from types import SimpleNamespace

from experiments.reports import tuning
from experiments.reports.report import Report


def test_the_notes_are_those_of_the_result_each_once_and_after_the_verdict(monkeypatch, capsys):
    for part in ("gains_table", "margins_table", "loop_figures", "verification_table", "tuning_figure"):
        monkeypatch.setattr(tuning, part, lambda *_: None)
    monkeypatch.setattr(tuning, "verdict", lambda *_: "NOT ACCEPTED")
    notes = ("Held back by the command noise.", "the run at 8 kN diverged")
    setup = SimpleNamespace(limits=None, notes=notes[:1], friction=True)
    result = SimpleNamespace(
        notes=notes, setup=setup, accepted=False, initial_axis=SimpleNamespace(controller=None), runs=(), plan=None,
        search=SimpleNamespace(controller=None), loop_margins=(), measured_margins=(),
    )  # fmt: skip
    report = Report("tuning", None)
    tuning.report_tuning(report, result)
    assert sorted(report.data["notes"]) == sorted(["NOT ACCEPTED", *notes])
    printed = capsys.readouterr().out
    assert printed.index("NOT ACCEPTED") < printed.index(notes[0]) < printed.index(notes[1])
