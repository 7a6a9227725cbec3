"""The closed loop compiles into one native kernel on a CPU; without this every step is ten times slower."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from diffdrive import motion
from diffdrive.controllers import (
    DOBVSC,
    PD,
    Cascade,
    DisturbanceObserver,
    Feedforward,
    FrictionCompensation,
    PDFeedforwardDOB,
)
from diffdrive.controllers.base import paper_tracking
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.loop.costs import running_costs
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.smooth import smooth
from diffdrive.loop.step import initial_state, step
from diffdrive.model.parameters import Actuator, Drive, Sampling, Sensor
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.motion.load import Ramp
from diffdrive.numerics.arrays import as_arrays, in_precision_of
from diffdrive.observers.friction_observer import KalmanObserver, LoadStateObserver, Tuning
from diffdrive.observers.load_estimator import InnovationLoad
from experiments.benchmarks import loops
from experiments.benchmarks.loops import one_kernel
from tuning.sweeps import engine
from tuning.sweeps.varied import with_effects

pytestmark = pytest.mark.skipif(
    jax.default_backend() != "cpu", reason="only XLA's CPU compiler hoists loops into one kernel"
)

SAMPLES, LANES = 500, 64
PAPER = paper_drive()
TRACKING = paper_tracking(PAPER, PAPER_KP, PAPER_KD)
CONTROLLERS = {
    "PD": PD(TRACKING),
    "PD+FC": FrictionCompensation(TRACKING, KalmanObserver(PAPER.plant, PAPER.friction)),
    "PD+FC+LE": FrictionCompensation(TRACKING, KalmanObserver(PAPER.plant, PAPER.friction, Tuning(), InnovationLoad())),
    "PD+FC+LS": FrictionCompensation(TRACKING, LoadStateObserver(PAPER.plant, PAPER.friction)),
    "DOBVSC": DOBVSC(TRACKING, DisturbanceObserver.of(PAPER.plant, 240.0)),
    "PD+FF+DOB": PDFeedforwardDOB(TRACKING, DisturbanceObserver.of(PAPER.plant, 3.0), PAPER.friction),
    "cascade": Cascade(100.0, 2e4, 1e6, 1.0, Feedforward.of(PAPER.plant), 4),
}
IMPERFECT = Drive(PAPER.plant, PAPER.friction, Actuator(500.0, delay_samples=2), Sensor(1e-7, 2e-8))
DRIVES = {"exact": PAPER, "imperfect": IMPERFECT, "smooth": smooth(IMPERFECT)}


def inputs():
    there = motion.sine(amplitude=1e-3, frequency=5.0, duration=(SAMPLES - 1) * 1e-4, rate=1e4)
    return loop_inputs(there, np.zeros(SAMPLES))


def key_for(drive):
    return jax.random.key(0) if np.any(drive.sensor.noise > 0) else None


def is_hoisted(function, *args):
    return one_kernel(jax.jit(function).lower(*args).compile().as_text())


@pytest.mark.long
@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("machine", DRIVES)
def test_one_lane_is_one_kernel(name, machine):
    drive, controller = as_arrays((DRIVES[machine], CONTROLLERS[name]))
    key = key_for(DRIVES[machine])
    assert is_hoisted(lambda d, c, i: rollout_loop(d, c, i, Sampling(), key), drive, controller, inputs())


@pytest.mark.long
@pytest.mark.parametrize("name", CONTROLLERS)
def test_many_lanes_with_a_running_cost_are_one_kernel(name):
    drive, controller = as_arrays((PAPER, CONTROLLERS[name]))
    lanes = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (LANES,)), controller)
    counts = jnp.ones(SAMPLES)
    costs = jax.vmap(lambda d, c, i: running_costs(d, c, i, counts, Sampling()), in_axes=(None, 0, None))
    assert is_hoisted(costs, drive, lanes, inputs())


def test_many_imperfect_lanes_are_one_kernel():
    drive, controller = as_arrays((IMPERFECT, CONTROLLERS["PD+FC+LE"]))
    lanes = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (LANES,)), controller)

    def roll(drive, controller, key, inputs):
        return rollout_loop(drive, controller, inputs, Sampling(), key).table_position

    keys = jax.random.split(jax.random.key(0), LANES)
    assert is_hoisted(jax.vmap(roll, in_axes=(None, 0, 0, None)), drive, lanes, keys, inputs())


def test_decimated_recording_is_one_kernel():
    drive, controller = as_arrays((PAPER, CONTROLLERS["PD+FC+LS"]))
    assert is_hoisted(lambda d, c, i: rollout_loop(d, c, i, Sampling(), every=5), drive, controller, inputs())


def test_the_guard_sees_a_loop_that_is_no_kernel():
    drive, controller = as_arrays((PAPER, CONTROLLERS["PD"]))

    def solving(drive, controller, inputs):
        def body(state, at):
            state, frame = step(drive, controller, Sampling(), None, state, at)
            return state, jnp.linalg.inv(jnp.eye(3) * (2.0 + frame.table_position))

        return lax.scan(body, initial_state(drive, controller, inputs.load[0]), inputs)[1]

    assert not is_hoisted(solving, drive, controller, inputs())


@pytest.mark.long
def test_every_derivative_that_is_timed_is_one_kernel():
    compiled = loops.derivatives(PAPER, CONTROLLERS["PD+FC+LE"], inputs(), Sampling(substeps=1))
    assert {name: one.one_kernel for name, one in compiled.items()} == dict.fromkeys(compiled, True)


def test_the_whole_catalogue_at_once_is_one_kernel():
    assert loops.single(
        with_effects(PAPER, EFFECTS), CONTROLLERS["PD+FC+LE"], inputs(), Sampling(substeps=2)
    ).one_kernel


def swept(drive, name, noisy=False, precision="double", own_cycles=False):
    """The blocks of a sweep, compiled; `own_cycles`: each machine has a motion and a load over time of its own."""
    count = 2 * engine.CPU_BLOCK * len(jax.devices())
    machine = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count,)), as_arrays(drive))
    varied, fixed = eqx.partition(machine, lambda leaf: np.ndim(leaf) == 1)
    keys = jax.vmap(lambda k: jax.random.fold_in(jax.random.key(0), k))(jnp.arange(count)) if noisy else None
    given = inputs()
    cycle = engine.LaneCycle(given.reference, given.load, jnp.ones(SAMPLES), jnp.asarray(1.0))
    every = jax.tree.map(lambda signal: jnp.broadcast_to(signal, (count, *signal.shape)), cycle)
    own, common = (every, None) if own_cycles else (None, cycle)
    lanes = engine.SweepLanes(varied, Ramp(*(jnp.zeros(count) for _ in range(4))), keys, own)
    models = (lanes, fixed, as_arrays(CONTROLLERS[name]), common)
    models = in_precision_of(jnp.zeros((), precision), models)
    return engine._costs.lower(*models, Sampling(), len(jax.devices())).compile().compiled.as_text()


@pytest.mark.long
@pytest.mark.parametrize("name", CONTROLLERS)
def test_the_blocks_of_a_sweep_are_one_kernel(name):
    assert one_kernel(swept(PAPER, name, noisy=True))


@pytest.mark.long
@pytest.mark.parametrize(("noisy", "precision"), [(False, "double"), (True, "single")])
def test_without_noise_and_in_single_precision_too(noisy, precision):
    assert one_kernel(swept(PAPER, "PD+FC+LE", noisy, precision))


def test_machines_with_cycles_of_their_own_are_one_kernel():
    assert one_kernel(swept(PAPER, "PD+FC+LE", own_cycles=True))


@pytest.mark.long
def test_a_sweep_over_the_whole_catalogue_is_one_kernel():
    assert one_kernel(swept(with_effects(PAPER, EFFECTS), "PD+FC+LE"))
