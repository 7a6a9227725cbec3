"""`diffdrive identify` as a user meets it: from log files to a drive file, with what it says."""

import dataclasses
import json
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.logs import write_log
from diffdrive.logs.write import write_csv
from experiments.cli.main import app
from experiments.reports import interruption
from experiments.reports.checked_logs import read_sound_logs
from experiments.reports.interruption import stop_at_next_step
from experiments.reports.readable import interval, readable, significant
from experiments.reports.report import Report
from experiments.studies.emps import axis as emps
from tests.support.identify_command import MOTION, QUESTION, TRUE, run
from tests.support.sound_log import simulate_log
from tuning.identification.identify import COARSE_STEPS
from tuning.sweeps.identified import about_identified, read_uncertainty
from tuning.sweeps.machines import machines
from tuning.sweeps.samples import correlate, correlation_root, unit_samples
from tuning.sweeps.varied import parse_varied


@pytest.fixture(scope="module")
def identified(folder):
    """One identification for all who look at its result."""
    out = folder / "out"
    result = run(
        folder / "lap.csv", "--drive", folder / "drive.toml", *QUESTION, "--held-out", folder / "other.csv",
        "--out", out,
    )  # fmt: skip
    return result, out, json.loads((out / "result.json").read_text())


def estimates(written):
    return {row[0]: dict(zip(written["tables"]["estimates"]["columns"], row, strict=True)) for row in records(written)}


def records(written):
    return written["tables"]["estimates"]["rows"]


@pytest.mark.long
def test_it_finds_the_machine_and_writes_everything(identified):
    result, out, written = identified
    assert result.exit_code == 0, result.output
    mass = estimates(written)["mass"]
    assert mass["drive_file"] == 125.0
    assert mass["low"] < mass["identified"] < mass["high"]
    assert mass["identified"] == pytest.approx(100.0, rel=1e-3)
    assert mass["status"] == "fitted"
    assert written["search"]["status"] == "converged"
    figures = {f"{name}.png" for name in ("stribeck", "hysteresis", "missing_force", "parameters", "innovations")}
    assert set(written["figures"]) == figures
    for name in {*figures, "identified.toml", "estimates.csv", "gaps.csv", "findings.csv"}:
        assert (out / name).stat().st_size > 100, name
    assert "stopped_by" not in written


@pytest.mark.long
def test_what_is_printed_is_in_the_json(identified):
    result, _, written = identified
    viscous = estimates(written)["viscous.positive"]
    value, between = interval(viscous["identified"], viscous["low"], viscous["high"])
    assert re.search(rf"viscous\.positive +N s/m +\S+ +{value} +{between}", result.output)
    printed = " ".join(result.output.split())  # however wide the terminal is
    for sentence in written["notes"]:
        assert readable(sentence) in printed
    assert {"inverse_dynamics", "search", "accuracy", "adequacy", "starts"} <= set(written)
    assert {"findings", "findings_held_out", "estimates", "correlated", "gaps"} <= set(written["tables"])
    assert f"force error {significant(written['inverse_dynamics']['force_error_percent'])} %" in " ".join(
        result.output.split()
    )
    assert any(said.startswith("Nothing is missing that these logs would show") for said in written["notes"])


@pytest.mark.long
def test_fixed_parameters_stay_and_undetermined_ones_are_named(identified):
    _, _, written = identified
    found = estimates(written)
    for side in ("positive", "negative"):
        held = found[f"stribeck_velocity.{side}"]
        assert (held["status"], held["low"]) == ("fixed", None)
        assert held["identified"] == pytest.approx(held["drive_file"])
        assert found[f"load_coefficient.{side}"]["status"] == "not determined"
    assert any("do not determine load_coefficient.positive" in said for said in written["notes"])


@pytest.mark.long
def test_the_gap_closes_also_on_the_held_out_log(identified):
    _, _, written = identified
    rows = written["tables"]["gaps"]["rows"]
    assert {(row[0], row[1]) for row in rows} == {("lap", "identified from"), ("other", "held out")}
    for _, _, gap, before, after in rows:
        assert after < 0.3 * before, gap
    step = {row[0]: row[4] for row in rows if row[2] == "one-step prediction, um"}
    assert step["other"] == pytest.approx(step["lap"], rel=0.1)


