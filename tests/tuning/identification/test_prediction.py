"""One-step prediction along a log, its derivatives, and the filter that chooses its gains."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage
from hypothesis import example, given, settings
from hypothesis import strategies as st

from diffdrive.controllers import PD
from diffdrive.controllers.base import PDGains, Tracking
from diffdrive.logs import Log
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.model import plant
from diffdrive.model.parameters import Actuator, Sensor
from diffdrive.model.presets import PAPER_KD, PAPER_KP
from diffdrive.model.quantity import Directional
from diffdrive.motion import load
from diffdrive.numerics.arrays import as_arrays
from experiments.studies.recovery.excitation import concatenate, resting, strokes
from tests.support.asymmetric_drive import ASYMMETRIC
from tuning.identification.filter_gain import PROCESS_FORCES, filter_lanes, most_likely
from tuning.identification.prediction import Lanes, constant_gains, predict
from tuning.identification.problem import IdentificationProblem, Innovations, lanes_of, sampling_of
from tuning.identification.refinement import linearised
from tuning.identification.row_force import delayed
from tuning.identification.unknowns import default_bounds, free_paths, unknowns_of
from tuning.optimisation.least_squares import with_jacobian
from tuning.optimisation.space import bounds_of, coordinates, search_space

RATE = 4_000.0
SAMPLING = sampling_of(RATE, 50e-6)
DELAYED = replace(ASYMMETRIC, actuator=Actuator(force_limit=105.0, delay_samples=1, delay_fraction=0.3))
NOISE = 3e-8  # m
CONTROLLER = PD(Tracking(PDGains(PAPER_KP, PAPER_KD)))


def reversal(rate=RATE):
    """Rest, presliding there and back, then 3 mm/s there and back, and rest: 0.24 s."""
    rows = ((4e-6, 2e-4, 0.02, 4.0), (1e-4, 3e-3, 0.3, 60.0))
    return concatenate([resting(0.02, rate), *strokes(rows, rate), resting(0.03, rate)], "reversal")


def growing(reference):
    """A load that comes on during the motion (N)."""
    end = reference.duration
    return load.ramp(reference.time, start=0.3 * end, end=0.6 * end, to=5_000.0)


@eqx.filter_jit
def _rolled(drive, inputs, sampling, key):
    return rollout_loop(drive, as_arrays(CONTROLLER), inputs, sampling, key)


def logged(drive, reference, sampling=SAMPLING, disturbance=None, seed=None):
    """One lane: what a simulated machine logs, its scale clean unless there is a seed."""
    loads = growing(reference)
    key = None if seed is None else jax.random.key(seed)
    frames = _rolled(as_arrays(drive), loop_inputs(reference, loads, disturbance), sampling, key)
    zero = np.zeros((1, len(loads)))
    return Lanes(frames.measured[None], frames.command[None], zero, loads[None], zero + 1.0, np.zeros(1))


@cache
def noisy_lane():
    return logged(replace(DELAYED, sensor=Sensor(noise=NOISE)), reversal(), seed=0)


predicted = eqx.filter_jit(predict)


def innovations(drive, lanes, gains, delay=1.3):
    return np.asarray(predicted(as_arrays(drive), jnp.asarray(delay), gains, lanes, SAMPLING).innovation)


def pulling(bandwidth, lanes, bristle=0.0):
    gains = constant_gains(bandwidth, NOISE, lanes, 1.0 / RATE)
    return gains._replace(bristle=jnp.full(gains.bristle.shape, bristle))


@settings(max_examples=15)
@given(st.floats(0.0, 5e3))
@example(0.0)
def test_a_simulation_is_foreseen_to_rounding_however_hard_it_is_pulled(bandwidth):
    lanes = clean_lane()
    assert np.ptp(lanes.position) > 5e-5
    assert np.max(np.abs(lanes.command)) > 105.0  # the limit acts
    assert np.max(np.abs(innovations(DELAYED, lanes, pulling(bandwidth, lanes)))) < 1e-15


@pytest.mark.parametrize("process", [1e-3, 1.0, 1e3])
def test_a_simulation_is_foreseen_to_rounding_under_the_filters_gains(process):
    lanes = clean_lane()
    gains = filter_lanes(as_arrays(DELAYED), 1.3, process, NOISE, lanes, SAMPLING).gains
    assert np.max(np.abs(gains.bristle)) > 1e-3
    assert np.max(np.abs(innovations(DELAYED, lanes, gains))) < 1e-15


@cache
def clean_lane():
    return logged(DELAYED, reversal())


def test_what_is_predicted_ends_at_the_velocity_of_the_simulation():
    lanes = clean_lane()
    frames = _rolled(as_arrays(DELAYED), loop_inputs(reversal(), growing(reversal())), SAMPLING, None)
    found = predicted(as_arrays(DELAYED), jnp.asarray(1.3), pulling(0.0, lanes), lanes, SAMPLING)
    np.testing.assert_allclose(found.velocity[0], frames.velocity, atol=1e-14)


def test_a_known_disturbance_is_foreseen_and_an_unknown_one_is_not():
    reference = reversal()
    pulses = np.where(np.sin(2 * np.pi * 30.0 * reference.time) > 0.9, 20.0, 0.0)
    unknown = logged(DELAYED, reference, disturbance=pulses)
    known = unknown._replace(disturbance=pulses[None])
    gains = pulling(500.0, known)
    assert np.max(np.abs(innovations(DELAYED, known, gains))) < 1e-15
    assert np.max(np.abs(innovations(DELAYED, unknown, gains))) > 1e-9


def test_a_current_loop_that_is_stated_is_foreseen_and_one_that_is_not_is_missing():
    answering = Actuator(force_limit=105.0, delay_samples=1, current_loop_frequency=400.0, current_loop_damping=0.7)
    drive = replace(ASYMMETRIC, actuator=answering)
    lanes = logged(drive, reversal())
    gains = pulling(100.0, lanes)
    assert np.max(np.abs(innovations(drive, lanes, gains, delay=1.0))) < 1e-14
    rigid = replace(ASYMMETRIC, actuator=Actuator(force_limit=105.0, delay_samples=1))
    assert np.max(np.abs(innovations(rigid, lanes, gains, delay=1.0))) > 1e-9


def test_where_the_position_is_counted_from_does_not_matter():
    lanes = noisy_lane()
    gains = pulling(300.0, lanes)
    here = innovations(DELAYED, lanes, gains)
    there = innovations(DELAYED, lanes._replace(position=lanes.position + 0.125), gains)
    assert np.std(here) > 0.5 * NOISE
    np.testing.assert_allclose(there, here, atol=2e-15)


def mirrored(drive):
    """The drive seen from its other end."""
    swapped = jax.tree.map(
        lambda part: Directional(part.negative, part.positive) if isinstance(part, Directional) else part,
        drive,
        is_leaf=lambda part: isinstance(part, Directional),
    )
    return eqx.tree_at(lambda d: d.plant.constant_force, swapped, -drive.plant.constant_force)


def test_a_mirrored_log_of_a_mirrored_drive_has_mirrored_innovations():
    # a velocity of exactly zero counts as positive on both, so both begin with next to none
    lanes = noisy_lane()._replace(velocity=np.array([1e-9]))
    turned = lanes._replace(**{name: -getattr(lanes, name) for name in ("position", "command", "velocity")})
    gains = pulling(300.0, lanes, 0.1)
    ours, theirs = innovations(DELAYED, lanes, gains), innovations(mirrored(DELAYED), turned, gains)
    assert np.std(ours) > 0.5 * NOISE
    np.testing.assert_allclose(theirs, -ours, atol=1e-18)
    assert np.max(np.abs(innovations(DELAYED, turned, gains) + ours)) > NOISE


def log_of(lanes, stop=None, **more):
    piece = slice(None, stop)
    signals = {name: np.asarray(getattr(lanes, name)[0, piece]) for name in ("position", "command", "load")}
    return Log("log", np.arange(len(signals["position"])) / RATE, **signals, **more)


def test_padding_changes_neither_innovations_nor_likelihood():
    lanes = noisy_lane()
    short = log_of(lanes, 500)
    alone, beside = lanes_of([short]), lanes_of([short, log_of(lanes)])
    assert beside.lanes == 2
    assert beside.counts[0].sum() == 500 < beside.counts.shape[1]
    drive = as_arrays(DELAYED)
    ours = innovations(drive, alone, pulling(300.0, alone))[0]
    np.testing.assert_allclose(innovations(drive, beside, pulling(300.0, beside))[0, :500], ours, atol=1e-18)
    padded = jax.tree.map(lambda one: one[:1], beside)
    values = [float(filter_lanes(drive, 1.3, 0.01, NOISE, each, SAMPLING).deviance) for each in (alone, padded)]
    assert values[0] == pytest.approx(values[1], rel=1e-9)


def test_a_log_with_a_gap_is_two_lanes_each_with_its_own_beginning():
    lanes = noisy_lane()
    whole = log_of(lanes)
    both = lanes_of([log_of(lanes, gaps=(400,))])
    assert both.lanes == 2
    np.testing.assert_array_equal(both.position[0, :400], whole.position[:400])
    np.testing.assert_array_equal(both.position[1, : len(whole.time) - 400], whole.position[400:])
    # through the gap the table went on: its velocity there is that of the whole log
    assert float(both.velocity[1]) == pytest.approx(RATE * np.diff(whole.position[395:406]).mean(), abs=2e-4)


# --- derivatives of the residuals


def problem_at(delay):
    """A machine believed a few per cent off, everything free, on rest, stick, sliding and a reversal under load."""
    lanes = noisy_lane()
    believed = unknowns_of(DELAYED, delay)
    free = tuple(
        default_bounds(path, float(eqx_value(believed, path)), float(believed.coulomb.positive))
        for path in free_paths(believed)
    )
    origin = search_space(believed, free).origin
    gains = filter_lanes(DELAYED, delay, 1.0, NOISE, lanes, SAMPLING).gains
    problem = IdentificationProblem(
        DELAYED, believed, believed, lanes, jax.tree.map(np.asarray, gains), origin, bounds_of(free),
        np.ones_like(origin),
    )  # fmt: skip
    return Innovations(coordinates(free), SAMPLING), as_arrays(problem)


def eqx_value(unknowns, path):
    for part in path.split("."):
        unknowns = getattr(unknowns, part)
    return unknowns


PATHS = free_paths(unknowns_of(ASYMMETRIC, 1.3))


@cache
def derivatives():
    """Forward-mode in one pass, jax's own, with the value alongside; and central differences at several steps."""
    residuals, problem = problem_at(1.3)
    y = 0.03 * np.random.default_rng(2).normal(size=len(residuals.free))
    y[-1] = 0.0
    slopes = [
        jax.jit(jax.jacfwd(with_jacobian(residuals)))(y, problem),
        jax.jit(jax.jacfwd(residuals))(y, problem),
        linearised(residuals, jnp.asarray(y), problem)[1],
    ]
    steps = np.array([1e-4, 3e-5, 1e-5])
    points = y + steps[:, None, None, None] * np.array([1.0, -1.0])[:, None, None] * np.eye(len(y))
    values = jax.jit(lambda all: jax.lax.map(lambda one: residuals(one, problem), all))(points.reshape(-1, len(y)))
    values = np.asarray(values).reshape(len(steps), 2, len(y), -1)
    differences = (values[:, 0] - values[:, 1]) / (2 * steps[:, None, None])
    return [np.asarray(slope).T for slope in slopes], differences


