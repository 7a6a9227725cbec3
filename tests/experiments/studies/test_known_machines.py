"""The study of machines whose truth is known: what is compared, and that finished cases are not done again."""

import dataclasses
import json

import numpy as np
import pytest

from diffdrive.logs import Log
from diffdrive.model.presets import paper_drive
from experiments.studies.known_machines import (
    covered,
    force_errors,
    main,
    sliding_force,
    study,
    true_drive,
    true_values,
)

TRUTH = {
    "mass": 400.0, "coulomb_screw+": 100.0, "coulomb_screw-": 90.0, "load_coefficient": 0.004, "initial_load": 2e4,
    "breakaway_gap+": 70.0, "breakaway_gap-": 60.0, "stribeck_velocity+": 4e-3, "stribeck_velocity-": 5e-3,
    "viscous+": 1000.0, "viscous-": 1200.0, "bristle_stiffness": 5e7, "bristle_damping": 1e5,
}  # fmt: skip
TRUE = true_drive(paper_drive(), TRUTH)


def test_the_drive_of_the_key_has_its_values_by_the_names_that_are_reported():
    values = true_values(TRUE, has_delay=True)
    assert values["plant.mass"] == 400.0
    assert values["friction.coulomb_at_no_load.positive"] == pytest.approx(100.0 + 80.0)
    assert values["friction.viscous.negative"] == 1200.0
    assert values["friction.bristle_damping"] == 1e5
    assert values["actuator.delay"] == 0.0
    assert "actuator.delay" not in true_values(TRUE, has_delay=False)


def test_sliding_takes_friction_at_that_speed_less_what_pulls_along():
    fast = 0.1  # far beyond the Stribeck velocity
    assert sliding_force(TRUE, fast, 0.0) == pytest.approx(180.0 + 100.0)
    assert sliding_force(TRUE, -fast, 1e3) == pytest.approx(90.0 + 0.004 * 2.1e4 + 120.0)
    pulled = dataclasses.replace(TRUE, plant=dataclasses.replace(TRUE.plant, constant_force=30.0))
    assert sliding_force(pulled, fast, 0.0) == pytest.approx(250.0)
    assert sliding_force(pulled, -fast, 0.0) == pytest.approx(170.0 + 120.0 + 30.0)


def test_the_error_of_the_force_is_in_percent_at_the_logs_own_speeds():
    time = np.arange(4_000) / 1_000.0
    log = Log("lap", time=time, position=0.02 * (1.0 - np.cos(3.0 * time)), command=np.zeros_like(time))
    np.testing.assert_allclose(force_errors(TRUE, TRUE, log), 0.0)
    plant = dataclasses.replace(TRUE.plant, constant_force=-2.8)
    errors = force_errors(dataclasses.replace(TRUE, plant=plant), TRUE, log)
    assert len(errors) == 6
    assert all(0.0 < error < 2.0 for error in errors[:3])  # forwards it takes more
    assert all(-2.0 < error < 0.0 for error in errors[3:])


def case(name, *rows):
    return {
        "case": name, "family": "cnc", "status": "ok", "seconds": 80.0, "mass_error": 0.1, "force_errors": [0.1, -0.3],
        "constant_force": 0.0, "rows": list(rows), "notes": [],
    }  # fmt: skip


def row(path, value, true, half=1.0, status="fitted"):
    return {"path": path, "status": status, "value": value, "low": value - half, "high": value + half, "true": true}


def test_only_what_was_fitted_counts_and_a_miss_is_named_with_its_size():
    lost = row("friction.viscous", 1.0, 9.0, status="not determined")
    found = covered([case("01", row("plant.mass", 10.0, 10.5), lost), case("02", row("plant.mass", 10.0, 12.0))])
    assert found == (1, 2, ["02 plant.mass by -2 half-widths"])


def test_what_is_there_is_not_done_again(tmp_path, monkeypatch, capsys):
    (tmp_path / "key.json").write_text(json.dumps({"01": {}, "02": {}}))
    out = tmp_path / "out.jsonl"
    out.write_text("".join(json.dumps(case(name, row("plant.mass", 1.0, 1.5))) + "\n" for name in ("01", "02")))
    assert [one["case"] for one in study(tmp_path, (), out, held_out=False)] == ["01", "02"]
    monkeypatch.setattr("sys.argv", ["study", str(tmp_path), "--out", str(out), "--case", "02"])
    main()
    printed = capsys.readouterr().out
    assert "| 02 | cnc | ok | +0.100 | 0.200 | 0.300 |" in printed
    assert "1 of 1 intervals hold the truth (100.0 %)" in printed
