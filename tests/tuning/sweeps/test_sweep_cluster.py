"""A sweep on several machines has the numbers of one, also where a process is killed in the middle."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from typer.testing import CliRunner

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.errors import ParameterError
from diffdrive.library import PAPER_DRIVE
from experiments.cli.main import app
from tuning.sweeps.cluster import on_cluster
from tuning.sweeps.parts import run_parts
from tuning.sweeps.spec import SweepSpec

distributed = pytest.importorskip("distributed")


def asked(**more):
    motion = "sine:amplitude=1mm,frequency=10Hz,duration=0.05s"
    vary = {"plant.mass": "lognormal:3%", "load": "uniform:0..10 kN"}
    return SweepSpec.of(read_axis(PAPER_DRIVE), motion, vary, 96, most_in_a_part=8, **more)


def rows(found):
    return found.to_table().sort_by("machine")


@pytest.mark.long
def test_a_lost_worker_changes_nothing(tmp_path):
    wanted = asked()
    plan, killed = wanted.plan(), []
    alone = rows(run_parts(plan, tmp_path / "alone", lambda done: None))
    here = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**here) as cluster:

        def kill(done):
            if done and not killed:
                killed.append(cluster.workers[0].process.pid)
                os.kill(killed[0], signal.SIGKILL)

        together = rows(run_parts(plan, tmp_path / "together", kill, on_cluster(wanted, cluster.scheduler_address)))
    assert killed
    assert together.equals(alone)


@pytest.mark.long
def test_a_cluster_without_workers_says_what_it_waits_for_and_goes_on_when_one_comes(tmp_path):
    wanted, said = asked(), []
    plan = wanted.plan()
    alone = rows(run_parts(plan, tmp_path / "alone", lambda done: None))
    with distributed.LocalCluster(n_workers=0, threads_per_worker=1, dashboard_address=None) as cluster:

        def say(text):
            said.append(text)
            cluster.scale(1)

        engine = on_cluster(wanted, cluster.scheduler_address)
        together = rows(run_parts(plan, tmp_path / "together", lambda done: None, engine, say))
        [told] = said
        assert "has none; start some as `dask worker tcp://127.0.0.1:" in told
    assert together.equals(alone)


@pytest.mark.long
def test_a_cluster_that_is_lost_says_that_the_same_command_goes_on(tmp_path):
    """Scheduler and worker as programs of their own, killed."""
    wanted, file, parts = asked(), tmp_path / "scheduler.json", tmp_path / "parts"

    def program(name, *more):
        command = (sys.executable, "-m", f"distributed.cli.dask_{name}", "--scheduler-file", str(file), *more)
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    both = [program("scheduler", "--no-dashboard", "--port", "0"), program("worker", "--no-dashboard")]
    try:
        while not file.exists() or not file.read_text().strip():
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]

        def lose(done):
            for one in both if done else ():
                one.kill()

        with pytest.raises(ParameterError, match=r"cluster tcp://.* is lost .* the same sweep goes on"):
            run_parts(wanted.plan(), parts, lose, on_cluster(wanted, address))
    finally:
        for one in both:
            one.kill()
            one.wait()
    kept = list(parts.glob("part-*.parquet"))
    assert kept
    assert len(kept) < 12


def test_nobody_at_the_address_is_said_and_leaves_no_folder(tmp_path, monkeypatch):
    monkeypatch.setattr("tuning.sweeps.cluster.CONNECTION_TIMEOUT", 0.5)
    arguments = ("sweep", PAPER_DRIVE, "--motion", "sine:amplitude=1mm,frequency=10Hz,duration=0.6s", "--samples", 8,
                 "--cluster", "tcp://127.0.0.1:9", "--out", tmp_path / "out")  # fmt: skip
    result = CliRunner().invoke(app, [str(one) for one in arguments])
    assert isinstance(result.exception, ParameterError)
    assert "no scheduler answers there" in str(result.exception)
    assert not (tmp_path / "out").exists()
