"""The linearised loop against python-control, a drive derived by hand, and the simulation whose derivative it is."""

import collections
import dataclasses
from functools import cache

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.flatten_util import ravel_pytree
from scipy.linalg import eig
from scipy.signal import cont2discrete

from diffdrive.controllers import Cascade, Command, Controller, Feedforward, Reference
from diffdrive.loop import linearise
from diffdrive.loop.linearise import OpenLoop, OperatingPoint, open_loop
from diffdrive.loop.smooth import smooth
from diffdrive.loop.step import Inputs, LoopState, initial_state, step
from diffdrive.model import actuator, plant, sensor
from diffdrive.model.friction import steady_friction, stribeck_level
from diffdrive.model.parameters import Actuator, Sampling
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.model.quantity import Directional
from diffdrive.numerics.arrays import as_arrays
from experiments.studies.paper import scenario as paper

PERIOD = 1e-4
PAPER = paper_drive()
ONE_SAMPLE, FRACTIONAL = Actuator(delay_samples=1), Actuator(delay_fraction=0.4)
CASCADE = Cascade(100.0, 2e4, 1e6, 0.9, Feedforward.of(PAPER.plant), 2)
CONTROLLERS = paper.controllers(PAPER) | {"cascade": CASCADE}
VELOCITIES = np.array([0.0, 3e-4, 3e-3, -3e-3, 1e-2, 0.1])
LOADS = np.array([0.0, 1e4, 0.0, 0.0, 1e4, 0.0])
FREQUENCY = np.geomspace(1.0, 4900.0, 300)
response, growth = jax.jit(linearise.response), jax.jit(linearise.growth_rate)


def drive_with(delay):
    return as_arrays(smooth(dataclasses.replace(PAPER, actuator=delay)))


def smooth_controller(name):
    return as_arrays(smooth(CONTROLLERS[name]))


@cache
def loops_of(name, delay=ONE_SAMPLE, substeps=None):
    """The open loops at every operating point, [p] each; compiled once for all tests."""
    loop = jax.vmap(lambda v, w: open_loop(drive_with(delay), smooth_controller(name), sampling, OperatingPoint(v, w)))
    sampling = Sampling(substeps=substeps)
    return jax.jit(loop)(VELOCITIES, LOADS)


def loop_of(name, point, delay=ONE_SAMPLE, substeps=None):
    return jax.tree.map(lambda leaf: np.asarray(leaf[point]), loops_of(name, delay, substeps))


def with_gain(loop, gain):
    return OpenLoop(loop.a, gain * loop.b, loop.c, loop.period)


