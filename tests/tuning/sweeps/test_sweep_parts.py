"""A sweep in parts: the same rows however it was run, and whatever was done stays done."""

import dataclasses

import numpy as np
import pyarrow.compute as pc
import pytest

from diffdrive import motion
from diffdrive.axis import Axis
from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.parameters import Drive, Sampling, Sensor
from diffdrive.model.presets import paper_drive
from diffdrive.motion.motion import Limits
from diffdrive.runtime import arithmetic_signature
from diffdrive.support.atomic_write import temporary_beside
from experiments.studies.paper import scenario as paper
from tuning.sweeps.identity import identity
from tuning.sweeps.notes import extreme_cycles
from tuning.sweeps.parts import in_process, missing_parts, part_path, run_parts
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.possible import require_machines, require_possible

PAPER = paper_drive()
DRIVE = Drive(PAPER.plant, PAPER.friction, PAPER.actuator, Sensor(1e-7, 2e-8))
CONTROLLERS = {name: paper.controllers(DRIVE)[name] for name in ("PD", "PD+FC+LE")}
AXIS = Axis(DRIVE, CONTROLLERS["PD"], Sampling(1e4, 1), Limits())
MOTIONS = {"sine": motion.sine(amplitude=1e-3, frequency=20.0, duration=0.05, rate=1e4)}
VARY = ("plant.mass=lognormal:3%", "load=uniform:0..12 kN")


def plan(samples=20, vary=VARY, **more):
    return SweepPlan.of(AXIS, CONTROLLERS, MOTIONS, vary, samples, **({"seed": 5, "most_in_a_part": 8} | more))


def rows(found):
    return found.to_table().sort_by([("machine", "ascending"), ("controller", "ascending")])


@pytest.mark.long
def test_a_sweep_has_a_row_for_each_machine_and_controller_on_the_same_machines(tmp_path):
    done = []
    found = rows(run_parts(plan(), tmp_path, done.append))
    assert done == [0, 8, 16, 20]
    assert found.num_rows == 40
    table = {name: np.array(found[name].to_pylist(), object) for name in found.column_names}
    pd, le = (table["controller"] == name for name in CONTROLLERS)
    for name in ("machine", "plant.mass", "load"):
        assert np.array_equal(table[name][pd], table[name][le])
    assert sorted(table["machine"][pd]) == list(range(20))
    assert len(set(table["plant.mass"][pd])) == 20
    assert not any(table["diverged"])
    assert all(one is None for one in table["load_error_N"][pd])
    assert all(one > 0.0 for one in table["load_error_N"][le])
    assert np.mean(table["rms_m"][le]) < np.mean(table["rms_m"][pd])


def test_an_interrupted_sweep_goes_on_and_ends_with_the_same_bits(tmp_path):
    def dying(plan, wanted, say):
        yield from in_process(plan, wanted[:1], say)
        raise KeyboardInterrupt

    whole = rows(run_parts(plan(), tmp_path / "whole", lambda done: None))
    with pytest.raises(KeyboardInterrupt):
        run_parts(plan(), tmp_path / "cut", lambda done: None, dying)
    temporary_beside(part_path(tmp_path / "cut", 1)).write_bytes(b"cut off in the middle of writing")
    asked = []

    def counting(plan, wanted, say):
        asked.extend(wanted)
        yield from reversed(list(in_process(plan, wanted, say)))  # in any order

    assert rows(run_parts(plan(), tmp_path / "cut", lambda done: None, counting)).equals(whole)
    assert asked == [1, 2]


def test_a_part_that_cannot_be_written_lets_its_workers_go(tmp_path):
    left = []

    def engine(plan, wanted, say):
        try:
            yield from in_process(plan, wanted, say)
        finally:
            left.append(plan)

    (tmp_path / "file").write_text("")
    with pytest.raises(NotADirectoryError) as caught:
        run_parts(plan(), tmp_path / "file" / "parts", lambda done: None, engine)
    assert left  # at once, while what was raised still holds on to the engine
    del caught


