"""What is said of a change: in one sentence, with its numbers, and of what is one thing in the workshop once."""

from types import SimpleNamespace

import numpy as np
import pytest

from diffdrive.logs.encoders.regression import Estimate
from diffdrive.model.presets import paper_drive
from tuning.comparison.change import Change, sentence
from tuning.comparison.changes import Difference, Estimates, Interval
from tuning.comparison.controller import ControllerChanges, controller_changes
from tuning.comparison.encoders import EncoderChanges, encoder_changes
from tuning.comparison.findings import findings_of, friction_change, limits, machine_changes, scales_friction_alone
from tuning.comparison.machine import Component, MachineDifference
from tuning.comparison.sides import Sides
from tuning.identification.controller.gains import Parts

COULOMB = "friction.coulomb_at_no_load"
NO_GAINS, NO_SCREW = ControllerChanges((), (), ()), EncoderChanges((), None, ())
LEVEL = 0.01
MASS, FRICTION, OFFSET = 400.0, 300.0, 5.0


def machine(mass=1.0, friction=1.0, offset=0.0, deviation=1e-3):
    """A machine whose mass and friction change by factors, its constant force by newtons; all well known."""
    before = np.array([np.log(MASS), np.log(FRICTION), np.log(FRICTION), OFFSET])
    change = np.array([np.log(mass), np.log(friction), np.log(friction), offset])
    covariance = deviation**2 * np.diag([1.0, 1.0, 1.0, FRICTION**2])
    difference = Difference(
        ("plant.mass", COULOMB, COULOMB, "plant.constant_force"),
        Estimates(before, covariance, 100.0), Estimates(before + change, covariance, 100.0),
    )  # fmt: skip
    components = (
        Component("plant.mass", "kg", True, (MASS, MASS * mass)),
        Component(f"{COULOMB}.positive", "N", True, (FRICTION, FRICTION * friction)),
        Component(f"{COULOMB}.negative", "N", True, (FRICTION, FRICTION * friction)),
        Component("plant.constant_force", "N", False, (OFFSET, OFFSET + offset)),
    )
    return machine_changes(MachineDifference(components, difference, ()), LEVEL)


def encoders(reversal, wind_up=(2e-6, 1e-6, 3e-6), reversals=20):
    """What two encoders show of a reversal error (m), known to 0.1 um."""
    error = Estimate(reversal, reversal - 1e-7, reversal + 1e-7)
    return SimpleNamespace(
        reversal_error=error, per_turn=None, linear=Estimate(0.0, -1e-6, 1e-6),
        wind_up=Estimate(*wind_up), reversals=[None] * reversals,
    )  # fmt: skip


def screw(before, after, friction):
    return encoder_changes(Sides((encoders(before),), (encoders(after),), ()), friction, LEVEL)


def friction_of(changes, load_before=0.0, load_after=0.0):
    return friction_change(changes, paper_drive().friction, load_before, load_after)


def sentences(found):
    return [one.sentence for one in found]


def test_a_payload_is_one_sentence_with_its_interval():
    (found,) = findings_of(machine(mass=1.1), NO_GAINS, NO_SCREW)
    assert found.code == "plant.mass"
    assert found.sentence.startswith("the moving mass rose by 10.00 % (9.69 to 10.31), ")
    assert found.sentence.endswith("from 400 to 440 kg: a payload, or a heavier table")


def test_both_directions_of_friction_are_one_sentence():
    (found,) = findings_of(machine(friction=0.9), NO_GAINS, NO_SCREW)
    assert found.sentence.startswith("the Coulomb friction fell by 10.00 % (")
    assert "forwards and by 10.00 % (" in found.sentence
    assert found.sentence.endswith("backwards, from 300 and 300 to 270 and 270 N")


def test_what_may_be_of_either_sign_changes_by_its_unit():
    (found,) = findings_of(machine(offset=-8.0), NO_GAINS, NO_SCREW)
    assert found.sentence.startswith("the constant force fell by 8.00 N (")
    assert found.sentence.endswith("from 5 to -3 N")


