"""What is no axis, motion, log or controller is refused by the argument's name, whichever function it is given to."""

import pytest

import diffdrive as dd
import tuning
from diffdrive.errors import ParameterError

AXIS = dd.paper_axis()
LAP = dd.motion.sine(amplitude=1e-3, frequency=10.0, duration=0.2, rate=AXIS.rate)
FILE = "axis.toml"


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: dd.simulate(FILE, LAP), "axis"),
        (lambda: dd.simulate(AXIS, LAP, machine=FILE), "machine"),
        (lambda: dd.simulate(AXIS, "sine:amplitude=1mm,frequency=10Hz,duration=1s"), "motion"),
        (lambda: dd.rollout(FILE, LAP), "axis"),
        (lambda: dd.rollout(AXIS, None), "motion"),
        (lambda: dd.linearise(FILE, velocity=0.01), "axis"),
        (lambda: dd.compare_encoders("log.csv"), "log"),
        (lambda: AXIS.with_controller("cascade"), "controller"),
        (lambda: tuning.tune(FILE), "axis"),
        (lambda: tuning.tune(AXIS, [LAP]), "motion"),
        (lambda: tuning.pareto_front(AXIS, [5.0]), "result"),
        (lambda: tuning.tune(AXIS, requirements=30.0), "requirements"),
        (lambda: tuning.tune(AXIS, objective="rms"), "objective"),
        (lambda: tuning.tune(AXIS, measured="plant.csv"), "measured"),
        (lambda: tuning.tune(AXIS, measured=["plant.csv"]), "measured"),
        (lambda: tuning.tune(AXIS, measured=None), "measured"),
        (lambda: dd.measured_loop(AXIS, "plant.csv"), "measured"),
        (lambda: dd.compare_frequency_response(AXIS, "plant.csv"), "measured"),
        (lambda: tuning.identify_controller(FILE, "log.csv"), "axis"),
        (lambda: tuning.propose_notch(FILE), "axis"),
        (lambda: tuning.identify(FILE, "log.csv"), "axis"),
        (lambda: tuning.diagnose(FILE, "log.csv"), "axis"),
        (lambda: tuning.sweep(FILE, LAP), "axis"),
        (lambda: tuning.sweep(AXIS, 3.0), "motion"),
        (lambda: tuning.sweep(AXIS, LAP, against={"other": FILE}), "against other"),
    ],
)
def test_it_is_refused_by_its_name(call, name):
    with pytest.raises(ParameterError, match=f"^{name}: must be an? [A-Za-z]+, got "):
        call()