@pytest.mark.long
def test_the_identified_drive_file_reads_back_and_simulates(identified, folder):
    _, out, written = identified
    believed, found = read_axis(folder / "drive.toml"), read_axis(out / "identified.toml")
    assert float(found.drive.plant.mass) == estimates(written)["mass"]["identified"]
    for part in ("sampling", "limits", "mapping"):
        assert getattr(found, part) == getattr(believed, part)
    assert found.controller.tracking.gains == believed.controller.tracking.gains
    motion = "sine:amplitude=2mm,frequency=2Hz,duration=0.5s"
    simulated = CliRunner().invoke(app, ["simulate", str(out / "identified.toml"), "--motion", motion])
    assert simulated.exit_code == 0
    assert "status ok" in simulated.output


@pytest.fixture
def in_volts(folder, tmp_path):
    """A log whose command is in volts of 159.6 N, and says newtons."""
    log = simulate_log(TRUE, MOTION)
    path = tmp_path / "volts.csv"
    write_log(path, dataclasses.replace(log, command=log.command / 159.6))
    return path


@pytest.mark.long
def test_a_fatal_finding_ends_with_one_line_and_code_2(folder, in_volts, tmp_path):
    code = "from experiments.cli.main import main; main()"
    arguments = ["identify", in_volts, "--drive", folder / "drive.toml", "--out", tmp_path / "out"]
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "error: volts: command: " in done.stderr
    assert "--force" in done.stderr
    assert "fatal" in done.stdout  # the table with all that was found
    assert not (tmp_path / "out" / "identified.toml").exists()


@pytest.mark.long
def test_force_goes_on_over_a_fatal_finding_and_says_so(in_volts, capsys):
    with Report("forced", None) as report:
        read_sound_logs([in_volts], TRUE, report, name="findings", force=True)
    assert "overruled by --force" in capsys.readouterr().out


def test_ctrl_c_ends_the_search_at_its_next_step_and_a_second_one_at_once(monkeypatch):
    monkeypatch.setattr(interruption, "TOGETHER", 0.0)
    steps, said = [], []
    handler = signal.getsignal(signal.SIGINT)
    with stop_at_next_step(lambda *step: steps.append(step), said.append) as progress:
        progress(1, 9, 1.0)
        signal.raise_signal(signal.SIGINT)  # no exception here, in the midst of a computation
        with pytest.raises(KeyboardInterrupt):
            progress(2, 9, 1.0)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        progress(3, 9, 1.0)  # of what comes after the search
    assert [step[0] for step in steps] == [1, 2, 3]
    assert "best so far is written" in said[0]
    assert signal.getsignal(signal.SIGINT) is handler


@pytest.mark.long
def test_an_interrupted_identification_keeps_the_best_so_far_and_ends_with_3_and_continues(
    identified, folder, monkeypatch, tmp_path
):
    monkeypatch.setattr(Report, "stages", lambda self: _interrupting())
    out = tmp_path / "out"
    command = (folder / "lap.csv", "--drive", folder / "drive.toml", *QUESTION, "--out", out)
    result = run(*command)
    assert result.exit_code == 3
    written = json.loads((out / "result.json").read_text())
    assert written["search"]["status"].startswith("interrupted")
    assert any("did not converge" in said for said in written["notes"])
    assert "The same command continues the search from identification.parts." in written["notes"]
    assert (out / "identified.toml").is_file()
    monkeypatch.undo()
    again = run(*command)
    assert again.exit_code == 0
    assert "1 finished searches of an interrupted identification were used" in again.output
    continued = json.loads((out / "result.json").read_text())
    # not bit for bit, nor step for step: BLAS sums in the order that the memory's alignment allows
    assert continued["search"]["status"] == identified[2]["search"]["status"] == "converged"
    assert continued["accuracy"]["noise_m"] == pytest.approx(identified[2]["accuracy"]["noise_m"], rel=1e-3)
    assert continued["adequacy"]["structured"] == identified[2]["adequacy"]["structured"]
    uninterrupted = estimates(identified[2])
    assert estimates(continued).keys() == uninterrupted.keys()
    for name, found in estimates(continued).items():
        expected = uninterrupted[name]
        assert found["status"] == expected["status"], name
        if expected["status"] == "fitted":
            within = 0.01 * (expected["high"] - expected["low"])
            for key in ("identified", "low", "high"):
                assert found[key] == pytest.approx(expected[key], abs=within), (name, key)
    assert not (out / "identification.parts").exists()


