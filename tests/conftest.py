import pytest
from hypothesis import settings

from experiments.runtime import configure

configure()

# the first example of a test pays for compilation: no deadline
settings.register_profile("compiled", deadline=None)
settings.load_profile("compiled")


@pytest.fixture(scope="session")
def drive():
    from diffdrive.presets import paper_drive

    return paper_drive(quantised=False)
