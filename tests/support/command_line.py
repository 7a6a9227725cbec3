"""Commands, run in this process as a user types them."""

import pytest
from typer.testing import CliRunner

from diffdrive.errors import DiffdriveError
from experiments.cli.main import app

SHORT = "triangular:speed=10mm/s,stroke=2mm,rounding=0.05s,duration=0.3s"


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments], catch_exceptions=False)


def refused(*arguments):
    """What a command says that ends in one line and code 2."""
    with pytest.raises(DiffdriveError) as told:
        run(*arguments)
    assert "\n" not in str(told.value)
    return str(told.value)
