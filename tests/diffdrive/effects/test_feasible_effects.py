"""Effects that no machine can have, or that none can compute, are refused by name: in files, runs and sweeps."""

import dataclasses

import jax
import numpy as np
import pytest

from diffdrive import motion as motions
from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import axis_tables, parse_axis
from diffdrive.controllers import PD
from diffdrive.controllers.base import paper_tracking
from diffdrive.effects.base import Envelope
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.effects.feasibility import require_feasible
from diffdrive.errors import DriveFileError, MotionError, ParameterError
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.parameters import Sampling
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.model.quantity import quantities
from diffdrive.motion.motion import Limits
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.possible import require_possible

DRIVE = paper_drive(quantised=False)
CONTROLLER = PD(paper_tracking(DRIVE, PAPER_KP, PAPER_KD))
MOVE = motions.jerk_limited(distance=2e-4, speed=0.01, acceleration=1.0, jerk=100.0, rate=10_000.0, dwell=0.01)
WITHIN = Envelope(position=(0.0, 0.1), speed=0.2, duration=10.0, period=1e-4)

IMPOSSIBLE = {
    "no mass": ("payload_mass", {"mass": -100.0}, "effects.payload_mass: with it the moving mass is 0 kg"),
    "no friction": ("friction_shape", {"coulomb": -500.0}, "Coulomb friction in the positive direction is -.* N: it"),
    "one direction without": ("friction_asymmetry", {"coulomb": 500.0}, "Coulomb friction in the negative direction"),
    "drag that drives": ("friction_shape", {"viscous": -5e4}, "viscous friction and damping in the positive direction"),
    "drag that drives at speed": ("friction_shape", {"curvature": -1e5}, "with this curvature .* at 0.2 m/s"),
    "a factor beyond all numbers": ("friction_shape", {"stribeck_velocity": 1e3}, "beyond all numbers"),
    "a load that lifts": ("applied_load", {"more": -2e4}, "a load of -20000 N lifts the table off its guides, which"),
    "a wave deeper than the level": ("position_friction", {"cosine": -0.8, "sine": 0.8}, "takes 113.1 % of the"),
    "a slope": ("position_friction", {"slope": -20.0}, "takes 200 % of the Coulomb friction off at some place"),
    "more than all viscous friction": ("viscous_drift", {"viscous": -1.5}, "takes off more viscous friction than"),
    "all Coulomb friction": ("viscous_drift", {"coulomb": -1.0}, "leaves no Coulomb friction: it must be above -1"),
    "breakaway gone at rest": ("friction_dwell", {"growth": -50.0}, "at rest the breakaway friction .* is -.* N"),
    "no stiffness": ("presliding_hysteresis", {"share": 50.0}, "stiffness before sliding becomes -.* N/m: it must"),
    "a stiff spring": ("position_spring", {"stiffness": -1e12}, r"changes by 1e\+12 N/m along the stroke, more than"),
    "a ripple of nothing": ("cogging", {"period": 1e-300, "sine": 1.0}, r"is 1e\+299 of its waves, of which 1e\+09"),
    "a steep ripple": ("cogging", {"period": 1e-9, "sine6": 1.0}, "along the stroke, more than the .* N/m"),
    "a scale that counts backwards": ("lead_error", {"cosine": 1e-3}, "the scale counts -0.257 m for each metre"),
    "a scale that shrinks": ("lead_error", {"linear": -2.0}, "the scale counts -1 m for each metre"),
    "a signal period of nothing": ("interpolation_error", {"period": 1e-200, "sine": 1e-9}, "of its waves"),
    "a coarse interpolation": ("interpolation_error", {"sine2": 2e-6}, "the scale counts -0.257 m"),
    "a force beyond the rate": ("process_force", {"frequency": 6e3, "sine": 1.0}, "6000 Hz are beyond half of the"),
    "a screw beyond all numbers": ("compliance", {"frequency": 1e300}, "of its waves"),
}  # fmt: skip


def having(name, values):
    return dataclasses.replace(DRIVE, effects=(EFFECTS[name](**values),))


@pytest.mark.parametrize(("name", "values", "says"), IMPOSSIBLE.values(), ids=IMPOSSIBLE.keys())
def test_an_impossible_effect_is_named(name, values, says):
    with pytest.raises(ParameterError, match=rf"^effects\.{name}: .*{says.removeprefix(f'effects.{name}: ')}"):
        require_feasible(having(name, values), WITHIN)


@pytest.mark.parametrize(("name", "values", "says"), IMPOSSIBLE.values(), ids=IMPOSSIBLE.keys())
def test_one_impossible_machine_among_many_is_found(name, values, says):
    """As a sweep draws them: a parameter is an array over machines."""
    last = {key: np.array([getattr(EFFECTS[name](), key), value]) for key, value in values.items()}
    with pytest.raises(ParameterError, match=rf"^effects\.{name}: "):
        require_feasible(having(name, last), WITHIN)


