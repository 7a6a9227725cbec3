"""`tuning.compare` on logs of simulated machines: what has changed is named, the rest is not, and what is refused."""

import dataclasses
import json

import numpy as np
import pytest

import experiments
import tuning
from diffdrive.errors import LogError, ParameterError
from experiments.studies.recovery.excitation import concatenate, resting, strokes
from tests.support.identify_command import MOTION, STROKES
from tests.support.sound_log import DRIVE, RATE, SOUND, axis_of, simulate_log

AXIS = axis_of("cascade", kp=50.0, kv=1e5, ki=1e6, velocity_feedforward=1.0)
# the strokes in another order, and as long: the programs are compiled once
OTHER = concatenate([resting(0.05, RATE), *strokes(STROKES[::-1], RATE), resting(0.05, RATE)], "reversed")


def log(axis, seed, motion=MOTION):
    return dataclasses.replace(simulate_log(axis, motion, seed=seed), name=f"log{seed}")


def weaker(axis, factor):
    friction = axis.drive.friction
    level = friction.coulomb_screw.map(lambda one: factor * one - (1.0 - factor) * 15_200.0 * 3.66e-4)
    return dataclasses.replace(
        axis, drive=dataclasses.replace(axis.drive, friction=dataclasses.replace(friction, coulomb_screw=level))
    )


@pytest.fixture(scope="module")
def before():
    return log(AXIS, 1)


@pytest.fixture(scope="module")
def found(before):
    """A machine whose Coulomb friction and K_v have fallen by a tenth, on another motion."""
    changed = weaker(AXIS, 0.9).with_gains(kp=45.0)
    return tuning.compare(AXIS, before, log(changed, 2, OTHER), starts=1)


@pytest.mark.long
def test_changed_friction_and_gain_are_named_and_nothing_else(found):
    assert [one.code for one in found.findings] == ["friction.coulomb_at_no_load", "controller.kp"]
    assert found.status.ok
    assert found.status.code == "changed"
    for side in ("positive", "negative"):
        one = found.change(f"friction.coulomb_at_no_load.{side}").change
        assert one.low < -0.1 < one.high
        assert one.high - one.low < 0.02
    gain = found.change("controller.kp")
    assert gain.change.value == pytest.approx(-0.1, abs=0.01)
    assert found.p_unchanged < 1e-6
    assert any("one encoder, so the backlash" in note for note in found.notes)


@pytest.mark.long
def test_swapped_sides_have_the_opposite_changes(found, before):
    back = tuning.compare(AXIS, log(weaker(AXIS, 0.9).with_gains(kp=45.0), 2, OTHER), before, starts=1)
    assert {one.code for one in back.findings} == {one.code for one in found.findings}
    for one in ("friction.coulomb_at_no_load.positive", "friction.coulomb_at_no_load.negative", "controller.kp"):
        there, here = found.change(one), back.change(one)
        width = here.change.high - here.change.low
        assert np.log1p(here.change.value) == pytest.approx(-np.log1p(there.change.value), abs=0.5 * width)


@pytest.mark.long
def test_an_unchanged_machine_has_no_finding_but_limits(before):
    found = tuning.compare(AXIS, before, log(AXIS, 3, OTHER), starts=1)
    assert found.findings == ()
    assert found.status.code == "unchanged"
    assert found.headline().startswith("no change found (p = ")
    assert 0.0 < found.change("plant.mass").smallest < 0.1
    assert any(note.startswith("nine in ten changes of this size would have been found: ") for note in found.notes)


@pytest.mark.long
def test_the_result_is_written_and_reported(found, tmp_path):
    experiments.report(found, tmp_path)
    written = json.loads((tmp_path / "comparison.json").read_text())
    assert written["schema"] == "comparison/1"
    assert [one["code"] for one in written["findings"]] == [one.code for one in found.findings]
    names = {path.name for path in tmp_path.iterdir()}
    assert {"comparison.json", "changes.csv", "changes.png", "identified.toml", "result.json"} <= names
    assert "the Coulomb friction fell by " in found.summary()
    assert len(repr(found)) < 400
    with pytest.raises(ParameterError, match=r"plant\.weight: is not compared; known: plant\.mass, "):
        found.change("plant.weight")


def test_a_log_on_both_sides_is_refused():
    with pytest.raises(LogError, match="holds the same samples as simulated"):
        tuning.compare(DRIVE, SOUND, dataclasses.replace(SOUND, name="again"))


def test_a_side_without_logs_is_refused():
    with pytest.raises(LogError, match="no log is given"):
        tuning.compare(DRIVE, SOUND, [])
    with pytest.raises(ParameterError, match="after: no log is given"):
        tuning.compare(DRIVE, SOUND, None)


@pytest.mark.parametrize("level", [0.0, 0.6, float("nan")])
def test_a_level_that_is_none_is_refused_before_the_logs_are_read(level):
    with pytest.raises(ParameterError, match="level: must be a share"):
        tuning.compare(DRIVE, ["no such file"], ["nor this"], level=level)


def test_a_log_with_a_fault_is_refused_on_either_side():
    wrong = dataclasses.replace(SOUND, command=-SOUND.command, name="wrong")
    for sides in ((SOUND, wrong), (wrong, SOUND)):
        with pytest.raises(LogError, match=r"wrong: .*reverse.*force=True compares all the same"):
            tuning.compare(DRIVE, *sides)
