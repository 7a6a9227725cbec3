"""The diagnosis at its edges: gaps in a log, no friction in the file, long delays, impossible machines."""

import dataclasses
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.axis_file.drive_file import write_axis
from diffdrive.effects.actuator import LoopDelay
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.effects.friction import ViscousDrift
from diffdrive.effects.transmission import Compliance
from diffdrive.errors import LogError, ParameterError
from diffdrive.logs import write_log
from diffdrive.model.quantity import Directional
from diffdrive.numerics.arrays import as_arrays
from experiments.reports.diagnosis import diagnosis as command
from experiments.reports.diagnosis.diagnosis import diagnose_logs
from tests.support.sound_log import COUNT, DRIVE, RATE, SOUND, axis_of, replaced, simulate_log, two_sines, without_rows
from tuning.diagnosis.as_json import as_json
from tuning.diagnosis.diagnose import diagnose, logged_of
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.gap.gap import drive_of, loop_gap
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.catalogue import candidates
from tuning.diagnosis.hypotheses.model import Member, Model, effect_in_lanes, signals_along
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.judgement.verdict import _probabilities
from tuning.diagnosis.next_experiment import Experiment
from tuning.diagnosis.selection.screening import begin, joined
from tuning.diagnosis.selection.search import _screened, initial_trajectory, recalibrated


def candidate_of(logs, name):
    at = setting(logs.drive, logs.lanes, logs.sampling.period, logs.thinning, logs.starts)
    return next(one for one in candidates(at) if one.name == name)


def test_time_goes_on_through_a_gap():
    broken = without_rows(SOUND, range(2000, 3000), restamp=False)
    broken = dataclasses.replace(broken, gaps=(2000,))
    logs = logged_of(DRIVE.drive, [broken])
    assert logs.owner == (0, 0)
    np.testing.assert_allclose(np.asarray(logs.starts), [0.0, 1.5])
    whole = logged_of(DRIVE.drive, [SOUND])
    drift = {"viscous": np.array([0.4]), "time_constant": np.array([1.0])}
    in_pieces, in_one = (
        signals_along(
            each, as_arrays(DRIVE.drive), (effect_in_lanes(ViscousDrift, drift, each.owner),), initial_trajectory(each)
        )
        for each in (logs, whole)
    )
    later = np.asarray(in_one.viscous)[0, 3000:5000]
    np.testing.assert_allclose(np.asarray(in_pieces.viscous)[1, :2000], later, rtol=1e-12)
    at = setting(logs.drive, logs.lanes, 1.0 / RATE, 1, logs.starts)
    assert at.duration == pytest.approx(len(SOUND.time) / RATE)


def test_a_log_of_scraps_is_named_before_anything_is_searched():
    scraps = dataclasses.replace(SOUND, name="scraps", gaps=tuple(range(100, len(SOUND.time), 100)))
    with pytest.raises(LogError, match=r"scraps: no stretch of 200 samples.*leave this log out"):
        diagnose(DRIVE.drive, DRIVE.controller, [scraps, SOUND])
    with pytest.raises(LogError, match="log a longer motion"):
        diagnose(DRIVE.drive, DRIVE.controller, [scraps])


def test_logs_of_two_rates_are_not_diagnosed_together():
    slow = dataclasses.replace(SOUND, name="slow", time=2.0 * SOUND.time)
    with pytest.raises(LogError, match=r"slow is sampled at 1000 Hz, .* at 2000 Hz: diagnose logs of one rate"):
        logged_of(DRIVE.drive, [SOUND, slow])


def test_a_loop_without_noise_beyond_its_scales_steps_has_a_floor_all_the_same():
    quantised = float(DRIVE.drive.sensor.resolution) / np.sqrt(12)
    counts = np.ones((1, len(SOUND.time)))
    loop = loop_gap([DRIVE.drive], DRIVE.controller, [SOUND], [counts], quantised, DRIVE.sampling)
    assert 0.0 < loop.position_floor < 1e-6
    assert loop.command_floor > 0.0


def test_an_effect_that_does_not_exist_cannot_be_left_out():
    with pytest.raises(ParameterError, match=r"no effect .coging.; did you mean .cogging.\?"):
        diagnose(DRIVE.drive, DRIVE.controller, [SOUND], without=("coging",))


