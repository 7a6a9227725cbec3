"""The search for a candidate begins near what the missing force shows."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from tuning.diagnosis.hypotheses.catalogue import candidates
from tuning.diagnosis.hypotheses.harmonics import at_its_root
from tuning.diagnosis.hypotheses.setting import Setting
from tuning.diagnosis.selection.starting_points import starting_points

RATE = 1_000.0
SETTING = Setting(100.0, 70.0, 4e-4, 2e3, 0.0, 3e-6, 1.0 / RATE, 9.0, -0.02, 0.02, 0.06, 200.0, 200.0)


TIME = np.arange(8_000) / RATE
POSITION = 0.04 * np.sin(1.1 * TIME) + 0.01 * np.sin(3.7 * TIME)
VELOCITY = np.gradient(POSITION, TIME)


def _off(name, parameter, period, measured, force, noise):
    """Turns over the travel, by which the nearest point that a search begins from is off."""
    flat = np.zeros((1, len(TIME)))
    lanes = SimpleNamespace(counts=flat + 1.0, position=jnp.asarray(measured)[None])
    logged = SimpleNamespace(logs=1, owner=(0,), starts=jnp.zeros(1), sampling=SimpleNamespace(rate=RATE), lanes=lanes)
    trajectory = SimpleNamespace(position=POSITION[None])
    filtered = SimpleNamespace(
        kalman_gain=(flat, flat),
        innovation=noise[None],
        normalised_innovation=noise[None] / (1e-7 + flat),
        disturbance=force[None],
        trajectory=trajectory,
    )
    drive = SimpleNamespace(plant=SimpleNamespace(mass=100.0))
    candidate = next(one for one in candidates(SETTING) if one.name == name)
    points = starting_points(
        SimpleNamespace(model=SimpleNamespace(logged=logged), filtered=filtered, drive=drive), candidate
    )
    travel = np.ptp(POSITION)
    return min(abs(travel / float(one[parameter][0]) - travel / period) for one in points)


@pytest.mark.long
@pytest.mark.parametrize("passes_for", ["force", "noise"])
@pytest.mark.parametrize(("name", "parameter", "period"), [
    ("lead_error", "lead", 3.7e-3), ("lead_error", "lead", 5.08e-3), ("lead_error", "lead", 2.5e-2),
    ("interpolation_error", "period", 2.35e-5), ("interpolation_error", "period", 3.3e-6),
])  # fmt: skip
def test_the_period_of_a_scales_error_is_seen_in_what_it_passes_for(name, parameter, period, passes_for):
    """Whatever it is: a position error e(x) reads as a force m e''(x) v^2; too quick for that, as noise."""
    wave = np.cos(2 * np.pi * POSITION / period) * (VELOCITY**2 if passes_for == "force" else 1.0)
    wave = wave / wave.std() + 0.5 * np.random.default_rng(1).standard_normal(wave.shape)
    flat = np.zeros_like(wave)
    force, noise = (wave, flat) if passes_for == "force" else (flat, 1e-7 * wave)
    assert _off(name, parameter, period, POSITION, force, noise) < 0.25  # turns over the travel: a fit finds the rest


def test_a_long_period_is_seen_beside_many_short_ones_that_stand_out_further():
    """A motor's cogging, in ten times as much noise, where places shake the table at short periods."""
    short = sum(np.cos(2 * np.pi * POSITION / period) for period in np.geomspace(6e-5, 9e-5, 8))
    wave = 2.0 * np.cos(2 * np.pi * POSITION / 3.3333e-3)
    noise = 20.0 * np.random.default_rng(1).standard_normal(wave.shape)
    still = np.zeros_like(wave)
    assert _off("cogging", "period", 3.3333e-3, POSITION, wave + 5.0 * short + noise, still) < 0.25


@pytest.mark.parametrize("period", [2.35e-5, 8.79e-6, 3.3e-6])
def test_the_period_of_a_scales_error_is_seen_where_the_table_goes_through_many_a_sample(period):
    """The filter shows nothing of it: at 80 mm/s, 3.4 to 24 periods go by in a sample of 1 ms."""
    noise = 5e-8 * np.random.default_rng(1).standard_normal(POSITION.shape)
    measured = POSITION + 3e-7 * np.cos(2 * np.pi * POSITION / period) + noise
    flat = np.zeros_like(measured)
    assert _off("interpolation_error", "period", period, measured, flat, flat) < 0.25


