"""`experiments.export`: the controller of an axis as code for its target, with a run to prove it by."""

from pathlib import Path

import numpy as np

from diffdrive.axis import Axis, require_axis
from diffdrive.errors import ParameterError
from diffdrive.loop.run import Run
from diffdrive.model.motor_units import axis_unit
from diffdrive.motion.motion import Motion
from diffdrive.simulation import simulate
from diffdrive.support.atomic_write import atomic_write
from diffdrive.support.messages import suggestion
from experiments.exports.compiled import replayed
from experiments.exports.fingerprint import fingerprint_of
from experiments.exports.names import checked_name, name_of
from experiments.exports.program import ExportError, Program
from experiments.exports.readme import readme_files
from experiments.exports.replay import Replay, replay_of
from experiments.exports.result import ExportResult
from experiments.exports.targets import TARGETS
from experiments.exports.trace import APPLIED, program_of

PRECISIONS = ("double", "single")
# of each output's largest value: a hundred times what roundings make of it (docs/how-to/export-a-controller.md)
DOUBLE_TOLERANCE = 1e-9
# single precision rounds elsewhere with every compiler; only what is an order of magnitude beyond is another law
SINGLE_MARGIN = 10.0


def export(
    axis: Axis,
    motion: Motion,
    folder: str | Path,
    *,
    target: str = "c99",
    name: str | None = None,
    precision: str = "double",
    load: np.ndarray | float = 0.0,
    machine: Axis | None = None,
) -> ExportResult:
    """Write the controller of an axis as code, and with it a simulated run that its bench replays.

    The code comes from the step that `simulate` runs, with all its parts: observer, load estimator, filters. Where this
    machine has a C compiler, C code is compiled and replayed at once, and the result says how far it agrees.

    Args:
        axis: The drive and its controller.
        motion: What the bench replays, [n] samples at the axis's rate.
        folder: Where the files go; made if need be.
        target: `c99`, `structured-text`, `fmu`, `hal`, or one of your own (`targets.register`).
        name: What every name in the code begins with; by default the axis's name.
        precision: `double` or `single`.
        load: Force on the guides in that run (N), one number or one per sample.
        machine: An axis whose drive is the machine in that run, as in `simulate`.

    Raises:
        ExportError: The controller's law is unknown, or uses what the target has not.
        ParameterError: No such target or precision, or the name is none.

    Examples:
        >>> lap = motion.sine(amplitude=1e-3, frequency=10.0, duration=0.5, rate=axis.rate)
        >>> export(axis, lap, "code").differences

    """
    require_axis(axis)
    if target not in TARGETS:
        raise ParameterError(f"target: no {target!r}; {suggestion(target, TARGETS)}")
    if precision not in PRECISIONS:
        raise ParameterError(f"precision: must be 'double' or 'single', got {precision!r}")
    single = precision == "single"
    prefix = name_of(axis.name) if name is None else checked_name(name)
    program = program_of(axis.controller, axis.sampling.period, prefix, single=single)
    program = program.in_units(lambda unit: axis_unit(unit, axis.sheet))
    run = simulate(axis, motion, load, machine=machine, throw=True)
    replay = replay_of(program, axis, motion, run)
    lost = _lost(replay, replay_of(program, axis, motion, run, single=True)) if single else {}
    tolerances = {one: SINGLE_MARGIN * lost[one] if single else DOUBLE_TOLERANCE for one in replay.outputs}
    described = TARGETS[target]
    files = described.write(program, f"{axis.name}: {motion.name}", replay, tolerances)
    differences = replayed(prefix, files) if described.has_c_bench else {}
    for one, difference in differences.items():
        if not difference <= tolerances[one]:
            raise ExportError(f"the compiled code's {one} differs from the simulation by {difference:.2g}: report it")
    notes = _notes(axis, program, run, lost)
    readme = readme_files(
        described,
        program,
        axis_name=axis.name,
        motion_name=motion.name,
        steps=len(replay.outputs["force"]),
        files=tuple(files),
        tolerances=tolerances,
        differences=differences,
        notes=notes,
    )
    files = {**files, **readme}
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    for file, content in files.items():
        with atomic_write(out / file) as stream:
            stream.write(content.encode("utf-8") if isinstance(content, str) else content)
    return ExportResult(
        target=target,
        folder=out,
        files=tuple(files),
        kind=program.kind,
        rate=axis.rate,
        fingerprint=fingerprint_of(program),
        precision=precision,
        steps=len(replay.outputs["force"]),
        differences=differences,
        lost=lost,
        next_command=described.next_command(prefix),
        notes=notes,
    )


def _lost(double: Replay, single: Replay) -> dict[str, float]:
    """The largest difference of each output between both precisions over its largest value."""
    losses = {}
    for name, exact in double.outputs.items():
        largest = float(np.max(np.abs(exact)))
        losses[name] = float(np.max(np.abs(single.outputs[name] - exact))) / (largest or 1.0)
    return losses


def _notes(axis: Axis, program: Program, run: Run, lost: dict[str, float]) -> tuple[str, ...]:
    """What a reader should know of it."""
    notes = list(run.notes)
    if program.single:
        farthest = np.float32(np.max(np.abs(run.reference)))
        step, resolution = float(np.spacing(farthest)), axis.drive.sensor.resolution
        beside = "" if resolution is None else f"; the scale has {1e9 * float(resolution):.3g} nm"
        notes.append(
            f"In single precision a position of {float(farthest):.3g} m has steps of {1e9 * step:.3g} nm{beside}. The "
            f"force differs by up to {lost['force']:.2g} of its largest."
        )
    if program.reads(APPLIED) and (axis.drive.actuator.delay_samples or axis.drive.actuator.delay_fraction):
        notes.append(
            "applied_force is the force that acts, not the command that was just given: feed back the measured one, or "
            "the command as late as the drive's delay."
        )
    return (*notes, *_unlimited(axis), *_pushed_at_rest(axis))


def _unlimited(axis: Axis) -> list[str]:
    """That the amplifier's limit is not the controller's."""
    limit = axis.drive.actuator.force_limit
    if limit is None or getattr(axis.controller, "force_limit", None) is not None:
        return []
    said = (
        f"The code does not limit the command: the drive file's {float(limit):.4g} {axis_unit('N', axis.sheet)} are "
        "the amplifier's"
    )
    if hasattr(axis.controller, "force_limit"):
        return [
            f"{said}, and an integral goes on there. Limit the command before it, or give [controller] a force_limit."
        ]
    return [f"{said}. Limit the command before it."]


def _pushed_at_rest(axis: Axis) -> list[str]:
    """That an axis which its friction does not hold moves at first: a controller begins without force."""
    force = float(axis.drive.plant.constant_force)
    held = axis.drive.friction.coulomb_at(0.0)
    if abs(force) <= float(held.negative if force < 0.0 else held.positive):
        return []
    return [
        f"A constant force of {force:.4g} {axis_unit('N', axis.sheet)} acts, and friction does not hold it: after a "
        "reset the command begins at zero, and the axis moves until the controller has built up as much. Open the "
        "brake only then, or add that force to the command."
    ]
