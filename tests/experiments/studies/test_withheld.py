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
def simulated_logs(monkeypatch):
    """Logs without integration; what was asked for."""
    requests = []

    def log_of(case, log, peak=None):
        requests.append((log, peak))
        reference = case.inputs[log].reference
        time = np.arange(len(reference)) / case.rate
        return Log("ab"[log], time, reference, 0.0 * reference + 100.0, reference=reference)

    monkeypatch.setattr(generate, "_simulate_log", log_of)
    return requests


def test_cases_that_are_there_are_not_integrated_again(tmp_path, simulated_logs):
    cases, parts = tmp_path / "cases", tmp_path / "key_parts"
    names = list(generate.generate(cases, parts, 0, 3))
    key = generate.write_key(tmp_path / "key.json", parts)
    assert names == sorted(key) == ["001", "002", "003"]
    assert simulated_logs
    (cases / "002" / "drive.toml").unlink()
    simulated_logs.clear()
    assert list(generate.generate(cases, parts, 0, 3)) == names
    assert {log for log, _ in simulated_logs} == {0, 1}
    assert len(simulated_logs) <= 3  # of the one case that was not finished
    assert generate.write_key(tmp_path / "key.json", parts) == key
    with pytest.raises(ParameterError, match="another seed"):
        list(generate.generate(cases, parts, 1, 3))


def test_a_limit_lies_below_the_peak_of_the_first_log(simulated_logs):
    logs, peak = generate._simulate_logs(draw(np.random.default_rng([3, 1, 0]), ("force_limit",)))
    assert len(logs) == 2
    assert peak == 100.0
    assert simulated_logs == [(0, None), (0, 100.0), (1, 100.0)]


def make_case(case):
    """A folder that looks like a case."""
    case.mkdir(parents=True)
    for name in ("drive.toml", "log-a.parquet", "notes.txt"):
        (case / name).write_text("")
    return case


@pytest.mark.long
def test_an_answer_that_fails_is_an_error_and_whole(tmp_path, monkeypatch, capfd):
    def fails(case, without):
        raise ValueError("no such thing")

    monkeypatch.setattr(answer, "diagnose_case", fails)
    path = tmp_path / "answers" / "1" / "diagnosis.json"
    answer._diagnose_batch([(make_case(tmp_path / "1"), path, ())])
    assert capfd.readouterr().out == "1 error []\n"
    written = json.loads(path.read_text())
    assert written.pop("question") == answer.task_digest(tmp_path / "1", ())
    assert written == {"verdict": "error", "says": "ValueError: no such thing", "causes": []}
    assert list(path.parent.iterdir()) == [path]


def test_cases_of_a_length_are_asked_in_one_process_those_drawn_first_first_and_none_is_lost(tmp_path):
    for number in range(25):
        (case := tmp_path / f"{number:02d}").mkdir()
        rows = 4000 if number in {3, 24} else 1990 if number % 2 else 2000
        pd.DataFrame({"time": np.arange(rows)}).to_parquet(case / "log-a.parquet")
    make_case(tmp_path / "unreadable")
    groups = answer._batches([(case, tmp_path, ()) for case in sorted(tmp_path.iterdir())])
    named = [[case.name for case, _, _ in some] for some in groups]
    alike = [f"{number:02d}" for number in range(24) if number != 3]
    count = answer.BATCH
    assert named == [alike[:count], ["03", "24"], alike[count : 2 * count], alike[2 * count :], ["unreadable"]]


def write_answer(case, out, without=()):
    """An answer that is there."""
    path = out / case.name / "diagnosis.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    written = {"verdict": "none", "causes": [], "question": answer.task_digest(case, without)}
    path.write_text(json.dumps(written))
    return written


def test_answers_that_are_there_are_left_alone_and_half_of_one_is_none(tmp_path):
    cases, out = tmp_path / "cases", tmp_path / "answers"
    for name in "123":
        make_case(cases / name)
        (out / name).mkdir(parents=True)
    written = write_answer(cases / "1", out)
    temporary_beside(out / "2" / "diagnosis.json").write_text('{"verdict": ')
    assert [one.name for one in answer.unanswered(cases, out)] == ["2", "3"]
    assert [one.name for one in answer.unanswered(cases, out, {"1": [], "3": []})] == ["3"]
    answer.main(cases, out, 1, {"1": []})  # nothing is asked
    assert json.loads((out / "1" / "diagnosis.json").read_text()) == written


def test_an_answer_to_another_question_is_none(tmp_path):
    cases, out = tmp_path / "cases", tmp_path / "answers"
    write_answer(make_case(cases / "1"), out, ("cogging", "backlash"))
    assert answer.unanswered(cases, out, {"1": ["backlash", "cogging"]}) == []
    assert answer.unanswered(cases, out, {"1": ["backlash"]})
    (cases / "1" / "log-a.parquet").write_text("another machine")
    assert answer.unanswered(cases, out, {"1": ["backlash", "cogging"]})


def test_a_case_that_kills_its_process_is_an_error_and_the_others_are_answered(tmp_path, monkeypatch):
    cases, out = tmp_path / "cases", tmp_path / "answers"
    for name in "123":
        make_case(cases / name)

    def ask(questions, workers):
        for case, _, without in questions:
            if case.name == "2":
                raise BrokenProcessPool("was terminated abruptly")
            write_answer(case, out, without)

    monkeypatch.setattr(answer, "_diagnose_all", ask)
    answer.main(cases, out, 2)
    verdicts = {name: json.loads((out / name / "diagnosis.json").read_text())["verdict"] for name in "123"}
    assert verdicts == {"1": "none", "2": "error", "3": "none"}
    assert answer.unanswered(cases, out) == []


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="processes are listed in /proc on Linux only")
def test_whoever_asks_no_more_leaves_no_process_behind(tmp_path):
    """The answering process is told to end while it has cases left: so do the processes that it began."""
    for k in range(6):
        make_case(tmp_path / "cases" / str(k))
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
def spy_folder(tmp_path, monkeypatch):
    """In the place of the answering process one that says what it can see."""
    spy = tmp_path / "spy.py"
    spy.write_text(SPY)
    monkeypatch.setattr(study, "ANSWER_COMMAND", (str(spy),))
    return tmp_path


