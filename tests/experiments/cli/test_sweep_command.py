"""`diffdrive sweep` and `replay` as a user meets them."""

import json
import re

import numpy as np
import pyarrow.dataset as ds
import pytest
import xarray as xr
from typer.testing import CliRunner

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.errors import ParameterError
from experiments.cli.main import app
from experiments.reports.sweep import sweep as command

MOTION = "sine:amplitude=1mm,frequency=10Hz,duration=0.1s"
VARY = ("--vary", "plant.mass=lognormal:3%", "--vary", "load=uniform:0..10 kN")


def run(*arguments):
    return CliRunner().invoke(app, [str(one) for one in arguments])


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """A drive with noise, and the same under a controller that does not know of friction."""
    folder = tmp_path_factory.mktemp("drives")
    text = run("template", "--controller", "pd+fc+le").output  # the paper's, without its [uncertainty]
    (folder / "axis.toml").write_text(text.replace("\nresolution =", "\nnoise = 2e-8\nresolution =", 1))
    head = text[: text.index("[controller.observer]")].replace('kind = "pd+fc+le"', 'kind = "pd"')
    tail = text[text.index("[units]") :]
    (folder / "plain.toml").write_text(head + tail)
    return folder


@pytest.fixture(scope="module")
def swept(drives):
    out = drives / "swept"
    result = run(
        "sweep", drives / "axis.toml", "--against", drives / "plain.toml", *VARY, "--motion", MOTION, "--samples", 128,
        "--settle", 0.02, "--tolerance", "1um", "--record", "error,load_estimate", "--out", out,
    )  # fmt: skip
    if result.exit_code:
        raise AssertionError(result.output) from result.exception
    return result, out, json.loads((out / "result.json").read_text())


@pytest.mark.long
def test_a_sweep_in_single_precision_is_another_sweep_and_replays_to_the_bit(drives, swept, tmp_path, monkeypatch):
    arguments = ("sweep", drives / "axis.toml", *VARY, "--motion", MOTION, "--samples", 64, "--settle", 0.02)
    result = run(*arguments, "--precision", "single", "--out", tmp_path / "swept")
    assert result.exit_code == 0, result.output
    told = json.loads((tmp_path / "swept" / "result.json").read_text())
    assert told["sweep"]["precision"] == "single"
    refused = run(*arguments, "--out", tmp_path / "swept")
    assert isinstance(refused.exception, ParameterError)
    sweep = tmp_path / "swept"
    monkeypatch.setattr(command, "ALIKE", 1e-9)
    recorded = run(*arguments, "--precision", "single", "--record", "error", "--out", sweep)
    assert "computed in double precision, the sweep in single" in " ".join(recorded.output.split())
    result = run("replay", tmp_path / "swept", "--machine", 5, "--out", tmp_path / "again")
    assert json.loads((tmp_path / "again" / "result.json").read_text())["as_in_the_sweep"]["to_the_last_bit"]
    assert "half" in str(run(*arguments, "--precision", "half").exception)


@pytest.mark.long
def test_it_says_how_often_the_axis_misses_and_why(swept):
    result, out, written = swept
    assert result.exit_code == 0, result.output
    rows = ds.dataset(out / "parts").to_table().to_pydict()
    for told in written["results"]:
        mine = np.array(rows["controller"]) == told["controller"]
        assert np.sum(mine) == 128
        peaks = np.array(rows["peak_m"])[mine]
        assert told["misses"]["peak_m"]["value"] == np.mean(peaks > 1e-6)
        assert told["quantiles"]["peak_m"]["0.5"]["value"] == np.sort(peaks)[63]
    assert {one["name"] for one in written["results"][0]["sensitivity"]} == {"plant.mass", "load"}
    assert "tables" in written
    assert "compared" in written["tables"]
    for name in written["figures"]:
        assert (out / name).stat().st_size > 5000, name
    assert {"distribution.png", "exceedance.png", "error_against_load.png"} <= set(written["figures"])
    (_, unit, text, least, middle, most) = written["tables"]["varied"]["rows"][1]
    assert (unit, text) == ("N", "uniform:0..10 kN")
    assert 0.0 <= least < 500.0 < 4500.0 < middle < 5500.0 < 9500.0 < most <= 10_000.0