def test_the_log_of_the_derivatives_visits_rest_stick_sliding_and_reversals():
    frames = _rolled(as_arrays(DELAYED), loop_inputs(reversal(), growing(reversal())), SAMPLING, None)
    velocity = np.asarray(frames.velocity)
    assert velocity[0] == 0.0
    assert np.mean(np.abs(velocity) < 1e-5) > 0.1
    assert np.ptp(np.sign(velocity[np.abs(velocity) > 2e-3])) == 2.0  # slides both ways
    assert np.ptp(np.sign(velocity[(np.abs(velocity) > 2e-5) & (np.abs(velocity) < 2e-4)])) == 2.0


@pytest.mark.long
@pytest.mark.parametrize("path", PATHS)
def test_the_jacobian_is_the_central_difference(path):
    """At the step that suits it best of three: a switch of direction that moves past a substep is a kink."""
    (column, *others), differences = derivatives()
    k = PATHS.index(path)
    size = np.linalg.norm(column[k])
    assert size > 10.0  # noise of the log is 1: each is to be seen
    assert min(np.linalg.norm(one[k] - column[k]) for one in differences) < 1e-6 * size
    for other in others:
        np.testing.assert_allclose(other[k], column[k], atol=1e-10 * size)


# --- the filter


def by_hand(drive, delay, process, lanes, samples):
    """The textbook's extended Kalman filter; its transition matrix by central differences of a control period."""
    period, substeps = SAMPLING.period, SAMPLING.plant_steps
    force = np.asarray(delayed(jnp.clip(lanes.command[0], -105.0, 105.0), delay))

    @jax.jit
    def ahead(state, force, load):
        moved = plant.advance(as_arrays(drive), plant.PlantState(*state), force, load, period, substeps)
        return jnp.stack(moved)

    position, loads, friction = np.asarray(lanes.position[0]), np.asarray(lanes.load[0]), drive.friction
    level = friction.coulomb_screw.positive + friction.load_coefficient.positive * (friction.initial_load + loads[0])
    stiffness, velocity = friction.bristle_stiffness.positive, float(lanes.velocity[0])
    gap = friction.breakaway_gap.positive * np.exp(-velocity / friction.stribeck_velocity.positive)
    state = np.array([position[0], velocity, (level + gap) / stiffness * np.tanh(velocity / 1e-3)])
    spread = np.diag([NOISE**2, 1e-3**2, (0.5 * level / stiffness) ** 2])
    added = np.diag([0.0, (process * period / drive.plant.mass) ** 2, 0.0])
    sees = np.array([[1.0, 0.0, 0.0]])
    steps = np.array([1e-9, 1e-10, 1e-12])
    gains, scatter = [], []
    for k in range(samples):
        variance = (sees @ spread @ sees.T).item() + NOISE**2
        pull = (spread @ sees.T / variance)[:, 0]
        state = state + pull * (position[k] - state[0])
        spread = (np.eye(3) - np.outer(pull, sees)) @ spread
        columns = [
            (ahead(state + one, force[k], loads[k]) - ahead(state - one, force[k], loads[k])) / (2 * step)
            for one, step in zip(np.diag(steps), steps, strict=True)
        ]
        moves = np.stack(columns, axis=1)
        state = np.asarray(ahead(state, force[k], loads[k]))
        spread = moves @ spread @ moves.T + added
        gains.append(pull)
        scatter.append(np.sqrt(variance))
    return np.array(gains), np.array(scatter)