def test_the_parts_of_another_sweep_are_not_overwritten(tmp_path, monkeypatch):
    run_parts(plan(8), tmp_path, lambda done: None)
    before = part_path(tmp_path, 0).read_bytes()
    others = [plan(8, seed=6), plan(8, vary=VARY[:1]), plan(8, settle=0.01), plan(8, method="random")]
    wider = dataclasses.replace(AXIS, limits=Limits(stroke=(-0.1, 0.1)))  # which says what has diverged
    others.append(dataclasses.replace(plan(8), axis=wider))
    for other in others:
        with pytest.raises(ParameterError, match="is of another sweep"):
            run_parts(other, tmp_path, lambda done: None)
    monkeypatch.setattr("tuning.sweeps.identity.code_digest", lambda *_: "another edition")
    with pytest.raises(ParameterError, match="is of another sweep"):
        run_parts(plan(8), tmp_path, lambda done: None)
    assert part_path(tmp_path, 0).read_bytes() == before


def test_all_that_a_sweep_follows_from_tells_it_apart():
    """Of a motion each signal: the feed-forward takes velocity and acceleration as they are."""

    def moved(**signals):
        return dataclasses.replace(plan(), motions={"sine": dataclasses.replace(MOTIONS["sine"], **signals)})

    sine = MOTIONS["sine"]
    others = [
        plan(),
        moved(position=2.0 * sine.position),
        moved(velocity=np.zeros_like(sine.velocity)),
        moved(acceleration=np.zeros_like(sine.acceleration)),
        moved(time=sine.time + 1.0),
        plan(load="1"),
        plan(settle=0.01),
        plan(precision="single"),
        plan(correlation={"plant.mass": {"load": 0.5}}),
        dataclasses.replace(plan(), axis=dataclasses.replace(AXIS, sampling=Sampling(1e4, 2))),
        dataclasses.replace(plan(), axis=dataclasses.replace(AXIS, limits=Limits(speed=3.0))),
        dataclasses.replace(plan(), axis=AXIS.replace({"plant.mass": 90.0})),
        dataclasses.replace(plan(), controllers={"PD": CONTROLLERS["PD"]}),
        dataclasses.replace(plan(), controllers=CONTROLLERS | {"PD": AXIS.with_gains(kp=1.0).controller}),
    ]
    assert len({identity(other) for other in others}) == len(others)
    whole = dataclasses.replace(plan(), axis=dataclasses.replace(AXIS, sampling=Sampling(10_000, 1)))
    assert identity(whole) == identity(plan())  # the same numbers


def test_a_sweep_with_more_machines_begins_with_the_same_ones(tmp_path):
    few, many = (rows(run_parts(plan(n, method="sobol"), tmp_path / str(n), lambda done: None)) for n in (8, 16))
    assert few.num_rows == 16
    assert few.select(["machine", "plant.mass", "rms_m"]).equals(
        many.slice(0, 16).select(["machine", "plant.mass", "rms_m"])
    )


@pytest.mark.parametrize(
    ("vary", "more", "says"),
    [
        (("plant.mass=normal:2%", "plant.mass=normal:3%"), {}, "given more than once"),
        (("friction.viscous=normal:2%", "friction.viscous.positive=normal:3%"), {}, "stands for both directions"),
        (VARY, {"samples": 0}, "at least one machine"),
        (VARY, {"settle": 1.0}, "leaves nothing of sine"),
        (VARY, {"settle": -0.1}, "leaves nothing of sine"),
    ],
)
def test_a_sweep_that_cannot_be_is_refused_before_it_starts(vary, more, says):
    with pytest.raises(DiffdriveError, match=says):
        plan(vary=vary, **more)


@pytest.mark.parametrize("vary", ["load=uniform:0..12 kN", "load.change=uniform:0..12 kN"])
def test_what_a_motion_is_judged_by_is_the_most_load_that_varies(vary):
    planned = plan(vary=(vary,))
    [(_, loads)] = extreme_cycles(planned, "sine")
    assert (loads.min(), loads.max()) == (0.0, 12e3)


def test_where_numpy_has_no_vectors_of_its_own_there_are_none_to_name(monkeypatch):
    named = arithmetic_signature()
    monkeypatch.setattr("diffdrive.runtime.np.show_config", lambda mode: {})
    assert set(arithmetic_signature()) < set(named)


