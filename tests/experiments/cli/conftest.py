import dataclasses

import pytest
from typer.testing import CliRunner

from diffdrive.axis_file.drive_file import write_axis
from diffdrive.logs import write_log
from experiments.cli.main import app


@pytest.fixture
def drive_file(tmp_path):
    path = tmp_path / "drive.toml"
    path.write_text(CliRunner().invoke(app, ["template", "--controller", "pd+fc+le"]).output, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two logs of one machine, and a drive file that takes its mass for a quarter too large."""
    from tests.support.identify_command import MOTION, TRUE
    from tests.support.sound_log import simulate_log

    folder = tmp_path_factory.mktemp("identify")
    for name, seed in (("lap", 1), ("other", 2)):
        write_log(folder / f"{name}.csv", simulate_log(TRUE, MOTION, seed=seed))
    heavy = dataclasses.replace(TRUE.drive, plant=dataclasses.replace(TRUE.drive.plant, mass=125.0))
    write_axis(folder / "drive.toml", dataclasses.replace(TRUE, drive=heavy))
    return folder
