"""A sweep on several processes has the numbers of one, also where a process is killed in the middle."""

import os
import signal

import pytest

from diffdrive.errors import ParameterError
from experiments.demo import PAPER_DRIVE
from experiments.sweeps.asked import Asked
from experiments.sweeps.cluster import on_cluster
from experiments.sweeps.parts import run

distributed = pytest.importorskip("distributed")


def asked(**more):
    motion = "sine:amplitude=1mm,frequency=10Hz,duration=0.05s"
    vary = ("plant.mass=lognormal:3%", "load=uniform:0..10 kN")
    return Asked.of(PAPER_DRIVE, [motion], vary, 96, most_in_a_part=8, **more)


def rows(found):
    return found.to_table().sort_by("machine")


def test_a_lost_worker_changes_nothing(tmp_path):
    wanted = asked()
    plan, killed = wanted.plan(), []
    alone = rows(run(plan, tmp_path / "alone", lambda done: None))
    here = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**here) as cluster:

        def kill(done):
            if done and not killed:
                killed.append(cluster.workers[0].process.pid)
                os.kill(killed[0], signal.SIGKILL)

        together = rows(run(plan, tmp_path / "together", kill, on_cluster(wanted, address=cluster.scheduler_address)))
    assert killed
    assert together.equals(alone)


def test_nobody_at_the_address_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr("experiments.sweeps.cluster.ANSWERS_WITHIN", 0.5)
    wanted = asked()
    with pytest.raises(ParameterError, match="no scheduler answers"):
        run(wanted.plan(), tmp_path, lambda done: None, on_cluster(wanted, address="tcp://127.0.0.1:9"))