def test_the_filter_is_the_textbooks():
    lanes = noisy_lane()._replace(velocity=np.array([1e-6]))  # at exactly zero the directions meet in a kink
    samples = 450  # past the reversal of presliding
    gains, scatter = by_hand(DELAYED, 1.3, 0.5, lanes, samples)
    found = filter_lanes(as_arrays(DELAYED), 1.3, 0.5, NOISE, lanes, SAMPLING)
    ours = np.stack([np.asarray(one[0, :samples]) for one in found.gains[:3]], axis=1)
    np.testing.assert_allclose(np.asarray(found.gains.innovation_std[0, :samples]), scatter, rtol=1e-7)
    size = np.abs(gains).max(axis=0)
    np.testing.assert_allclose(ours / size, gains / size, atol=1e-7)


def test_the_innovations_of_a_filter_are_those_of_the_prediction_under_its_gains():
    lanes = noisy_lane()
    found = filter_lanes(as_arrays(DELAYED), 1.3, 0.5, NOISE, lanes, SAMPLING)
    again = innovations(DELAYED, lanes, found.gains)
    np.testing.assert_allclose(again, np.asarray(found.innovation), atol=1e-15)


def test_on_an_exact_model_the_normalised_innovations_are_white_noise_of_size_one():
    lanes = noisy_lane()
    found = filter_lanes(as_arrays(DELAYED), 1.3, 1e-3, NOISE, lanes, SAMPLING)
    normal = np.asarray(found.innovation / found.gains.innovation_std)[0, 50:]
    assert np.std(normal) == pytest.approx(1.0, abs=4 / np.sqrt(2 * len(normal)))
    assert abs(np.mean(normal[1:] * normal[:-1])) < 4 / np.sqrt(len(normal))