class _interrupting:  # noqa: N801
    """A progress bar whose user presses Ctrl-C once the starts are done."""

    def __enter__(self):
        self.steps = 0

        def advance(*_):
            self.steps += 1
            if self.steps == COARSE_STEPS + 1:
                signal.raise_signal(signal.SIGINT)

        return advance

    def __exit__(self, *_):
        return None


@pytest.mark.long
def test_what_it_left_open_is_what_a_sweep_varies(identified):
    _, out, written = identified
    axis = read_axis(out / "identified.toml")
    vary, together = read_uncertainty(out / "uncertainty.toml")
    assert about_identified(axis) == (vary, together)  # the drive file says the same
    found = estimates(written)
    known = ("fitted", "only in a sum")
    fitted = {name for name, row in found.items() if row["status"] in known} - {"delay"}
    names = list(vary)
    assert {name.split(".", 1)[1] for name in names} == {one for one in fitted if not one.startswith("coulomb_at")}
    assert sum(map(len, together.values())) == len(names) * (len(names) - 1) / 2  # no pair is left out
    drawn = correlate(unit_samples("sobol", len(vary), 0, 0, 4096), correlation_root(together, names))
    machine, _, values = machines(
        axis.drive, [parse_varied(f"{name}={text}", axis.drive) for name, text in vary.items()], drawn
    )
    for name, value in values.items():
        row = found[name.split(".", 1)[1]]
        if row["status"] != "fitted":
            continue
        near = 0.02 * (row["high"] - row["low"])
        assert np.quantile(value, [0.025, 0.975]) == pytest.approx([row["low"], row["high"]], abs=near), name
    assert len(np.ravel(machine.plant.mass)) == 4096
    for one, other, r in written["tables"]["correlated"]["rows"]:
        if f"friction.{one}" in names and f"friction.{other}" in names:
            normal = np.corrcoef(values[f"friction.{one}"], values[f"friction.{other}"])[0, 1]
            assert normal == pytest.approx(r, abs=0.02)


FOLDER = emps.find_folder()


@pytest.mark.slow
@pytest.mark.skipif(FOLDER is None, reason="the EMPS log is not in ../shared/data/emps")
def test_the_emps_axis_end_to_end(tmp_path):
    """The file with pulses is held out, they being taken out of the command and given as the disturbance."""
    from diffdrive.library import PAPER_DRIVE

    pulses = emps.read(FOLDER / emps.FILES["pulses"]).log
    mapping = read_axis(PAPER_DRIVE.parent / "emps.toml").mapping
    columns = {mapping.columns.get(channel, channel): values for channel, values in pulses.channels.items()}
    columns["vir"] = columns["vir"] / mapping.force_per_volt
    write_csv(tmp_path / "pulses.csv", columns, {"disturbance": "N"})
    out = tmp_path / "out"
    result = run(
        FOLDER / emps.FILES["estimation"], "--drive", PAPER_DRIVE.parent / "emps.toml", "--starts", 3,
        "--held-out", tmp_path / "pulses.csv", "--out", out,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    written = json.loads((out / "result.json").read_text())
    assert written["search"]["status"] == "converged; model incomplete"
    assert any(said.startswith("The model does not explain the logs") for said in written["notes"])
    found = estimates(written)
    assert found["mass"]["identified"] == pytest.approx(95.1, rel=0.01)
    gaps = {(row[1], row[2]): row[3:] for row in written["tables"]["gaps"]["rows"]}
    for role, before in (("identified from", 4.46), ("held out", 5.04)):  # as docs/evidence/emps.md has them
        assert gaps[role, "closed loop: command, %"][0] == pytest.approx(before, rel=0.1)
        for gap in ("one-step prediction, um", "missing force, N", "closed loop: command, %"):
            assert gaps[role, gap][1] < gaps[role, gap][0], (role, gap)
    assert read_axis(out / "identified.toml").mapping.columns["reference"] == "qg"
