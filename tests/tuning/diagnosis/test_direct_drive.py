"""A motor that cogs with many times its friction: at one speed that looks like an error of the scale."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from diffdrive.axis_file.drive_file import parse_axis
from diffdrive.controllers import UnknownController
from diffdrive.effects.actuator import ForceGain
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.effects.forces import Cogging
from diffdrive.motion.builders import from_array
from diffdrive.runtime import configure
from experiments.studies import laas
from tests.support.sound_log import simulate_log
from tuning.diagnosis.diagnose import diagnose
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.candidates import cogging, strong_cogging
from tuning.diagnosis.hypotheses.priors import Parameter
from tuning.diagnosis.selection.screening import Screened
from tuning.diagnosis.selection.search import _likeliest, _promising

configure()

AMONG = ("cogging", "interpolation_error", "force_gain")
OTHERS = [name for name in EFFECTS if name not in AMONG]
FRICTION, WAVE, PERIOD = 0.5, 8.0, 2e-4
MOTOR = parse_axis(
    {
        "plant": {"mass": 8.0, "damping": 0.0},
        "friction": {
            "coulomb_screw": FRICTION,
            "load_coefficient": 0.0,
            "initial_load": 0.0,
            "breakaway_gap": 0.1 * FRICTION,
            "stribeck_velocity": 1e-3,
            "viscous": 400.0,
            "bristle_stiffness": FRICTION / 2e-6,
            "bristle_damping": 100.0,
        },
        "sensor": {"noise": 1e-7, "resolution": 1e-7},
        "sampling": {"rate": 1000.0},
        "controller": {"kind": "pd", "kp": 5e5, "kd": 3e3},
    }
)


def run_with(wave):
    time = np.arange(0.0, 3.0, 1e-3)
    machine = dataclasses.replace(MOTOR.drive, effects=(Cogging(period=PERIOD, cosine=0.6 * wave, sine=0.8 * wave),))
    return simulate_log(dataclasses.replace(MOTOR, drive=machine), from_array(time, 8e-3 * time))


@pytest.mark.long
def test_a_wave_many_times_the_friction_is_cogging_and_no_error_of_the_scale():
    found = diagnose(MOTOR.drive, UnknownController(), [run_with(WAVE)], without=OTHERS, most_effects=1)
    first = next(one for one in found.verdict.beliefs if one.found)
    cogging = first.fitted.model.values(first.fitted.theta)[-1]
    assert first.effect == "cogging"
    assert np.hypot(cogging["cosine"][0], cogging["sine"][0]) == pytest.approx(WAVE, rel=0.03)
    assert cogging["period"][0] == pytest.approx(PERIOD, rel=1e-3)
    assert found.closed.share > 0.9  # of a gap at which a filter that trusts the nominal drive is lost all along


def test_of_two_sizes_of_one_kind_only_the_likelier_is_fitted():
    at = SimpleNamespace(friction=1.0, command=30.0, low=0.0, high=0.1)
    usual, strong = cogging(at), strong_cogging(at)
    assert usual.kind == strong.kind
    gain = Candidate(ForceGain, (Parameter("gain", 0.0, 0.15),))
    screened = [
        Screened(one, 0.0, evidence, {}, None, None, None)
        for one, evidence in ((strong, 90.0), (gain, 80.0), (usual, 70.0))
    ]
    assert [one.candidate for one in _promising(screened)] == [strong, gain]
    assert [one.candidate for one in _likeliest(screened)] == [strong, gain]  # about the drive file's numbers, too


@pytest.mark.slow  # a diagnosis of two long logs, which `diffdrive real-axes` makes, too
@pytest.mark.skipif(laas.find_folder() is None, reason="needs shared/data/laas_cogging beside the checkout")
def test_the_motor_of_laas_cogs_a_tenth_as_much_with_its_compensation():
    folder = laas.find_folder()
    nominal = laas.nominal_drive(folder)
    sizes = {}
    for name, log in laas.read(folder / "speed_test.txt").items():
        found = diagnose(nominal, UnknownController(), [log], without=OTHERS, tolerance=0.2, most_effects=1)
        fits = found.explanation.rounds[0].fits
        cogging = next(one for one in fits if one.model.members[-1].candidate.name == "cogging")
        values = cogging.model.values(cogging.theta)[-1]
        assert laas.LEAD / values["period"][0] == pytest.approx(72, rel=2e-3)
        sizes[name] = np.hypot(values["cosine"][0], values["sine"][0])
        if name == "off":
            assert cogging is fits[0]
            assert found.closed.share > 0.8
    assert sizes["on"] < 0.2 * sizes["off"]
