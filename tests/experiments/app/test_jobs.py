"""Jobs: what is on the disk says how far each is, whoever asks, and whatever was killed."""

import errno
import os
import signal
import subprocess
import sys
import time

import pytest

from experiments.app.job import Job
from experiments.app.jobs import MOST_LOOKS, Jobs
from experiments.app.result import read_result
from experiments.app.workspace import AppError, Workspace, read_json, write_json

# a command that takes as long as it is asked to, in the place of the command line
FAKE = """
import os, sys, time
import experiments.cli.main as line
def fake():
    out, how = sys.argv[3], sys.argv[4]
    if how == "refused":
        print("error: lap.csv: holds no position"); sys.exit(2)
    if how == "fault":
        raise RuntimeError("unforeseen")
    if how == "doubtful":
        sys.exit(3)
    os.makedirs(out, exist_ok=True)
    kept = os.path.join(out, "kept")
    begun = int(open(kept).read()) if os.path.exists(kept) else 0
    for step in range(begun, 4):
        print(f"searching: {step} of 4, 0 s", flush=True)
        open(kept, "w").write(str(step))
        if how == "slow" and begun == 0:
            time.sleep(60)
    print("searching: 4 of 4, 0 s")
line.main = fake
from experiments.app.command import main
main()
"""


@pytest.fixture
def workspace(tmp_path):
    return Workspace(tmp_path / "work")


@pytest.fixture
def jobs(workspace):
    jobs = Jobs(workspace, (sys.executable, "-c", FAKE))
    yield jobs
    for job in jobs.all():
        process = job.process()
        if process is not None:
            process.kill()
    jobs.wait(10.0)


def until(true, seconds=180.0):  # a process that begins beside many others takes a minute
    ends = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < ends
        time.sleep(0.05)


def test_a_job_runs_to_its_end_and_says_how_far_it_was(jobs):
    job = jobs.create("diagnose", ["quick"], "Diagnose")
    assert job.state == "running"
    until(lambda: job.state == "done")
    [stage] = job.console().stages
    assert (stage.name, stage.share) == ("searching", 1.0)
    assert job.console().text.startswith("$ diffdrive diagnose --out jobs/0001-diagnose/out quick")


def test_a_refusal_is_its_one_line_and_a_fault_shows_no_traceback(jobs):
    refused, fault = jobs.create("check", ["refused"], "Check"), jobs.create("check", ["fault"], "Check")
    until(lambda: {refused.state, fault.state} == {"refused", "failed"})
    assert refused.console().error == "lap.csv: holds no position"
    assert "Traceback" not in fault.console().text
    assert "unforeseen" in fault.log.read_text(encoding="utf-8")


def test_a_job_that_is_stopped_goes_on_from_what_it_kept(jobs):
    job = jobs.create("diagnose", ["slow"], "Diagnose")
    until(lambda: (job.out / "kept").exists())
    jobs.stop(job)
    until(lambda: job.state == "stopped")
    (job.out / "kept").write_text("2")
    jobs.proceed(job)
    until(lambda: job.state == "done")
    assert "searching: 0 of 4" not in job.console().text  # that of the last run
    assert "searching: 2 of 4" in job.console().text


def test_a_process_that_is_killed_is_no_end_and_the_job_goes_on(jobs):
    job = jobs.create("diagnose", ["slow"], "Diagnose")
    until(lambda: (job.out / "kept").exists())
    job.process().kill()
    until(lambda: job.state == "killed")
    (job.out / "kept").write_text("3")
    jobs.proceed(job)
    until(lambda: job.state == "done")


def test_a_second_reader_sees_the_same_and_a_new_app_finds_what_runs(jobs, workspace):
    job = jobs.create("diagnose", ["slow"], "Diagnose")
    until(lambda: (job.out / "kept").exists())
    other = Jobs(Workspace(workspace.folder), (sys.executable, "-c", FAKE))
    [same] = other.all()
    assert (same.state, same.title, same.stamp()) == (job.state, job.title, job.stamp())
    other.proceed(same)  # it runs: nothing is to be started
    other.tick()
    assert same.process().pid == job.process().pid
    other.stop(same)
    until(lambda: job.state == "stopped")


