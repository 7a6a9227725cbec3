"""Effects that follow the table within a period, against the naive oracle: the equations as they stand, microsecond by
microsecond.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.effects import stages
from diffdrive.effects.forces import ConstantForce, FrameVibration
from diffdrive.effects.friction import ELEMENTS, FrictionDwell, PreslidingHysteresis
from diffdrive.effects.transmission import Backlash, Compliance
from diffdrive.model.plant import advance, at_rest
from diffdrive.model.presets import paper_drive
from diffdrive.numerics.arrays import as_arrays

LOAD = 2_000.0
FORCE = 220.0  # N, to and fro
STEP = 1e-6  # s, of the oracle
DRIVE = paper_drive()
MASS = float(DRIVE.plant.mass)


def forces(rate):
    """There and back, held over each period: through presliding into sliding, three times."""
    time = np.arange(round(0.1 * rate)) / rate
    return FORCE * np.sin(2.0 * np.pi * 30.0 * time)


def side(pair, sign):
    return float(pair.positive if sign >= 0 else pair.negative)


def gap_of(v, growth=0.0):
    return side(DRIVE.friction.breakaway_gap, v) * (1.0 + growth)


def level_of(way, speed, gap):
    """Friction level (N) in a direction at a speed."""
    friction = DRIVE.friction
    level = side(friction.coulomb_screw, way)
    level += side(friction.load_coefficient, way) * (float(friction.initial_load) + LOAD)
    return level + gap * math.exp(-speed / side(friction.stribeck_velocity, way))


def resisting(v, z, gap, share=0.0, elements=0.0):
    """Friction and damping (N) and the bristle's rate; what Maxwell elements hold (N) in the place of a share of it."""
    friction, level = DRIVE.friction, level_of(v, abs(v), gap)
    stiffness = side(friction.bristle_stiffness, z)
    drift = v - stiffness * abs(v) / level * z
    held = (1.0 - share) * stiffness * z + share * elements
    drag = (side(friction.viscous, v) + side(DRIVE.plant.damping, v)) * v
    return held + side(friction.bristle_damping, v) * drift + drag, drift


def of_elements(effect, rate):
    distances = [
        effect.longest * (effect.shortest + (1.0 - effect.shortest) * k / (ELEMENTS - 1)) for k in range(ELEMENTS)
    ]
    x, v, z, stretched, found = 0.0, 0.0, 0.0, [0.0] * ELEMENTS, []
    for u in forces(rate):
        found.append(x)
        for _ in range(round(1.0 / rate / STEP)):
            up, down = (level_of(way, abs(v), gap_of(way)) for way in (1.0, -1.0))
            held = sum(e * (up if e >= 0.0 else down) for e in stretched) / ELEMENTS
            force, drift = resisting(v, z, gap_of(v), effect.share, held)
            a = (u - force) / MASS
            x, z = x + STEP * (v + 0.5 * STEP * a), z + STEP * drift
            stretched = [min(max(e + STEP * v / d, -1.0), 1.0) for e, d in zip(stretched, distances, strict=True)]
            v += STEP * a
    return np.array(found)


def of_dwell(effect, rate):
    x, v, z, age, found = 0.0, 0.0, 0.0, effect.rested, []
    for u in forces(rate):
        found.append(x)
        for _ in range(round(1.0 / rate / STEP)):
            force, drift = resisting(v, z, gap_of(v, effect.growth * math.log1p(age / effect.onset)))
            a = (u - force) / MASS
            x, z = x + STEP * (v + 0.5 * STEP * a), z + STEP * drift
            age += STEP * (1.0 - abs(v) * age / effect.slip)
            v += STEP * a
    return np.array(found)


