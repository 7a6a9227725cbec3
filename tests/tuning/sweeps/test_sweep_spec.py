"""A sweep as text is the same sweep: what its folder keeps, what workers get, what `replay` begins from."""

import dataclasses

import numpy as np
import pyarrow as pa
import pytest

import diffdrive as dd
import tuning
from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.model.parameters import Sampling
from tuning.sweeps.identity import identity
from tuning.sweeps.spec import FILE, SweepSpec, from_text, read_spec, to_text, write_spec
from tuning.sweeps.workflow import run_sweep

AXIS = dd.paper_axis("pd+fc+le")
SINE = "sine:amplitude=1mm,frequency=10Hz,duration=0.1s"
VARY = {"plant.mass": "lognormal:3%", "load": "uniform:0..10 kN"}
# a controller that believes in another machine than its axis: a file cannot say so
BESIDE_ITSELF = dataclasses.replace(AXIS, drive=AXIS.replace({"plant.mass": 90.0}).drive, name="beside itself")


def of_one_s_own():
    """A motion in memory, whose feed-forward follows from nothing else, on a clock that does not begin at zero."""
    rng = np.random.default_rng(1)
    position, velocity, acceleration = 1e-3 * rng.standard_normal((3, 400))
    return dd.motion.Motion(0.3 + np.arange(400) / AXIS.rate, position, velocity, acceleration, "lap")


def spec(motions=(SINE,), axis=AXIS, **more):
    return SweepSpec.of(axis, motions, VARY, 16, **more)


@pytest.mark.parametrize(
    "given",
    [
        spec(),
        spec((SINE, SINE.replace("1mm", "2mm"), of_one_s_own())),
        spec(axis=AXIS.replace({"plant.mass": 101, "friction.viscous": (1800, 1700.1)}).with_gains(kp=1234567)),
        spec(machine=AXIS.with_effects(dd.effects.Cogging(cosine=3.0)), against={"other": dd.paper_axis("pd")}),
        spec(load="step:at=0.05s,to=3kN", settle=0.01, correlation={"plant.mass": {"load": 0.3}}, precision="single"),
    ],
)
def test_a_sweep_read_back_is_told_from_no_other(given):
    again = from_text(to_text(given))
    assert identity(again.plan()) == identity(given.plan())
    assert list(again.plan().controllers) == list(given.plan().controllers)
    assert [one.given for one in again.motions] == [one.given for one in given.motions]
    assert [one.recipe is None for one in again.motions] == [one.recipe is None for one in given.motions]


def test_machines_vary_about_a_machine_that_no_file_holds_under_its_controller():
    given = spec(machine=BESIDE_ITSELF)
    plan = from_text(to_text(given)).plan()
    assert identity(plan) == identity(given.plan())
    assert float(plan.axis.drive.plant.mass) == 90.0


def test_a_motion_from_a_file_is_kept_as_numbers(tmp_path):
    path = tmp_path / "lap.csv"
    path.write_text("time,position\n" + "".join(f"{k / AXIS.rate!r},{1e-6 * k * k!r}\n" for k in range(40)))
    given = spec((str(path),))
    text = to_text(given)
    path.unlink()
    assert identity(from_text(text).plan()) == identity(given.plan())
    assert from_text(text).motions[0].given == str(path)


def test_what_no_file_can_hold_is_said_where_text_is_needed_and_nowhere_else(tmp_path):
    unwritable = spec(axis=BESIDE_ITSELF)
    unwritable.plan()
    write_spec(unwritable, tmp_path)
    with pytest.raises(ParameterError, match=r"spec\.json: this sweep cannot be repeated: .*need drive files.*beside"):
        read_spec(tmp_path)
    for more in ({"workers": 2}, {"cluster": "tcp://127.0.0.1:9"}):
        with pytest.raises(
            ParameterError, match="workers, a cluster and `replay` need drive files of all axes: beside"
        ):
            tuning.sweep(BESIDE_ITSELF, SINE, settle=0.0, **more)


@pytest.mark.parametrize("text", ["{", "[]", "3", "{}", '{"axis": 3}'])
def test_a_damaged_file_is_said(tmp_path, text):
    (tmp_path / FILE).write_text(text)
    with pytest.raises(ParameterError, match=r"spec\.json: is damaged"):
        read_spec(tmp_path)
    with pytest.raises(ParameterError, match="holds no sweep"):
        read_spec(tmp_path / "absent")


def at_rest(plan, wanted, notify):
    """An engine whose machines all stand still."""
    for part in wanted:
        rows = [
            {"machine": int(number), "controller": controller, "motion": motion, "rms_m": 0.0, "peak_m": 0.0,
             "diverged": False, "diverged_at_s": None, **dict.fromkeys(plan.units, 0.0)}
            for motion in plan.motions for controller in plan.controllers for number in plan.numbers(part)
        ]  # fmt: skip
        yield part, pa.Table.from_pylist(rows)


@pytest.mark.long
def test_a_sweep_says_that_an_estimator_diverges_before_it_runs_and_afterwards(tmp_path):
    began = []

    def started(plan, notes):
        began.append((list(plan.motions), notes, list(tmp_path.iterdir())))

    lap = dd.motion.triangular(speed=0.05, stroke=0.0025, rounding=0.02, duration=0.2, rate=AXIS.rate)
    found = run_sweep(
        spec((lap,)), tmp_path, at_rest, tolerance=None, by="peak", started=started, notify=print, done=lambda _: None
    )
    [(motions, notes, there)] = began
    assert (motions, there) == ([lap.name], [])
    assert found.notes == notes
    assert "does not converge" in notes[0]
    assert notes[0].startswith(f"{lap.name}, paper: ")
    assert notes[0] in found.summary()
    assert found.as_dict()["notes"] == list(notes)
    assert identity(read_spec(tmp_path).plan()) == identity(found.plan)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"by": "peak_m"}, "by: no error 'peak_m'; known: rms, peak"),
        ({"tolerance": -1.0}, "tolerance: must be above zero"),
        ({"out": "swept"}, "resume, out: give one"),
        ({"method": "grid"}, "method: no method 'grid'; known: sobol"),
        ({"precision": "half"}, "precision: no precision 'half'; known: double, single"),
        ({"settle": 0.1}, r"settle: 0\.1 s leaves nothing of sine"),
        ({"load": "stepp:to=3"}, "load: no shape 'stepp'"),
        ({"samples": 2**31}, r"samples: 2\.15e\+09, and sobol has 1073741824 machines at most"),
        ({"workers": 0}, "workers: at least one is needed"),
        ({"cluster": "foo"}, "cluster foo: write tcp"),
        ({"spread": "abc"}, "spread abc: give a share"),
        ({"against": {"paper": AXIS}}, "against: 'paper' is the axis itself"),
        ({"machine": dataclasses.replace(AXIS, sampling=Sampling(4e3))}, "machine: is sampled at 4000 Hz, the axis"),
        ({"vary": {"motion.stroke": "uniform:1..2 mm"}}, "no setting that every motion has"),
    ],
)
def test_what_cannot_be_is_refused_in_words_of_the_argument(more, says, tmp_path):
    with pytest.raises(DiffdriveError, match=says) as told:
        tuning.sweep(AXIS, SINE, **({"settle": 0.01, "resume": tmp_path} | more))
    assert "--" not in str(told.value)
    assert not list(tmp_path.iterdir())