@pytest.mark.parametrize(("name", "order"), [("cogging", 2), ("cogging", 6), ("process_force", 2)])
def test_a_wave_that_is_above_all_a_harmonic_is_told_by_its_own_period(name, order):
    candidate = next(one for one in candidates(SETTING) if one.name == name)
    of, power = {"cogging": ("period", -1.0), "process_force": ("frequency", 1.0)}[name]
    values = {one.name: np.zeros(2) for one in candidate.parameters} | {of: np.array([0.04, 0.04])}
    values |= {"cosine": np.array([0.0, 1e-3])}
    values |= {f"cosine{order}": np.array([3.0, 2.0]), f"sine{order}": np.array([4.0, -3.0])}
    found = at_its_root(candidate, values)

    def wave(one, at):
        turned = 2.0 * np.pi * (at / one[of] if of == "period" else at * one[of])
        orders = ("", "2", "6") if "cosine6" in one else ("", "2")
        parts = ((one[f"cosine{k}"], one[f"sine{k}"], float(k or 1)) for k in orders)
        return sum(cosine * np.cos(k * turned) + sine * np.sin(k * turned) for cosine, sine, k in parts)

    assert found[of] == pytest.approx(np.full(2, order**power * 0.04))
    for at in (0.0, 0.013, 0.3):
        assert wave(found, at) == pytest.approx(wave(values, at), abs=2e-3)
    assert found.keys() == values.keys()


def test_a_wave_whose_first_harmonic_is_its_strongest_stays_as_it_is():
    candidate = next(one for one in candidates(SETTING) if one.name == "cogging")
    values = {one.name: np.zeros(1) for one in candidate.parameters} | {"period": np.array([0.04])}
    values |= {"sine": np.array([3.0]), "cosine2": np.array([2.9]), "sine6": np.array([-1.0])}
    assert at_its_root(candidate, values) is values


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("later", [7.0, 3607.0])
def test_the_times_of_a_load_are_those_of_each_log(sign, later):
    """One log in two pieces, put on in the first and taken off in the second; one where it stays on to its end, which
    comes before that of the others.
    """
    windows, starts, owner = [(3.2, later + 2.1), (2.4, None)], [0.0, later, 0.0], (0, 0, 1)
    time = np.arange(round(6.0 * RATE)) / RATE
    velocity = np.stack([0.05 * np.cos(3.0 * time)] * 3)
    when = np.asarray(starts)[:, None] + time
    on = np.stack([
        (at >= windows[log][0]) & (windows[log][1] is None or at < windows[log][1])
        for at, log in zip(when, owner, strict=True)
    ])  # fmt: skip
    room = np.random.default_rng(4)
    force = -np.sign(velocity) * (sign * 3.0 * on + 1.0) + room.standard_normal(velocity.shape)
    counts = np.ones_like(force)
    counts[2, 5_500:] = 0.0
    lanes = SimpleNamespace(counts=counts, position=jnp.zeros_like(force))
    sampling = SimpleNamespace(rate=RATE)
    logged = SimpleNamespace(logs=2, owner=owner, starts=jnp.asarray(starts), sampling=sampling, lanes=lanes)
    flat = np.zeros_like(force)
    filtered = SimpleNamespace(
        kalman_gain=(flat, flat), innovation=flat, disturbance=force, trajectory=SimpleNamespace(velocity=velocity)
    )
    drive = SimpleNamespace(plant=SimpleNamespace(mass=100.0))
    candidate = next(one for one in candidates(SETTING) if len(one.parameters) > 1 and one.name == "applied_load")
    points = starting_points(
        SimpleNamespace(model=SimpleNamespace(logged=logged), filtered=filtered, drive=drive), candidate
    )
    more, less = points[-2:]
    found = more if sign > 0 else less
    np.testing.assert_allclose(found["start"], [3.2, 2.4], atol=0.06)
    assert found["end"][0] == pytest.approx(later + 2.1, abs=0.06)
    assert found["end"][1] > 6.0  # never, in this log
