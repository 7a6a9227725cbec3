"""A folder that came from elsewhere: nothing in it runs unasked, and nothing is written outside of it."""

import os
import stat
import sys
import time

import platformdirs
import pytest

from experiments.app.job import Job
from experiments.app.jobs import Jobs
from experiments.app.private import user_secret
from experiments.app.seal import Seal
from experiments.app.workspace import Workspace, read_json, write_json

# leaves a mark in its folder of results, in the place of the command line
MARK = """
import pathlib, sys
import experiments.cli.main as line
def fake():
    out = pathlib.Path(sys.argv[3])
    out.mkdir(parents=True, exist_ok=True)
    (out / "mark").write_text("ran")
line.main = fake
from experiments.app.command import main
main()
"""
OWN = Seal(b"the secret of this user")


@pytest.fixture
def workspace(tmp_path):
    return Workspace(tmp_path / "work")


def app_of(workspace, seal=OWN, program=(sys.executable, "-c", MARK)):
    return Jobs(workspace, program, seal)


def put(workspace, arguments, name="0001-check", **more):
    job = Job(workspace.jobs / name)
    job.folder.mkdir()
    write_json(job.folder / "job.json", {"arguments": arguments, "title": "Check: run.csv", "wanted": "run"} | more)
    return job


def run_until_quiet(jobs):
    ends = time.monotonic() + 180.0
    jobs.tick()
    while any(job.state == "running" for job in jobs.all()):
        assert time.monotonic() < ends
        time.sleep(0.05)
        jobs.tick()
    jobs.wait(60.0)


def ask(jobs, job):
    """As the user does who opens the page and presses Start."""
    run_until_quiet(jobs)
    assert job.state == "unconfirmed"
    jobs.proceed(job)
    run_until_quiet(jobs)


def test_a_record_that_nobody_here_made_neither_runs_nor_writes_outside(workspace, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    foreign = put(workspace, ["axes", "gantry", "--out", str(elsewhere)])
    jobs = app_of(workspace)
    run_until_quiet(jobs)
    assert not foreign.log.exists()
    assert not elsewhere.exists()
    ask(jobs, foreign)
    assert foreign.state == "refused"
    assert "no command of this page" in foreign.console().error
    assert not elsewhere.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["check", "--out", "{elsewhere}", "files/lap.csv"],
        ["check", "--out", "jobs/0001-check/out", "--out={elsewhere}", "files/lap.csv"],
        ["check", "--out", "jobs/0001-check/out/../../../../elsewhere", "files/lap.csv"],
        ["check", "--out", "files", "files/lap.csv"],
        ["start", "--out", "jobs/0001-check/out", "--drive", "{elsewhere}/drive.toml", "files/lap.csv"],
        ["look", "files/lap.csv", "{elsewhere}"],
        ["check", "files/lap.csv"],
    ],
)
def test_a_command_line_that_leads_outside_of_its_folder_is_refused_in_one_line(workspace, tmp_path, arguments):
    elsewhere = tmp_path / "elsewhere"
    job = put(workspace, [one.replace("{elsewhere}", str(elsewhere)) for one in arguments])
    ask(app_of(workspace), job)
    assert job.state == "refused"
    assert "outside of its folder" in job.console().error
    assert not elsewhere.exists()
    assert list(workspace.files.iterdir()) == []


def test_what_waited_begins_with_the_next_app_of_its_user_and_not_in_a_copy(workspace, tmp_path):
    first = app_of(workspace)
    first._launch = lambda job: None  # it is killed before it can
    job = first.create("diagnose", ["files/lap.csv"], "Diagnose")
    stranger = app_of(workspace, Seal(b"another's"))
    copied = Workspace(tmp_path / "copy")
    (copied.jobs / job.id).mkdir()
    write_json(copied.jobs / job.id / "job.json", read_json(job.folder / "job.json"))
    copy = app_of(copied)
    run_until_quiet(copy)
    assert [one.state for one in copy.all()] == ["unconfirmed"]
    run_until_quiet(app_of(workspace))
    assert job.state == "done"
    (job.folder / "exit.json").unlink()
    record = job.record
    del record["process"]
    write_json(job.folder / "job.json", record)
    ask(stranger, job)
    assert job.state == "done"


@pytest.mark.parametrize("seal", [None, 7, "\udc80", ["a"]])
def test_a_seal_that_is_none_holds_for_nothing(seal, tmp_path):
    assert not OWN.holds(seal, tmp_path, "check")
    assert OWN.holds(OWN.of(tmp_path, "check"), tmp_path, "check")


def test_a_record_that_was_changed_since_does_not_begin_by_itself(workspace):
    jobs = app_of(workspace)
    jobs._launch = lambda job: None
    job = jobs.create("diagnose", ["files/lap.csv"], "Diagnose")
    job.update(arguments=[*job.arguments, "--tune"])
    run_until_quiet(app_of(workspace))
    assert job.state == "unconfirmed"


@pytest.mark.parametrize("name", ["log.txt", "exit.json", "job.json", ".running.lock", "out"])
def test_a_link_among_the_files_of_a_job_is_not_written_through(workspace, tmp_path, name):
    outside = tmp_path / "outside"
    outside.write_text("{}")
    job = put(workspace, ["check", "--out", "jobs/0001-check/out", "files/lap.csv"])
    (job.folder / name).unlink(missing_ok=True)
    (job.folder / name).symlink_to(outside)
    jobs = app_of(workspace)
    run_until_quiet(jobs)
    assert jobs.all() == []
    assert outside.read_text() == "{}"


def test_a_link_among_the_results_is_not_written_through(workspace, tmp_path):
    outside = tmp_path / "outside"
    outside.write_text("theirs")
    job = put(workspace, ["check", "--out", "jobs/0001-check/out", "files/lap.csv"])
    job.out.mkdir()
    (job.out / "mark").symlink_to(outside)
    ask(app_of(workspace), job)
    assert job.state == "refused"
    assert "a link is among the results" in job.console().error
    assert outside.read_text() == "theirs"


def test_the_look_at_a_file_is_never_what_its_folder_says(workspace, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    workspace.add("lap.csv", b"x")
    folder = workspace.look_folder("lap.csv")
    folder.mkdir()
    write_json(folder / "job.json", {"arguments": ["check", "--out", str(elsewhere)], "wanted": "run"})
    jobs = app_of(workspace, program=(sys.executable, "-c", ""))
    look = jobs.look("lap.csv")
    jobs.wait(60.0)
    assert look.arguments == ["look", "files/lap.csv", "looks/lap.csv/out"]
    assert not elsewhere.exists()


def test_the_secret_of_a_user_is_made_once_and_is_private(tmp_path, monkeypatch):
    monkeypatch.setattr(platformdirs, "user_state_dir", lambda *_, **__: str(tmp_path / "state"))
    secret = user_secret()
    assert (len(secret), user_secret()) == (43, secret)
    [path] = (tmp_path / "state").iterdir()
    if os.name == "nt":
        return
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    path.chmod(0o644)  # others may have read it
    assert user_secret() != secret
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_secret_that_cannot_be_kept_is_that_of_the_process(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(platformdirs, "user_state_dir", lambda *_, **__: str(tmp_path / "file"))
    assert len(user_secret()) == 43
