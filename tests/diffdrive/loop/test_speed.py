"""How fast the loop is from edition to edition: timed and compared (docs/evidence/performance.md).

Nothing is asserted of the times: they are the machine's. What is asserted is that the loop is the fast one.
"""

import os

import pytest

from diffdrive.model.parameters import Sampling
from diffdrive.model.presets import paper_drive
from experiments.benchmarks import loops
from experiments.studies.paper import scenario as paper

pytestmark = pytest.mark.speed
STEPS, SAMPLING = 5_000, Sampling(1e4)
DRIVE = paper_drive()


@pytest.fixture
def timed(benchmark):
    """A loop timed, its cost a lane-step told beside."""

    def run(loop, lanes=1):
        assert loop.one_kernel or os.environ.get("JAX_PLATFORMS", "cpu") != "cpu"
        benchmark(loop.run)
        benchmark.extra_info["ns_a_lane_step"] = 1e9 * benchmark.stats.stats.min / (STEPS * lanes)

    return run


@pytest.mark.parametrize("name", ["PD", "DOBVSC", "PD+FF+DOB", "PD+FC", "PD+FC+LE"])
@pytest.mark.parametrize("lanes", [1, 64])
def test_controllers(timed, name, lanes):
    controller, given = paper.controllers(DRIVE)[name], loops.paper_inputs(STEPS)
    one = loops.single if lanes == 1 else loops.lanes
    timed(one(DRIVE, controller, given, SAMPLING, *([] if lanes == 1 else [lanes])), lanes)


@pytest.mark.parametrize("name", ["forward", "jacfwd, 8 parameters", "Gauss-Newton", "reverse"])
def test_derivatives(timed, name):
    timed(loops.derivatives(DRIVE, paper.controllers(DRIVE)["PD+FC+LE"], loops.paper_inputs(STEPS), SAMPLING)[name])
