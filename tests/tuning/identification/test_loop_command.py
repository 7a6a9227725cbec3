"""The command of snapshots by the law of their loop, against loops of which every sample is known."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from experiments.studies.controller_study import NaiveCascade
from tests.support.slow_trace import every
from tuning.diagnosis.selection.snapshots import within_rows
from tuning.identification.loop_command import loop_command

SAMPLES, SECONDS = 4, 8.0
NOISY = NaiveCascade(ratio=1, velocity_samples=1, noise=7e-8)  # of each sample, 40 N of noise in the command
WIDTH = 51  # rows, whose mean shows the slow part


def slow(signal):
    return uniform_filter1d(signal, WIDTH)[WIDTH:-WIDTH]


def rms(signal):
    return float(np.sqrt(np.mean(signal**2)))


def rows_and_forces(cascade, seed):
    """A trace of every fourth sample, and the mean command from row to row."""
    log = cascade.log(SECONDS, seed)
    return every(log, SAMPLES), log.command.reshape(-1, SAMPLES).mean(axis=1)


def means(command):
    """Of what the loop holds from row to row, where its command is smooth between them."""
    return np.asarray(within_rows(jnp.asarray(command), SAMPLES)).mean(axis=1)


@pytest.mark.parametrize(
    "cascade",
    [NOISY, replace(NOISY, velocity_samples=2, velocity_feedforward=0.9), replace(NOISY, acceleration_feedforward=400)],
)
def test_the_slow_force_is_known_far_better_than_rows_tell_it_and_as_well_as_is_said(cascade):
    raw, left, said = [], [], []
    for seed in (1, 2, 3):
        rows, force = rows_and_forces(cascade, seed)
        law = loop_command([rows])
        raw.append(rms(slow(means(rows.command) - force)))
        left.append(rms(slow(means(law.commands[0]) - force)))
        said.append(law.std)
    assert rms(np.array(left)) < 0.3 * rms(np.array(raw))
    assert 0.5 < rms(np.array(left)) / rms(np.array(said)) < 1.5


@pytest.mark.parametrize("window", [SAMPLES, 2 * SAMPLES])
def test_a_velocity_over_whole_rows_has_no_slow_noise_and_its_command_acts_as_logged(window):
    rows, force = rows_and_forces(replace(NOISY, velocity_samples=window), 1)
    law = loop_command([rows])
    np.testing.assert_array_equal(law.commands[0], rows.command)
    assert rms(slow(means(rows.command) - force)) < law.std < 1.0


@pytest.mark.parametrize("window", [2, 3, 5, 6, 7])
def test_a_velocity_over_part_of_a_row_has_white_noise_and_its_command_is_the_laws(window):
    rows, force = rows_and_forces(replace(NOISY, velocity_samples=window), 1)
    law = loop_command([rows])
    left, raw = (rms(slow(means(one) - force)) for one in (law.commands[0], rows.command))
    assert left < 0.7 * raw
    assert left < 2.5 * law.std


def test_without_noise_the_law_answers_as_the_loop_did():
    rows, _ = rows_and_forces(replace(NOISY, noise=0.0, resolution=1e-12), 1)
    law = loop_command([rows])
    assert 0.0 < rms(slow(law.commands[0] - rows.command)) < 1e-4 * rms(rows.command)
    assert law.std < 1e-3 * rms(rows.command)


def test_logs_of_one_loop_are_known_better_together():
    both = [rows_and_forces(NOISY, seed)[0] for seed in (1, 2)]
    assert loop_command(both).std < 0.85 * loop_command(both[:1]).std


@pytest.mark.parametrize("other", [{"kv": 5e4}, {"kp": 40.0}, {"velocity_feedforward": 1.0}])
def test_logs_of_two_loops_have_a_law_each(other):
    logs, forces = zip(rows_and_forces(NOISY, 1), rows_and_forces(replace(NOISY, **other), 2), strict=True)
    law = loop_command(logs)
    left = [rms(slow(means(one) - force)) for one, force in zip(law.commands, forces, strict=True)]
    assert max(left) < 2.0 * law.std < 3.0


def test_what_the_law_lacks_is_followed_and_counted():
    """A slow force of another source in the command: it acts, too."""
    rows, force = rows_and_forces(NOISY, 1)
    more = 30.0 * np.sin(2.0 * np.pi * 0.3 * rows.time)
    law, plain = loop_command([replace(rows, command=rows.command + more)]), loop_command([rows])
    error = slow(means(law.commands[0]) - force - more)
    assert rms(error) < 0.25 * rms(more)
    assert plain.std < law.std
    assert rms(error) < 2.0 * law.std


def test_a_clipped_command_is_what_is_logged_and_the_integral_is_another_after_it():
    """As the loop went on, its integral elsewhere, while the command stood at its limit."""
    rows, force = rows_and_forces(NOISY, 1)
    begins, ends = 4000, 4100
    at, after = np.arange(len(rows.time)), np.where(np.arange(len(rows.time)) < ends, 0.0, 500.0)
    most = np.abs(rows.command).max() + 600.0
    clipped = np.where((at >= begins) & (at < ends), most, rows.command + after)
    law = loop_command([replace(rows, command=clipped)])
    np.testing.assert_array_equal(law.commands[0][begins:ends], most)
    error = means(law.commands[0]) - force - after
    assert rms(slow(error[: begins - 1])) < 2.0 * law.std < 4.0
    assert rms(slow(error[ends:])) < 2.0 * law.std


def test_each_side_of_a_gap_has_an_integral_of_its_own():
    rows, force = rows_and_forces(NOISY, 1)
    half = len(rows.time) // 2
    later = np.where(np.arange(len(rows.time)) < half, 0.0, 500.0)
    broken = replace(rows, command=rows.command + later, gaps=(half,))
    error = means(loop_command([broken]).commands[0]) - force - later
    assert rms(slow(error)[: half - 2 * WIDTH]) < 2.0
    assert rms(slow(error)[half:]) < 2.0


def test_a_log_without_a_reference_shows_no_law():
    rows, _ = rows_and_forces(NOISY, 1)
    assert loop_command([rows, replace(rows, reference=None)]) is None


def test_what_no_cascade_computes_is_followed_and_costs_certainty():
    """A compensation of friction: a step of the command at each reversal, which acts."""
    left, said, raw = [], [], []
    for seed in (1, 2):
        rows, force = rows_and_forces(NOISY, seed)
        steps = 20.0 * np.sign(np.gradient(rows.reference))
        law = loop_command([replace(rows, command=rows.command + steps)])
        left.append(rms(slow(means(law.commands[0]) - force - steps)))
        said.append(law.std)
        raw.append(rms(slow(means(rows.command) - force)))
    assert rms(np.array(left)) < 0.8 * rms(np.array(raw))
    assert rms(np.array(said)) > 2.0 * loop_command([rows]).std
    assert 0.5 < rms(np.array(left)) / rms(np.array(said)) < 1.5