def of_screw(effect, rate):
    """Motor and table: q is by how far the motor is ahead."""
    s, r, half = effect.motor_share, effect.table_friction, 0.5 * getattr(effect, "gap", 0.0)
    reduced = s * (1.0 - s) * MASS
    stiffness = reduced * (2.0 * math.pi * effect.frequency) ** 2
    damping = 2.0 * effect.damping * math.sqrt(stiffness * reduced)
    x = v = z = q = w = y = 0.0
    found = []
    for u in forces(rate):
        found.append(x)
        for _ in range(round(1.0 / rate / STEP)):
            table, drift = resisting(v, z, gap_of(v))
            motor, turn = resisting(v + w, y, gap_of(v + w))
            beyond = q - min(max(q, -half), half)
            pull = stiffness * beyond + (damping * w if beyond != 0.0 or half == 0.0 else 0.0)
            pull = pull if half == 0.0 or pull * beyond > 0.0 else 0.0  # the sides of a gap push, they do not hold on
            a = (pull - r * table) / ((1.0 - s) * MASS)
            ahead = (u - (1.0 - r) * motor - pull) / (s * MASS) - a
            x, z = x + STEP * (v + 0.5 * STEP * a), z + STEP * drift
            q, y = q + STEP * (w + 0.5 * STEP * ahead), y + STEP * turn
            v, w = v + STEP * a, w + STEP * ahead
    return np.array(found)


def ours(effect, rate):
    return driven(dataclasses.replace(DRIVE, effects=(effect,)), rate, forces(rate))


def driven(drive, rate, forces):
    """Positions of the table under these forces, period by period."""
    drive, period = as_arrays(drive), 1.0 / rate

    def body(carry, force):
        table, states = carry
        seen = stages.seen_by(drive, 0.0, *table, force, 0.0, LOAD)
        states, acts = stages.table_action(drive.effects, states, seen, drive, period)
        moved = advance(
            stages.with_friction_offset(drive, acts), table, force + acts.force, LOAD, period, round(period / 1e-5)
        )
        return (moved._replace(position=moved.position + acts.shift), states), table.position

    begin = (at_rest(0.0), stages.initial_states(drive.effects, 0.0))
    return np.asarray(jax.lax.scan(body, jax.tree.map(jnp.asarray, begin), jnp.asarray(forces))[1])


def pushes(off, rate):
    """The force (N) that would move the table so from period to period: what a filter sees of an error."""
    return MASS * rate**2 * np.diff(off, 2)


def rms(signal):
    return np.sqrt(np.mean(signal**2))


@pytest.mark.long
@pytest.mark.parametrize("rate", [2_000.0, 10_000.0])
@pytest.mark.parametrize("longest", [2e-6, 1e-5])
def test_elements_move_the_table_as_the_equations_say(rate, longest):
    """Also where the whole hysteresis is over within a few periods."""
    effect = PreslidingHysteresis(1.0, longest, 0.2)
    truth, without = of_elements(effect, rate), ours(PreslidingHysteresis(0.0, longest, 0.2), rate)
    assert np.ptp(truth) > 1e-4
    assert np.max(np.abs(ours(effect, rate) - truth)) < 7e-3 * np.max(np.abs(without - truth))


@pytest.mark.parametrize(("rate", "allowed"), [(2_000.0, 0.01), (10_000.0, 3e-4)])
def test_elements_stretch_alike_by_forces_and_by_a_known_travel(rate, allowed):
    """What the forces make of them in steps within a period, and what the travel from one sample to the next does."""
    effect, drive, period = PreslidingHysteresis(1.0, 5e-6, 0.2), as_arrays(DRIVE), 1.0 / rate

    def body(carry, force):
        table, state, other = carry
        seen = stages.seen_by(drive, 0.0, *table, force, 0.0, LOAD)
        ahead, acts = effect.step(state, seen, drive, period)
        moved = advance(
            stages.with_friction_offset(drive, acts), table, force + acts.force, LOAD, period, round(period / 1e-5)
        )
        moved = moved._replace(position=moved.position + acts.shift)
        other = effect.state_after_travel(other, seen, moved.position - table.position, drive, period)
        return (moved, ahead, other), (jnp.stack(ahead), jnp.stack(other))

    begin = (at_rest(0.0), effect.init(), effect.init())
    by_forces, by_travel = jax.lax.scan(body, jax.tree.map(jnp.asarray, begin), jnp.asarray(forces(rate)))[1]
    assert np.ptp(by_forces[:, 0]) > 1.9  # of the longest element, from one stop to the other
    off = np.sqrt(np.mean(np.asarray(by_travel - by_forces) ** 2, axis=0)) / np.ptp(by_forces, axis=0)
    assert np.all(off < allowed)


