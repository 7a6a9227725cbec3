"""An option is called as the argument of the function that its command calls; one that repeats, by the singular."""

import dataclasses
import inspect

import pytest

import diffdrive as dd
import tuning
from experiments.cli import drives, logs, sweeps

FILES = {"drive", "log", "out", "svg", "pdf"}  # what a command reads and writes
COMMANDS = {
    # --loads, --max-load and --steps are numbers of the command's own; --of and --unit are read_frequency_response's
    "tune": (drives.tune, (tuning.tune,), {"max_load", "loads", "steps", "pareto"}),
    "margins": (drives.margins, (dd.compare_frequency_response,), set()),
    "identify": (logs.identify, (tuning.identify,), set()),
    "compare": (logs.compare, (tuning.compare,), set()),
    "diagnose": (logs.diagnose, (tuning.diagnose,), {"tune"}),
    "start": (logs.start, (tuning.start,), set()),
    "sweep": (sweeps.sweep, (tuning.sweep,), {"record"}),
}


def arguments(*functions):
    return {name for function in functions for name in inspect.signature(function).parameters}


@pytest.mark.parametrize(("command", "functions", "own"), COMMANDS.values(), ids=COMMANDS.keys())
def test_an_option_has_the_name_of_its_argument(command, functions, own):
    known = arguments(*functions, dd.read_log, dd.read_frequency_response)
    known |= {field.name for kind in (tuning.Requirements, tuning.Objective) for field in dataclasses.fields(kind)}
    options = arguments(command) - FILES - own
    assert not {name for name in options if not {name, f"{name}s"} & known}
