"""The recipes of CONTRIBUTING.md, run as they stand there: a package of one's own, and all that knows what is in it."""

import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from typer.testing import CliRunner

import diffdrive as dd
import experiments
import tuning
from diffdrive.controllers import PD, PDGains, Tracking
from diffdrive.controllers.catalogue import KINDS
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.errors import LogError
from diffdrive.logs.checks import examine
from diffdrive.logs.formats.registry import READERS
from diffdrive.loop.linearise import OperatingPoint, open_loop, response
from diffdrive.loop.run import Run
from diffdrive.numerics.arrays import as_arrays
from experiments.cli.main import app
from experiments.reports.page.sections import SECTIONS
from tests.support.perturbed_machine import catalogue, fitter_of
from tests.support.sound_log import DRIVE, SOUND
from tuning.diagnosis.hypotheses.calibration import TOLERANCE
from tuning.diagnosis.selection.first_fits import fit_from
from tuning.diagnosis.selection.screening import screen
from tuning.diagnosis.selection.search import recalibrated
from tuning.gains.objective import AGGREGATIONS, Objective
from tuning.gains.scenarios import EnsembleSignals

ROOT = Path(__file__).resolve().parents[1]
MODULES = {
    "An effect": "effect",
    "A controller": "controller",
    "A format of logs": "trace",
    "A check of logs": "warm",
    "An objective of tuning": "objective",
    "A figure of a report": "figure",
    "A section of the page": "guides",
}
PROGRAM = "import {}\nfrom experiments.cli.main import main\n\nmain()\n"
AXIS = dd.paper_axis()
LAP = dd.motion.triangular(speed=0.010, stroke=0.001, rounding=0.05, duration=0.2, rate=AXIS.rate)
SINE = "sine:amplitude=1mm,frequency=5,duration=0.2"


def recipes():
    """The code below each heading of the guide: what is indented."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    sections = dict(part.split("\n", 1) for part in text.split("\n## ")[1:])
    blocks = {title: re.findall(r"(?:^ {4}.*\n(?:\n+(?= {4}))?)+", sections[title], re.M) for title in MODULES}
    return {MODULES[title]: re.sub("^ {4}", "", block, flags=re.M) for title, (block,) in blocks.items()}


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A folder with a package of the recipes, and a program of one's own that has the command line know them."""
    folder = tmp_path_factory.mktemp("own")
    shop = folder / "shop"
    shop.mkdir()
    (shop / "__init__.py").write_text("")
    for name, code in recipes().items():
        (shop / f"{name}.py").write_text(code, encoding="utf-8")
    (shop / "__main__.py").write_text(PROGRAM.format(", ".join(f"shop.{name}" for name in MODULES.values())))
    return folder


@pytest.fixture(scope="module")
def shop(package):
    """Its modules, imported; what they register is gone again afterwards."""
    section = experiments.section.dispatch(Run)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(package)
        yield SimpleNamespace(**{name: importlib.import_module(f"shop.{name}") for name in MODULES.values()})
        for name in ("shop", *(f"shop.{name}" for name in MODULES.values())):
            patch.delitem(sys.modules, name)
        patch.undo()
    for registry, name in (
        (EFFECTS, "counterbalance"), (KINDS, "damped"), (READERS, ".trc"), (AGGREGATIONS, "sum of squares"),
        (examine._REGISTERED, "shop.warm.warm"), (SECTIONS, "load_on_the_guides"),
    ):  # fmt: skip
        registry.remove(name)
    experiments.section.register(Run, section)


def told(*arguments):
    """What a command prints in a program that has imported the package."""
    return CliRunner().invoke(app, [str(one) for one in arguments], catch_exceptions=False).output


@pytest.mark.long
def test_a_program_of_ones_own_has_the_command_line_know_what_it_imports(package):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (package, ROOT)))}
    call = [sys.executable, "-m", "shop", "keys"]
    done = subprocess.run(call, env=environment, capture_output=True, text=True, check=True)
    assert "| [effects.counterbalance] |  | force | N |  | 0 | force at position zero |" in done.stdout
    assert "| [controller] | damped | kp | N/m | >= 0 | required | stiffness |" in done.stdout
    assert re.search(r"\| kind \|.*, unknown, damped \|", done.stdout)


def test_an_effect_is_simulated_swept_and_differentiated(shop):
    def error(force):
        machine = AXIS.smooth().with_effects(shop.effect.Counterbalance(force, 0.2))
        return dd.rollout(AXIS.smooth(), LAP, machine=machine).rms_error(0.02)

    slope, difference = float(jax.grad(error)(25.0)), float(error(25.01) - error(24.99)) / 0.02
    assert slope == pytest.approx(difference, rel=1e-4)
    assert slope != 0.0
    found = tuning.sweep(AXIS, LAP, vary={"effects.counterbalance.force": "uniform:-60..60 N"}, samples=8, settle=0.0)
    assert len(set(found.frame.to_pandas().peak_m)) == 8


def test_an_effect_is_in_axis_files(shop, tmp_path):
    axis = AXIS.with_effects(shop.effect.Counterbalance(25.0, 0.2))
    axis.write(tmp_path / "axis.toml")
    assert dd.read_axis(tmp_path / "axis.toml").drive.effects == axis.drive.effects
    assert "[effects.counterbalance]" in (tmp_path / "axis.toml").read_text()
    assert "peak error" in told("simulate", tmp_path / "axis.toml", "--motion", SINE)