@pytest.mark.long
def test_the_worst_machines_are_recorded(swept):
    _, out, written = swept
    found = xr.load_dataset(out / "traces.nc", engine="h5netcdf")
    worst = [set(map(int, row[2].split())) for row in written["tables"]["worst"]["rows"]]
    assert set(found.machine.values.tolist()) == worst[0] | worst[1]
    assert found.error.dims == ("controller", "machine", "time")
    assert found.error.attrs["units"] == "m"
    rows = ds.dataset(out / "parts").to_table().to_pydict()
    for controller in ("axis", "plain"):
        for number in found.machine.values:
            after = found.error.sel(controller=controller, machine=number).values[found.time.values >= 0.02]
            row = rows["controller"].index(controller) + int(number)
            assert rows["machine"][row] == number
            assert np.max(np.abs(after)) == pytest.approx(rows["peak_m"][row], rel=0.02)
            assert np.max(np.abs(after)) == float(found.peak_m.sel(controller=controller, machine=number))
            assert float(found["plant.mass"].sel(machine=number)) == rows["plant.mass"][row]
    assert np.isnan(found.load_estimate.sel(controller="plain")).all()


@pytest.mark.long
def test_a_machine_runs_again_to_the_last_bit_and_as_a_drive_file(swept, tmp_path):
    _, out, _ = swept
    result = run("replay", out, "--machine", 77, "--controller", "plain", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    written = json.loads((tmp_path / "result.json").read_text())
    assert written["as_in_the_sweep"] == {"to_the_last_bit": True}
    mass = {row[0]: row[2] for row in written["tables"]["machine"]["rows"]}["plant.mass"]
    assert float(read_axis(tmp_path / "machine.toml").drive.plant.mass) == mass
    assert (tmp_path / "run.png").exists()
    refused = run("replay", out, "--machine", 77, "--controller", "plian")
    assert "controller 'plian': is not of this sweep; known: axis, plain" in str(refused.exception)
    assert not refused.output.strip()
    before = (out / "result.json").read_bytes()
    assert "holds a sweep" in str(run("replay", out, "--machine", 77, "--out", out).exception)
    assert (out / "result.json").read_bytes() == before
    assert run("replay", out, "--machine", 128).exit_code != 0
    assert run("replay", tmp_path, "--machine", 1).exit_code != 0


@pytest.mark.long
def test_a_second_run_computes_nothing_and_another_sweep_is_refused(swept, drives):
    _, out, before = swept
    same = (
        "sweep", drives / "axis.toml", "--against", drives / "plain.toml", *VARY, "--motion", MOTION, "--samples", 128,
        "--settle", 0.02, "--tolerance", "1um", "--out", out,
    )  # fmt: skip
    stamps = {path: path.stat().st_mtime_ns for path in (out / "parts").iterdir()}
    assert run(*same).exit_code == 0
    assert {path: path.stat().st_mtime_ns for path in (out / "parts").iterdir()} == stamps
    assert json.loads((out / "result.json").read_text())["results"] == before["results"]
    before = {name: (out / name).read_bytes() for name in ("spec.json", "result.json")}
    other = run(*same, "--seed", 1)
    assert other.exit_code != 0
    assert "is of another sweep" in str(other.exception)
    assert {name: (out / name).read_bytes() for name in before} == before


def test_the_results_of_another_command_are_not_overwritten(drives, tmp_path):
    (tmp_path / "result.json").write_text("{}")
    refused = run("sweep", drives / "axis.toml", "--motion", MOTION, "--samples", 8, "--settle", 0, "--out", tmp_path)
    assert "holds the results of another command" in str(refused.exception)
    assert (tmp_path / "result.json").read_text() == "{}"


@pytest.mark.long
def test_what_no_quantity_drives_is_said(drives, tmp_path):
    """The load comes when the motion is over: nothing but noise is left."""
    late = (
        "--vary",
        "load.change=uniform:0..10 kN",
        "--vary",
        "load.change.begin=uniform:9..10 s",
        "--vary",
        "load.change.end=fixed:11 s",
    )
    result = run("sweep", drives / "axis.toml", *late, "--motion", MOTION, "--samples", 128, "--settle", 0.02)
    assert result.exit_code == 0, result.output
    assert "no quantity stands out" in result.output


@pytest.mark.parametrize("command", ["sweep", "simulate"])
def test_a_machine_of_another_rate_is_refused(drives, tmp_path, command):
    (tmp_path / "slow.toml").write_text((drives / "plain.toml").read_text().replace('"10 kHz"', '"4 kHz"'))
    assert read_axis(tmp_path / "slow.toml").sampling.rate == 4e3
    refused = run(
        command, drives / "plain.toml", "--machine", tmp_path / "slow.toml", "--motion", MOTION, "--settle", 0
    )
    assert re.search("machine: is sampled at 4000 Hz, the (axis|drive file) at 10000 Hz", str(refused.exception))
    for name, rate in (("one", '"8.12 kHz"'), ("other", "8120")):  # which differ in their last bits
        (tmp_path / f"{name}.toml").write_text((drives / "plain.toml").read_text().replace('"10 kHz"', rate))
    more = ("--samples", 8) if command == "sweep" else ()
    same = run(
        command, tmp_path / "one.toml", "--machine", tmp_path / "other.toml", "--motion", MOTION, "--settle", 0, *more
    )
    assert same.exit_code == 0, same.output


def test_machines_that_diverge_are_counted_and_the_code_is_3(drives, tmp_path):
    text = (drives / "plain.toml").read_text()
    (tmp_path / "wild.toml").write_text(text.replace("kd = ", "kd = 1e8 # "))
    result = run(
        "sweep", tmp_path / "wild.toml", *VARY, "--motion", MOTION, "--samples", 8, "--settle", 0, "--out", tmp_path
    )
    assert result.exit_code == 3, result.output
    told = json.loads((tmp_path / "result.json").read_text())["results"][0]
    assert told["diverged"] == 8
    assert told["quantiles"]["peak_m"]["0.5"]["value"] == "inf"
    again = run("replay", tmp_path, "--machine", 3, "--out", tmp_path / "again")
    assert again.exit_code == 3, again.output
    assert json.loads((tmp_path / "again" / "result.json").read_text())["as_in_the_sweep"] == {"to_the_last_bit": True}


def test_what_decides_over_divergence_is_said(drives, tmp_path):
    text = (drives / "plain.toml").read_text()
    kd = float(text.split("kd = ")[1].split()[0])
    (tmp_path / "hard.toml").write_text(text.replace("kd = ", f"kd = {40 * kd} # "))
    vary = ("--vary", "plant.mass=uniform:-90%..+300%", "--vary", "friction.viscous=lognormal:2%")
    result = run(
        "sweep", tmp_path / "hard.toml", *vary, "--motion", MOTION, "--samples", 256, "--settle", 0, "--out", tmp_path
    )
    assert result.exit_code == 3, result.output
    told = json.loads((tmp_path / "result.json").read_text())
    assert 0 < told["results"][0]["diverged"] < 256
    rows = told["tables"]["divergence"]["rows"]
    assert [row[2] for row in rows] == ["plant.mass"]
    assert rows[0][6] > rows[0][7]  # light machines diverge
    assert rows[0][5] < 1e-9


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (("--by", "mean"), "by: no error 'mean'; known: rms, peak"),
        (("--record", "errors", "--out", "x"), "--record: no signal 'errors'; known: reference, "),
        (("--record", "error"), "give --out"),
        (("--method", "grid", "--out", "x"), "method: no method 'grid'; known: sobol, latin-hypercube, random"),
        (("--load", "stepp:to=3"), "load: no shape 'stepp'; known: constant, step, ramp, "),
        (("--load", "-90 kN", "--out", "x"), "lifts the table"),
        (("--vary", "effects.loop_delay.delay=fixed:12", "--out", "x"), "at most 8"),
        (("--vary", "effects.loop_delay.delay=uniform:0..0.2 ms", "--out", "x"), "it must be a plain number"),
        (("--cluster", "foo", "--out", "x"), "cluster foo: write tcp://host:8786"),
        (("--settle", "0.5", "--out", "x"), "settle: 0.5 s leaves nothing of sine (0.1 s)"),
        (("--tolerance", "2 N"), "--tolerance"),
        (("--vary", "plant.mas=lognormal:3%"), "is no quantity"),
        (("--spread", "abc"), "spread abc: give a share above 0 and up to 100%, as 3% or 0.03"),
        (("--spread", "0%"), "spread 0%: give a share"),
        (("--spread=-3%",), "spread -3%: give a share"),
        (
            (
                "--vary",
                "load.change=fixed:1 kN",
                "--vary",
                "load.change.begin=uniform:0..0.05 s",
                "--vary",
                "load.change.end=uniform:0.02..0.07 s",
                "--out",
                "x",
            ),
            "cannot be: its load.change.begin comes after its load.change.end",
        ),
        (("--samples", "0"), "--samples"),
        (("--tolerance", "2"), "give it with its unit"),
        (("--identified", "absent.toml"), "no such file"),
    ],
)
def test_what_cannot_be_is_refused_at_once(drives, tmp_path, monkeypatch, more, says):
    monkeypatch.chdir(tmp_path)
    settle = () if "--settle" in more else ("--settle", 0.02)
    result = run("sweep", drives / "axis.toml", "--motion", MOTION, *settle, *more)
    assert result.exit_code not in (0, 3)
    assert says in (str(result.exception) + result.output)
    assert "simulating machines" not in result.output  # no bar for what does not begin
    assert not (tmp_path / "x").exists()


@pytest.mark.long
def test_two_files_of_one_name_are_not_told_apart(drives, tmp_path):
    (tmp_path / "axis.toml").write_text((drives / "axis.toml").read_text())
    result = run("sweep", drives / "axis.toml", "--against", tmp_path / "axis.toml", "--motion", MOTION)
    assert "two files are called axis" in str(result.exception)
