"""The public interface: an axis simulated and differentiated, logs from any table, an effect of one's own."""

import dataclasses
import json
import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import polars as pl
import pytest

import diffdrive as dd
from diffdrive.effects.catalogue import EFFECTS, effects_by_part
from diffdrive.errors import DivergenceError, LoadEstimatorWarning, LogError, ParameterError, ResultError
from diffdrive.loop.run import Run
from diffdrive.loop.simulate import simulate_loop
from diffdrive.paper import example_controllers
from diffdrive.results import Status

AXIS = dd.paper_axis()
LAP = dd.motion.triangular(speed=0.010, stroke=0.001, rounding=0.05, duration=0.2, rate=AXIS.rate)
SMOOTH = AXIS.smooth()
KINDS = list(example_controllers(AXIS.drive))


@pytest.mark.parametrize("kind", KINDS)
def test_the_papers_axis_runs_and_is_written_under_every_controller(kind, tmp_path):
    axis = dd.paper_axis(controller=kind)
    run = dd.simulate(axis, LAP, load=1_000.0)
    assert run.status.ok, run
    assert len(repr(run)) < 300
    assert axis.controller.kind == kind
    heavier = axis.replace({"plant.mass": 130.0, "friction.coulomb_screw": (50.0, 80.0)})
    heavier.write(tmp_path / "heavier.toml")  # a file knows no controller that believes in another machine
    read = dd.read_axis(tmp_path / "heavier.toml")
    assert read.value("plant.mass") == 130.0
    assert read.value("friction.coulomb_screw") == (50.0, 80.0)
    assert read.gains == pytest.approx(axis.gains)
    assert read.name == "heavier"


@pytest.mark.long
@pytest.mark.parametrize(
    ("path", "value"),
    [("kp", None), ("kd", None), ("plant.mass", 100.0), ("friction.viscous", 1800.0), ("load", 5_000.0)],
)
def test_gradients_through_the_interface_are_differences(path, value):
    def error(at):
        if path == "load":
            return dd.rollout(SMOOTH, LAP, load=at).rms_error(0.02)
        axis = SMOOTH.replace({path: at}) if "." in path else SMOOTH.with_gains(**{path: at})
        # the machine as it is: what moves is what the controller has of it
        return dd.rollout(axis, LAP, load=3_000.0, machine=SMOOTH).rms_error(0.02)

    at = AXIS.gains[path] if value is None else value
    step = 1e-4 * at
    difference = float((error(at + step) - error(at - step)) / (2.0 * step))
    slope = float(jax.jit(jax.grad(error))(at))
    if path == "friction.viscous":  # PD believes nothing of friction
        assert slope == difference == 0.0
    else:
        assert slope == pytest.approx(difference, rel=1e-4)


def test_an_axis_is_a_pytree_and_loads_are_lanes():
    def error(axis, load):
        return dd.rollout(axis, LAP, load=load).rms_error()

    loads = jnp.array([0.0, 4_000.0, 8_000.0])
    found = jax.jit(jax.vmap(error, (None, 0)))(SMOOTH, loads)
    assert found == pytest.approx([float(error(SMOOTH, one)) for one in loads], rel=1e-9)
    assert len(set(np.asarray(found).tolist())) == 3


def test_a_roll_out_is_the_simulation():
    run = dd.simulate(AXIS, LAP, load=2_000.0)
    same = dd.rollout(AXIS, LAP, load=2_000.0)
    np.testing.assert_array_equal(same.command, run.command)
    for name in ("reference", "load", "measured", "table_position", "velocity", "force", "friction", "error"):
        np.testing.assert_array_equal(getattr(same, name), getattr(run, name), err_msg=name)
    assert run.position is run.measured  # as a log has it
    for window in ((), (0.05,), (0.05, 0.15), (-1.0, 0.0)):
        assert float(same.rms_error(*window)) == pytest.approx(run.rms_error(*window), rel=1e-12)
        assert float(same.peak_error(*window)) == pytest.approx(run.peak_error(*window), rel=1e-12)
    for one in (run, same):
        for window in ((0.3,), (0.1, 0.05), (-2.0, -1.0), (float("nan"),)):
            with pytest.raises(ParameterError, match=r"no sample between .* s: the run lasts 0 to 0\.2 s"):
                one.rms_error(*window)
            with pytest.raises(ParameterError, match="no sample between"):
                one.peak_error(*window)