@pytest.mark.long
def test_an_effect_is_found_by_the_diagnosis_among_all_others(shop):
    fitter = fitter_of(shop.effect.Counterbalance(40.0, 0.06))
    base = recalibrated(fitter, TOLERANCE)
    (candidate,) = (one for one in catalogue(fitter, base) if one.name == "counterbalance")
    fit = fit_from(fitter, base, screen(base, candidate))
    values = fit.model.values(fit.theta)[0]
    assert values["force"][0] == pytest.approx(40.0, rel=0.03)
    assert values["length"][0] == pytest.approx(0.06, rel=0.03)
    assert base.evidence - fit.evidence > 100.0


def damped(shop):
    return AXIS.with_controller(shop.controller.Damped(*AXIS.gains.values()))


def test_a_controller_is_simulated_written_and_swept(shop, tmp_path):
    axis = damped(shop)
    run = dd.simulate(axis, LAP).require_ok()
    slope = (axis.gains["kd"] * np.diff(run.position) * AXIS.rate)[:-1]
    expected = axis.gains["kp"] * (run.reference - run.position)[1:-1] - slope
    np.testing.assert_allclose(run.command[1:-1], expected, rtol=1e-9, atol=1e-9)
    axis.write(tmp_path / "axis.toml")
    assert dd.read_axis(tmp_path / "axis.toml").controller == axis.controller
    (tmp_path / "template.toml").write_text(told("template", "--controller", "damped"))
    assert dd.read_axis(tmp_path / "template.toml").gains == dd.paper_axis("damped").gains == {"kp": 8e6, "kd": 16e3}
    found = tuning.sweep(axis, LAP, against={"pd": AXIS}, vary={"plant.mass": "lognormal:3%"}, samples=8, settle=0.0)
    assert len(found.frame) == 16


@pytest.mark.long
def test_a_controller_is_linearised(shop):
    """Without a motion of the reference its loop is that of PD."""
    pd = AXIS.with_controller(PD(Tracking(PDGains(*AXIS.gains.values()))))
    frequency, point = np.array([5.0, 30.0, 120.0]), OperatingPoint(0.01, 0.0)
    ours, theirs = (
        response(open_loop(*as_arrays((axis.drive, axis.controller)), axis.sampling, point), frequency).loop
        for axis in (damped(shop).smooth(), pd.smooth())
    )
    np.testing.assert_allclose(ours, theirs, rtol=1e-6)


def made_up():
    rng = np.random.default_rng(4)
    return EnsembleSignals(*(1e-8 * rng.normal(size=(5, 200)) for _ in range(2)), None, None)


def test_an_objective_is_asked_for_by_its_name(shop, tmp_path):
    signals = made_up()
    costs = 1e6 * np.sqrt(np.mean(signals.error**2, axis=1))
    assert float(Objective(aggregation="sum of squares")(signals)) == pytest.approx(np.sum(costs**2))
    AXIS.write(tmp_path / "axis.toml")
    with pytest.raises(dd.errors.DiffdriveError, match="--command-noise"):  # looked at after aggregation
        told("tune", tmp_path / "axis.toml", "--aggregation", "sum of squares", "--command-noise", "loud")


@pytest.mark.slow
def test_the_gains_of_a_controller_are_tuned_for_an_objective(shop):
    best = tuning.tune(
        damped(shop), LAP, loads=(0.0, 8_000.0), machines=1, starts=1, max_steps=3, settle=0.05,
        objective=tuning.Objective(aggregation="sum of squares"),
    )  # fmt: skip
    assert best.accepted
    assert best.gains["kp"][1] != best.gains["kp"][0]
    assert best.held_out.rms_after < best.held_out.rms_before


def test_a_format_is_read_like_any_other(shop, tmp_path):
    time = np.arange(400) / 1000.0
    np.savetxt(tmp_path / "lap.trc", np.stack([time, 1e3 * np.sin(time), np.cos(time)], axis=1))
    log = dd.read_log(tmp_path / "lap.trc", units={"position": "mm"})
    np.testing.assert_allclose(log.position, np.sin(time), atol=1e-12)
    (tmp_path / "note.trc").write_text("none of these\n")
    with pytest.raises(LogError, match=r"note\.trc: .*export the trace again"):
        dd.read_log(tmp_path / "note.trc")


def test_a_check_is_asked_of_every_log_of_every_format(shop, tmp_path):
    hot = SOUND.replace(temperature=70.0 + 0.0 * SOUND.position)
    assert next(one for one in examine.examine(hot) if one.channel == "temperature").message.startswith("the motor is")
    assert not [one for one in examine.examine(SOUND) if one.channel == "temperature"]
    DRIVE.write(tmp_path / "drive.toml")
    np.savetxt(tmp_path / "lap.trc", np.stack([SOUND.time, SOUND.position, SOUND.command], axis=1))
    assert "lap" in told("check", tmp_path / "lap.trc", "--drive", tmp_path / "drive.toml")


def test_a_figure_is_in_every_report_of_its_result(shop, tmp_path):
    experiments.report(dd.simulate(AXIS, LAP), tmp_path)
    assert {"run.csv", "run.json", "run.png", "error_over_position.png"} <= {path.name for path in tmp_path.iterdir()}
    first, *_, last = json.loads((tmp_path / "result.json").read_text())["figures"]
    assert (first, last) == ("run.png", "error_over_position.png")  # behind what is written anyway


def test_a_section_is_on_every_page_that_has_something_for_it(shop, tmp_path):
    dd.paper_axis("pd+fc+ls").write(tmp_path / "axis.toml")
    told("simulate", tmp_path / "axis.toml", "--motion", SINE, "--load", "8kN", "--out", tmp_path / "run")
    text = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert re.search(r"<h2>Load on the guides</h2>\s*<p>8000 N at most, \S+ N estimated.</p>", text)
    told("template", "--out", tmp_path / "template")
    assert "Load on the guides" not in (tmp_path / "template" / "report.html").read_text(encoding="utf-8")
