"""What of an effect an engineer would call by its name: numbers that a machine may have, and a log can show."""

import dataclasses

import numpy as np
import pytest

from diffdrive.model.parameters import Sensor
from tests.support.sound_log import DRIVE, RATE, SOUND, simulate_log, two_sines
from tuning.diagnosis.diagnose import logged_of
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.catalogue import candidates
from tuning.diagnosis.hypotheses.model import Model
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.selection.screening import begin, joined


def test_a_payload_may_be_missing_but_not_half_of_the_table():
    log = logged_of(DRIVE.drive, [SOUND])  # of 100 kg
    at = setting(log.drive, log.lanes, log.sampling.period)
    payload = next(one for one in candidates(at) if one.name == "payload_mass")
    found = [payload.plausible({"mass": np.array([one])}, np.ones(1)) for one in (80.0, -40.0, -60.0, -95.0)]
    assert found == [True, True, False, False]


@pytest.mark.parametrize(
    ("name", "parameter", "strokes", "so_called"),
    [
        ("position_spring", "neutral", [-4.0, -1.0, 0.0, 2.0, 6.0], [False, True, True, True, False]),
        ("cogging", "period", [0.01, 0.5, 0.9, 1.2, 3.0], [True, True, True, False, False]),
    ],
)
def test_what_looks_the_same_everywhere_is_neither_a_spring_nor_a_ripple(name, parameter, strokes, so_called):
    """A spring of -10 N/m about a place six strokes away, and a ripple longer than the stroke, passed for a tilt."""
    log = logged_of(DRIVE.drive, [SOUND])
    at = setting(log.drive, log.lanes, log.sampling.period)
    stroke, middle = at.high - at.low, 0.5 * (at.high + at.low) if name == "position_spring" else 0.0
    for one in (one for one in candidates(at) if one.name == name):
        found = [one.plausible({parameter: np.array([middle + share * stroke])}, np.ones(1)) for share in strokes]
        assert found == so_called


@pytest.mark.parametrize("resolution", [1e-7, 1e-6, 3e-5])
def test_a_signal_period_is_longer_than_the_counts_that_divide_it(resolution):
    """Coarse counts repeat themselves with the place, too: no period that a scale could have is to pass for them."""
    coarse = dataclasses.replace(DRIVE.drive, sensor=Sensor(resolution=resolution))
    log = logged_of(coarse, [SOUND])
    at = setting(log.drive, log.lanes, log.sampling.period)
    assert at.count > 0.99 * resolution
    candidate = next(one for one in candidates(at) if one.name == "interpolation_error")
    begun = [point["period"] for point in candidate.grid]
    assert min(begun) >= 4.0 * resolution
    assert any(np.isclose(begun, 2e-5)) == (resolution < 4e-6)  # the usual one, where it can be
    assert [_read(candidate, at, period=one) for one in (1.0, 2.0, 4.0, 8.0)] == [False, False, False, True]


def _read(candidate, at, period=8.0, amplitude=1.0, second=0.0):
    """Whether an engineer would read a wave of so many counts, and one of half the period, as those of a scale."""
    counts = {"period": period, "cosine": amplitude, "sine": 0.0, "cosine2": second, "sine2": 0.0}
    return candidate.plausible({name: np.array([one * at.count]) for name, one in counts.items()}, np.ones(1))


def test_an_error_of_a_scale_is_larger_than_that_of_its_counts():
    """Met at even distances, the staircase of the counts passes for a wave of any length and the one of half of it."""
    log = logged_of(dataclasses.replace(DRIVE.drive, sensor=Sensor(resolution=1e-7)), [SOUND])
    at = setting(log.drive, log.lanes, log.sampling.period)
    candidate = next(one for one in candidates(at) if one.name == "interpolation_error")
    place = np.linspace(0.0, 1000.0, 100_001)  # counts
    stairs = np.round(place) - place
    wave, half = (2.0 * abs(np.mean(stairs * np.exp(2j * np.pi * k * place))) for k in (1, 2))
    assert not _read(candidate, at, 40.0, wave, half)
    assert not _read(candidate, at, 40.0, half)
    assert _read(candidate, at, 40.0, 1.15 * wave, 1.15 * half)
    assert _read(candidate, at, 40.0, 3.0)


@pytest.mark.parametrize(
    ("share", "so_called"), [(-0.02, False), (0.01, False), (0.5, True), (1.1, True), (1.5, False)]
)
def test_elements_before_sliding_replace_some_of_the_bristle_and_no_more_than_all_of_it(share, so_called):
    log = logged_of(DRIVE.drive, [SOUND])
    at = setting(log.drive, log.lanes, log.sampling.period)
    candidate = next(one for one in candidates(at) if one.name == "presliding_hysteresis")
    assert candidate.plausible({"share": np.array([share])}, np.ones(1)) == so_called


def test_a_resonance_is_one_that_the_log_can_show():
    log = logged_of(DRIVE.drive, [SOUND])
    at = setting(log.drive, log.lanes, log.sampling.period)
    screw = next(one for one in candidates(at) if one.name == "compliance")
    calm = {"damping": np.full(2, 0.03), "motor_share": np.full(2, 0.4)}
    both = [{"frequency": np.array([150.0, one])} for one in (0.39 * RATE, 0.43 * RATE, 0.9 * RATE)]
    found = [screw.plausible(calm | one, np.ones(2)) for one in both]
    assert found == [True, False, False]
    slow = calm | {"frequency": np.full(2, 150.0)}
    assert [screw.plausible(slow | {"damping": np.full(2, one)}, np.ones(2)) for one in (0.3, 0.8)] == [True, False]


