"""The loop with a measured plant: what was sampled from a model has the model's margins, whatever was measured."""

import dataclasses

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffdrive as dd
from diffdrive.controllers import PT2, Cascade
from diffdrive.errors import ParameterError
from diffdrive.loop.linearise import OperatingPoint, open_loop, response
from diffdrive.loop.measured import hold, measured_margins, measured_plant
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Actuator, Sampling
from diffdrive.model.presets import paper_drive
from diffdrive.numerics.arrays import as_arrays
from tests.diffdrive.controllers.test_filters import by_python_control
from tests.support.second_order import two_mass_speed

RATE = 8_000.0  # that of the filters in test_filters.py
PERIOD = 1.0 / RATE
AT = OperatingPoint(0.01, 0.0)
FREQUENCY = np.geomspace(2.0, 3_900.0, 200)  # 60 in a decade
DRIVE = dataclasses.replace(
    paper_drive(quantised=False), actuator=Actuator(force_limit=3_000.0, delay_samples=1, delay_fraction=0.4)
)
CONTROLLER = Cascade(
    kp=90.0, kv=3e4, reset_time=0.02, velocity_feedforward=0.5, reference_filter_time=1e-3, filters=(PT2(1_500.0),)
)
AXIS = dd.Axis(DRIVE, CONTROLLER, Sampling(RATE, 4))


def prepared(of, value, frequency=FREQUENCY, controller=CONTROLLER):
    drive, controller = as_arrays(smooth((DRIVE, controller)))
    return measured_plant(drive, controller, AXIS.sampling, as_arrays(AT), of, frequency, value)


def loop_of(controller=CONTROLLER):
    return open_loop(*as_arrays(smooth((DRIVE, controller))), AXIS.sampling, AT)


@pytest.fixture(scope="module")
def plant():
    """The model's plant: the reading per force that is held over each period."""
    model = prepared("plant", np.ones(len(FREQUENCY), complex)).model
    return -np.asarray(response(model, FREQUENCY).loop)


def measurement(of, reading):
    """What would be measured of a plant with this reading per force, by the controller's law."""
    s, z = 2j * np.pi * FREQUENCY, np.exp(2j * np.pi * FREQUENCY * PERIOD)
    amplifier = (0.4 / z + 0.6) / z
    pi = CONTROLLER.kv * (1.0 + PERIOD / CONTROLLER.reset_time * z / (z - 1.0)) * by_python_control(PT2(1_500.0))(z)
    speed = (1.0 - 1.0 / z) / PERIOD
    set_point = CONTROLLER.kp * by_python_control(dd.controllers.PT1(1e-3))(z) + 0.5 * s
    round_trip = pi * (CONTROLLER.kp + speed) * amplifier * reading
    return {
        "plant": s * reading / np.asarray(hold(FREQUENCY, PERIOD)),
        "plant-with-current-loop": s * reading / np.asarray(hold(FREQUENCY, PERIOD)) * amplifier,
        "open-loop": round_trip,
        "position-loop": pi * set_point * amplifier * reading / (1.0 + round_trip),
        "speed-loop": s * pi * amplifier * reading / (1.0 + pi * speed * amplifier * reading),
    }[of]


LONG = [pytest.param(of, marks=pytest.mark.long) for of in ("plant-with-current-loop", "open-loop", "speed-loop")]


@pytest.mark.parametrize("of", ["plant", "position-loop", *LONG])
def test_what_was_sampled_from_the_model_has_its_margins(plant, of):
    loop = dd.linearise(AXIS, velocity=AT.velocity)
    measured = dd.FrequencyResponse(FREQUENCY, measurement(of, plant), of, "(m/s)/N" if of.startswith("pl") else "1")
    found, expected = dd.measured_loop(AXIS, measured, velocity=AT.velocity), loop.margins()
    np.testing.assert_allclose(found.response(FREQUENCY), loop.response(FREQUENCY), rtol=1e-6)
    got = found.margins()
    assert bool(got.stable)
    for name in ("gain_margin_up", "phase_margin", "peak_sensitivity", "crossover"):
        assert float(getattr(got, name)) == pytest.approx(float(getattr(expected, name)), rel=1e-5), name


def test_nothing_of_the_model_s_plant_is_in_the_loop():
    other = dataclasses.replace(DRIVE, plant=dataclasses.replace(DRIVE.plant, mass=3.0 * float(DRIVE.plant.mass)))
    measured = dd.FrequencyResponse(FREQUENCY, two_mass_speed(FREQUENCY), "plant", "(m/s)/N")
    loops = [
        dd.measured_loop(dataclasses.replace(AXIS, drive=drive), measured).response(FREQUENCY)
        for drive in (DRIVE, other)
    ]
    np.testing.assert_allclose(loops[0], loops[1], rtol=1e-9)


def test_a_loop_of_a_measured_mass_is_its_formula():
    """In continuous time between the samples: the law by hand, the hold, and 1 / (M s^2)."""
    s = 2j * np.pi * FREQUENCY
    reading = np.asarray(hold(FREQUENCY, PERIOD)) / (80.0 * s**2)
    found = dd.measured_loop(AXIS, dd.FrequencyResponse(FREQUENCY, 1.0 / (80.0 * s), "plant", "(m/s)/N"))
    np.testing.assert_allclose(found.response(FREQUENCY), measurement("open-loop", reading), rtol=1e-9)
    between = np.sqrt(FREQUENCY[1:] * FREQUENCY[:-1])
    coarse = dd.measured_loop(AXIS, dd.FrequencyResponse(FREQUENCY[::20], 1.0 / (80.0 * s[::20]), "plant", "(m/s)/N"))
    np.testing.assert_allclose(coarse.response(between[:-20]), found.response(between[:-20]), rtol=1e-5)