@pytest.mark.long
def test_a_drive_file_without_friction_has_priors_and_a_screening_of_numbers():
    friction = DRIVE.drive.friction
    none = dataclasses.replace(friction, coulomb_screw=Directional(1e-9, 1e-9), load_coefficient=Directional(0.0, 0.0))
    logs = logged_of(dataclasses.replace(DRIVE.drive, friction=none), [SOUND])
    at = setting(logs.drive, logs.lanes, 1.0 / RATE)
    for candidate in candidates(at):
        for one in candidate.parameters:
            assert np.isfinite(one.middle), candidate.name
            assert one.spread > 0, candidate.name
            assert np.isfinite(one.standard(one.middle)), candidate.name
    fitter = Fitter(logs)
    base = recalibrated(fitter, 0.02)
    for name in ("friction_dwell", "presliding_hysteresis", "friction_asymmetry"):
        assert not np.isnan(_screened(fitter, base, candidate_of(logs, name)).evidence), name


@pytest.mark.parametrize("gains", [[-7000.0, -9000.0], [-1e6], [0.0, 0.0], [5e5, -5e5]])
def test_probabilities_are_that_however_bad_all_are(gains):
    found = _probabilities(np.array(gains), 0.0)
    assert np.sum(found) == pytest.approx(1.0)
    assert np.all(found >= 0.0)
    assert int(np.argmax(found)) == int(np.argmax(gains))


@pytest.mark.long
def test_a_longer_delay_than_the_effect_can_hold_never_loses_the_force():
    forces = tuple([100.0] * 8)
    for delay in (7.5, 8.0, 8.5, 20.0):
        assert float(LoopDelay(delay).step(forces, jnp.asarray(100.0), 1e-3)[1].mean) == pytest.approx(100.0)
    fast = axis_of(rate=10_000.0)
    logs = logged_of(fast.drive, [simulate_log(fast, two_sines(1.0, 10_000.0))])
    model = joined(Model(logs), candidate_of(logs, "loop_delay"))
    theta = np.r_[np.zeros(len(NAMES)), begin(model, {"delay": np.array([2.1])})]  # samples of the thinned log
    fit = Fitter(logs).fit(model, theta, None, initial_trajectory(logs), 0)
    drive = drive_of(fit, 0)
    assert drive.effects == ()
    assert drive.actuator.delay_samples + float(drive.actuator.delay_fraction) == pytest.approx(10.5)


def test_a_machine_that_cannot_be_is_no_explanation():
    logs = logged_of(DRIVE.drive, [SOUND])
    model = joined(Model(logs), candidate_of(logs, "frame_vibration"))
    values = {"frequency": np.array([20.0]), "damping": np.array([0.03])}
    for ratio, possible in ((0.1, True), (-0.1, False)):
        theta = np.r_[np.zeros(len(NAMES)), begin(model, values | {"ratio": np.array([ratio])})]
        assert model.possible(theta) is possible
    less = Model(logs, (Member(candidate_of(logs, "loop_delay")),))
    assert less.possible(np.r_[np.zeros(len(NAMES)), -1.0])  # the drive file claims too much


def test_the_loop_is_judged_by_what_is_held_out():
    """A first half that is off by 0.1 mm does not count when the second one is asked for."""
    half = len(SOUND.time) // 2
    off = dataclasses.replace(SOUND, position=SOUND.position + np.where(np.arange(len(SOUND.time)) < half, 1e-4, 0.0))
    late = (np.arange(len(SOUND.time)) >= half).astype(float)[None]
    given = (DRIVE.drive, DRIVE.controller, off)
    judged, all_of_it = (
        loop_gap([given[0]], given[1], [given[2]], [counts], 5e-8, DRIVE.sampling)
        for counts in (late, np.ones_like(late))
    )
    assert judged.position_rms < 2e-7
    assert all_of_it.position_rms > 5e-5