class Simulated:
    """The simulated loop about its steady motion, at `position` (m). This knows nothing of linearise.py."""

    def __init__(self, name, delay=ONE_SAMPLE, settling=6000, steps=300, position=0.0):
        self.drive, self.controller = drive_with(delay), smooth_controller(name)
        self.settling, self.steps, self.position = settling, steps, position
        self.load_is_assumed = name == "PD+FC"
        self.settled, self.pushed = jax.jit(self._settled), jax.jit(self._pushed)

    def inputs(self, k, velocity, load):
        return Inputs(Reference(self.position + velocity * PERIOD * k, velocity, 0.0), load, 0.0)

    def _moved(self, state, inputs, force_of):
        measured = sensor.measure(self.drive.sensor, state.plant.position, None)
        inside, command = self.controller.step(
            state.controller, inputs.reference, measured, state.actuator.applied, PERIOD
        )
        under_way = actuator.step(self.drive.actuator, state.actuator, command.force, PERIOD)
        force = force_of(under_way.applied)
        table = plant.advance(self.drive, state.plant, force, inputs.load, PERIOD, Sampling().plant_steps)
        return LoopState(table, under_way, inside, state.count), under_way.applied

    def _settled(self, velocity, load):
        """The state after `settling` steps of the motion, and the force asked for then (N)."""
        state = initial_state(self.drive, self.controller, jnp.asarray(self.position))
        deflection = jnp.sign(velocity) * stribeck_level(self.drive.friction, velocity, load) / 3.35e7
        state = state._replace(plant=plant.PlantState(state.plant.position, velocity, deflection))
        held = steady_friction(self.drive.friction, velocity, load)
        held = held + self.drive.plant.damping.towards(velocity) * velocity
        state = state._replace(actuator=jax.tree.map(lambda _: held, state.actuator))
        if hasattr(state.controller, "observer"):  # begins at the truth: a load that is not may take seconds to forget
            observed = state.controller.observer
            observed = observed._replace(x=(self.position - velocity * PERIOD, velocity, deflection))
            observed = observed if self.load_is_assumed else observed._replace(load=load)
            state = state._replace(controller=state.controller._replace(observer=observed))

        def body(state, k):
            return self._moved(state, self.inputs(k, velocity, load), lambda asked: asked)

        state, asked = lax.scan(body, state, jnp.arange(self.settling))
        return state, asked[-1]

    def _pushed(self, velocity, load, gain, kick):
        """Force asked for beyond the steady one (N) after a push of `kick` (N), `gain` times of which acts."""
        state, steady = self._settled(velocity, load)

        def body(state, k):
            push = jnp.where(k == 0, kick, 0.0)
            inputs = self.inputs(self.settling + k, velocity, load)
            return self._moved(state, inputs, lambda asked: steady + gain * (asked - steady) + push)

        return lax.scan(body, state, jnp.arange(self.steps))[1] - steady


simulated = cache(Simulated)


def recursion(loop, gain, kick, steps):
    """What `Simulated.pushed` returns, by the linear loop."""
    asked, x = [], np.zeros(len(loop.b))
    for k in range(steps):
        asked.append(loop.c @ x)
        x = loop.a @ x + loop.b * (gain * asked[-1] + (kick if k == 0 else 0.0))
    return np.array(asked)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "delay"),
    [("DOBVSC", ONE_SAMPLE), ("PD+FC+LS", ONE_SAMPLE), ("PD", FRACTIONAL), ("cascade", FRACTIONAL)],
)
def test_frequency_response_is_that_of_python_control(name, delay):
    for point in range(len(VELOCITIES)):
        loop = loop_of(name, point, delay)
        theirs = control.ss(loop.a, loop.b[:, None], -loop.c[None], 0.0, loop.period)
        expected = theirs(np.exp(2j * np.pi * FREQUENCY * loop.period))
        np.testing.assert_allclose(response(loop, FREQUENCY).loop, expected, rtol=1e-9)


@pytest.mark.long
def test_slope_of_the_response_is_its_derivative():
    loop, step = loop_of("PD+FC+LS", 4), 1e-4
    ahead, behind = (np.asarray(response(loop, FREQUENCY * np.exp(s)).loop) for s in (step, -step))
    slope = np.asarray(response(loop, FREQUENCY).slope)
    assert np.max(np.abs((ahead - behind) / (2 * step) - slope) / np.abs(slope)) < 1e-5


def drive_by_hand(velocity, load):
    """The paper's drive about a steady motion: [x, v, z] from force to position, held over each period exactly.

    dz/dt = v - s0 |v| z / g(v) at z = g / s0 leaves dv (v g'/g) - r dz; the damping force is s1 dz/dt.
    """
    friction, speed = PAPER.friction, abs(velocity)
    level = float(stribeck_level(friction, velocity, load))
    slope = -friction.breakaway_gap.towards(velocity) / friction.stribeck_velocity.towards(velocity)
    slope = slope * np.exp(-speed / friction.stribeck_velocity.towards(velocity)) if speed else 0.0
    rate = 3.35e7 * speed / level
    bristle = np.array([0.0, speed * slope / level if speed else 1.0, -rate])
    drag = float(friction.viscous.towards(velocity) + PAPER.plant.damping.towards(velocity))
    pull = -(np.array([0.0, drag, 3.35e7]) + 4.54e3 * bristle) / 100.0
    a = np.array([[0.0, 1.0, 0.0], pull, bristle])
    return cont2discrete((a, np.array([[0.0], [0.01], [0.0]]), np.eye(3)[:1], 0.0), PERIOD, "zoh")[:2]