@cache
def filtered_under(amplitude):
    reference = reversal()
    sine = amplitude * np.sin(2 * np.pi * 3.0 * reference.time)
    lanes = logged(replace(DELAYED, sensor=Sensor(noise=NOISE)), reference, disturbance=sine, seed=0)
    found = most_likely(as_arrays(DELAYED), 1.3, NOISE, lanes, SAMPLING)
    return found, filter_lanes(as_arrays(DELAYED), 1.3, found.process_force, NOISE, lanes, SAMPLING)


def test_an_exact_model_needs_no_force():
    found, _ = filtered_under(0.0)
    assert found.process_force == PROCESS_FORCES[0]
    assert found.deviance_gain == 0.0


def test_a_force_that_the_model_lacks_is_found_in_its_size():
    """A sine is not white: what must be given the filter grows with it, as it grows within the filter's memory."""
    (small, follows), (large, _) = filtered_under(2.0), filtered_under(20.0)
    assert 0.2 < small.process_force < 20.0
    assert 2.0 < large.process_force < 200.0
    assert large.process_force > 3 * small.process_force
    assert 1e3 < small.deviance_gain < large.deviance_gain
    reference = reversal()
    given = 2.0 * np.sin(2 * np.pi * 3.0 * reference.time)
    invented = DELAYED.plant.mass * RATE * np.asarray(follows.gains.velocity * follows.innovation)[0]
    smooth = scipy.ndimage.uniform_filter1d(invented, 80)
    late = reference.time > 0.05  # once the bristle is known
    # the bristle's corrections stand for the rest
    assert np.corrcoef(smooth[late], given[late])[0, 1] > 0.85
    assert 0.5 < np.std(smooth[late]) / np.std(given[late]) < 1.5


