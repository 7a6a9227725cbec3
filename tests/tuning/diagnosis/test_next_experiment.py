"""Which motion is asked for next: every one is tried, an unfinished fit is not believed, `unknown` is never content."""

import dataclasses
import re
from types import SimpleNamespace

import numpy as np
import pytest

from diffdrive.controllers import UnknownController
from diffdrive.effects.forces import ConstantForce
from diffdrive.loop.rollout import loop_inputs
from diffdrive.motion.motion import Limits, require_within
from diffdrive.motion.text import parse_motion
from tests.support.fake_fits import fake_fit
from tests.support.sound_log import DRIVE, RATE, simulate_log, two_sines
from tuning.diagnosis import next_experiment as module
from tuning.diagnosis.diagnose import logged_of
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.gap.where import Region
from tuning.diagnosis.hypotheses.calibration import TOLERANCE
from tuning.diagnosis.hypotheses.catalogue import candidates as hypotheses
from tuning.diagnosis.hypotheses.model import Model
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.levels import LACKING
from tuning.diagnosis.next_experiment import next_experiment
from tuning.diagnosis.selection.screening import joined
from tuning.diagnosis.selection.search import recalibrated
from tuning.experiment_design.next_motion import available_limits, candidates

TIME = np.arange(6_000) / RATE
MIDDLE = 0.03  # m, of where `diagnosed` says that the logs went
MOTIONS = candidates(DRIVE.drive, DRIVE.limits, RATE, MIDDLE)


def belief(effect, found=True, alternatives=(), round=0):
    alternatives = list(alternatives)
    return SimpleNamespace(
        effect=effect, found=found, round=round, alternatives=alternatives, fitted=effect, gain=100.0
    )


def diagnosed(verdict, *beliefs, where=(), unexplained=1.0, deficits=(), says="as it is", rounds=((), ())):
    """A diagnosis of a log that went to and fro over 40 mm, as far as is looked at here."""
    position = 0.01 + 0.02 * (1 - np.cos(3.0 * TIME))[None]
    lanes = SimpleNamespace(position=position, counts=np.ones_like(position))
    velocity = 0.06 * np.sin(3.0 * TIME)[None]
    return SimpleNamespace(
        verdict=SimpleNamespace(verdict=verdict, beliefs=list(beliefs), unexplained=unexplained, says=says),
        explanation=SimpleNamespace(rounds=[SimpleNamespace(fits=list(fits)) for fits in rounds]),
        excitation_deficits=list(deficits),
        where=list(where),
        logged=SimpleNamespace(lanes=lanes),
        gap=SimpleNamespace(trajectory=SimpleNamespace(velocity=velocity), is_known=True),
    )


def region(dimension, name, p_value=1e-3):
    ends = [1e-3 * float(one) for one in name.split()[0:3:2]] if " to " in name else [None, None]  # mm and mm/s
    return Region(dimension, name, 0.6, 0.2, p_value, f"60 % of the gap lies in {name}", *ends)


def test_an_axis_that_crept_is_asked_to_creep():
    found = diagnosed("unknown")
    found.gap.trajectory.velocity *= 4e-4 / 0.06
    asked = module._exciting(found, DRIVE)
    speeds = [float(one) for one in re.findall(r"speeds?=([\d.e;-]+)m/s", asked.motion)[0].split(";")]
    assert max(speeds) < 5e-4


def telling(monkeypatch, tells):
    """Let the n-th motion tell what `tells(n, steps)` says; what was asked is recorded."""
    asked = []

    def told(truth, rival, description, inputs, steps):
        number = next(
            k
            for k, one in enumerate(MOTIONS.values())
            if np.array_equal(one.position, np.asarray(inputs.reference.position))
        )
        asked.append((number, steps))
        return tells(number, steps)

    monkeypatch.setattr(module, "_misfit", told)
    return asked


@pytest.mark.parametrize("best", range(len(MOTIONS)))
def test_every_motion_that_the_axis_can_do_is_tried(monkeypatch, best):
    telling(monkeypatch, lambda number, steps: 50.0 if number == best else 5.0)
    pair = belief("cogging", alternatives=["lead_error"]), belief("lead_error", found=False)
    offer = next_experiment(diagnosed("effect", *pair), DRIVE)
    assert (offer.motion, offer.between, offer.tells) == (list(MOTIONS)[best], ["cogging", "lead_error"], 50.0)
    run = offer.reference.position
    np.testing.assert_allclose(run, parse_motion(offer.motion, RATE).position, rtol=0, atol=1e-12)
    assert 0.5 * (run.min() + run.max()) == pytest.approx(MIDDLE, abs=5e-3)  # where the axis was, not at its end