@pytest.mark.parametrize("name", EFFECTS)
def test_a_neutral_effect_is_possible_wherever_the_drive_goes(name):
    for within in (WITHIN, Envelope(), Envelope((-100.0, 100.0), 10.0, -15_000.0, 1e6, 0.1)):
        require_feasible(having(name, {}), within)


def test_what_is_traced_is_passed_over():
    def mass(more):
        drive = having("payload_mass", {"mass": more})
        require_feasible(drive, WITHIN)
        return more

    assert float(jax.grad(mass)(-200.0)) == 1.0


def test_a_drive_file_with_an_impossible_effect_is_refused_by_name():
    axis = Axis(DRIVE, CONTROLLER, Sampling(), Limits((-0.075, 0.075), 0.5))
    tables = axis_tables(axis) | {"effects": {"payload_mass": {"mass": "-100 kg"}}}
    with pytest.raises(DriveFileError, match=r"^axis\.toml: effects\.payload_mass: with it the moving mass is 0 kg"):
        parse_axis(tables, "axis.toml")
    tables["effects"] = {"position_friction": {"slope": 20.0}}  # what it may be depends on the stroke
    with pytest.raises(DriveFileError, match="takes 150 % of the Coulomb friction off"):
        parse_axis(tables, "axis.toml")
    tables["limits"]["stroke"] = [0.0, 0.1]
    parse_axis(tables, "axis.toml")


def test_a_run_with_an_impossible_effect_is_refused_by_name():
    with pytest.raises(ParameterError, match=r"^effects\.position_friction: it takes 200 % of the Coulomb"):
        simulate_loop(having("position_friction", {"slope": -1e4}), CONTROLLER, MOVE)


STRANGE = [0.0, -1.0, 1e-300, -1e-300, 1e-12, 1e12, -1e12, 1e300, -1e300]


def test_every_parameter_of_every_effect_at_strange_values_is_judged_in_numbers():
    """Refused by the effect's name or let through: never another error, never a warning."""
    judged = {True: 0, False: 0}
    for name, effect in EFFECTS.items():
        for path, declared, _ in quantities(effect()):
            for value in STRANGE:
                if declared.violated_bounds(np.asarray(value)):
                    continue
                amplitudes = {key: 1e-6 for key in ("cosine", "sine") if hasattr(effect(), key)}
                said = f"effects.{name}: "
                try:
                    require_feasible(having(name, amplitudes | {path: value}), WITHIN)
                    judged[True] += 1
                except ParameterError as problem:
                    said = str(problem)
                    judged[False] += 1
                assert said.startswith(f"effects.{name}: ")
    assert judged[True] > 100
    assert judged[False] > 100


@pytest.mark.parametrize(
    ("effects", "blamed"),
    [
        ({"force_gain": {"gain": 200.0}, "constant_force": {"force": 1.0}}, "force_gain"),
        ({"frame_vibration": {"ratio": 1e6}}, "frame_vibration"),
    ],
)
def test_a_run_that_an_effect_makes_diverge_blames_the_effect_and_not_the_gains(effects, blamed):
    drive = dataclasses.replace(DRIVE, effects=tuple(EFFECTS[name](**values) for name, values in effects.items()))
    status = simulate_loop(drive, CONTROLLER, MOVE).status
    assert not status.ok
    assert status.message.endswith(f": without effects.{blamed} it stays within them; check the units there")


def test_gains_are_blamed_where_they_fail_without_the_effects_too():
    wild = PD(paper_tracking(DRIVE, 1e12, PAPER_KD))
    status = simulate_loop(having("constant_force", {"force": 1.0}), wild, MOVE).status
    assert "the loop is unstable with these gains" in status.message


def test_a_load_whose_rounding_moves_the_table_is_refused():
    with pytest.raises(MotionError, match=r"^under a load of 1e\+300 N the rounding of the friction.* check the units"):
        simulate_loop(DRIVE, CONTROLLER, MOVE, load=1e300)


def test_an_impossible_machine_of_a_sweep_is_named_before_any_runs():
    axis = Axis(DRIVE, CONTROLLER, Sampling(), Limits())
    plan = SweepPlan.of(axis, {"PD": CONTROLLER}, {"move": MOVE}, ("effects.payload_mass.mass=uniform:-150..0 kg",), 8)
    with pytest.raises(
        ParameterError, match=r"^sweep: machine \d cannot be: effects\.payload_mass: with it the moving"
    ):
        require_possible(plan, range(plan.parts))