@pytest.mark.parametrize("amplitude", [0.0, 2.0, 20.0])
def test_the_likeliest_force_is_that_of_all(amplitude):
    """Though not all of them are tried."""
    reference = reversal()
    sine = amplitude * np.sin(2 * np.pi * 3.0 * reference.time)
    lanes = logged(replace(DELAYED, sensor=Sensor(noise=NOISE)), reference, disturbance=sine, seed=0)
    every = [
        float(filter_lanes(as_arrays(DELAYED), 1.3, one, NOISE, lanes, SAMPLING).deviance) for one in PROCESS_FORCES
    ]
    found, _ = filtered_under(amplitude)
    assert found.process_force == PROCESS_FORCES[np.argmin(every)]
    assert found.deviance == pytest.approx(min(every), rel=1e-12)
    assert found.deviance_gain == pytest.approx(every[0] - min(every), rel=1e-9)


def test_without_the_constant_force_the_filter_invents_it():
    drive = eqx.tree_at(lambda d: d.plant.constant_force, DELAYED, 0.0)
    found = most_likely(as_arrays(drive), 1.3, NOISE, noisy_lane(), SAMPLING)
    filtered = filter_lanes(as_arrays(drive), 1.3, found.process_force, NOISE, noisy_lane(), SAMPLING)
    force = drive.plant.mass * RATE * np.asarray(filtered.gains.velocity * filtered.innovation)[0]
    assert found.deviance_gain > 1e3
    assert np.mean(force[200:]) == pytest.approx(12.0, rel=0.3)