def test_a_sentence_ends_where_its_change_leads_whatever_each_side_is_by_itself():
    """With the other parameters unchanged the gap fell, though by itself each side's estimate rose."""
    gap = Change(
        "friction.breakaway_gap", "the breakaway gap", "N", 30.0, 31.0, Interval(-0.5, -0.6, -0.4), False, True
    )
    assert sentence([gap]) == "the breakaway gap fell by 0.50 N (0.40 to 0.60), from 30 to 29.5 N"
    share = gap._replace(change=Interval(-0.1, -0.11, -0.09), is_relative=True)
    assert sentence([share]).endswith("from 30 to 27 N")


def test_no_change_has_no_sentence_but_a_limit():
    same = machine()
    assert findings_of(same, NO_GAINS, NO_SCREW) == ()
    assert same.p_unchanged == 1.0
    said = limits(same.changes)
    assert said.startswith("nine in ten changes of this size would have been found: moving mass 2")
    assert "Coulomb friction" in said


def test_where_a_doubling_would_be_missed_no_size_is_stated():
    """A number hundreds of times the parameter is of the linear model, not of a machine."""
    known = Change("plant.mass", "the moving mass", "kg", 100.0, 100.0, Interval(0, -0.01, 0.01), True, False, 0.02)
    gap = Change("friction.breakaway_gap.positive", "the breakaway gap", "N", 30.0, 13.0, (), False, False, 1.3e4)
    speed = Change(
        "friction.stribeck_velocity.positive", "the Stribeck velocity", "m/s", 1e-3, 2e-3, (), True, False, 9
    )
    force = Change("plant.constant_force", "the constant force", "N", 0.01, 0.02, (), False, False, 19.0)
    assert limits([known, gap, speed, force]) == (
        "nine in ten changes of this size would have been found: moving mass 2 kg (2 %), constant force 19 N; "
        "not even twice as much would have been found of: breakaway gap, Stribeck velocity"
    )
    assert limits([speed]).startswith("not even twice as much")


def test_what_has_changed_has_no_limit():
    assert "moving mass" not in limits(machine(mass=1.1).changes)


def test_backlash_that_appears_is_found():
    found = findings_of(machine(), NO_GAINS, screw(2e-6, 7e-6, friction_of(machine())))
    assert sentences(found) == [
        "the backlash rose by 5.00 um (4.85 to 5.15): the reversal error of motor against table went from 2 to 7 um"
    ]


def test_lost_preload_is_one_finding():
    slack = machine(friction=0.8)
    (found,) = findings_of(slack, NO_GAINS, screw(2e-6, 7e-6, friction_of(slack)))
    assert found.code == "lost preload"
    assert found.sentence.startswith("lost preload: the Coulomb friction fell by 20.00 % (")
    assert "and the backlash rose by 5.40 um (" in found.sentence  # 5 um, and 0.4 um that the wind-up has fallen


def test_wind_up_under_more_friction_is_no_backlash():
    """Reversal error 2 um, all of it wind-up or half: with twice the friction 3 to 4 um."""
    tight = machine(friction=2.0)
    found = findings_of(tight, NO_GAINS, screw(2e-6, 4e-6, friction_of(tight)))
    assert {one.code for one in found} == {COULOMB, "encoders.reversal_error"}
    assert found[-1].sentence.endswith(
        "from 2 to 4 um, as the wind-up of the screw may under friction that these logs do not exclude"
    )


def test_friction_that_may_have_changed_may_have_wound_up_the_screw():
    """3 % more, not seen for its deviation of 2 %, under a wind-up of 20 um: 0.6 um."""
    unseen = machine(friction=1.03, deviation=0.02)
    assert unseen.changed == ()
    friction = friction_of(unseen)
    assert friction.value == pytest.approx(0.03)
    assert friction.low < 0.0 < friction.high
    both = (encoders(one, wind_up=(20e-6, 19e-6, 21e-6)) for one in (22.0e-6, 22.6e-6))
    found = findings_of(unseen, NO_GAINS, encoder_changes(Sides(*((one,) for one in both), ()), friction, LEVEL))
    assert [one.code for one in found] == ["encoders.reversal_error"]


