"""The withheld-effect check: what is asked again, what the answering process is given, what becomes of answers."""

import json
import os
import subprocess
import sys
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from diffdrive.errors import ParameterError
from diffdrive.logs import Log
from diffdrive.support.atomic_write import temporary_beside
from experiments.cli import main as cli
from experiments.reports.report import Report
from experiments.studies.withheld import answer, generate, study
from experiments.studies.withheld.draw import draw


@pytest.fixture
def integrated(monkeypatch):
    """Logs without integration; what was asked for."""
    asked = []

    def log_of(case, log, peak=None):
        asked.append((log, peak))
        reference = case.inputs[log].reference
        time = np.arange(len(reference)) / case.rate
        return Log("ab"[log], time, reference, 0.0 * reference + 100.0, reference=reference)

    monkeypatch.setattr(generate, "_simulate_log", log_of)
    return asked


def test_cases_that_are_there_are_not_integrated_again(tmp_path, integrated):
    cases, parts = tmp_path / "cases", tmp_path / "key_parts"
    names = list(generate.generate(cases, parts, 0, 4))
    key = generate.write_key(tmp_path / "key.json", parts)
    assert names == sorted(key) == ["001", "002", "003", "004"]
    assert integrated
    (cases / "002" / "drive.toml").unlink()
    integrated.clear()
    assert list(generate.generate(cases, parts, 0, 4)) == names
    assert {log for log, _ in integrated} == {0, 1}
    assert len(integrated) <= 3  # of the one case that was not finished
    assert generate.write_key(tmp_path / "key.json", parts) == key
    with pytest.raises(ParameterError, match="another seed"):
        list(generate.generate(cases, parts, 1, 4))


def test_a_limit_lies_below_the_peak_of_the_first_log(integrated):
    logs, peak = generate._simulate_logs(draw(np.random.default_rng([3, 1, 0]), ("force_limit",)))
    assert len(logs) == 2
    assert peak == 100.0
    assert integrated == [(0, None), (0, 100.0), (1, 100.0)]


def machine(place):
    """A folder that looks like a case."""
    place.mkdir(parents=True)
    for name in ("drive.toml", "log-a.parquet", "notes.txt"):
        (place / name).write_text("")
    return place


def test_an_answer_that_fails_is_an_error_and_whole(tmp_path, monkeypatch, capfd):
    def fails(place, without):
        raise ValueError("no such thing")

    monkeypatch.setattr(answer, "diagnose_case", fails)
    path = tmp_path / "answers" / "1" / "diagnosis.json"
    answer._diagnose_batch([(machine(tmp_path / "1"), path, ())])
    assert capfd.readouterr().out == "1 error []\n"
    told = json.loads(path.read_text())
    assert told.pop("question") == answer.task_digest(tmp_path / "1", ())
    assert told == {"verdict": "error", "says": "ValueError: no such thing", "causes": []}
    assert list(path.parent.iterdir()) == [path]


def test_cases_of_a_length_are_asked_in_one_process_the_longest_first_and_none_is_lost(tmp_path):
    for number in range(25):
        (place := tmp_path / f"{number:02d}").mkdir()
        rows = (1990 if number % 2 else 2000) if number < 23 else 4000
        pd.DataFrame({"time": np.arange(rows)}).to_parquet(place / "log-a.parquet")
    machine(tmp_path / "unreadable")
    groups = answer._batches([(place, tmp_path, ()) for place in sorted(tmp_path.iterdir())])
    named = [[place.name for place, _, _ in some] for some in groups]
    assert named[0] == ["23", "24"]
    assert named[-1] == ["unreadable"]
    assert [name for some in named[1:-1] for name in some] == [f"{number:02d}" for number in range(23)]
    assert max(map(len, named)) == answer.BATCH


def answered(place, out, without=()):
    """An answer that is there."""
    path = out / place.name / "diagnosis.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    told = {"verdict": "none", "causes": [], "question": answer.task_digest(place, without)}
    path.write_text(json.dumps(told))
    return told


def test_answers_that_are_there_are_left_alone_and_half_of_one_is_none(tmp_path):
    cases, out = tmp_path / "cases", tmp_path / "answers"
    for name in "123":
        machine(cases / name)
        (out / name).mkdir(parents=True)
    told = answered(cases / "1", out)
    temporary_beside(out / "2" / "diagnosis.json").write_text('{"verdict": ')
    assert [one.name for one in answer.unanswered(cases, out)] == ["2", "3"]
    assert [one.name for one in answer.unanswered(cases, out, {"1": [], "3": []})] == ["3"]
    answer.main(cases, out, 1, {"1": []})  # nothing is asked
    assert json.loads((out / "1" / "diagnosis.json").read_text()) == told