def test_what_takes_minutes_waits_and_what_takes_seconds_does_not(jobs):
    first, second = jobs.create("diagnose", ["slow"], "1"), jobs.create("identify", ["quick"], "2")
    short = jobs.create("check", ["quick"], "3")
    assert second.state == "waiting"
    until(lambda: short.state == "done")
    jobs.tick()
    assert second.state == "waiting"
    jobs.stop(first)
    until(lambda: first.state == "stopped")
    jobs.tick()
    until(lambda: second.state == "done")


def test_of_many_files_that_are_dropped_few_are_looked_at_at_once(workspace):
    jobs = Jobs(workspace, (sys.executable, "-c", "import time; time.sleep(60)"))
    names = [workspace.add("lap.csv", b"x") for _ in range(5)]
    looks = [jobs.look(name) for name in names]
    try:
        assert [look.state for look in looks] == [*["running"] * MOST_LOOKS, *["waiting"] * (5 - MOST_LOOKS)]
        looks[0].process().kill()
        until(lambda: jobs.look(names[-1]).state == "running")
    finally:
        for look in looks:
            if look.process() is not None:
                look.process().kill()
        jobs.wait(10.0)


def test_one_that_waits_can_be_taken_back(jobs):
    first, second = jobs.create("diagnose", ["slow"], "1"), jobs.create("identify", ["quick"], "2")
    jobs.stop(second)
    assert second.state == "stopped"
    jobs.stop(first)
    until(lambda: first.state == "stopped")
    jobs.tick()
    assert second.state == "stopped"


def test_two_processes_of_one_job_are_one(jobs):
    job = jobs.create("diagnose", ["slow"], "Diagnose")
    until(lambda: (job.out / "kept").exists())
    second = subprocess.run(
        [sys.executable, "-c", FAKE, str(job.folder)], cwd=jobs.workspace.folder, timeout=60, check=False
    )
    assert second.returncode == 0
    assert job.state == "running"
    assert job.log.read_text(encoding="utf-8").count("$ diffdrive") == 1


def test_a_question_that_is_asked_twice_at_once_is_one_job(jobs):
    first = jobs.create("diagnose", ["slow"], "Diagnose")
    assert jobs.create("diagnose", ["slow"], "Diagnose") == first
    assert jobs.create("diagnose", ["quick"], "Diagnose") != first
    jobs.stop(first)
    until(lambda: first.state == "stopped")
    assert jobs.create("diagnose", ["slow"], "Diagnose") != first


def test_a_stop_that_comes_too_late_changes_nothing(jobs):
    job = jobs.create("diagnose", ["doubtful"], "Diagnose")
    until(lambda: job.state == "doubtful")
    jobs.stop(job)  # of a tab that has not looked since
    assert job.state == "doubtful"


def test_what_was_refused_runs_once_its_reason_is_gone(workspace):
    jobs = Jobs(workspace, (sys.executable, "-c", FAKE.replace('how == "refused"', "not os.path.exists('room')")))
    job = jobs.create("diagnose", ["quick"], "Diagnose")
    until(lambda: job.state == "refused")
    (workspace.folder / "room").write_text("")
    jobs.proceed(job)
    until(lambda: job.state == "done")
    jobs.wait(10.0)


def test_a_job_that_another_tab_deleted_does_not_come_back(jobs):
    job = jobs.create("diagnose", ["quick"], "Diagnose")
    until(lambda: job.state == "done")
    jobs.remove(job)
    for act in (jobs.stop, jobs.proceed):
        with pytest.raises(AppError, match="was deleted"):
            act(job)
    assert not job.folder.exists()
    jobs.remove(job)


