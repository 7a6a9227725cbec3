"""The machine of the withheld-effect check: without a fault it is the simulator's, with one it is the catalogue's.

Two programs, two integrators, and no equation of an effect in common: what each fault changes in position and command
is held against what the effect of that name changes in the simulator.
"""

import dataclasses

import equinox as eqx
import numpy as np
import pytest
from scipy.signal import lfilter

from diffdrive.effects.actuator import ActuatorLag, ForceGain, ForceLimit, LoopDelay
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.effects.forces import Cogging, ConstantForce, FrameVibration, PositionSpring, ProcessForce
from diffdrive.effects.friction import AppliedLoad, FrictionDwell, PositionFriction, ViscousDrift
from diffdrive.effects.scale import InterpolationError, LeadError
from diffdrive.effects.transmission import Backlash, Compliance
from diffdrive.loop.simulate import simulate_loop
from diffdrive.motion.builders import from_array
from experiments.studies.control import Control
from experiments.studies.withheld import machine
from experiments.studies.withheld.equations import FaultParameters, MachineStructure
from experiments.studies.withheld.faults import KNOWN
from experiments.studies.withheld.machine import MachineInputs, run
from tests.support.sound_log import RATE, axis_of

PLAIN = axis_of(resolution=None, noise=0.0)
MASS = float(PLAIN.drive.plant.mass)
TIME = np.arange(1000) / RATE
MOTION = from_array(TIME, 1e-3 * (1 - np.cos(2 * np.pi * 5.0 * TIME)) * np.where(TIME < 0.4, 1.0, 0.0))
PHASE = 0.4


def wave(size, harmonic=1):
    """Cosine and sine of size sin(harmonic (x + PHASE))."""
    return size * np.sin(harmonic * PHASE), size * np.cos(harmonic * PHASE)


def screw(frequency, share):
    return (2 * np.pi * frequency) ** 2 * share * (1 - share) * MASS


ELASTIC = {"screw_damping": 0.1, "motor_share": 0.4, "table_friction": 0.6}
# (what is wrong with the machine, the effect that says the same, how far they may differ)
FAULTS = [
    ({"extra_load": 6e3, "load_start": 0.1, "load_end": 0.3}, AppliedLoad(more=6e3, start=0.125, end=0.275), 0.1),
    (
        {"slope": 40.0, "middle": 1e-3, "wave": 0.1, "wave_period": 1.5e-3, "wave_phase": PHASE},
        PositionFriction(40.0, 1e-3, 1.5e-3, *wave(0.1)),
        0.02,
    ),
    ({"drift_viscous": 0.5, "drift_coulomb": 0.1, "drift_time": 0.2}, ViscousDrift(0.5, 0.1, 0.2), 0.02),
    ({"growth": 0.5, "onset": 0.05, "slip": 2e-5, "rested": 0.6}, FrictionDwell(0.5, 0.05, 2e-5, 0.6), 0.05),
    ({"constant": 4.0}, ConstantForce(4.0), 0.02),
    ({"spring": 3e3, "neutral": 5e-4}, PositionSpring(3e3, 5e-4), 0.02),
    (
        {"base_ratio": 0.1, "base_frequency": 25.0, "base_damping": 0.05},
        FrameVibration(0.1, 25.0, 0.05),
        0.05,
    ),
    (
        {"process": 5.0, "process_mean": 3.0, "process_frequency": 40.0, "process_phase": PHASE,
         "process_start": 0.1, "process_end": 0.3},
        ProcessForce(40.0, 3.0, *wave(5.0), 1.5 * np.sin(2 * PHASE), 1.5 * np.cos(2 * PHASE), 0.105, 0.295),
        0.05,
    ),
    (
        {"cogging": 4.0, "cogging_period": 1e-3, "cogging_phase": PHASE, "second": 0.5, "sixth": 0.2},
        Cogging(1e-3, *wave(4.0), *wave(2.0, 2), *wave(0.8, 6)),
        0.05,
    ),
    ({"gain": -0.1}, ForceGain(-0.1), 0.02),
    ({"fading": 0.1, "fading_time": 1e-9}, ForceGain(-0.1), 0.02),  # at once, which the catalogue does know
    ({"bumper": 3e3, "bumper_place": -1e-3}, PositionSpring(3e3, -1e-3), 0.02),  # met throughout
    ({"limit": 100.0}, ForceLimit(100.0), 0.05),
    ({"delay": 1.4}, LoopDelay(1.4), 0.05),
    ({"lead_error": 4e-6, "lead": 1.5e-3, "lead_phase": -PHASE, "linear": 1e-3},
     LeadError(1.5e-3, 4e-6 * np.cos(PHASE), 4e-6 * np.sin(PHASE), 1e-3), 0.02),
    ({"interpolation": 5e-7, "interpolation_period": 2e-4, "interpolation_phase": PHASE},
     InterpolationError(2e-4, *wave(5e-7)), 0.05),
    (ELASTIC | {"stiffness": screw(200.0, 0.4), "gap": 1e-5, "constant": 60.0},
     (Backlash(1e-5, 200.0, 0.1, 0.4, 0.6), ConstantForce(60.0)), 0.15),
    ({"lag": 2e-3}, ActuatorLag(2e-3), 0.05),
    (ELASTIC | {"stiffness": screw(250.0, 0.4)}, Compliance(250.0, 0.1, 0.4, 0.6), 0.1),
    (ELASTIC | {"stiffness": screw(200.0, 0.4), "gap": 1e-5}, Backlash(1e-5, 200.0, 0.1, 0.4, 0.6), 0.15),
]  # fmt: skip
ELSEWHERE = {  # parameters of the drive that are scaled, and one that the catalogue describes by another law
    "friction_shape", "friction_asymmetry", "payload_mass", "presliding_hysteresis",
}  # fmt: skip