def test_an_answer_to_another_question_is_none(tmp_path):
    cases, out = tmp_path / "cases", tmp_path / "answers"
    answered(machine(cases / "1"), out, ("cogging", "backlash"))
    assert answer.unanswered(cases, out, {"1": ["backlash", "cogging"]}) == []
    assert answer.unanswered(cases, out, {"1": ["backlash"]})
    (cases / "1" / "log-a.parquet").write_text("another machine")
    assert answer.unanswered(cases, out, {"1": ["backlash", "cogging"]})


def test_a_case_that_kills_its_process_is_an_error_and_the_others_are_answered(tmp_path, monkeypatch):
    cases, out = tmp_path / "cases", tmp_path / "answers"
    for name in "123":
        machine(cases / name)

    def ask(questions, workers):
        for place, _, without in questions:
            if place.name == "2":
                raise BrokenProcessPool("was terminated abruptly")
            answered(place, out, without)

    monkeypatch.setattr(answer, "_diagnose_all", ask)
    answer.main(cases, out, 2)
    verdicts = {name: json.loads((out / name / "diagnosis.json").read_text())["verdict"] for name in "123"}
    assert verdicts == {"1": "none", "2": "error", "3": "none"}
    assert answer.unanswered(cases, out) == []


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="processes are listed in /proc on Linux only")
def test_whoever_asks_no_more_leaves_no_process_behind(tmp_path):
    """The answering process is told to end while it has cases left: so do the processes that it began."""
    for k in range(6):
        machine(tmp_path / "cases" / str(k))
    command = [sys.executable, "-m", "experiments.studies.withheld.answer", "cases", "answers", "2"]
    environment = os.environ | {"PYTHONPATH": str(study.REPOSITORY)}
    process = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True)
    process.stdout.readline()  # the first is answered
    began = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.terminate()
    process.communicate(timeout=60)
    assert began
    assert [
        one for one in began if Path(f"/proc/{one}/cmdline").exists() and Path(f"/proc/{one}/cmdline").read_text()
    ] == []


SPY = """
import json, pathlib, sys
from experiments.studies.withheld.answer import task_digest
cases, answers, workers, without, _ = sys.argv[1:]
left_out = json.loads(pathlib.Path(without).read_text())
here = pathlib.Path.cwd()
seen = sorted(str(one.relative_to(here)) for one in here.rglob("*") if one.is_file())
links = [str(one) for one in here.rglob("*") if one.is_symlink()]
for place in pathlib.Path(cases).iterdir():
    path = pathlib.Path(answers) / place.name / "diagnosis.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({
        "verdict": "none", "causes": [], "seen": seen, "cwd": str(here), "links": links, "argv": sys.argv[1:],
        "without": left_out, "question": task_digest(place, (left_out or {}).get(place.name, ())),
    }))
    print(place.name, flush=True)
if "fail" in json.dumps(seen):
    sys.exit(3)
"""


@pytest.fixture
def spied(tmp_path, monkeypatch):
    """In the place of the answering process one that says what it can see."""
    spy = tmp_path / "spy.py"
    spy.write_text(SPY)
    monkeypatch.setattr(study, "ANSWER_COMMAND", (str(spy),))
    return tmp_path


def test_the_answering_process_is_given_machines_and_no_key(spied):
    bench, out = spied / "bench", spied / "out"
    for name in "12":
        machine(bench / name)
    (bench / "key.json").write_text('{"1": {"kind": "none", "effects": []}, "2": {"kind": "none", "effects": []}}')
    done = answered(bench / "2", out / "answers")
    card = study.check_given_machines(out, bench, bench / "key.json")
    assert (card["cases"], card["false_alarms"]) == (2, 0.0)
    told = json.loads((out / "answers" / "1" / "diagnosis.json").read_text())
    assert told["seen"] == ["cases/1/drive.toml", "cases/1/log-a.parquet", "without.json"]
    assert told["argv"] == ["cases", "answers", "1", "without.json", "attended"]
    assert (told["links"], told["without"]) == ([], None)
    above = [Path(told["cwd"]), *Path(told["cwd"]).parents]
    assert not {out, bench, spied} & set(above)
    assert json.loads((out / "answers" / "2" / "diagnosis.json").read_text()) == done