@pytest.mark.long
@pytest.mark.parametrize("slip", [3e-6, 1e-5])
def test_a_dwell_holds_the_table_as_the_equations_say(slip):
    effect, rate = FrictionDwell(1.0, 0.05, slip, 5.0), 2_000.0
    truth, without = of_dwell(effect, rate), ours(FrictionDwell(0.0, 0.05, slip, 5.0), rate)
    assert np.max(np.abs(ours(effect, rate) - truth)) < 7e-3 * np.max(np.abs(without - truth))


@pytest.mark.long
@pytest.mark.parametrize(
    ("screw", "share"),
    [
        (Compliance(150.0, 0.05, 0.3, 0.6), 0.01),
        (Compliance(400.0, 0.05, 0.4, 0.5), 0.03),
        (Backlash(4e-6, 400.0, 0.1, 0.3, 0.6), 0.02),
        (Backlash(1e-5, 250.0, 0.08, 0.4, 0.5), 0.02),
    ],
)
def test_a_screw_moves_the_table_as_two_masses_would(screw, share):
    """At a period in which the screw swings through a fifth of a turn and more, and bounces in its play."""
    rate = 2_000.0
    truth, found = of_screw(screw, rate), ours(screw, rate)
    stiff = dataclasses.replace(screw, frequency=1e5, **({"gap": 0.0} if isinstance(screw, Backlash) else {}))
    assert rms(pushes(found - truth, rate)) < share * rms(pushes(ours(stiff, rate) - truth, rate))


FOLLOWERS = [
    PreslidingHysteresis(1.0, 5e-6, 0.2),
    FrictionDwell(1.0, 0.05, 1e-5, 0.0),
    FrameVibration(0.05, 20.0, 0.03),
    Compliance(150.0, 0.05, 0.3, 0.6),
    Backlash(4e-6, 400.0, 0.1, 0.3, 0.6),
]


@pytest.mark.parametrize("rate", [500.0, 2_000.0, 10_000.0])
@pytest.mark.parametrize("effect", FOLLOWERS, ids=lambda effect: effect.name)
def test_under_a_held_force_the_table_comes_to_rest(effect, rate):
    """Below breakaway: what is left of the motion after a second is rounding."""
    drive = dataclasses.replace(DRIVE, effects=(effect,))
    held = 40.0 * np.clip(np.arange(round(3.0 * rate)) / rate / 0.2, 0.0, 1.0)
    last = driven(drive, rate, held)[round(2.0 * rate) :]
    assert last[0] > 1e-7
    assert np.ptp(last) < 1e-12 + 1e-4 * last[0] * (effect.name == "frame_vibration")  # that one rings on


@pytest.mark.parametrize("effect", FOLLOWERS, ids=lambda effect: effect.name)
def test_a_constant_force_is_the_same_beside_the_drive_and_in_it(effect):
    rate = 2_000.0
    beside = dataclasses.replace(DRIVE, effects=(effect, ConstantForce(20.0)))
    plant = dataclasses.replace(DRIVE.plant, constant_force=DRIVE.plant.constant_force + 20.0)
    within = dataclasses.replace(DRIVE, plant=plant, effects=(effect,))
    found, wanted = (driven(drive, rate, forces(rate)) for drive in (beside, within))
    assert np.max(np.abs(found - wanted)) < 1e-9 * np.ptp(wanted)


@pytest.mark.parametrize("effect", FOLLOWERS[:2], ids=lambda effect: effect.name)
def test_a_force_that_something_else_holds_moves_nothing(effect):
    """An observer that finds the table at rest although it is pushed: no element is stretched, and the contact ages."""
    drive, period = as_arrays(DRIVE), 5e-4
    seen = stages.seen_by(drive, 0.0, 0.0, 0.0, 0.0, 20.0, 0.0, LOAD)
    pushes = seen.external_force(drive)
    state, acts = effect.step(effect.init(), seen._replace(disturbance=-20.0 - pushes), drive, period)
    still, none = effect.step(effect.init(), seen._replace(force=-pushes), drive, period)
    np.testing.assert_allclose(state, still, rtol=1e-12, atol=1e-15)
    assert float(acts.force) == float(none.force) == 0.0
