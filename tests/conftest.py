import os
from pathlib import Path

import jax
import platformdirs
import pytest
from hypothesis import settings

from diffdrive.runtime import configure

configure()

KEPT = {
    "jax_compilation_cache_dir": str(Path(platformdirs.user_cache_dir("diffdrive", appauthor=False)) / "tests"),
    "jax_compilation_cache_max_size": 2**29,  # bytes; what was used longest ago gives way
    "jax_persistent_cache_min_compile_time_secs": 0.1,
}


def pytest_configure():
    """What one process or one run of the tests has compiled, the others need not: it is half of the tests' time.

    jax recognises programs by content, version, flags and processor. `JAX_ENABLE_COMPILATION_CACHE=0` keeps nothing.
    """
    for option, value in KEPT.items():
        if option.upper() not in os.environ:
            os.environ[option.upper()] = str(value)  # for the other processes
            jax.config.update(option, value)


# the first example of a test pays for compilation: no deadline
settings.register_profile("compiled", deadline=None)
settings.load_profile("compiled")


@pytest.fixture(scope="session")
def drive():
    from diffdrive.model.presets import paper_drive

    return paper_drive(quantised=False)


@pytest.fixture
def tilted():
    """The diagnosis of `constant_force_log`."""
    from tests.support import constant_force_log

    return constant_force_log.diagnosis()


@pytest.fixture
def told_of(tmp_path, monkeypatch):
    """The command on that log, as if it had found what it is given."""
    from tests.support import constant_force_log

    return constant_force_log.telling(tmp_path, monkeypatch)
