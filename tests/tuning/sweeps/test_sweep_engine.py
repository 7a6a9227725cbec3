"""A machine in a sweep has the costs that it has alone, whatever stands beside it."""

import dataclasses
import os
import subprocess
import sys
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive import motion
from diffdrive.effects import actuator, forces, friction, scale, transmission
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.loop.costs import running_costs
from diffdrive.loop.rollout import loop_inputs
from diffdrive.loop.run import divergence_bound
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.parameters import Actuator, Drive, Sampling, Sensor
from diffdrive.model.presets import paper_drive
from diffdrive.motion.motion import Limits
from diffdrive.numerics.arrays import as_arrays
from experiments.studies.paper import scenario as paper
from tuning.sweeps.duty_cycles import DutyCycle, shared_cycle
from tuning.sweeps.engine import lane_costs
from tuning.sweeps.machines import lane, machines
from tuning.sweeps.samples import unit_samples
from tuning.sweeps.varied import parse_varied, with_effects

NOISY = Drive(paper_drive().plant, paper_drive().friction, paper_drive().actuator, Sensor(1e-7, 2e-8))
TEXTS = (
    "plant.mass=lognormal:3%",
    "friction.viscous=lognormal:5%",
    "load=uniform:0..12 kN",
    "load.change=uniform:-2..2 kN",
)
SAMPLING = Sampling(1e4, 2)
THERE = motion.sine(amplitude=1e-3, frequency=5.0, duration=0.1, rate=1e4)


def swept(name="PD+FC+LE", count=128, first=0, to=None, precision="double", drive=NOISY):
    drawn = unit_samples("sobol", len(TEXTS), 3, 0, count)[first:to]
    machine, ramp, _ = machines(drive, [parse_varied(text, drive) for text in TEXTS], drawn)
    keys = jax.vmap(lambda k: jax.random.fold_in(jax.random.key(3), k))(jnp.arange(first, first + len(drawn)))
    cycle = shared_cycle(DutyCycle(THERE, np.zeros(len(THERE.time))), 0.0201, Limits())
    controller = paper.controllers(drive)[name]
    found = lane_costs(machine, ramp, keys, controller, cycle, SAMPLING, precision)
    return found, (machine, ramp, keys, controller)


@pytest.mark.long
@pytest.mark.parametrize("name", ["PD", "PD+FC+LE"])
def test_a_machine_in_a_sweep_costs_what_it_costs_alone(name):
    found, (machine, ramp, keys, controller) = swept(name)
    inputs, counts = loop_inputs(THERE, np.zeros(len(THERE.time))), jnp.asarray(THERE.time > 0.02, float)
    alone = jax.jit(
        lambda drive, controller, ramp, key: running_costs(drive, controller, inputs, counts, SAMPLING, key, ramp)
    )
    for k in (0, 63, 64, 127):
        one = alone(lane(machine, k), as_arrays(controller), jax.tree.map(lambda leaf, k=k: leaf[k], ramp), keys[k])
        assert float(one.rms) == pytest.approx(found.rms[k], rel=1e-3)  # a quantum may fall to the other side
        assert float(one.peak) == pytest.approx(found.peak[k], rel=1e-2)
        assert int(one.steps_finite) == found.steps_finite[k] == len(THERE.time)


def test_a_lane_does_not_hang_on_its_neighbours():
    whole, _ = swept()
    few, _ = swept(first=37, to=90)
    assert np.array_equal(whole.rms[37:90], few.rms)
    assert np.array_equal(whole.load_error[37:90], few.load_error)