def test_a_screw_with_next_to_no_play_is_an_elastic_one():
    log = logged_of(DRIVE.drive, [SOUND])
    at = setting(log.drive, log.lanes, log.sampling.period)
    screw = next(one for one in candidates(at) if one.name == "backlash")
    calm = {"damping": np.array([0.08]), "motor_share": np.array([0.4])}
    assert [screw.plausible(calm | {"gap": np.array([one])}, np.ones(1)) for one in (3e-9, 3e-7)] == [False, True]


@pytest.mark.parametrize("name", ["compliance", "backlash"])
def test_neither_motor_nor_table_of_a_screw_is_next_to_nothing(name):
    """A spring before a table with hardly any motor is a lag by another name."""
    log = logged_of(DRIVE.drive, [SOUND])
    screw = next(one for one in candidates(setting(log.drive, log.lanes, log.sampling.period)) if one.name == name)
    usual = {one.name: np.array([one.middle]) for one in screw.parameters}
    shares = [usual | {"motor_share": np.array([one])} for one in (0.016, 0.1, 0.9, 0.99)]
    assert [screw.plausible(one, np.ones(1)) for one in shares] == [False, True, True, False]


def test_a_base_that_does_not_swing_is_no_vibration():
    log = logged_of(DRIVE.drive, [SOUND])
    base = next(
        one for one in candidates(setting(log.drive, log.lanes, log.sampling.period)) if one.name == "frame_vibration"
    )
    damped = [{"ratio": np.array([0.1]), "damping": np.array([one])} for one in (0.02, 0.3, 0.8)]
    assert [base.plausible(one, np.ones(1)) for one in damped] == [True, True, False]


@pytest.mark.parametrize(("effect", "name"), [("friction_dwell", "growth"), ("frame_vibration", "ratio")])
def test_what_cannot_be_less_than_nothing_is_not(effect, name):
    """Friction that falls with the dwell, and a frame of negative mass, would give energy to the table."""
    log = logged_of(DRIVE.drive, [SOUND])
    at = setting(log.drive, log.lanes, log.sampling.period)
    candidate = next(one for one in candidates(at) if one.name == effect)
    usual = {one.name: np.array([one.middle]) for one in candidate.parameters}
    assert [candidate.plausible(usual | {name: np.array([one])}, np.ones(1)) for one in (-0.1, 0.1)] == [False, True]


@pytest.mark.parametrize(
    ("frequency", "end", "beside", "swings"),
    [(1.0, 2.2, 3.0, False), (60.0, 2.2, 3.0, True), (4.0, 2.2, 0.1, False), (1.0, 9.0, 3.0, False)],
)
def test_a_process_force_swings_while_it_is_on(frequency, end, beside, swings):
    """On for 0.1 s in one log and for longer in the other: few swings, small ones, or none within the log are none."""
    logs = logged_of(DRIVE.drive, [simulate_log(DRIVE, two_sines(2.5))] * 2)
    process_noise = next(
        one for one in candidates(setting(logs.drive, logs.lanes, logs.sampling.period)) if one.name == "process_force"
    )
    model = joined(Model(logs), process_noise)
    values = {one.name: np.full(2, one.middle) for one in process_noise.parameters}
    values |= {"frequency": np.full(2, frequency), "start": np.array([0.2, 0.2]), "end": np.array([0.3, end])}
    values["cosine"] = np.array([3.0, beside])
    assert model.possible(np.r_[np.zeros(len(NAMES)), begin(model, values)]) == swings


@pytest.mark.parametrize(("slope", "possible"), [(0.5, True), (0.9, True), (1.1, False), (3.0, False)])
def test_a_scale_that_counts_backwards_is_none(slope, possible):
    """Its reading falls where the wave is steeper than 1; along a course of its own such a wave fits what it likes."""
    logs = logged_of(DRIVE.drive, [SOUND])
    wave = next(
        one
        for one in candidates(setting(logs.drive, logs.lanes, logs.sampling.period))
        if one.name == "interpolation_error"
    )
    model, period = joined(Model(logs), wave), 2e-5
    values = {one.name: np.array([one.middle]) for one in wave.parameters}
    values |= {"period": np.array([period]), "cosine": np.array([slope * period / (2.0 * np.pi)])}
    assert model.possible(np.r_[np.zeros(len(NAMES)), begin(model, values)]) is possible


@pytest.mark.parametrize("amplitude", [0.2, 0.8])
def test_a_lead_error_is_larger_than_the_staircase_of_the_counts(amplitude):
    log = logged_of(DRIVE.drive, [SOUND])
    at = setting(log.drive, log.lanes, log.sampling.period)
    lead = next(one for one in candidates(at) if one.name == "lead_error")
    values = {"lead": 5e-3, "cosine": amplitude * at.count, "sine": 0.0, "linear": 0.0}
    told = lead.plausible({name: np.array([one]) for name, one in values.items()}, np.ones(1))
    assert told == (amplitude > 0.4)
