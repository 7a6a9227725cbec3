"""The drive file as a text: each value beside how sure it is, and why."""

from collections.abc import Iterator, Mapping
from dataclasses import fields

import numpy as np
import tomli_w

from diffdrive.axis_file.controller_file import controller_table
from diffdrive.controllers.pd import PD
from diffdrive.logs import Log
from diffdrive.logs.guess.result import Guess
from diffdrive.logs.guess.trace import TraceGuess
from diffdrive.model.data_sheet import DataSheet
from diffdrive.model.motor_units import axis_unit
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import Directional
from diffdrive.support.messages import printable
from tuning.unknown_trace.controller import FirstController
from tuning.unknown_trace.friction import PRESLIDING, PRESLIDING_ANGLE, FirstMachine

WIDTH = 34  # of key and value, before a comment
_GAINS = ("kp", "kv", "reset_time", "velocity_feedforward")
_MEANINGS = {"kv": ": velocity gain", "velocity_feedforward": ": share", "reset_time": ": T_n"}


def drive_text(source: str, log: Log, trace: TraceGuess, machine: FirstMachine, controller: FirstController) -> str:
    """A complete drive file; `source` names the trace."""
    reasons = {guess.what: guess for guess in trace.guesses}
    lines = [
        f"# Made by `diffdrive start` from {source}.",
        "# sure: the file states it, or its names and its numbers agree; likely: one of them; stated: by you;",
        "# seen: in the log; usual: on machine tools, not in this log. Correct what you know better;",
        "# `diffdrive identify` does the rest.",
        "",
        *_data_sheet(trace.sheet, reasons),
        *_machine(machine, log, trace),
        *_encoders(machine.drive, trace.sheet),
        "[sampling]",
        _line(
            "rate",
            float(f"{log.rate:.6g}"),
            "Hz, of the rows; a control that runs faster: docs/reference/drive-file.md",
        ),
        "",
        *_controller(controller),
        *_limits(log, trace.sheet),
        *_columns(trace, reasons),
    ]
    return "\n".join(lines) + "\n"


def _line(key: str, value: object, comment: str = "") -> str:
    text = tomli_w.dumps({key: value}).strip()
    return f"{text:<{WIDTH - 2}}  # {printable(comment)}" if comment else text


def _said(guess: Guess | None) -> str:
    return "" if guess is None else f"{guess.certainty}: {guess.why}"


def _data_sheet(sheet: DataSheet, reasons: Mapping[str, Guess]) -> Iterator[str]:
    if sheet.is_empty:
        return
    yield "[axis]"
    if sheet.is_rotary:
        yield _line("kind", "rotary", "rad, N m and kg m^2 in the place of m, N and kg")
    for one in fields(sheet):
        value = getattr(sheet, one.name)
        if one.name == "kind" or value is None or (one.name == "gear_ratio" and value == 1.0):
            continue
        declared = one.metadata["quantity"]
        unit = "" if declared.unit == "1" else f"{declared.unit}, "
        yield _line(one.name, float(value), unit + (_said(reasons.get(one.name)) or f"stated: {declared.meaning}"))
    yield ""