def test_a_job_for_which_there_is_no_room_leaves_no_folder(jobs, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("experiments.app.jobs.write_json", full)
    with pytest.raises(OSError, match="No space"):
        jobs.create("diagnose", ["quick"], "Diagnose")
    assert list(jobs.workspace.jobs.iterdir()) == []


def test_a_job_that_runs_is_not_deleted(jobs):
    job = jobs.create("diagnose", ["slow"], "Diagnose")
    with pytest.raises(AppError, match="stop it first"):
        jobs.remove(job)
    jobs.stop(job)
    until(lambda: job.state == "stopped")
    jobs.remove(job)
    assert jobs.all() == []
    with pytest.raises(AppError, match="may have been deleted"):
        jobs.get(job.id)


def test_another_process_of_the_same_number_is_not_the_jobs(jobs):
    job = jobs.create("diagnose", ["quick"], "Diagnose")
    until(lambda: job.state == "done")
    (job.folder / "exit.json").unlink()
    job.update(process={"pid": os.getpid(), "started": 1.0})  # this very process, which began later
    assert job.state == "killed"
    jobs.stop(job)  # and is not sent a signal


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="sends signals of POSIX")
def test_a_broken_job_is_not_the_end_of_the_list(jobs):
    job = jobs.create("diagnose", ["quick"], "Diagnose")
    until(lambda: job.state == "done")
    (job.folder / "job.json").write_text("[")
    other = jobs.create("check", ["quick"], "Check")
    until(lambda: other.state == "done")
    assert [one.id for one in jobs.all()] == ["0002-check", "0001-diagnose"]
    assert read_json(job.folder / "job.json") is None


def test_what_the_command_line_refuses_is_its_sentence(workspace):
    jobs = Jobs(workspace)
    misspelt = jobs.create("identify", ["--starts=many", "--drive=files/drive.toml", "files/lap.csv"], "Identify")
    gone = jobs.create("check", ["--drive=files/drive.toml", "files/lap.csv"], "Check")
    until(lambda: (jobs.tick(), misspelt.state, gone.state)[1:] == ("refused", "refused"), 120.0)
    assert "--starts" in misspelt.console().error
    assert "drive.toml" in gone.console().error
    assert not gone.out.exists()
    jobs.wait(10.0)


def test_a_result_begins_with_its_first_note_else_with_its_numbers(workspace):
    job = Job(workspace.jobs / "0001-start")
    job.out.mkdir(parents=True)
    write_json(job.out / "result.json", {"notes": ["it is a drive file", " 5 um away\n", "", "Next: identify"]})
    assert read_result(job).says == ["it is a drive file", "5 µm away", "Next: identify"]
    assert read_result(job).headline == "it is a drive file"
    write_json(job.out / "result.json", {"result": {"rms_error_um": 0.25, "peak_error_um": 1.5}})
    assert read_result(job).headline == "RMS error 0.25 µm, peak error 1.5 µm"
    (job.out / "result.json").write_text("[1, 2")
    assert read_result(job).headline == ""


def test_a_trace_is_looked_at_and_a_broken_one_refused_in_one_line(workspace):
    rows = "".join(f"{0.001 * k},{k % 7},{k % 5}\n" for k in range(500))
    workspace.add("lap.csv", f"time [s],ActPos [mm],torque [%]\n{rows}".encode())
    workspace.add("noise.csv", bytes(range(256)) * 40)
    jobs = Jobs(workspace)
    lap, noise = jobs.look("lap.csv"), jobs.look("noise.csv")
    until(lambda: (lap.state, noise.state) == ("done", "refused"), 120.0)
    found = read_json(lap.out / "look.json")
    assert [column["name"] for column in found["columns"]] == ["time [s]", "ActPos [mm]", "torque [%]"]
    assert found["rows"] == 500
    assert found["columns"][1]["curve"][0][0] == 0.0
    assert "noise.csv" in noise.console().error
    assert "\n" not in noise.console().error
    jobs.wait(10.0)