def test_a_fit_that_stopped_on_its_way_is_not_believed(monkeypatch):
    short, long = [900.0, 3.0, 300.0, 40.0, 0.0, 0.0, 0.0, 0.0], [1.0, 3.0, 30.0, 40.0, 0.0, 0.0, 0.0, 0.0]
    asked = telling(monkeypatch, lambda number, steps: (short if steps == module.STEPS else long)[number])
    pair = belief("cogging", alternatives=["lead_error"]), belief("lead_error", found=False)
    offer = next_experiment(diagnosed("effect", *pair), DRIVE)
    assert (offer.motion, offer.tells) == (list(MOTIONS)[3], 40.0)
    assert [number for number, steps in asked if steps == module.MORE] == [0, 2, 3]


@pytest.mark.long
def test_a_motion_is_simulated_with_one_cause_and_read_by_the_other():
    pushed = dataclasses.replace(DRIVE.drive, effects=(ConstantForce(6.0),))
    log = logged_of(DRIVE.drive, [simulate_log(dataclasses.replace(DRIVE, drive=pushed), two_sines())])
    fitter = Fitter(log)
    base = recalibrated(fitter, TOLERANCE)
    known = {one.name: one for one in hypotheses(setting(log.drive, log.lanes, 1.0 / RATE))}
    fits = []
    for name in ("constant_force", "friction_asymmetry"):
        model = joined(Model(log), known[name])
        theta = np.zeros(model.size)
        fits.append(fitter.fit(model, theta, base.process_noise, base.filtered.trajectory, 2))
    stroke = list(MOTIONS.values())[-1]
    inputs = loop_inputs(stroke, np.zeros(len(stroke.time)))
    assert module._misfit(fits[0], fits[1], DRIVE, inputs, module.STEPS) > LACKING
    assert abs(module._misfit(fits[0], fits[0], DRIVE, inputs, module.STEPS)) < 1e-6


def test_an_axis_whose_ends_nobody_gave_goes_no_further_than_in_the_logs():
    lanes = diagnosed("effect").logged.lanes
    limits, about = available_limits(lanes, Limits())
    motions = candidates(DRIVE.drive, limits, RATE, about)
    assert motions
    for one in motions.values():
        assert 0.01 - 1e-3 <= one.position.min() <= one.position.max() <= 0.05 + 1e-3
    assert available_limits(lanes, DRIVE.limits) == (DRIVE.limits, pytest.approx(MIDDLE, abs=1e-6))


def test_where_no_motion_tells_it_is_said_how_many_were_tried(monkeypatch):
    telling(monkeypatch, lambda number, steps: 3.0)
    pair = belief("cogging", alternatives=["lead_error"]), belief("lead_error", found=False)
    offer = next_experiment(diagnosed("effect", *pair), DRIVE)
    assert offer.motion == ""
    assert f"None of the {len(MOTIONS)} motions tried" in offer.says


def test_the_rival_of_a_second_effect_counts(monkeypatch):
    telling(monkeypatch, lambda number, steps: 50.0)
    second = belief("force_gain", alternatives=["payload_mass"], round=1)
    found = diagnosed("effect", belief("cogging"), second, belief("payload_mass", found=False, round=1))
    assert next_experiment(found, DRIVE).between == ["force_gain", "payload_mass"]
    assert "no rival" in next_experiment(diagnosed("effect", belief("cogging")), DRIVE).says


def test_the_rival_that_a_second_way_found_is_decided_where_its_own_round_has_none(monkeypatch):
    telling(monkeypatch, lambda number, steps: 50.0)
    first = belief("backlash", alternatives=["constant_force", "cogging"])
    elsewhere, own = belief("constant_force", found=False, round=1), belief("cogging", found=False, round=0)
    assert next_experiment(diagnosed("effect", first, elsewhere), DRIVE).between == ["backlash", "constant_force"]
    assert next_experiment(diagnosed("effect", first, elsewhere, own), DRIVE).between == ["backlash", "cogging"]


