"""Whatever tunes, identifies or diagnoses compiles its loops over time into native kernels, as the simulation does."""

import equinox as eqx
import jax
import numpy as np
import pytest

from diffdrive.effects.forces import FrameVibration
from experiments.benchmarks.loops import one_kernel
from experiments.studies.tuning_study import penalised
from tests.support.perturbed_machine import catalogue, fitter_of
from tests.support.small_tuning import small_problem
from tests.tuning.identification.test_prediction import DELAYED, NOISE, SAMPLING, noisy_lane, problem_at
from tests.tuning.identification.test_replay import CONTROLLERS, axis, logged
from tests.tuning.identification.test_replay import SAMPLING as LOGGED
from tuning.diagnosis.hypotheses.calibration import TOLERANCE
from tuning.diagnosis.selection.first_fits import fit_from
from tuning.diagnosis.selection.screening import screen
from tuning.diagnosis.selection.search import recalibrated
from tuning.gains.constrained import evaluate, linearise_at
from tuning.identification.filter_gain import most_likely
from tuning.identification.replay import replay_closed_loop
from tuning.optimisation.evolution import Budget
from tuning.optimisation.least_squares import levenberg_marquardt, multistart

pytestmark = pytest.mark.skipif(
    jax.default_backend() != "cpu", reason="only XLA's CPU compiler hoists loops into one kernel"
)


@pytest.fixture
def compiled(monkeypatch):
    """What every `filter_jit` of whatever runs is compiled to, by its name and the shapes of what it is given."""
    found, kind = {}, type(eqx.filter_jit(lambda: None))
    original = kind.__call__

    def call(self, *arguments, **named):
        leaves = jax.tree.leaves((arguments, named))
        if not any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            shapes = tuple(np.shape(leaf) for leaf in leaves if eqx.is_array(leaf))
            name = (f"{self.__wrapped__.__module__}.{self.__wrapped__.__qualname__}", shapes)
            if name not in found:
                found[name] = self.lower(*arguments, **named).compile().compiled.as_text()
        return original(self, *arguments, **named)

    monkeypatch.setattr(kind, "__call__", call)
    return found


def assert_native(found, *wanted):
    """All programs that have loops have native ones, and those of these functions are among them."""
    looping = {name: text for name, text in found.items() if " while(" in text}
    assert [name for name, text in looping.items() if not one_kernel(text)] == []
    assert set(wanted) <= {name.rpartition(".")[2] for name, _ in looping}


@pytest.mark.long
def test_the_tuner(compiled):
    gains, problem, _ = small_problem()
    y = np.zeros(len(gains.free))
    evaluate(gains, y, problem)
    linearise_at(gains, y, problem)
    penalised.levenberg_marquardt(gains, problem, Budget(1, 60.0))
    assert_native(compiled, "evaluate", "linearise_at", "_step")


@pytest.mark.long
def test_the_identification(compiled):
    residuals, problem = problem_at(1.3)
    most_likely(DELAYED, 1.3, NOISE, noisy_lane(), SAMPLING)
    levenberg_marquardt(residuals, np.zeros(len(residuals.free)), problem, max_steps=1, tolerance=1e-3)
    multistart(residuals, np.zeros((3, len(residuals.free))), problem, steps=1)
    replay_closed_loop(axis(), CONTROLLERS["pd"], logged(axis(), CONTROLLERS["pd"]), LOGGED)
    assert_native(compiled, "_deviances", "run_filter", "_step", "_step_lanes", "replay")


@pytest.mark.long
def test_the_diagnosis(compiled):
    """With an effect that is stepped within the filter, its fit by differences of whole filters among it."""
    fitter = fitter_of(FrameVibration(ratio=0.08, frequency=21.0, damping=0.05))
    base = recalibrated(fitter, TOLERANCE)
    candidate = next(one for one in catalogue(fitter, base) if one.name == "frame_vibration")
    fit_from(fitter, base, screen(base, candidate))
    assert_native(compiled, "run_filter", "step_jacobians_along", "innovation_jvp", "deviances_under", "_innovations")