def test_lanes_of_a_roll_out_are_not_pooled():
    error = jnp.concatenate([jnp.full((3, 1), 7.0), jnp.outer(jnp.array([1.0, 2.0, 3.0]), jnp.ones(199))], axis=1)
    lanes = dd.Rollout(error, *(0.0 * error for _ in range(7)), None, None, AXIS.rate)
    assert lanes.between(0.01, 0.0105) == slice(100, 106)
    np.testing.assert_array_equal(lanes.rms_error(0.001), [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(lanes.peak_error(0.001), [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(lanes.peak_error(), [7.0, 7.0, 7.0])


def test_a_run_and_a_roll_out_count_time_alike():
    late = dataclasses.replace(LAP, time=LAP.time + 2.0)
    one = dd.Rollout(*(LAP.position for _ in range(8)), None, None, AXIS.rate, 2.0)
    other = Run(*(LAP.position for _ in range(8)), None, None, late.time, LAP.velocity)
    assert one.between(2.05, 2.1) == other.between(2.05, 2.1) == slice(500, 1001)
    assert one.position is one.measured


BARE_PD = AXIS.with_controller(dd.controllers.PD(dd.controllers.Tracking(AXIS.controller.tracking.gains)))
AXES = {kind: dd.paper_axis(controller=kind) for kind in KINDS} | {"pd without feed-forward": BARE_PD}


@pytest.mark.parametrize("axis", AXES.values(), ids=AXES)
def test_another_machine_is_believed_in_alike_within_a_compiled_function(axis):
    def error(axis):
        return dd.rollout(axis.replace({"plant.mass": 130.0}).smooth(), LAP).rms_error()

    assert float(jax.jit(error)(axis)) == pytest.approx(float(error(axis)), rel=1e-9)


def test_a_machine_of_its_own_moves_under_what_the_axis_believes():
    machine = AXIS.replace({"plant.mass": 150.0})
    run = dd.simulate(AXIS, LAP, machine=machine)
    ours = simulate_loop(machine.drive, AXIS.controller, LAP, sampling=AXIS.sampling, limits=AXIS.limits)
    np.testing.assert_array_equal(run.position, ours.position)


def test_what_cannot_be_is_refused_by_name():
    with pytest.raises(ParameterError, match=r"no such parameter; did you mean 'plant\.mass'"):
        AXIS.replace({"plant.mas": 1.0})
    with pytest.raises(ParameterError, match=r"plant.mass: must be a number in kg"):
        AXIS.replace({"plant.mass": "100 kg"})
    for value in (None, True, "130", [130.0], np.array(["130"])):
        with pytest.raises(ParameterError, match=r"plant.mass: must be a number in kg, got"):
            AXIS.replace({"plant.mass": value})
        with pytest.raises(ParameterError, match=r"kp: must be a number in N/m, got"):
            AXIS.with_gains(kp=value)
    with pytest.raises(ParameterError, match=r"friction.viscous \(negative direction\): must be a number"):
        AXIS.replace({"friction.viscous": (5.0, None)})
    with pytest.raises(ParameterError, match="no such gain; did you mean 'kp'"):
        AXIS.with_gains(kpp=1.0)
    with pytest.raises(ParameterError, match="no kind 'pid'; known: pd, "):
        dd.paper_axis(controller="pid")
    slow = dd.motion.sine(amplitude=1e-3, frequency=10.0, duration=0.2, rate=5_000.0)
    with pytest.raises(ParameterError, match="make the rates equal"):
        dd.rollout(AXIS, slow)
    unstable = AXIS.with_gains(kp=1e12)
    assert dd.simulate(unstable, LAP).status.code == "diverged"
    with pytest.raises(DivergenceError, match="diverged"):
        dd.simulate(unstable, LAP, throw=True)


def test_an_axis_says_what_its_mass_is_whatever_it_is():
    assert repr(AXIS) == "Axis(100 kg, pd, 10000 Hz)"
    assert repr(AXIS.replace({"plant.mass": np.ones(3)})) == "Axis(mass of shape (3,), pd, 10000 Hz)"
    assert (
        "of shape (3,)" in AXIS.replace({"friction.viscous": np.ones(3)[:, None]}).with_gains(kp=np.ones(3)).summary()
    )
    absent = eqx.tree_at(lambda axis: axis.drive.plant.mass, AXIS, None)
    assert repr(absent) == "Axis(mass absent, pd, 10000 Hz)"
    jax.eval_shape(lambda axis: (repr(axis), axis.drive)[1], AXIS)
    limited = AXIS.replace({"actuator.force_limit": 100.0})
    assert limited.replace({"actuator.force_limit": None}).value("actuator.force_limit") is None


def test_a_result_is_saved_with_its_schema(tmp_path):
    path = dd.simulate(AXIS, LAP).save(tmp_path)
    assert path.name == "run.json"
    assert '"schema": "run/1"' in path.read_text()
    diverged = dd.simulate(AXIS.with_gains(kp=1e12), LAP)
    written = json.loads(diverged.save(tmp_path).read_text())
    assert written["status"] == dataclasses.asdict(diverged.status)
    assert written["status"]["signal"] == "tracking error"


def test_a_note_of_a_run_is_a_warning_at_the_callers_line_and_is_saved(monkeypatch, tmp_path):
    zeros = np.zeros(3)
    noted = Run(*(zeros for _ in range(8)), None, None, zeros, zeros, notes=("the load estimate drifts",))
    monkeypatch.setattr("diffdrive.simulation.simulate_loop", lambda *_, **__: noted)
    with pytest.warns(LoadEstimatorWarning, match="drifts") as caught:
        run = dd.simulate(AXIS, LAP)
    assert caught[0].filename == __file__
    assert json.loads(run.save(tmp_path).read_text())["notes"] == ["the load estimate drifts"]
    assert str(run).endswith("- the load estimate drifts")


def test_the_error_in_the_place_of_a_result_holds_it():
    zeros = np.zeros(3)
    run = Run(*(zeros for _ in range(8)), None, None, zeros, zeros, status=Status(False, "too weak", code="saturated"))
    with pytest.raises(ResultError, match="too weak") as caught:
        run.require_ok()
    assert caught.value.result is run
    assert str(pickle.loads(pickle.dumps(ResultError("too weak", 3)))) == "too weak"


LOG = dd.simulate(AXIS, LAP).log("lap")
TABLE = {
    "t [ms]": 1e3 * LOG.time,
    "SetPos": 1e3 * LOG.reference,
    "ActPos": 1e3 * LOG.position,
    "Torque %": LOG.command / 16.0,
}
COLUMNS = {"time": "t [ms]", "reference": "SetPos", "position": "ActPos", "command": "Torque %"}
UNITS = {"reference": "mm", "position": "mm", "command": "16 N"}


@pytest.mark.parametrize("made", [dict, pd.DataFrame, pl.DataFrame, "csv", "index"])
def test_any_table_reads_like_a_file(made, tmp_path):
    if made == "csv":
        source = tmp_path / "lap.csv"
        pd.DataFrame(TABLE).to_csv(source, index=False)
    elif made == "index":
        source = pd.DataFrame(TABLE).set_index("t [ms]")
    else:
        source = made(TABLE)
    log = dd.read_log(source, AXIS, columns=COLUMNS, units=UNITS, name="lap")
    for channel in ("time", "reference", "position", "command"):
        np.testing.assert_allclose(getattr(log, channel), getattr(LOG, channel), rtol=1e-12, atol=1e-15)
    assert repr(log).startswith("Log 'lap': 2001 samples at 10000 Hz, 0 to ")


def test_several_tables_read_like_one():
    late = TABLE | {"Torque %": np.append(TABLE["Torque %"][1:], 0.0)}
    mapped = {"columns": COLUMNS, "units": UNITS}
    logs = dd.read_logs([TABLE, late], AXIS, **mapped, shifts={"late:command": 1}, names=["lap", "late"])
    assert [log.name for log in logs] == ["lap", "late"]
    np.testing.assert_allclose(logs[0].command, LOG.command, rtol=1e-12)
    np.testing.assert_array_equal(logs[1].command, logs[0].command[1:])
    assert [log.name for log in dd.read_logs([TABLE, late], AXIS, **mapped)] == ["log1", "log2"]
    with pytest.raises(LogError, match="2 logs and 1 names; give one for each"):
        dd.read_logs([TABLE, late], AXIS, **mapped, names=["lap"])


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ({"position": [[1.0, 2.0]], "command": [1.0]}, "column 'position' has 2 dimensions"),
        ({"position": [1j, 2j], "command": [1.0, 2.0]}, "column 'position' holds complex128"),
        ({}, "lap: has no samples"),
        (17, "a log is a path, a data frame or a dict of arrays by column, got int"),
        (pd.DataFrame([[1.0, 2.0]], columns=["a", "a"]), "several columns have one name"),
    ],
)
def test_what_is_no_table_is_refused(source, says):
    with pytest.raises(LogError, match=says):
        dd.read_log(source, AXIS, name="lap")


@pytest.fixture
def weakening():
    """A registered effect, gone again afterwards."""

    @dd.effects.register
    class Weakening(dd.effects.TableForce):
        """F = force (1 - position / length)."""

        name = "weakening"
        force: float = dd.effects.amplitude("N", "force at position zero", usual=20.0)
        length: float = dd.effects.positive("m", "travel after which it is spent", usual=0.3)

        def push(self, seen):
            return self.force * (1.0 - seen.position / self.length)

    yield Weakening
    EFFECTS.remove("weakening")
    assert effects_by_part()["plant"][-1] is dd.effects.PositionSpring


def test_an_effect_of_ones_own_is_simulated_written_and_read(weakening, tmp_path):
    machine = AXIS.with_effects(weakening(force=25.0, length=1e6))
    constant = AXIS.with_effects(dd.effects.ConstantForce(force=25.0))
    np.testing.assert_allclose(
        dd.simulate(AXIS, LAP, machine=machine).command, dd.simulate(AXIS, LAP, machine=constant).command, atol=1e-3
    )
    machine.write(tmp_path / "machine.toml")
    (read,) = dd.read_axis(tmp_path / "machine.toml").drive.effects
    assert (read.name, read.force, read.length) == ("weakening", 25.0, 1e6)
    neutral = AXIS.with_effects(weakening())
    np.testing.assert_array_equal(dd.simulate(neutral, LAP).position, dd.simulate(AXIS, LAP).position)


def test_an_effect_of_ones_own_is_replaced_by_what_has_its_name(weakening):
    class Stronger(weakening):
        part = "environment"

    dd.effects.register(Stronger)
    assert EFFECTS["weakening"] is Stronger
    assert list(EFFECTS)[-1] == "weakening"
    assert effects_by_part()["environment"][-1] is Stronger
    assert weakening not in effects_by_part()["plant"]


def test_an_effect_that_is_not_whole_is_refused():
    class Nameless(dd.effects.TableForce):
        def push(self, seen):
            return 0.0

    class Bare(Nameless):
        name = "bare"
        force: float = 1.0

    class Cogging(Nameless):
        name = "cogging"

    class Spaced(Nameless):
        name = "two words"

    class Elsewhere(Nameless):
        name, part = "elsewhere", "moon"

    for effect, says in (
        (Nameless, "name: must be a word"), (Bare, "declare force with its unit"),
        (Cogging, "effect 'cogging': there is one of this name"),
        (Spaced, "its name must be a word"), (Elsewhere, "no part 'moon' of a machine"),
    ):  # fmt: skip
        with pytest.raises(ParameterError, match=says):
            dd.effects.register(effect)


def test_an_effect_that_nobody_registered_is_refused():
    class Mine(dd.effects.TableForce):
        name = "mine"

        def push(self, seen):
            return 0.0

    class Unnamed(Mine):
        name = None

    for effect in (Mine(), Unnamed()):
        with pytest.raises(ParameterError, match=r"register its class, by @diffdrive\.effects\.register"):
            AXIS.with_effects(effect)
    with pytest.raises(ParameterError, match=r"must be effects, such as ConstantForce\(force=5\.0\)"):
        AXIS.with_effects(dd.effects.ConstantForce)


def test_a_controller_of_ones_own_is_written_read_and_simulated(tmp_path):
    class Damper(dd.controllers.Controller):
        """u = -c v, of a velocity by backward difference."""

        damping: float = dd.controllers.quantity("N*s/m", "damping", at_least=0.0)

        @property
        def kind(self):
            return "damper"

        def table(self):
            return {"damping": float(self.damping)}

        def init(self, position):
            return position

        def step(self, state, reference, position, applied, period):
            return position, dd.controllers.Command(-self.damping * (position - state) / period)

    kind = dd.controllers.Kind(
        "damper", "damping alone", lambda section, drive: section.build(Damper),
        (dd.controllers.Keys("controller", Damper),),
    )  # fmt: skip
    dd.controllers.register(kind)
    dd.controllers.register(kind)  # as a cell of a notebook that runs again
    with pytest.raises(ParameterError, match="controller kind 'pd': there is one of this name"):
        dd.controllers.register(dataclasses.replace(kind, name="pd"))
    try:
        AXIS.with_controller(Damper(100.0)).write(tmp_path / "damped.toml")
        read = dd.read_axis(tmp_path / "damped.toml")
        assert read.controller == Damper(100.0)
        assert np.max(np.abs(dd.rollout(read, LAP).table_position)) < 1e-9  # nobody asks it to move
    finally:
        dd.controllers.KINDS.remove("damper")