def test_where_friction_is_not_compared_a_reversal_error_is_not_said_to_be_backlash():
    nothing = machine_changes(MachineDifference((), None, ()), LEVEL)
    assert friction_of(nothing) is None
    (found,) = findings_of(nothing, NO_GAINS, screw(2e-6, 7e-6, None))
    assert found.code == "encoders.reversal_error"
    assert "backlash, or wind-up of the screw under another friction, which is not compared" in found.sentence


def test_a_load_winds_the_screw_up_as_friction_does():
    """The paper's guide under 8 kN: 3.66e-4 of it beside the friction of 300 N."""
    assert friction_of(machine(), 0.0, 8_000.0).value == pytest.approx(3.66e-4 * 8_000.0 / FRICTION, rel=1e-3)
    assert friction_of(machine(), 8_000.0, 8_000.0).value == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("mass", "friction", "alone"), [(1.0, 0.2, True), (0.2, 0.2, False), (1.0, 1.001, False)])
def test_a_wrong_unit_scales_the_mass_as_well(mass, friction, alone):
    assert scales_friction_alone(machine(mass=mass, friction=friction)) is alone


def test_an_error_without_scatter_is_not_compared():
    """The motor's position a copy of the scale's."""
    exact = Estimate(0.0, 0.0, 0.0)
    copied = SimpleNamespace(reversal_error=exact, per_turn=None, linear=exact, wind_up=exact, reversals=[None] * 9)
    assert encoder_changes(Sides((copied,), (copied,), ()), Interval(0.0, 0.0, 0.0), LEVEL).changes == ()


def test_of_two_encoders_on_one_side_alone_nothing_is_compared():
    found = encoder_changes(Sides((), (encoders(1e-6),), ("before: one encoder",)), Interval(0.0, 0.0, 0.0), LEVEL)
    assert found == EncoderChanges((), None, ("before: one encoder",))


def controller(kp):
    values = np.array([np.log(kp), np.log(1e5), 50.0, 1.0, 400.0, 0.0])
    parts = Parts(values, np.diag([1e-5, 1e-5, 0.01, 1e-6, 1.0, 1e-10]), 20.0)
    return SimpleNamespace(parts=parts)


@pytest.mark.parametrize(("after", "verb"), [(45.0, "fell"), (55.0, "rose")])
def test_a_changed_gain_is_one_sentence(after, verb):
    gains = controller_changes(Sides((controller(50.0),), (controller(after),), ()), LEVEL)
    ((_, said),) = gains.sentences
    assert said.startswith(f"K_v {verb} by 10.0")
    assert said.endswith(f"from 50 to {after:g} 1/s")
    (found,) = findings_of(machine(), gains, NO_SCREW)
    assert found == ("controller.kp", said)


def test_gains_that_change_places_are_seen_to_have_changed():
    """K_v and the inverse reset time of which the sum is known, and neither: one has fallen by a tenth."""

    def side(kp):
        values = np.array([np.log(kp), np.log(1e5), 50.0, 1.0, 400.0, 0.0])
        spread = np.zeros((6, 1))
        spread[0], spread[2] = 0.2, -0.2 * 50.0
        covariance = spread @ spread.T + np.diag([1e-6, 1e-6, 1e-3, 1e-6, 1.0, 1e-10])
        return (SimpleNamespace(parts=Parts(values, covariance, 20.0)),)

    same, changed = (controller_changes(Sides(side(50.0), side(kp), ()), LEVEL) for kp in (50.0, 40.0))
    assert same.sentences == ()
    ((code, said),) = changed.sentences
    assert code == "controller"
    assert said.startswith("the controller has changed, in ")
    assert "K_v or the inverse reset time" in said or "the inverse reset time or K_v" in said
