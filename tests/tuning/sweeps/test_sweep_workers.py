"""A sweep in several processes has the numbers of one, opens no port, and leaves no process behind."""

import multiprocessing
import os
import signal

import pytest

import diffdrive as dd
from diffdrive.errors import ParameterError
from tuning.sweeps import workers
from tuning.sweeps.parts import run_parts
from tuning.sweeps.spec import SweepSpec
from tuning.sweeps.workers import on_workers


@pytest.fixture(scope="module")
def wanted():
    """An axis and a motion that are in no file."""
    axis = dd.paper_axis("pd+fc+le").replace({"plant.mass": 101})
    motion = dd.motion.sine(amplitude=1e-3, frequency=10.0, duration=0.05, rate=axis.rate)
    return SweepSpec.of(axis, motion, {"plant.mass": "lognormal:3%", "load": "uniform:0..10 kN"}, 96, most_in_a_part=8)


def rows(found):
    return found.to_table().sort_by("machine")


def listening():
    """The ports on which this process and those that it started listen."""
    psutil = pytest.importorskip("psutil")
    here = psutil.Process()
    return {
        (one.laddr, process.pid)
        for process in (here, *here.children(recursive=True))
        for one in process.net_connections("inet")
        if one.status == psutil.CONN_LISTEN
    }


@pytest.mark.long
def test_workers_open_no_port_and_a_lost_one_changes_nothing(wanted, tmp_path):
    plan, before, ports, said, killed = wanted.plan(), listening(), set(), [], []
    alone = rows(run_parts(plan, tmp_path / "alone", lambda done: None))

    def done(count):
        ports.update(listening())
        if count and not killed:
            killed.append(multiprocessing.active_children()[0].pid)
            os.kill(killed[0], signal.SIGTERM)

    together = rows(run_parts(plan, tmp_path / "together", done, on_workers(wanted, 2), said.append))
    assert killed
    assert said == ["a worker was killed; the parts that were under way are run again"]
    assert together.equals(alone)
    assert ports - before == set()
    assert multiprocessing.active_children() == []


def test_workers_that_are_killed_again_and_again_are_given_up(wanted, tmp_path, monkeypatch):
    pools = []

    def broken(*_):
        pools.append(1)
        raise workers.BrokenProcessPool
        yield

    monkeypatch.setattr(workers, "_compute", broken)
    with pytest.raises(
        ParameterError, match=r"workers: the 2 processes .* give fewer; the parts that were done are kept"
    ):
        run_parts(wanted.plan(), tmp_path, lambda done: None, on_workers(wanted, 2))
    assert len(pools) == workers.MAX_LOSSES
