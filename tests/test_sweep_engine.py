"""A machine in a sweep has the costs that it has alone, whatever stands beside it."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive import motion
from diffdrive.parameters import Drive, Sampling, Sensor, as_arrays
from diffdrive.presets import paper_drive
from diffdrive.simulate import inputs_of, running_costs
from experiments import paper
from experiments.sweeps.engine import costs_of
from experiments.sweeps.machines import lane, machines
from experiments.sweeps.samples import shares
from experiments.sweeps.varied import parse_varied

NOISY = Drive(paper_drive().plant, paper_drive().friction, paper_drive().actuator, Sensor(1e-7, 2e-8))
TEXTS = (
    "plant.mass=lognormal:3%",
    "friction.viscous=lognormal:5%",
    "load=uniform:0..12 kN",
    "load.change=uniform:-2..2 kN",
)
SAMPLING = Sampling(1e4, 2)
THERE = motion.sine(amplitude=1e-3, frequency=5.0, duration=0.1, rate=1e4)


def swept(name="PD+FC+LE", count=128, first=0, to=None):
    drive = NOISY
    drawn = shares("sobol", len(TEXTS), 3, 0, count)[first:to]
    machine, ramp, _ = machines(drive, [parse_varied(text, drive) for text in TEXTS], drawn)
    keys = jax.vmap(lambda k: jax.random.fold_in(jax.random.key(3), k))(jnp.arange(first, first + len(drawn)))
    inputs = inputs_of(THERE, np.zeros(len(THERE.time)))
    counts = (THERE.time > 0.02).astype(float)
    controller = paper.controllers(drive)[name]
    return costs_of(machine, ramp, keys, controller, inputs, counts, SAMPLING), (machine, ramp, keys, controller)


@pytest.mark.parametrize("name", ["PD", "PD+FC+LE"])
def test_a_machine_in_a_sweep_costs_what_it_costs_alone(name):
    found, (machine, ramp, keys, controller) = swept(name)
    inputs, counts = inputs_of(THERE, np.zeros(len(THERE.time))), jnp.asarray(THERE.time > 0.02, float)
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


def test_lanes_are_the_same_to_the_bit_on_any_number_of_devices():
    program = (
        "import sys; sys.path.insert(0, 'tests'); from experiments.runtime import configure; configure()\n"
        "import jax, test_sweep_engine as t; found = t.swept(count=512)[0]  # several blocks on each device\n"
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