@pytest.mark.parametrize(
    ("key", "says"),
    [
        (None, "not there"),
        ("{", "no key"),
        ('["1"]', "no key"),
        ('{"1": {"effects": [{}]}}', "no key"),
        ('{"1": {"effects": []}, "3": {"effects": []}}', "they differ in 2, 3"),
        ('{"1": {"effects": [{"name": "a"}, {"name": "b"}, {"name": "c"}]}}', "case 1 has more than 2"),
    ],
)
def test_a_key_that_does_not_fit_is_refused_before_hours_are_spent(tmp_path, key, says):
    for name in "12":
        machine(tmp_path / "bench" / name)
    if key is not None:
        (tmp_path / "bench" / "key.json").write_text(key)
    with pytest.raises(ParameterError, match=says):
        study.check_given_machines(tmp_path / "out", tmp_path / "bench", tmp_path / "bench" / "key.json")
    assert not (tmp_path / "out").exists()


def test_a_folder_without_machines_is_refused(tmp_path):
    (tmp_path / "key.json").write_text("{}")
    with pytest.raises(ParameterError, match="no machine in it"):
        study.check_given_machines(tmp_path / "out", tmp_path, tmp_path / "key.json")


def test_answers_of_other_sources_than_those_that_asked_are_refused(spied):
    machine(spied / "cases" / "1")
    spy = spied / "spy.py"
    spy.write_text(SPY.replace("task_digest(place", "'another ' + task_digest(place"))
    with (
        pytest.raises(ParameterError, match="1 were answered by other sources"),
        Report("check", spied / "out") as report,
    ):
        study._answer_cases(report, spied / "cases", spied / "out" / "answers", 1)


def test_answers_of_a_process_that_ends_early_are_kept(spied):
    machine(spied / "cases" / "fail")
    with pytest.raises(Exception, match="exit status 3"), Report("check", spied / "out") as report:
        study._answer_cases(report, spied / "cases", spied / "out" / "answers", 1, {"fail": ["cogging"]})
    told = json.loads((spied / "out" / "answers" / "fail" / "diagnosis.json").read_text())
    assert told["without"] == {"fail": ["cogging"]}


def test_the_key_is_written_after_the_answers(spied, integrated, monkeypatch):
    order = []
    ask, write = study._answer_cases, study.write_key
    monkeypatch.setattr(study, "_answer_cases", lambda *args: (order.append("ask"), ask(*args)))
    monkeypatch.setattr(study, "write_key", lambda *args: (order.append("key"), write(*args))[1])
    card = study.check_drawn_machines(spied / "out", 3, 0)
    assert order == ["ask", "key"]
    assert card["cases"] == 3
    told = json.loads((spied / "out" / "answers" / "001" / "diagnosis.json").read_text())
    assert not any("key" in one or "out" in Path(one).parts for one in told["seen"])
    order.clear()
    integrated.clear()
    study.check_drawn_machines(spied / "out", 3, 0)
    assert (order, integrated) == (["ask", "key"], [])


def test_the_answering_process_runs_from_anywhere_and_outlives_a_case_that_cannot_be_read(tmp_path):
    machine(tmp_path / "cases" / "1")
    with Report("check", tmp_path / "out") as report:
        study._answer_cases(report, tmp_path / "cases", tmp_path / "out" / "answers", 1)
    told = json.loads((tmp_path / "out" / "answers" / "1" / "diagnosis.json").read_text())
    assert told["verdict"] == "error"
    assert "DriveFileError" in told["says"]


def test_answers_to_what_was_asked_once_but_is_no_more_are_not_scored(tmp_path, monkeypatch):
    for name in ("000", "001"):
        place = tmp_path / "oracle" / name / "diagnosis.json"
        place.parent.mkdir(parents=True)
        place.write_text(json.dumps({"verdict": "none", "causes": [], "question": "of an earlier edition"}))
    monkeypatch.setattr(study, "_answer_cases", lambda *_: None)
    report = SimpleNamespace(out=tmp_path)
    told = study._rerun(report, tmp_path / "cases", "oracle", {"001": [], "002": []}, 1)
    assert list(told) == ["001"]


def test_machines_that_are_there_are_not_drawn_as_well(tmp_path):
    asked = ["withheld", "--out", str(tmp_path / "o"), "--bench", str(tmp_path), "--seed", "3"]
    result = CliRunner().invoke(cli.app, asked)
    assert isinstance(result.exception, ParameterError)
    assert "--cases, --seed and --axis" in str(result.exception)
    assert not (tmp_path / "o").exists()