FINE = np.geomspace(2.0, 3_900.0, 1_000)  # a dozen in the peak
HIDDEN = dd.FrequencyResponse(FINE, two_mass_speed(FINE, 100.0, 900.0, 0.02), "plant", "(m/s)/N")


def fastest_growth(controller):
    """Growth (1/s) of the mode that grows fastest, of two masses with free resonance 900 Hz sampled exactly."""
    w = 2.0 * np.pi * 900.0
    top, bottom = [1.0, 0.02 * w, 0.5 * w**2], [1.0, 0.04 * w, w**2]
    position = control.c2d(control.tf(top, np.polymul([50.0, 0.0, 0.0], bottom)), PERIOD, "zoh")
    later, share = control.tf([1.0], [1.0, 0.0], PERIOD), control.tf([0.6, 0.4], [1.0, 0.0], PERIOD)
    integral = control.tf([PERIOD / controller.reset_time, 0.0], [1.0, -1.0], PERIOD)
    speed = control.tf([1.0, -1.0], [PERIOD, 0.0], PERIOD)
    law = controller.kv * (1 + integral) * by_python_control(PT2(1_500.0)) * (controller.kp + speed)
    loop = control.minreal(law * later * share * position, verbose=False)
    return float(np.max(np.log(np.abs(control.feedback(loop, 1).poles())))) / PERIOD


@pytest.mark.long
def test_a_hidden_resonance_that_turns_about_minus_one_makes_the_loop_unstable():
    weak, strong = (dataclasses.replace(CONTROLLER, kp=30.0, kv=kv) for kv in (5e3, 6e4))
    assert fastest_growth(weak) < 0.0 < fastest_growth(strong)
    calm, wild = (dd.measured_loop(AXIS.with_controller(one), HIDDEN) for one in (weak, strong))
    assert bool(calm.margins().stable)
    assert bool(wild.linear.margins().stable)
    assert not bool(wild.margins().stable)
    assert np.isinf(wild.margins().growth)
    comparison = dd.compare_frequency_response(AXIS.with_controller(strong), HIDDEN)
    assert comparison.status.code == "unstable"
    assert comparison.resonances[0].frequency == pytest.approx(900.0, rel=0.03)
    assert comparison.resonances[0].damping == pytest.approx(0.02, rel=0.2)
    assert comparison.model_resonances == ()
    assert comparison.largest_departure[0] > 1.0
    assert "turns about -1 as the model's does not" in comparison.status.message


@pytest.mark.long
def test_derivatives_of_the_margins_are_those_of_differences():
    plant = prepared("plant", two_mass_speed(FREQUENCY, resonance=900.0, damping=0.05))
    axis = dd.Axis(smooth(DRIVE), smooth(CONTROLLER), AXIS.sampling)
    gains = {name: jnp.asarray(value) for name, value in axis.gains.items()}

    @jax.jit
    def worth(gains):
        found = measured_margins(loop_of(axis.with_gains(**gains).controller), plant)
        return jnp.array([found.gain_up, found.phase, found.sensitivity])

    slopes = jax.jit(jax.jacfwd(worth))(gains)
    assert np.all(np.isfinite(worth(gains)))
    for name, value in gains.items():
        up, down = (np.asarray(worth(gains | {name: factor * value})) for factor in (1.0 + 1e-5, 1.0 - 1e-5))
        np.testing.assert_allclose(slopes[name] * value, (up - down) / 2e-5, rtol=1e-5, atol=1e-5 * np.max(np.abs(up)))


@pytest.mark.long
def test_what_lies_outside_the_band_is_said():
    s = 2j * np.pi * np.geomspace(200.0, 900.0, 50)
    part = dd.FrequencyResponse(np.geomspace(200.0, 900.0, 50), 1.0 / (100.0 * s), "plant", "(m/s)/N")
    comparison = dd.compare_frequency_response(AXIS, part)
    assert any("crossover" in note and "outside the band" in note for note in comparison.notes)
    assert any("measured from 200 to 900 Hz" in note for note in comparison.notes)
    with pytest.raises(ParameterError, match=r"frequencies: 100 Hz is outside the measured band, 200 to 900 Hz"):
        dd.measured_loop(AXIS, part).response(np.array([100.0]))
    high = np.array([3_000.0, 3_500.0, 5_000.0, 6_000.0])
    with pytest.raises(ParameterError, match=r"has 2 values below half the control rate of 8000 Hz; 4 are needed"):
        dd.measured_loop(AXIS, dd.FrequencyResponse(high, 1.0 / high + 0j, "plant", "(m/s)/N"))


def test_a_controller_without_a_speed_loop_is_refused():
    axis = dd.paper_axis(controller="pd")
    with pytest.raises(ParameterError, match="of: a PD has no speed loop inside a position loop; a cascade has"):
        dd.measured_loop(axis, dd.FrequencyResponse(FINE, HIDDEN.value, "speed-loop"))