def _machine(machine: FirstMachine, log: Log, trace: TraceGuess) -> Iterator[str]:
    drive, sheet = machine.drive, trace.sheet

    def unit(of: str) -> str:
        return axis_unit(of, sheet)

    shown = "" if trace.implied_mass is None else f"; the log shows {trace.implied_mass:.4g} by inverse dynamics"
    plant, friction = drive.plant, drive.friction
    yield "[plant]"
    yield _line("mass", float(plant.mass), f"{unit('kg')}, stated{shown}")
    yield _line("damping", 0.0, f"{unit('N*s/m')}, all of it in [friction] viscous")
    constant = float(plant.constant_force)
    why = "seen: a weight, an offset, or friction that differs by direction" if constant else "none is seen"
    yield _line("constant_force", constant, f"{unit('N')}, {why}")
    seen = "usual" if machine.found is None else "seen by inverse dynamics"
    presliding = f"{1e6 * PRESLIDING_ANGLE:g} urad" if sheet.is_rotary else f"{1e6 * PRESLIDING:g} um"
    yield from ("", "[friction]")
    error = "" if machine.found is None else f", give or take {_error(machine, 'coulomb')} {unit('N')}"
    yield _line("coulomb_screw", _one(friction.coulomb_screw), f"{unit('N')}, {seen}{error}: all Coulomb friction")
    yield _line("load_coefficient", _one(friction.load_coefficient), "usual: without a load it is of no effect")
    yield _line("initial_load", 0.0, f"{unit('N')}: what it makes is part of coulomb_screw")
    yield _line("breakaway_gap", _one(friction.breakaway_gap), f"{unit('N')}, usual: a quarter of Coulomb friction")
    yield _line("stribeck_velocity", _one(friction.stribeck_velocity), f"{unit('m/s')}, usual")
    error = "" if machine.found is None else f", give or take {_error(machine, 'viscous')} {unit('N*s/m')}"
    yield _line("viscous", _one(friction.viscous), f"{unit('N*s/m')}, {seen}{error}")
    yield _line(
        "bristle_stiffness", _one(friction.bristle_stiffness), f"{unit('N/m')}, usual: {presliding} of presliding"
    )
    yield _line(
        "bristle_damping", _one(friction.bristle_damping), f"{unit('N*s/m')}, usual: sqrt(stiffness times mass)"
    )
    yield ""


def _one(value: Directional) -> float:
    return float(value.positive)


def _error(machine: FirstMachine, name: str) -> str:
    assert machine.found is not None
    return f"{2.0 * machine.found.standard_errors.get(name, np.nan):.2g}"


def _encoders(drive: Drive, sheet: DataSheet) -> Iterator[str]:
    encoders = {"sensor": drive.sensor, "motor_encoder": drive.motor_encoder}
    for name, encoder in encoders.items():
        if encoder is None:
            continue
        yield f"[{name}]"
        if encoder.resolution is None:
            yield "# resolution =                    # no steps are seen: computed, filtered, or finer than its noise"
        else:
            yield _line(
                "resolution", float(encoder.resolution), f"{axis_unit('m', sheet)}, seen: the values lie on such steps"
            )
        yield ""


def _controller(found: FirstController) -> Iterator[str]:
    yield "[controller]"
    if found.controller is None:
        yield _line("kind", "unknown", found.why)
        if found.estimate is not None:
            yield "# What a cascade would have, with 95 % intervals (docs/method/controller.md):"
            for gain in found.estimate.gains:
                if gain.determined and gain.name in _GAINS:
                    unit = "" if gain.unit == "1" else f" {gain.unit}"
                    yield f"# {gain.name} = {gain.value:.4g}  # {gain.low:.4g} to {gain.high:.4g}{unit}"
        yield ""
        return
    estimate = found.estimate
    assert estimate is not None
    yield _line("kind", found.controller.kind, f"seen: {found.why}")
    intervals = {
        gain.name: f", {gain.low:.4g} to {gain.high:.4g} {gain.unit}".removesuffix(" 1") for gain in estimate.gains
    }
    of_pd = isinstance(found.controller, PD)
    for name, value in controller_table(found.controller).items():
        if name != "kind":
            yield _line(name, value, f"seen{'' if of_pd else intervals.get(name, '')}{_MEANINGS.get(name, '')}")
    yield ""


def _limits(log: Log, sheet: DataSheet) -> Iterator[str]:
    low, high = float(np.min(log.position)), float(np.max(log.position))
    unit = axis_unit("m", sheet)
    yield "[limits]"
    yield f"# stroke = [{low:.4g}, {high:.4g}]  # {unit}, seen in this log; the axis may have more"
    yield ""


def _columns(trace: TraceGuess, reasons: Mapping[str, Guess]) -> Iterator[str]:
    yield "[columns]"
    for channel, column in trace.columns.items():
        yield _line(channel, column, _said(reasons.get(channel)))
    if trace.units:
        yield from ("", "[units]")
    for channel, unit in trace.units.items():
        value = float(unit) if channel.startswith("force_per") else unit
        yield _line(channel, value, _said(reasons.get(f"unit of the {channel}")))