@pytest.mark.long
def test_the_answering_process_is_given_machines_and_no_key(spy_folder):
    bench, out = spy_folder / "bench", spy_folder / "out"
    for name in "12":
        make_case(bench / name)
    (bench / "key.json").write_text('{"1": {"kind": "none", "effects": []}, "2": {"kind": "none", "effects": []}}')
    existing = write_answer(bench / "2", out / "answers")
    card = study.check_given_machines(out, bench, bench / "key.json")
    assert (card["cases"], card["false_alarms"]) == (2, 0.0)
    written = json.loads((out / "answers" / "1" / "diagnosis.json").read_text())
    assert written["seen"] == ["cases/1/drive.toml", "cases/1/log-a.parquet", "without.json"]
    assert written["argv"] == ["cases", "answers", "1", "without.json", "attended"]
    assert (written["links"], written["without"]) == ([], None)
    above = [Path(written["cwd"]), *Path(written["cwd"]).parents]
    assert not {out, bench, spy_folder} & set(above)
    assert json.loads((out / "answers" / "2" / "diagnosis.json").read_text()) == existing


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
        make_case(tmp_path / "bench" / name)
    if key is not None:
        (tmp_path / "bench" / "key.json").write_text(key)
    with pytest.raises(ParameterError, match=says):
        study.check_given_machines(tmp_path / "out", tmp_path / "bench", tmp_path / "bench" / "key.json")
    assert not (tmp_path / "out").exists()


def test_a_folder_without_machines_is_refused(tmp_path):
    (tmp_path / "key.json").write_text("{}")
    with pytest.raises(ParameterError, match="no machine in it"):
        study.check_given_machines(tmp_path / "out", tmp_path, tmp_path / "key.json")


@pytest.mark.long
def test_answers_of_other_sources_than_those_that_asked_are_refused(spy_folder):
    make_case(spy_folder / "cases" / "1")
    spy = spy_folder / "spy.py"
    spy.write_text(SPY.replace("task_digest(place", "'another ' + task_digest(place"))
    with (
        pytest.raises(ParameterError, match="1 were answered by other sources"),
        Report("check", spy_folder / "out") as report,
    ):
        study._answer_cases(report, spy_folder / "cases", spy_folder / "out" / "answers", 1)


@pytest.mark.long
def test_answers_of_a_process_that_ends_early_are_kept(spy_folder):
    make_case(spy_folder / "cases" / "fail")
    with pytest.raises(Exception, match="exit status 3"), Report("check", spy_folder / "out") as report:
        study._answer_cases(report, spy_folder / "cases", spy_folder / "out" / "answers", 1, {"fail": ["cogging"]})
    written = json.loads((spy_folder / "out" / "answers" / "fail" / "diagnosis.json").read_text())
    assert written["without"] == {"fail": ["cogging"]}


@pytest.mark.long
def test_the_key_is_written_after_the_answers(spy_folder, simulated_logs, monkeypatch):
    order = []
    ask, write = study._answer_cases, study.write_key
    monkeypatch.setattr(study, "_answer_cases", lambda *args: (order.append("ask"), ask(*args)))
    monkeypatch.setattr(study, "write_key", lambda *args: (order.append("key"), write(*args))[1])
    card = study.check_drawn_machines(spy_folder / "out", 3, 0)
    assert order == ["ask", "key"]
    assert card["cases"] == 3
    written = json.loads((spy_folder / "out" / "answers" / "001" / "diagnosis.json").read_text())
    assert not any("key" in one or "out" in Path(one).parts for one in written["seen"])
    order.clear()
    simulated_logs.clear()
    study.check_drawn_machines(spy_folder / "out", 3, 0)
    assert (order, simulated_logs) == (["ask", "key"], [])


@pytest.mark.long
def test_the_answering_process_runs_from_anywhere_and_outlives_a_case_that_cannot_be_read(tmp_path):
    make_case(tmp_path / "cases" / "1")
    with Report("check", tmp_path / "out") as report:
        study._answer_cases(report, tmp_path / "cases", tmp_path / "out" / "answers", 1)
    written = json.loads((tmp_path / "out" / "answers" / "1" / "diagnosis.json").read_text())
    assert written["verdict"] == "error"
    assert "DriveFileError" in written["says"]


def test_answers_to_what_was_asked_once_but_is_no_more_are_not_scored(tmp_path, monkeypatch):
    for name in ("000", "001"):
        case = tmp_path / "oracle" / name / "diagnosis.json"
        case.parent.mkdir(parents=True)
        case.write_text(json.dumps({"verdict": "none", "causes": [], "question": "of an earlier edition"}))
    monkeypatch.setattr(study, "_answer_cases", lambda *_: None)
    report = SimpleNamespace(out=tmp_path)
    written = study._rerun(report, tmp_path / "cases", "oracle", {"001": [], "002": []}, 1)
    assert list(written) == ["001"]


def test_machines_that_are_there_are_not_drawn_as_well(tmp_path):
    arguments = ["withheld", "--out", str(tmp_path / "o"), "--bench", str(tmp_path), "--seed", "3"]
    result = CliRunner().invoke(cli.app, arguments)
    assert isinstance(result.exception, ParameterError)
    assert "--cases, --seed and --axis" in str(result.exception)
    assert not (tmp_path / "o").exists()