@pytest.mark.parametrize("point", range(len(VELOCITIES)))
def test_pd_loop_is_the_one_derived_by_hand(point):
    """Mass, bristle spring and damper; PD with a backward difference; one sample of delay."""
    a, b = drive_by_hand(VELOCITIES[point], LOADS[point])
    z = np.exp(2j * np.pi * FREQUENCY * PERIOD)
    position = np.array([np.linalg.solve(one * np.eye(3) - a, b)[0, 0] for one in z])
    expected = position * (PAPER_KP + PAPER_KD / PERIOD * (1.0 - 1.0 / z)) / z
    got = np.asarray(response(loop_of("PD", point, substeps=128), FREQUENCY).loop)
    assert np.max(np.abs(got / expected - 1.0)) < 1e-4
    default = np.asarray(response(loop_of("PD", point), FREQUENCY).loop)
    assert np.max(np.abs(default / expected - 1.0)[FREQUENCY < 500.0]) < 1e-3


@pytest.mark.long
@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=[pytest.mark.slow] * (one == "PD+FC")) for one in CONTROLLERS]
)
def test_small_motion_of_the_simulated_loop(name):
    """A push of a hundredth of a newton, and a gain of 1.5 that the observers do not know of."""
    for point in (0, 2) if name == "PD+FC" else (0, 4):  # without load, where PD+FC assumes none
        pushed = simulated(name).pushed
        asked, still = (pushed(VELOCITIES[point], LOADS[point], 1.5, kick) for kick in (1e-2, 0.0))
        expected = recursion(loop_of(name, point), 1.5, 1e-2, len(asked))
        error = np.max(np.abs(asked - still - expected)) / np.max(np.abs(expected))
        # at standstill the table moves both ways, and its damping differs by direction: the loop takes the positive one
        assert error < (5e-3 if VELOCITIES[point] == 0 else 2e-5)


def whole_jacobian(name, point):
    """d(next state)/d(state) of a whole control step, covariances and all."""
    loop = simulated(name, position=0.12, settling=3000)  # as long as gains settle in linearise.py
    settled, _ = loop.settled(VELOCITIES[point], LOADS[point])
    vector, rebuild = ravel_pytree(settled._replace(count=None))
    inputs = loop.inputs(loop.settling, VELOCITIES[point], LOADS[point])

    def ahead(vector):
        state = rebuild(vector)._replace(count=settled.count)
        moved, _ = step(loop.drive, loop.controller, Sampling(), None, state, inputs)
        return ravel_pytree(moved._replace(count=None))[0]

    jacobian = np.asarray(jax.jit(jax.jacfwd(ahead))(vector))
    marked = jax.tree_util.tree_map_with_path(
        lambda path, leaf: jnp.full_like(leaf, "covariance" in jax.tree_util.keystr(path)), rebuild(vector)
    )
    return jacobian, np.asarray(ravel_pytree(marked)[0], bool)


def shifts_by_covariances(name, point):
    """The loop's modes with the covariances held, and by how much these move them: to first order, l E (z - F)^-1 C r.

    (The eigenvalues of the whole are no use: between variances of 1e-16 m^2 and 1e3 N^2 they are conditioned to 1e13.)
    """
    whole, free = whole_jacobian(name, point)
    modes, left, right = eig(whole[np.ix_(~free, ~free)], left=True)
    moved = np.zeros(len(modes), complex)
    for k, mode in enumerate(modes):
        if abs(mode) > 0.05 and np.any(free):
            through = np.linalg.solve(mode * np.eye(free.sum()) - whole[np.ix_(free, free)], whole[np.ix_(free, ~free)])
            row, column = left[:, k].conj(), right[:, k]
            moved[k] = row @ whole[np.ix_(~free, free)] @ through @ column / (row @ column)
    return modes, moved