def named(effect):
    return " + ".join(one.name for one in effect) if isinstance(effect, tuple) else effect.name


def simulate_fault(faults, noise=0.0):
    """Position and command of the machine that is not the simulator."""
    flat = np.zeros(len(TIME))
    rough = noise * np.random.default_rng(0).standard_normal(len(TIME))
    structure = MachineStructure(elastic="stiffness" in faults, lagging="lag" in faults)
    gains = PLAIN.controller.tracking.gains
    control = Control(0.0, float(gains.kp), float(gains.kd))
    inputs = MachineInputs(MOTION.position, flat, rough, flat, flat)
    return np.stack(run(PLAIN.drive, FaultParameters(**faults), structure, control, 1e-12, inputs, RATE)[:2])


def simulate_effects(*effects):
    """The same of the simulator; 100 N at most saturate it for much of the time, as they do the other machine."""
    drive = dataclasses.replace(PLAIN.drive, effects=effects)
    ours = simulate_loop(drive, PLAIN.controller, MOTION, sampling=PLAIN.sampling, seed=1)
    return np.stack([ours.position, ours.command])


@pytest.fixture(scope="module")
def fault_free():
    return simulate_fault({}), simulate_effects()


@pytest.mark.long
def test_without_a_fault_it_is_the_simulator(fault_free):
    (position, command), (ours, expected_command) = fault_free
    assert np.abs(position - ours).max() < 5e-9
    assert np.sqrt(np.mean((command - expected_command) ** 2)) < 0.01 * np.abs(command).max()


@pytest.mark.parametrize("dead", [5.0, 15.0])
def test_a_dead_time_takes_its_toll_of_the_force_whichever_way_it_pushes(dead):
    _, fault_free = simulate_fault({})
    _, command = simulate_fault({"dead": dead})
    moving = slice(50, 750)  # the command is well above the toll there, but for where it changes its sign
    more = np.sign(fault_free[moving]) * (command - fault_free)[moving]
    assert np.median(more) == pytest.approx(dead, rel=0.1)


STROKE = MachineInputs(0.02 * np.clip((TIME - 0.05) / 0.4, 0.0, 1.0), *(np.zeros(len(TIME)) for _ in range(4)))
BACK = STROKE._replace(reference=0.02 * (np.clip((TIME - 0.05) / 0.4, 0, 0.5) - np.clip((TIME - 0.25) / 0.4, 0, 0.5)))
CRUISE = slice(300, 500)  # at 50 mm/s, 0.1 s and more after it began
WIND_UP = 1e-6  # m/N: what the motor's encoder is ahead of the scale shows the force


def stroke(inputs=STROKE, **faults):
    """Position and command of one stroke, and the force that acted in the period before each sample."""
    gains, still = PLAIN.controller.tracking.gains, np.zeros(len(TIME))
    control = Control(0.0, float(gains.kp), float(gains.kd))
    arguments = FaultParameters(**faults), MachineStructure(), control, 1e-12
    seen = run(PLAIN.drive, *arguments, inputs._replace(motor_noise=still), RATE, 1, WIND_UP)
    return np.stack([seen.position, seen.command, (seen.motor - seen.position) / WIND_UP])


@pytest.fixture(scope="module")
def sound_stroke():
    return stroke()


@pytest.mark.long
def test_windage_grows_with_the_square_of_the_speed(sound_stroke):
    for speed, inputs, sound in ((0.05, STROKE, sound_stroke), (0.025, half_as_fast(), stroke(half_as_fast()))):
        more = (stroke(inputs, windage=2e3) - sound)[1, CRUISE]
        assert np.mean(more) == pytest.approx(2e3 * speed**2, rel=0.02)


def half_as_fast():
    return STROKE._replace(reference=0.5 * STROKE.reference)