def test_a_motion_of_another_rate_is_refused():
    slow = {"sine": motion.sine(amplitude=1e-3, frequency=2.0, duration=0.5, rate=1e3)}
    with pytest.raises(ParameterError, match="sine: is sampled at 1000 Hz, the axis at 10000 Hz"):
        SweepPlan.of(AXIS, CONTROLLERS, slow, VARY, 8)


GAP = ("friction.coulomb_screw=uniform:20..60", "friction.breakaway_gap=uniform:-400..0", "load=uniform:0..1 kN")


@pytest.mark.parametrize(
    ("vary", "says"),
    [
        (("plant.mass=uniform:-40..90 kg",), r"plant\.mass must be above 0 kg, got -\d"),
        (("load=uniform:-20..0 kN",), "lifts the table off its guides"),
        (
            ("load=uniform:-10..0 kN", "load.change=uniform:-10..0 kN", "load.change.end=fixed:0.04 s"),
            "lifts the table off its guides",
        ),
        (GAP, "the breakaway friction in the"),  # each of them alone is possible
    ],
)
def test_a_machine_that_cannot_be_is_named_before_the_first_one_runs(tmp_path, vary, says):
    asked = plan(vary=vary)
    with pytest.raises(ParameterError, match=rf"machine \d+ cannot be: .*{says}") as told:
        run_parts(asked, tmp_path, lambda done: None)
    assert not list(tmp_path.iterdir())
    number = int(str(told.value).split("machine ")[1].split()[0])
    with pytest.raises(ParameterError, match="cannot be"):
        require_possible(asked, [number // 8])
    if number % 8:
        require_machines(asked, np.arange(number // 8 * 8, number))  # those before it can be


def test_a_damaged_part_is_run_again_and_a_stranger_among_the_parts_is_refused(tmp_path):
    whole = rows(run_parts(plan(), tmp_path, lambda done: None))
    part_path(tmp_path, 1).write_bytes(b"cut off")
    assert missing_parts(plan(), tmp_path) == [1]
    assert rows(run_parts(plan(), tmp_path, lambda done: None)).equals(whole)
    part_path(tmp_path, 7).write_bytes(part_path(tmp_path, 2).read_bytes())
    with pytest.raises(ParameterError, match=r"part-000007\.parquet: is of another sweep"):
        missing_parts(plan(), tmp_path)


@pytest.mark.long
def test_a_machine_in_a_sweep_is_the_machine_in_a_single_simulation(tmp_path):
    quiet = Drive(PAPER.plant, PAPER.friction, PAPER.actuator, Sensor(None, 0.0))
    axis = Axis(quiet, CONTROLLERS["PD"], Sampling(1e4, 4), Limits())
    asked = SweepPlan.of(
        axis, CONTROLLERS, MOTIONS, ("load=uniform:0..10 kN", "load.change=fixed:1 kN"), 5, settle=0.01
    )
    found = rows(run_parts(asked, tmp_path, lambda done: None)).to_pylist()
    there = MOTIONS["sine"]
    for row in found:
        load = row["load"] + 1e3 * np.clip(there.time, 0.0, 1.0)
        one = simulate_loop(quiet, CONTROLLERS[row["controller"]], there, load, sampling=axis.sampling)
        assert row["rms_m"] == pytest.approx(one.rms_error(0.01), rel=1e-7)
        assert row["peak_m"] == pytest.approx(one.peak_error(0.01), rel=1e-7)


@pytest.mark.long
def test_spread_scatters_the_results_around_the_nominal_machine(tmp_path):
    vary = ("plant.mass=lognormal:5%", "friction.coulomb_screw=lognormal:5%", "friction.viscous=lognormal:5%")
    found = rows(run_parts(plan(128, vary=vary), tmp_path, lambda done: None))
    pd = found.filter(pc.field("controller") == "PD")["rms_m"].to_numpy()
    nominal = simulate_loop(DRIVE, CONTROLLERS["PD"], MOTIONS["sine"], sampling=AXIS.sampling).rms_error()
    assert np.median(pd) == pytest.approx(nominal, rel=0.03)
    assert 0.005 < np.std(pd) / nominal < 0.1