@pytest.mark.long
@pytest.mark.parametrize("name", ["PD", "PD+FC+LE", "PD+FC+LS"])
@pytest.mark.parametrize("point", [1, 4])
def test_covariances_move_no_mode_where_the_model_is_exact(name, point):
    """With all that a control step carries, and elsewhere on the table's way, the modes are those of the loop."""
    modes, moved = shifts_by_covariances(name, point)
    expected = np.linalg.eigvals(loop_of(name, point).closed_loop)
    for mode in expected[np.abs(expected) > 0.05]:  # a delay's zeros are multiple: no solver finds them to 1e-6
        assert np.min(np.abs(modes - mode)) < 1e-6
    assert np.max(np.abs(moved)) < 1e-6


def test_covariances_move_little_where_the_model_is_off():
    """PD+FC that assumes no load, under 10 kN."""
    modes, moved = shifts_by_covariances("PD+FC", 4)
    loops = (np.abs(modes) > 0.05) & (np.abs(modes) < 1.0 - 1e-9)  # the load that is assumed stays as it is
    share = np.abs(moved[loops] / np.log(modes[loops]))
    assert share[np.argmax(np.abs(modes[loops]))] < 2e-3
    assert 1e-3 < np.max(share) < 0.1


@pytest.mark.long
@pytest.mark.parametrize("name", ["PD", "PD+FC+LS", "cascade"])
def test_units_of_the_state_do_not_matter(name):
    loop = loop_of(name, 4)
    units = 10.0 ** np.random.default_rng(0).uniform(-6, 6, len(loop.b))
    other = OpenLoop(loop.a * units[:, None] / units, loop.b * units, loop.c / units, loop.period)
    # what a solve in units twelve decades apart leaves of its rounding: 1e-13 to 1e-9, by how they are drawn
    np.testing.assert_allclose(response(other, FREQUENCY).loop, response(loop, FREQUENCY).loop, rtol=1e-8)
    np.testing.assert_allclose(growth(other), growth(loop), rtol=1e-6)


@pytest.mark.long
def test_directions_agree_where_the_drive_is_the_same_in_both():
    def both_ways(part):
        return Directional(part.positive, part.positive) if isinstance(part, Directional) else part

    even = jax.tree.map(both_ways, PAPER, is_leaf=lambda part: isinstance(part, Directional))
    drive = as_arrays(smooth(dataclasses.replace(even, actuator=ONE_SAMPLE)))
    controller = as_arrays(smooth(paper.controllers(even)["PD+FC+LS"]))
    there_and_back = jax.jit(jax.vmap(lambda v: open_loop(drive, controller, Sampling(), OperatingPoint(v, 5e3))))
    loops = there_and_back(np.array([3e-3, -3e-3]))
    there, back = (response(jax.tree.map(lambda leaf, k=k: leaf[k], loops), FREQUENCY).loop for k in (0, 1))
    np.testing.assert_allclose(there, back, rtol=1e-9)


def pi_controller_whose_integral_is(name):
    """The same PI law each time; only the name of its state differs."""
    State = collections.namedtuple("State", [name])

    class PI(Controller):
        kp: float = 1e6
        ki: float = 5e6

        def init(self, position):
            return State(jnp.zeros_like(position))

        def step(self, state, reference, position, applied, period):
            error = reference.position - position
            integral = state[0] + self.ki * period * error
            return State(integral), Command(self.kp * error + integral)

    return as_arrays(PI())


@pytest.mark.long
def test_a_state_takes_part_whatever_its_name():
    loops = [
        open_loop(drive_with(ONE_SAMPLE), pi_controller_whose_integral_is(name), Sampling(), OperatingPoint(0.01, 0.0))
        for name in ("integral", "count", "load", "covariance", "known", "started")
    ]
    for loop in loops[1:]:
        np.testing.assert_array_equal(loop.closed_loop, loops[0].closed_loop)
