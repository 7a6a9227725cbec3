"""Tuned gains as a commissioning engineer types them in: SI and the controller's own units, with what they rest on."""

import re
from pathlib import Path

import numpy as np
import tomli_w

from diffdrive.axis import Axis
from diffdrive.loop.margins import Margins
from diffdrive.support.atomic_write import write_text
from diffdrive.support.typing import TomlTable
from tuning.gains.tune import GainSearch

FORCE = re.compile(r"N(?![\w^])")  # how the unit of a gain begins that is a force, or a force per something


def handover(description: Axis, tuned: GainSearch, margins: Margins, conditions: TomlTable) -> TomlTable:
    """The hand-over as nested tables: gains in SI, in command volts where the drive file says N/V; margins."""
    gains = {name: float(value) for name, value in zip(tuned.names, tuned.after, strict=True)}
    per_volt = description.mapping.force_per_volt
    tables: TomlTable = {"gains_si": gains}
    if per_volt is not None:
        forces = {name for name, unit in zip(tuned.names, tuned.units, strict=True) if FORCE.match(unit)}
        own = forces & description.controller.tunables.keys()  # not the friction that an observer is tuned to
        volts = {name: value / per_volt for name, value in gains.items() if name in own}
        tables["gains_in_command_volts"] = {"force_per_volt": per_volt, **volts}
    tables["margins_worst"] = worst_margins(margins)
    tables["conditions"] = conditions
    return tables


def worst_margins(margins: Margins) -> dict[str, float]:
    """The smallest of each over the operating points; infinite ones are left out."""
    found = {
        "gain_up_dB": 20.0 * np.log10(float(np.min(margins.gain_up))),
        "gain_down_dB": 20.0 * np.log10(float(np.min(margins.gain_down))),
        "phase_deg": float(np.degrees(np.min(margins.phase))),
        "peak_sensitivity": float(np.max(margins.sensitivity)),
        "growth_per_s": float(np.max(margins.growth)),
    }
    return {name: round(float(value), 6) + 0.0 for name, value in found.items() if np.isfinite(value)}  # no -0.0


def write_handover(path: Path, tables: TomlTable) -> None:
    """Write it as TOML."""
    write_text(path, tomli_w.dumps(tables))
