import os
import shutil
import tempfile

import pytest
from hypothesis import settings

from diffdrive.runtime import configure

configure()

COMPILED = "JAX_COMPILATION_CACHE_DIR"


def pytest_configure(config):
    """What one process of the tests has compiled, the others need not: most of the tests' time is compilation."""
    import jax

    if COMPILED not in os.environ:
        os.environ[COMPILED] = config.compiled = tempfile.mkdtemp(prefix="diffdrive-tests-")
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.3"
    jax.config.update("jax_compilation_cache_dir", os.environ[COMPILED])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def pytest_unconfigure(config):
    if hasattr(config, "compiled"):
        shutil.rmtree(config.compiled, ignore_errors=True)


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
