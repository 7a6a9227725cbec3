"""Inverse-dynamics identification against exact signals, the EMPS reference, a textbook oracle and Monte Carlo."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.io
from scipy.signal import butter, cheby1, filtfilt, lfilter

from diffdrive.errors import LogError
from diffdrive.logs import Log
from diffdrive.model.presets import paper_drive
from experiments.studies.emps.axis import FILES, find_folder
from tuning.identification.determined import long_run_covariance, solve
from tuning.identification.inverse_dynamics import BENCHMARK_BORDERS, evaluate, identify
from tuning.identification.regressors import DIRECTIONAL
from tuning.identification.seed import initial_drive

MASS, VISCOUS, COULOMB, CONSTANT = 95.0, 210.0, 21.0, 3.0
TRUTH = {"mass": MASS, "viscous": VISCOUS, "coulomb": COULOMB, "constant_force": CONSTANT}


def axis(
    rate=1_000.0,
    duration=6.0,
    *,
    viscous=(VISCOUS, VISCOUS),
    coulomb=(COULOMB, COULOMB),
    load=None,
    slope=0.0,
    scale=1.0,
):
    """A rigid axis with friction on a motion of three slow tones, exactly: force from the analytic derivatives."""
    time = np.arange(round(duration * rate) + 1) / rate
    tones = [(0.05, 0.5, 0.3), (0.01, 1.3, 1.1), (0.002, 2.7, 2.0)]
    position, velocity, acceleration = np.zeros((3, len(time)))
    for amplitude, frequency, phase in tones:
        turn = 2 * np.pi * frequency
        position += scale * amplitude * np.sin(turn * time + phase)
        velocity += scale * amplitude * turn * np.cos(turn * time + phase)
        acceleration -= scale * amplitude * turn**2 * np.sin(turn * time + phase)
    forwards = velocity > 0
    weight = 0.0 if load is None else load
    friction = np.where(forwards, viscous[0], viscous[1]) * velocity
    friction += (np.where(forwards, coulomb[0], coulomb[1]) + slope * weight) * np.sign(velocity)
    force = MASS * acceleration + friction - CONSTANT
    return Log("axis", time, position, force, load=None if load is None else np.full_like(time, load))


def emps(which):
    folder = find_folder()
    if folder is None:
        pytest.skip("the EMPS data are not in ../shared/data/emps")
    data = scipy.io.loadmat(folder / FILES[which])
    position = data["qm"].ravel()
    force = data["gtau"].item() * data["vir"].ravel()
    return Log(FILES[which], np.arange(len(position)) / 1_000.0, position, force)


@pytest.mark.parametrize("rate", [500.0, 1_000.0, 4_000.0, 20_000.0])
def test_a_rigid_axis_is_recovered_at_any_rate(rate):
    found = identify(axis(rate))
    for name, value in TRUTH.items():
        assert found.values[name] == pytest.approx(value, rel=3e-4), name
    assert found.fit.error_percent < 0.02
    assert not found.notes


def test_the_emps_reference_is_reproduced():
    estimation, pulses = emps("estimation"), emps("pulses")
    found = identify(estimation, borders=BENCHMARK_BORDERS)
    assert found.mass == pytest.approx(95.1089, abs=5e-5)
    assert found.viscous.positive == found.viscous.negative == pytest.approx(203.5034, abs=5e-5)
    assert found.coulomb.positive == pytest.approx(20.3935, abs=5e-5)
    assert found.constant_force == pytest.approx(3.1648, abs=5e-5)  # the benchmark's offset has the other sign
    assert found.fit.error_percent == pytest.approx(4.083, abs=5e-4)
    assert evaluate(found, pulses).error_percent == pytest.approx(5.982, abs=5e-4)


def test_an_end_in_motion_is_cut():
    log = one_way()  # ends in acceleration
    assert identify(log).mass == pytest.approx(MASS, rel=1e-3)
    assert abs(identify(log, borders=BENCHMARK_BORDERS).mass / MASS - 1) > 5e-3


def test_viscous_friction_of_emps_differs_between_the_directions():
    estimation, pulses = emps("estimation"), emps("pulses")
    one, two = identify(estimation), identify(estimation, DIRECTIONAL)
    assert two.viscous.negative - two.viscous.positive > 10 * two.standard_errors["viscous.negative"]
    assert evaluate(two, pulses).error_percent < evaluate(one, pulses).error_percent - 0.5


def test_it_is_the_textbook_computation():
    log = axis()
    rng = np.random.default_rng(1)
    log = replace(log, position=log.position + 1e-7 * rng.standard_normal(len(log.time)), command=log.command + 1.0)

    smooth = filtfilt(*butter(4, 0.2), log.position, padlen=12)
    velocity = np.gradient(smooth, 1e-3)
    table = np.stack(
        [np.gradient(velocity, 1e-3), velocity, np.sign(velocity), -np.ones_like(velocity), log.command], 1
    )
    b, a = cheby1(8, 0.05, 0.8 / 10)
    table = filtfilt(b, a, table[49:-49], axis=0, padlen=24)
    table = table[(len(table) - 1) % 10 :: 10]
    expected = np.linalg.solve(table[:, :4].T @ table[:, :4], table[:, :4].T @ table[:, 4])

    np.testing.assert_allclose(list(identify(log).values.values()), expected, rtol=1e-6)


def test_parameters_per_direction():
    found = identify(axis(viscous=(180.0, 240.0), coulomb=(25.0, 18.0)), DIRECTIONAL)
    assert found.mass == pytest.approx(MASS, rel=2e-3)
    assert [found.viscous.positive, found.viscous.negative] == pytest.approx([180.0, 240.0], rel=3e-3)
    # the constant force helps forwards and hinders backwards: no motion tells it from Coulomb friction
    assert [found.coulomb.positive, found.coulomb.negative] == pytest.approx([25 - CONSTANT, 18 + CONSTANT], rel=3e-3)
    assert found.constant_force is None


def test_several_loads_give_the_slope_of_the_coulomb_friction():
    logs = [axis(load=load, slope=1.5e-3) for load in (0.0, 4_000.0, 8_000.0)]
    for found in (identify(logs), identify(logs, DIRECTIONAL)):
        assert found.load_coefficient.positive == pytest.approx(1.5e-3, rel=5e-3)
        assert found.load_coefficient.negative == pytest.approx(1.5e-3, rel=5e-3)
        assert found.coulomb.positive + found.coulomb.negative == pytest.approx(2 * COULOMB, rel=5e-3)
    single = identify(logs[1])
    assert single.load_coefficient is None
    assert single.coulomb.positive == pytest.approx(COULOMB + 6.0, rel=5e-3)
    assert single.load == pytest.approx(4_000.0)


def test_a_shifted_origin_changes_nothing():
    log = axis()
    moved = identify(replace(log, position=log.position + 3.0, time=log.time + 100.0))
    np.testing.assert_allclose(list(moved.values.values()), list(identify(log).values.values()), rtol=1e-7)


def test_a_mirrored_axis_swaps_the_directions():
    log = axis(viscous=(180.0, 240.0), coulomb=(25.0, 18.0))
    mirror = replace(log, position=-log.position, command=-log.command)
    assert identify(mirror).constant_force == pytest.approx(-identify(log).constant_force, rel=1e-9)
    one, other = identify(log, DIRECTIONAL), identify(mirror, DIRECTIONAL)
    for name in ("viscous", "coulomb"):
        assert one.values[f"{name}.positive"] == pytest.approx(other.values[f"{name}.negative"], rel=1e-9)
        assert one.standard_errors[f"{name}.positive"] == pytest.approx(
            other.standard_errors[f"{name}.negative"], rel=1e-6
        )


def test_units_scale_the_parameters_and_their_errors():
    log = axis()
    rng = np.random.default_rng(2)
    log = replace(log, command=log.command + rng.standard_normal(len(log.time)))
    metres, millimetres = identify(log), identify(replace(log, position=1e3 * log.position))
    for name, factor in {"mass": 1e-3, "viscous": 1e-3, "coulomb": 1.0, "constant_force": 1.0}.items():
        assert millimetres.values[name] == pytest.approx(factor * metres.values[name], rel=1e-8)
        assert millimetres.standard_errors[name] == pytest.approx(factor * metres.standard_errors[name], rel=1e-6)
    assert millimetres.condition == pytest.approx(metres.condition, rel=1e-8)


def test_a_known_disturbance_counts_as_force():
    log = axis()
    pulses = 50.0 * np.sign(np.sin(3.0 * log.time))
    split = replace(log, command=log.command - pulses, disturbance=pulses)
    np.testing.assert_allclose(list(identify(split).values.values()), list(identify(log).values.values()), rtol=1e-9)


@pytest.mark.long
def test_standard_errors_are_those_of_coloured_noise():
    log = axis(500.0, 8.0)
    rng = np.random.default_rng(3)
    found = []
    for _ in range(60):  # a spread of 60 is known to 1 / sqrt(2 * 60), 9 %: the bars below are three of these
        noise = lfilter([1.0], [1.0, -0.985], rng.standard_normal(len(log.time)))  # correlated over 0.13 s
        found.append(identify(replace(log, command=log.command + noise)))
    for name in TRUTH:
        spread = np.std([one.values[name] for one in found])
        claimed = np.mean([one.standard_errors[name] for one in found])
        assert 0.7 < claimed / spread < 1.4, name


def test_white_scores_need_no_lags():
    scores = np.random.default_rng(4).standard_normal((4_000, 2)) * [1.0, 3.0]
    total = long_run_covariance([scores[:1_000], scores[1_000:]])
    np.testing.assert_allclose(np.diag(total), 4_000 * np.array([1.0, 9.0]), rtol=0.1)


def test_a_sample_left_out_is_a_row_of_zeros():
    rng = np.random.default_rng(5)
    columns, target = rng.standard_normal((50, 2)), rng.standard_normal(50)
    full = solve(columns, target, [50])
    padded = solve(np.vstack([columns, np.zeros((20, 2))]), np.append(target, np.zeros(20)), [70])
    np.testing.assert_allclose(padded.coefficients, full.coefficients, rtol=1e-12)


def one_way(duration=4.0, rate=1_000.0):
    time = np.arange(round(duration * rate)) / rate
    speed = 0.05 + 0.03 * np.sin(5.0 * time) + 0.01 * np.sin(13.0 * time)
    position = 0.05 * time - 0.006 * np.cos(5.0 * time) - 0.01 / 13.0 * np.cos(13.0 * time)
    acceleration = 0.15 * np.cos(5.0 * time) + 0.13 * np.cos(13.0 * time)
    return Log("one way", time, position, MASS * acceleration + VISCOUS * speed + COULOMB - CONSTANT)


def test_one_direction_does_not_tell_coulomb_from_constant_force():
    found = identify(one_way())
    assert found.mass == pytest.approx(MASS, rel=1e-3)
    assert found.viscous.positive == pytest.approx(VISCOUS, rel=1e-3)
    assert np.isnan([found.coulomb.positive, found.constant_force]).all()
    assert any("coulomb and constant_force cannot be distinguished" in note for note in found.notes)
    assert found.fit.error_percent < 0.1  # the force is foretold all the same
    split = identify(one_way(), DIRECTIONAL)
    assert split.coulomb.positive == pytest.approx(COULOMB - CONSTANT, rel=1e-3)
    assert np.isnan([split.coulomb.negative, split.viscous.negative]).all()
    assert any(note.startswith("viscous.negative is not determined") for note in split.notes)


def test_one_speed_does_not_tell_viscous_from_coulomb():
    time, rng = np.arange(3_000) / 1e3, np.random.default_rng(7)
    position = np.round(0.02 * time, 7)
    force = 0.02 * VISCOUS + COULOMB + 0.1 * rng.standard_normal(3_000)
    found = identify(Log("cruise", time, position, force))
    assert np.isnan([found.viscous.positive, found.coulomb.positive, found.constant_force]).all()
    assert any("viscous, coulomb and constant_force cannot be distinguished" in note for note in found.notes)
    drive = paper_drive()
    seeded, notes = initial_drive(drive, found)
    assert seeded.plant.mass == drive.plant.mass
    assert any("plant.mass stays at 100 kg" in note for note in notes)


def test_a_table_at_rest_identifies_nothing():
    time = np.arange(3_000) / 1e3
    with pytest.raises(LogError, match="does not move"):
        identify(Log("rest", time, np.full(3_000, 0.1), np.ones(3_000)))


def test_rests_are_left_out_by_the_slowest_speed():
    log, rng = axis(), np.random.default_rng(6)
    rest = np.arange(1, 4_001) / 1e3
    position = np.concatenate([log.position, log.position[-1] + 5e-8 * rng.standard_normal(4_000)])
    command = np.concatenate([log.command, np.full(4_000, 15.0)])
    dwelling = Log("dwell", np.append(log.time, log.time[-1] + rest), position, command, gaps=(len(log.time),))
    assert abs(identify(dwelling).constant_force - CONSTANT) > 1.0
    found = identify(dwelling, min_speed=1e-3)
    assert found.constant_force == pytest.approx(CONSTANT, rel=0.02)
    assert found.coulomb.positive == pytest.approx(COULOMB, rel=0.01)
    assert [piece.used.any() for piece in found.fit.pieces] == [True, False]
    with pytest.raises(LogError, match=r"not move faster than 9 m/s.*its peak is 0\.\d+ m/s"):
        identify(dwelling, min_speed=9.0)


def test_gaps_split_a_log_and_short_pieces_are_named():
    log = axis()
    keep = np.r_[0:2_500, 2_600:2_700, 2_900:6_001]
    torn = Log("torn", log.time[keep], log.position[keep], log.command[keep], gaps=(2_500, 2_600))
    found = identify(torn)
    assert found.mass == pytest.approx(MASS, rel=2e-3)
    assert len(found.fit.pieces) == 2
    assert found.notes == (
        "torn: the piece from 2.6 s is too short: 0.1 s; the filters need 0.2 s at dynamics of 20 Hz",
    )


@pytest.mark.parametrize("samples", [2, 10, 60, 199])
def test_a_log_shorter_than_the_filters_says_how_long_it_must_be(samples):
    log = axis()
    short = Log("short", log.time[:samples], log.position[:samples], log.command[:samples])
    with pytest.raises(LogError, match=r"short: the piece.* is too short: .*need 0\.2 s"):
        identify(short)


def test_bad_logs_are_refused():
    log = axis()
    with pytest.raises(LogError, match=r"sampled at 100 Hz, too slowly.*at most 9.074 Hz"):
        identify(axis(100.0))
    assert identify(axis(100.0), dynamics=9.0).mass == pytest.approx(MASS, rel=0.02)
    with pytest.raises(LogError, match="at least one"):
        identify([])
    with pytest.raises(LogError, match="dynamics must be"):
        identify(log, dynamics=0.0)
    holed = log.command.copy()
    holed[1_234] = np.nan
    with pytest.raises(LogError, match=r"command \+ disturbance is not finite at 1\.234 s"):
        identify(replace(log, command=holed))


def test_a_log_without_load_among_loaded_ones_is_noted():
    found = identify([axis(), axis(load=5_000.0, slope=1e-3)])
    assert any("no load signal" in note for note in found.notes)
    assert found.load_coefficient.positive == pytest.approx(1e-3, rel=1e-2)


def test_a_seeded_drive_has_the_identified_friction():
    logs = [axis(viscous=(2_200.0, 1_900.0), coulomb=(70.0, 80.0), load=w, slope=1.5e-3) for w in (0.0, 8_000.0)]
    drive = paper_drive()
    one, notes = initial_drive(drive, identify(logs))
    assert not notes
    assert one.plant.mass == pytest.approx(MASS, rel=0.01)
    two, _ = initial_drive(drive, identify(logs, DIRECTIONAL))
    assert two.friction.viscous.positive == pytest.approx(2_200.0 - 380.0, rel=0.01)
    assert two.friction.viscous.negative == pytest.approx(1_900.0 - 260.0, rel=0.01)
    assert two.plant.constant_force == drive.plant.constant_force == 0.0
    for side, level in {"positive": 70.0 - CONSTANT, "negative": 80.0 + CONSTANT}.items():
        friction = two.friction
        slope = getattr(friction.load_coefficient, side)
        assert slope == pytest.approx(1.5e-3, rel=0.01)
        assert getattr(friction.coulomb_screw, side) + slope * friction.initial_load == pytest.approx(level, rel=0.01)


def test_a_seed_keeps_what_is_not_determined_and_says_so():
    drive = paper_drive()
    seeded, notes = initial_drive(drive, identify(one_way()))
    assert seeded.plant.mass == pytest.approx(MASS, rel=1e-3)
    assert seeded.plant.constant_force == drive.plant.constant_force
    assert seeded.friction.coulomb_screw == drive.friction.coulomb_screw
    assert seeded.friction.viscous.positive == pytest.approx(0.01 * VISCOUS, rel=1e-3)  # the damping takes it all
    told = " ".join(notes)
    for name in ("plant.constant_force stays", "coulomb_screw (negative) stays", "viscous (positive) is set to 2.1"):
        assert name in told