@pytest.mark.long
def test_a_cable_chain_is_bent_the_other_way_along_its_length():
    more = (stroke(BACK, chain=4.0, chain_length=2e-3) - stroke(BACK))[1]
    turned = round(0.25 * RATE)
    assert np.mean(more[turned - 60 : turned - 20]) == pytest.approx(4.0, rel=0.02)
    assert np.mean(more[turned + 70 : turned + 90]) == pytest.approx(0.0, abs=0.3)  # after 2 mm of the way back
    assert np.mean(more[turned + 200 : turned + 260]) == pytest.approx(-4.0, rel=0.02)


@pytest.mark.long
def test_the_force_that_acts_is_in_counts_is_cut_and_comes_and_goes_along_the_motor(sound_stroke):
    coarse = stroke(step=2.0)[2]
    assert np.ptp(coarse) > 20.0
    assert np.max(np.abs(coarse / 2.0 - np.round(coarse / 2.0))) < 1e-5
    cut = np.zeros(len(TIME))
    cut[400:404] = 1.0
    force = stroke(STROKE._replace(cut=cut))[2]
    assert np.max(np.abs(force[401:405])) < 1e-5
    assert np.min(np.abs(force[390:401])) > 1.0
    always = {"commutation": 0.1, "commutation_period": 1e6, "commutation_phase": -0.5 * np.pi}
    assert np.max(np.abs(stroke(**always) - stroke(gain=-0.1))[0]) < 1e-9


@pytest.mark.long
def test_a_spindle_that_runs_up_is_a_force_of_rising_frequency(sound_stroke):
    start, rise, fastest = 0.05, 100.0, 30.0
    running = np.maximum(TIME + 0.5 / RATE - start, 0.0)
    ramp = fastest / rise
    turns = 0.5 * rise * np.minimum(running, ramp) ** 2 + fastest * np.maximum(running - ramp, 0.0)
    force = 8.0 * np.minimum(running / ramp, 1.0) ** 2 * np.sin(2.0 * np.pi * turns)
    expected = stroke(STROKE._replace(disturbance=force)) - sound_stroke
    found = stroke(spin=8.0, spin_start=start, spin_rise=rise, spin_fastest=fastest) - sound_stroke
    assert np.linalg.norm(found - expected) < 0.02 * np.linalg.norm(expected)


@pytest.mark.long
def test_oil_lags_behind_the_speed(sound_stroke):
    """As long as its film is thin, friction stays nearer to breakaway."""
    lag, moving = 0.05, slice(100, 300)
    late, friction = stroke(film_time=lag), PLAIN.drive.friction
    gap, width = float(friction.breakaway_gap.positive), float(friction.stribeck_velocity.positive)
    speed = np.abs(np.gradient(late[0])) * RATE
    film = lfilter([1.0 / (lag * RATE)], [1.0, 1.0 / (lag * RATE) - 1.0], speed)
    more = gap * (np.exp(-film / width) - np.exp(-speed / width))
    assert np.mean((late - sound_stroke)[1, moving]) == pytest.approx(np.mean(more[moving]), rel=0.3)


@pytest.mark.long
def test_a_late_sample_shows_what_was_passed_since(sound_stroke):
    side = np.where(np.arange(len(TIME)) % 2, 1.0, -1.0)
    late = stroke(STROKE._replace(lateness=1e-5 * side)) - sound_stroke
    assert np.mean((late[0] * side)[CRUISE]) == pytest.approx(1e-5 * 0.05, rel=0.1)


def test_every_effect_with_an_equation_of_its_own_is_held_against_the_catalogue():
    """Of an effect that is not among its faults the study says nothing, and that it does not."""
    assert {effect.name for _, effect, _ in FAULTS if not isinstance(effect, tuple)} == KNOWN.keys() - ELSEWHERE
    assert KNOWN.keys() <= EFFECTS.keys()


@pytest.mark.long
@pytest.mark.parametrize(("faults", "effect", "most"), FAULTS, ids=[named(effect) for _, effect, _ in FAULTS])
def test_a_fault_is_the_effect_of_its_name(faults, effect, most, fault_free):
    effects = effect if isinstance(effect, tuple) else (effect,)
    for theirs, ours in zip(
        simulate_fault(faults) - fault_free[0], simulate_effects(*effects) - fault_free[1], strict=True
    ):
        assert np.linalg.norm(theirs) > 0.0
        assert np.linalg.norm(theirs - ours) < most * np.linalg.norm(theirs)


@pytest.mark.long
def test_the_instant_at_which_a_late_command_arrives_is_not_blurred(monkeypatch):
    """A step across it is off by nanometres, which a diagnosis would take for an effect."""
    plain, found = machine._run.__wrapped__, []
    for tolerance in (1e-8, 1e-11):
        monkeypatch.setattr(machine, "TOLERANCE", tolerance)
        anew = eqx.filter_jit(lambda *given: plain(*given))
        monkeypatch.setattr(machine, "_run", anew)
        found.append(simulate_fault({"delay": 0.17}, noise=3e-8)[0])
    assert np.max(np.abs(found[0] - found[1])) < 2e-10  # 1.2e-8 by steps across it