def test_a_machine_diverges_in_a_sweep_where_it_does_alone():
    """Light machines behind a delay, some of which swing by more than a tenth of a metre and by less than one."""
    drive = dataclasses.replace(NOISY, actuator=Actuator(delay_samples=4), sensor=Sensor(1e-7))
    there = motion.sine(amplitude=1e-3, frequency=4.0, duration=0.3, rate=1e4)
    drawn = np.linspace(0.0, 1.0, 64).reshape(-1, 1)
    machine, ramp, _ = machines(drive, [parse_varied("plant.mass=uniform:4.7..4.9 kg", drive)], drawn)
    cycle, reach = shared_cycle(DutyCycle(there, np.zeros(len(there.time))), 0.0, Limits()), 0.1
    control = paper.controllers(drive)["PD"]
    assert divergence_bound(there.position, Limits()) == reach
    found = lane_costs(machine, ramp, None, control, cycle, SAMPLING)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        alone = [
            simulate_loop(lane(machine, k), control, there, sampling=SAMPLING, seed=None).status.ok
            for k in range(len(drawn))
        ]
    assert list(found.steps_finite == len(there.time)) == alone
    between = (found.peak > reach) & (found.peak < 1.0)
    assert between.any()  # some are told apart by this alone


def test_a_machine_at_the_limit_of_an_effect_is_at_the_force_limit():
    weak = dataclasses.replace(NOISY, effects=(actuator.ForceLimit(30.0),))
    assert np.all(swept("PD", 64, drive=weak)[0].saturated > 0.5)
    assert not np.any(swept("PD", 64)[0].saturated)


@pytest.mark.long
@pytest.mark.parametrize("name", ["PD", "DOBVSC", "PD+FF+DOB", "PD+FC", "PD+FC+LE", "PD+FC+LS"])
def test_in_single_precision_errors_are_off_by_nanometres(name):
    """A float's grid is 0.1 nm at 1 mm; the same machines under the same loads and noise."""
    double, single = swept(name)[0], swept(name, precision="single")[0]
    assert np.max(np.abs(single.rms - double.rms)) < 5e-9
    assert 0.0 < np.median(np.abs(single.rms - double.rms)) < 1e-9
    assert np.array_equal(single.steps_finite, double.steps_finite)
    assert np.median(np.abs(single.command_noise / double.command_noise - 1.0)) < 0.03  # quanta fall as they may


@pytest.mark.long
def test_every_effect_runs_in_single_precision():
    """Its state and its waves in the precision of the loop: a scan refuses a carry of another kind."""
    at_work = (friction.FrictionDwell(0.3, 0.02, 1e-5), friction.PreslidingHysteresis(0.7, 5e-6, 0.3),
               transmission.Backlash(4e-6, 400.0, 0.1, 0.3, 0.6), forces.Cogging(0.002, 3.0, 1.0),
               scale.InterpolationError(2e-5, 2e-7, 1e-7), actuator.LoopDelay(1.3),
               actuator.ForceLimit(900.0))  # fmt: skip
    # a machine has one screw
    neutral = with_effects(NOISY, set(EFFECTS) - {effect.name for effect in at_work} - {"compliance"})
    drive = dataclasses.replace(neutral, effects=(*at_work, *neutral.effects))
    double, single = (swept("PD", 64, precision=one, drive=drive)[0] for one in ("double", "single"))
    assert np.max(np.abs(single.rms / double.rms - 1.0)) < 5e-3


@pytest.mark.long
def test_lanes_are_the_same_to_the_bit_on_any_number_of_devices():
    program = (
        "from diffdrive.runtime import configure; configure()\n"
        "import jax; from tests.tuning.sweeps import test_sweep_engine as t\n"
        "found = t.swept(count=512)[0]  # several blocks on each device\n"
        "few = t.swept(count=512, to=40)[0]  # one block on one device, as a replay has\n"
        "assert (few.rms == found.rms[:40]).all() and (few.peak == found.peak[:40]).all()\n"
        "print(len(jax.devices()), found.rms.tobytes().hex() + found.load_error.tobytes().hex())"
    )
    found = set()
    for devices in (1, 2):
        environment = os.environ | {"JAX_NUM_CPU_DEVICES": str(devices)}
        done = subprocess.run(
            [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
        )
        count, text = done.stdout.split()
        assert int(count) == devices
        found.add(text)
    assert len(found) == 1
