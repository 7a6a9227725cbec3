"""Maxwell elements under a force, against the naive oracle: every equation as it stands, in steps of a microsecond."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.effects import acting
from diffdrive.effects.friction import ELEMENTS, PreslidingHysteresis
from diffdrive.parameters import as_arrays
from diffdrive.plant import advance, at_rest
from diffdrive.presets import paper_drive

LOAD = 2_000.0
FORCE = 220.0  # N, to and fro


def forces(rate):
    """There and back, held over each period: through presliding into sliding, three times."""
    time = np.arange(round(0.1 * rate)) / rate
    return FORCE * np.sin(2.0 * np.pi * 30.0 * time)


def oracle(effect, rate, step=1e-6):
    drive = paper_drive()
    friction, plant = drive.friction, drive.plant

    def side(pair, sign):
        return float(pair.positive if sign >= 0 else pair.negative)

    distance = effect.longest * (effect.shortest + (1.0 - effect.shortest) * np.arange(ELEMENTS) / (ELEMENTS - 1))
    x, v, z, stretched, found = 0.0, 0.0, 0.0, np.zeros(ELEMENTS), []
    for u in forces(rate):
        found.append(x)
        for _ in range(round(1.0 / rate / step)):
            pressed = float(friction.initial_load) + LOAD
            level = side(friction.coulomb_screw, v) + side(friction.load_coefficient, v) * pressed
            slow = side(friction.stribeck_velocity, v)
            level += side(friction.breakaway_gap, v) * np.exp(-abs(v) / slow)
            stiffness = side(friction.bristle_stiffness, z)
            drift = v - stiffness * abs(v) / level * z
            held = (1.0 - effect.share) * stiffness * z + effect.share * level * np.mean(stretched)
            drag = (side(friction.viscous, v) + side(plant.damping, v)) * v
            a = (u - held - side(friction.bristle_damping, v) * drift - drag) / float(plant.mass)
            x, z = x + step * (v + 0.5 * step * a), z + step * drift
            stretched = np.clip(stretched + step * v / distance, -1.0, 1.0)
            v = v + step * a
    return np.array(found)


def ours(effect, rate):
    drive = as_arrays(dataclasses.replace(paper_drive(), effects=(effect,)))
    period = 1.0 / rate

    def body(carry, force):
        table, states = carry
        seen = acting.seen_by(drive, 0.0, *table, force, 0.0, LOAD)
        states, acts = acting.upon(drive.effects, states, seen, drive, period)
        moved = advance(drive, table, force + acts.force, LOAD, period, round(period / 1e-5))
        return (moved, states), table.position

    begin = (at_rest(0.0), acting.at_rest(drive.effects, 0.0))
    return np.asarray(jax.lax.scan(body, jax.tree.map(jnp.asarray, begin), jnp.asarray(forces(rate)))[1])


@pytest.mark.parametrize("rate", [2_000.0, 10_000.0])
@pytest.mark.parametrize("longest", [2e-6, 1e-5])
def test_elements_move_the_table_as_the_equations_say(rate, longest):
    """Also where the whole hysteresis is over within a few periods; the bristle alone is far off."""
    effect = PreslidingHysteresis(1.0, longest, 0.2)
    truth = oracle(effect, rate)
    found, bristle = ours(effect, rate), ours(PreslidingHysteresis(0.0, longest, 0.2), rate)
    assert np.ptp(truth) > 1e-4
    assert np.max(np.abs(found - truth)) < 7e-3 * np.max(np.abs(bristle - truth))