@pytest.mark.long
@pytest.mark.parametrize("known", [True, False])
def test_a_log_is_judged_in_closed_loop_if_its_own_reference_is_known(known):
    """Whatever is known of the other log's."""
    flat = np.full(COUNT, 0.01)
    rest = replaced(name="rest", position=flat, command=0.0 * flat, reference=None if known else flat)
    moves = replaced(reference=SOUND.reference if known else None)
    found = diagnose(DRIVE.drive, DRIVE.controller, [moves, rest], without=list(EFFECTS))
    assert found.split.logs == [0]
    assert all((comparison.loop is not None) is known for comparison in found.comparisons)


@pytest.mark.slow
def test_a_screw_that_the_drive_file_knows_leaves_the_noise_its_floor():
    soft = dataclasses.replace(DRIVE, drive=dataclasses.replace(DRIVE.drive, effects=(Compliance(250.0, 0.05, 0.3),)))
    log = simulate_log(soft, two_sines())
    found = diagnose(soft.drive, soft.controller, [log], without=list(EFFECTS))
    assert found.verdict.verdict == "none"
    assert 0.0 < found.floor < 2.0
    assert found.comparisons[1].force.rms < 2.0 * found.floor
    assert all(np.isfinite(one.p_value) for one in found.where)


def test_the_drive_file_that_was_given_is_never_removed_as_an_earlier_diagnosis(tmp_path):
    (tmp_path / "augmented.toml").write_text("the drive")
    (tmp_path / "findings.csv").write_text("of this diagnosis")
    report = SimpleNamespace(out=tmp_path, data={"tables": {"findings": {}}})
    command._remove_stale(report, tmp_path / "." / "augmented.toml")
    assert {path.name for path in tmp_path.iterdir()} == {"augmented.toml", "findings.csv"}
    command._remove_stale(SimpleNamespace(out=tmp_path, data={"tables": {}}), tmp_path / "other.toml")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_a_log_with_the_servo_off_is_told_not_to_move(tmp_path):
    """Not one innovation of it differs from zero: no scale of the noise fits that, and no force is missing."""
    count = 4000
    flat = np.full(count, 0.01)
    off = dataclasses.replace(
        SOUND, time=np.arange(count) / RATE, position=flat, command=np.zeros(count), reference=flat
    )
    write_log(tmp_path / "off.parquet", off)
    write_axis(tmp_path / "drive.toml", DRIVE)
    (tmp_path / "out").mkdir()
    earlier = [tmp_path / "out" / name for name in ("causes.png", "next_reference.csv")]
    for path in earlier:
        path.write_bytes(b"of an earlier diagnosis")
    told = diagnose_logs([tmp_path / "off.parquet"], tmp_path / "drive.toml", tmp_path / "out")
    assert not any(path.exists() for path in earlier)
    assert "alt='causes'" not in (tmp_path / "out" / "report.html").read_text()
    assert told["verdict"] == "unknown"
    assert "the table travels 0 um" in told["says"]
    assert told["causes"] == []
    assert told["gap"]["force_rms_N"] < 1e-9 < told["gap"]["noise_floor_force_N"]
    assert [one["shrink"] for one in told["ladder"]] == [0.0, 0.0]
    assert "travels 0\N{NO-BREAK SPACE}µm" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.long
def test_where_the_drive_cannot_follow_its_log_no_force_is_told():
    """A position in mm, read as m: a filter that is lost at every sample would tell next to no force at all."""
    far = dataclasses.replace(SOUND, position=1e3 * SOUND.position, reference=1e3 * SOUND.reference)
    found = diagnose(DRIVE.drive, DRIVE.controller, [far], without=list(EFFECTS))
    told = as_json(found, Experiment("", [], 0.0, ""))
    assert not any(comparison.force.is_known for comparison in found.comparisons)
    gap = told["gap"]
    assert [gap[name] for name in ("force_rms_N", "recalibrated_force_rms_N", "noise_floor_force_N")] == [None] * 3
    assert "too far from the logs" in gap["says"]
    assert "units" in gap["says"]
    assert gap["position_rms_m"] > 1e-3 > gap["noise_floor_position_m"]
    assert all(one["force_rms_N"] is one["force_floor_N"] is one["shrink"] is None for one in told["ladder"])
    assert told["verdict"] == "unknown"
