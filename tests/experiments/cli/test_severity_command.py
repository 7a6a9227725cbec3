"""`diffdrive severity`: what effects cost, as a table, a picture and a file; the tolerance as an exit code."""

import json

import pytest
from typer.testing import CliRunner

from diffdrive.axis_file.drive_file import write_axis
from diffdrive.effects.scale import LeadError
from diffdrive.errors import ParameterError
from diffdrive.paper import paper_axis
from experiments.cli.main import app

MOTION = ["--stroke", "-20mm", "20mm", "--speed", "100mm/s", "--acceleration", "1m/s^2"]


@pytest.fixture
def axis(tmp_path):
    write_axis(tmp_path / "axis.toml", paper_axis("pd+fc+ls").with_effects(LeadError(linear=3e-4)))
    return tmp_path / "axis.toml"


def test_it_writes_what_it_prints_and_ends_with_3_beyond_the_tolerance(axis, tmp_path):
    call = ["severity", str(axis), *MOTION, "--tolerance", "5um", "--out", str(tmp_path / "out")]
    found = CliRunner().invoke(app, call)
    assert found.exit_code == 3
    assert "Look at the sensor first: lead_error costs most." in found.stdout
    assert "beyond 5 µm: positioning accuracy A Without lead_error" in " ".join(found.stdout.split())
    told = json.loads((tmp_path / "out" / "severity.json").read_text())
    assert told["tolerance_m"] == pytest.approx(5e-6)
    rows = json.loads((tmp_path / "out" / "result.json").read_text())["tables"]["severity"]["rows"]
    assert [row[0] for row in rows] == ["as it is", "without lead_error", "sound"]
    assert rows[0][1] == pytest.approx(1e6 * told["as_it_is_m"]["accuracy"], rel=1e-6)
    assert (tmp_path / "out" / "severity.png").exists()


def test_without_a_speed_it_says_where_to_state_it(axis):
    found = CliRunner().invoke(app, ["severity", str(axis)])
    assert isinstance(found.exception, ParameterError)
    assert "give speed, or state limits.speed in the drive file" in str(found.exception)
