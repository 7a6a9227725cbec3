import gc
import os

import jax
import psutil
import pytest
from hypothesis import settings

from diffdrive.runtime import configure

configure()  # which keeps what is compiled from run to run: half of the tests' time is compilation
gc.disable()  # a tenth of the time of tracing goes into looking for cycles; `bounded_memory` does it where it pays

# the first example of a test pays for compilation: no deadline
settings.register_profile("compiled", deadline=None)
settings.load_profile("compiled")


# bytes, by which a process may grow until it forgets: all of them together by a sixth of the machine
MORE_MEMORY = psutil.virtual_memory().total / 6 / int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))


@pytest.fixture(scope="session")
def forgotten():
    """At how many bytes the process forgot its programs last: what it gives back then, it takes first."""
    return {"at": 0.0}


@pytest.fixture(autouse=True, scope="module")
def bounded_memory(forgotten):
    """No process keeps the programs of all files that it has run: they are on the disk, too, and soon read again."""
    gc.freeze()  # whoever collects (asammdf with each file, pytest at its end) looks at this file's objects alone
    yield
    if psutil.Process().memory_info().rss > forgotten["at"] + MORE_MEMORY:
        jax.clear_caches()
        gc.unfreeze()
        gc.collect()
        forgotten["at"] = psutil.Process().memory_info().rss


@pytest.fixture(scope="session")
def drive():
    from diffdrive.model.presets import paper_drive

    return paper_drive(quantised=False)


@pytest.fixture
def constant_force_diagnosis():
    """The diagnosis of `constant_force_log`."""
    from tests.support import constant_force_log

    return constant_force_log.diagnosis()


@pytest.fixture
def command_for(tmp_path, monkeypatch):
    """The command on that log, as if it had found what it is given."""
    from tests.support import constant_force_log

    return constant_force_log.command_for(tmp_path, monkeypatch)
