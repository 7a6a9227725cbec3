import pytest

from experiments.runtime import configure

configure()


@pytest.fixture(scope="session")
def drive():
    from diffdrive.presets import paper_drive

    return paper_drive(quantised=False)
