"""`diffdrive margins` as a user meets it: the model alone, a measured plant beside it, and what it refuses."""

import json

import numpy as np
import pytest

from tests.support.command_line import refused, run
from tests.support.second_order import two_mass_speed

FREQUENCY = np.geomspace(2.0, 4_500.0, 300)


@pytest.fixture
def plant_file(tmp_path):
    value = two_mass_speed(FREQUENCY, 100.0, 400.0, 0.02)
    rows = [f"{f!r},{v.real!r},{v.imag!r},0.9" for f, v in zip(FREQUENCY.tolist(), value.tolist(), strict=True)]
    path = tmp_path / "plant.csv"
    path.write_text("\n".join(["frequency [Hz],real,imaginary,coherence", *rows, ""]))
    return path


@pytest.mark.long
def test_margins_of_the_model_and_with_what_was_measured(plant_file, tmp_path):
    drive_file = tmp_path / "pd.toml"
    drive_file.write_text(run("template", "--controller", "pd").output, encoding="utf-8")
    alone = run("margins", drive_file)
    assert alone.exit_code == 0, alone.output
    assert "Margins at 10 mm/s under 0 kN" in alone.output
    out = tmp_path / "out"
    measured = ("--measured", plant_file, "--of", "plant", "--unit", "(m/s)/N")
    both = run("margins", drive_file, *measured, "--out", out)
    assert both.exit_code in (0, 3), both.output
    assert "measured from 2 to 4500 Hz" in both.output.replace("\n", " ")
    numbers = json.loads((out / "result.json").read_text())
    names = [row[0] for row in numbers["tables"]["margins"]["rows"]]
    assert names == ["measured", "model"]
    peaks = [row for row in numbers["tables"]["resonances"]["rows"] if row[0] == "measured"]
    assert peaks[0][1] == pytest.approx(400.0, rel=0.05)
    assert {file.name for file in out.iterdir()} >= {"frequency_response.csv", "frequency_response.png", "margins.csv"}


def test_what_is_not_said_of_a_measurement_is_asked_for(drive_file, plant_file, tmp_path):
    told = refused("margins", drive_file, "--measured", plant_file)
    assert "of: say what the response is of, got None; one of 'plant'" in told
    assert "plant.csv: unit: a plant has a unit" in refused(
        "margins", drive_file, "--measured", plant_file, "--of", "plant"
    )
    assert "no such file" in refused("tune", drive_file, "--measured", tmp_path / "none.csv", "--of", "plant")
