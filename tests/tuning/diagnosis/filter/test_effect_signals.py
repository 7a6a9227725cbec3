"""What effects do along a trajectory, against exact solutions."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.effects.actuator import ActuatorLag
from diffdrive.effects.forces import Cogging
from diffdrive.model.parameters import Sampling
from tests.support.perturbed_machine import fitter_of
from tuning.diagnosis.filter.effect_signals import effect_signals
from tuning.diagnosis.selection.search import initial_trajectory

LAG, PERIOD = 3e-3, 2e-3  # s


def in_one_lane(effect):
    values = {one.name: jnp.array([float(getattr(effect, one.name))]) for one in dataclasses.fields(effect)}
    return dataclasses.replace(effect, **values)


@pytest.mark.parametrize("substeps", [10, 80])
@pytest.mark.parametrize("beside", [(), (Cogging(cosine=2.0, period=1e-3),)])
def test_a_lag_follows_a_step_exactly_in_however_many_parts(substeps, beside):
    """Of a slow log with fine steps, too: eighty of them written out took the compiler 16 GB."""
    logged = fitter_of().logged
    step = np.where(np.arange(logged.lanes.command.shape[1]) < 100, 0.0, 50.0)
    lanes = logged.lanes._replace(command=jnp.asarray(step)[None], period_commands=None)
    still = initial_trajectory(logged)._replace(position=jnp.zeros_like(lanes.position))
    effects = tuple(map(in_one_lane, (ActuatorLag(LAG), *beside)))
    drive = dataclasses.replace(logged.drive, actuator=dataclasses.replace(logged.drive.actuator, force_limit=None))
    sampling = Sampling(1.0 / PERIOD, substeps)
    found = effect_signals(drive, effects, jnp.zeros(()), lanes, still, sampling, logged.starts)
    ends = np.maximum((np.arange(len(step)) - 99) * PERIOD, 0.0)
    begins = np.maximum(ends - PERIOD, 0.0)
    mean = 50.0 * ((ends - begins) - LAG * (np.exp(-begins / LAG) - np.exp(-ends / LAG))) / PERIOD
    pushed = sum(one.cosine for one in beside)  # at position 0
    assert found.force[0] == pytest.approx(mean + pushed, abs=1e-9)
    assert found.beside[0] == pytest.approx(pushed, abs=1e-12)
    assert found.ripple.shape[-1] == substeps
    assert np.mean(found.ripple[0], axis=1) == pytest.approx(0.0, abs=1e-9)
