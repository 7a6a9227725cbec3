import pytest
from typer.testing import CliRunner

from experiments.cli.main import app


@pytest.fixture
def drive_file(tmp_path):
    path = tmp_path / "drive.toml"
    path.write_text(CliRunner().invoke(app, ["template", "--controller", "pd+fc+le"]).output, encoding="utf-8")
    return path