def test_a_rival_that_is_surer_in_another_round_is_read_as_it_was_beside_the_cause(monkeypatch):
    """There it stands beside the cause itself, and no motion would tell the two apart."""
    read = []
    monkeypatch.setattr(module, "_misfit", lambda truth, rival, *_: read.append((truth, rival)) or 50.0)
    beside = fake_fit("lead_error", evidence=-900.0)
    first = belief("cogging", alternatives=["lead_error", "constant_force"])
    others = belief("lead_error", found=False, round=1), belief("constant_force", found=False, round=1)
    offer = next_experiment(diagnosed("effect", first, *reversed(others), rounds=([beside], ())), DRIVE)
    assert offer.between == ["cogging", "lead_error"]
    assert all(truth == "cogging" and rival is beside for truth, rival in read)


@pytest.mark.parametrize("beliefs", [(), (belief("cogging"),), (belief("cogging", found=False),)])
@pytest.mark.parametrize(
    ("dimension", "name", "kind"),
    [
        ("phase", "reversal", "sine"),
        ("phase", "acceleration", "sine"),
        ("phase", "cruise", "staircase"),
        ("phase", "start and stop", "trapezoidal"),
        ("phase", "rest", "trapezoidal"),
        ("direction", "positive", "trapezoidal"),
        ("speed", "20 to 40 mm/s", "trapezoidal"),
        ("speed", "0.2 to 1.3 mm/s", "trapezoidal"),
        ("position", "7.96 to 17.8 mm", "trapezoidal"),
        ("position", "period of 1.25 mm", "staircase"),
        ("frequency", "line at 24 Hz", "staircase"),
        ("frequency", "10 to 30 Hz", "staircase"),
        ("load", "0 to 5e+03 N", "trapezoidal"),
        ("time", "1 to 2 s", "trapezoidal"),
        ("log", "log 2", "trapezoidal"),
    ],
)
def test_unknown_asks_for_a_motion_that_dwells_where_the_gap_lies(beliefs, dimension, name, kind):
    where = [region("subsystem", "sensor"), region("phase", "none of it", 0.5), region(dimension, name)]
    offer = next_experiment(diagnosed("unknown", *beliefs, where=where), DRIVE)
    assert offer.motion.startswith(f"{kind}:")
    assert f"60 % of the gap lies in {name}" in offer.says
    assert offer.motion in offer.says
    motion = require_within(offer.reference, DRIVE.limits)
    np.testing.assert_allclose(motion.position, parse_motion(offer.motion, RATE).position, atol=1e-12)
    assert 0.01 <= motion.position.min() <= motion.position.max() <= 0.05  # where the logs went
    assert motion.duration < 30.0


def test_a_speed_band_is_run_at_its_speed_and_a_reversal_turned_often():
    at_speed = next_experiment(diagnosed("unknown", where=[region("speed", "20 to 40 mm/s")]), DRIVE)
    speed = np.abs(at_speed.reference.velocity)
    assert np.mean(np.abs(speed - 0.03) < 1e-9) > 0.8
    turning = next_experiment(diagnosed("unknown", where=[region("phase", "reversal")]), DRIVE)
    assert np.sum(np.diff(np.sign(turning.reference.velocity)) != 0) > 90


def test_unknown_is_never_content_and_needs_no_controller():
    strange = dataclasses.replace(DRIVE, controller=UnknownController())
    for description in (DRIVE, strange):
        offer = next_experiment(diagnosed("unknown"), description)
        assert offer.motion.startswith("staircase:")
        assert "nowhere in particular" in offer.says
    moved = diagnosed("unknown", unexplained=0.0, says="mass had to be moved by +12 %")
    assert next_experiment(moved, DRIVE).says.startswith("Measure that parameter by itself")
    assert next_experiment(diagnosed("none"), DRIVE).says == "Nothing is left to decide."


def test_a_motion_that_dwells_lies_about_the_middle_of_where_the_logs_went():
    for name in ("reversal", "rest", "cruise"):
        motion = next_experiment(diagnosed("unknown", where=[region("phase", name)]), DRIVE).reference.position
        assert 0.5 * (motion.min() + motion.max()) == pytest.approx(0.03, abs=1e-6), name


def test_no_motion_is_proposed_where_the_missing_force_is_not_told():
    far = diagnosed("unknown", where=[region("phase", "reversal")])
    far.gap.is_known = False
    offer = next_experiment(far, DRIVE)
    assert offer.motion == ""
    assert "units" in offer.says


def test_a_motion_that_the_axis_cannot_do_is_not_proposed():
    narrow = dataclasses.replace(DRIVE, limits=Limits(stroke=(-0.01, 0.02)))
    offer = next_experiment(diagnosed("unknown", where=[region("position", "7 to 9 mm")]), narrow)
    assert offer.motion == ""
    assert offer.reference is None
    assert "no motion is proposed" in offer.says.casefold()
