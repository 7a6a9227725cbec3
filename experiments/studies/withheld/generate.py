"""Cases as a user would have them, a drive file and two logs each; the key to them is written elsewhere."""

import dataclasses
import functools
import hashlib
import inspect
import json
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import numpy as np

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import write_axis
from diffdrive.controllers import PD, Cascade, Controller, PDGains, Tracking, UnknownController
from diffdrive.errors import DivergenceError, ParameterError
from diffdrive.logs import Log, write_log
from diffdrive.model.parameters import Sampling, Sensor
from diffdrive.model.trace import Trace
from diffdrive.motion.motion import Limits
from diffdrive.support.atomic_write import remove_temporary, write_text
from experiments.studies import control
from experiments.studies.withheld import axes, equations, faults, machine, motions, outsiders
from experiments.studies.withheld import draw as draws
from experiments.studies.withheld import truth as truths
from experiments.studies.withheld.axes import AXES, INSTEAD, StudyAxis
from experiments.studies.withheld.draw import WithheldCase, draw, log_faults, without_fault
from experiments.studies.withheld.faults import KNOWN, PITFALLS
from experiments.studies.withheld.machine import MOTOR_SHARE, run
from experiments.studies.withheld.outsiders import OUTSIDE, UNSEEN
from experiments.studies.withheld.records import CaseKey, Key
from experiments.studies.withheld.truth import true_parameters

NONE_SHARE, TWO_SHARE, UNKNOWN_SHARE, PITFALL_SHARE = 0.16, 0.16, 0.16, 0.05  # shares of cases
# a loose screw is an elastic one; and a spring beside a tilt is a spring that is neutral elsewhere
EQUIVALENT = ({"compliance", "backlash"}, {"constant_force", "position_spring"})
ATTEMPTS = 10  # at a machine whose loop is stable and whose effects are visible
MIN_CHANGE = 1.0  # of the noise of the position: what each of two effects must change of a log


def draw_effects(seed: int, count: int) -> list[tuple[str, ...]]:
    """Which effects each case has: every effect of the catalogue in turn, and none, two, and others mixed in."""
    rng = np.random.default_rng([seed, 0])
    names, pitfalls = list(KNOWN), list(PITFALLS)
    mixed: list[tuple[str, ...]] = [()] * round(NONE_SHARE * count)
    mixed += [_draw_pair(rng, names) for _ in range(round(TWO_SHARE * count))]
    unseen = rng.permutation(list(UNSEEN))
    mixed += [(str(unseen[k % len(unseen)]),) for k in range(round(UNKNOWN_SHARE * count))]
    remaining = count - len(mixed)
    with_pitfall = round(PITFALL_SHARE * count)
    singles: list[tuple[str, ...]] = [(names[k % len(names)],) for k in range(remaining - with_pitfall)]
    cases = [*mixed, *singles, *((pitfalls[k % len(pitfalls)],) for k in range(with_pitfall))]
    return [tuple(map(str, cases[k])) for k in rng.permutation(len(cases))]


def _draw_pair(rng: np.random.Generator, names: list[str]) -> tuple[str, ...]:
    """Two effects that a machine can have at once, and that are not equivalent."""
    while True:
        pair = tuple(map(str, rng.choice(names, 2, replace=False)))
        if set(pair) not in EQUIVALENT:
            return pair


def seen_on(effects: tuple[str, ...], axis: StudyAxis) -> tuple[str, ...]:
    """The effects that are drawn for an axis: a linear motor has no screw, and a scale beside a motor does not see its
    errors, but has waves too.
    """
    for absent in axis.absent:
        others = (name for name in INSTEAD[absent] if name not in effects)
        effects = tuple(next(others) if name == absent else name for name in effects)
    return effects


def _follows(case: WithheldCase, log: Log) -> bool:
    assert log.reference is not None
    behind = case.control.following_error(float(np.abs(np.diff(log.reference)).max() * log.rate))
    return bool(np.all(np.abs(log.position - log.reference) < 2e-3 + behind))


def _simulate_log(case: WithheldCase, log: int, peak: float | None = None) -> Log:
    inputs = case.inputs[log]
    faults, structure = log_faults(case, log, peak)
    seen = run(
        case.true, faults, structure, case.control, case.resolution, inputs, case.rate, case.samples,
        case.wind_up or 0.0,
    )  # fmt: skip
    row = slice(None, None, case.samples_a_row)
    return Log(
        "ab"[log], (np.arange(len(seen.position)) / case.rate)[row], seen.position[row], seen.command[row],
        reference=np.asarray(inputs.reference)[row], load=np.asarray(inputs.load)[row],
        motor_position=None if seen.motor is None else seen.motor[row],
    )  # fmt: skip


def _is_visible(case: WithheldCase, logs: list[Log], peak: float | None) -> bool:
    """Whether each of two effects changes a log: a limit that only noise exceeds cannot be found."""
    noise = np.hypot(case.noise, case.resolution / np.sqrt(12.0))

    def changes(number: int) -> bool:
        other = without_fault(case, number)
        differences = (_simulate_log(other, log, peak).position - logs[log].position for log in range(2))
        return any(np.sqrt(np.mean(np.square(difference))) >= MIN_CHANGE * noise for difference in differences)

    return len(case.faults) < 2 or all(changes(number) for number in range(len(case.faults)))


def _simulate_logs(case: WithheldCase) -> tuple[list[Log], float | None]:
    """Both logs; of a machine with a limit also the peak (N) below which it is set, that of the first log without."""
    limited = any(fault.effect == "force_limit" for fault in case.faults)
    peak = float(np.abs(_simulate_log(case, 0).command).max()) if limited else None
    return [_simulate_log(case, log, peak) for log in range(2)], peak


def key_of(case: WithheldCase, peak: float | None = None) -> CaseKey:
    """The key to a machine: its effects and their true parameters; `peak` (N) as in `draw.log_faults`."""
    return {
        "effects": [
            {
                "name": fault.effect,
                "size": fault.size,
                "outside": fault.effect in OUTSIDE,
                "true": true_parameters(case, fault, peak),
            }
            for fault in case.faults
        ],
        "rate": case.rate,
        "samples_a_row": case.samples_a_row,
        "pitfall": case.pitfall,
    }


def generate(
    folder: Path, parts: Path, seed: int, count: int, drive_axes: tuple[StudyAxis, ...] = (AXES["paper"],)
) -> Iterator[str]:
    """Write the cases that are not there yet, and to `parts` what the key says of each; yields the name of each.

    Each is a machine of one of the axes, in turn. Raises `ParameterError` where `parts` is of another seed or count,
    `DivergenceError` for a case that no attempt keeps on its reference.
    """
    parts.mkdir(parents=True, exist_ok=True)
    remove_temporary(parts)
    for number, effects in enumerate(draw_effects(seed, count)):
        name, axis = f"{number + 1:03d}", drive_axes[number % len(drive_axes)]
        effects = seen_on(effects, axis)
        drawn = {"seed": seed, "of": count, "axis": repr(axis), "by": source_digest()}
        part = parts / f"{name}.json"
        exists = part.exists() and (folder / name / "drive.toml").exists()
        if exists and json.loads(part.read_text(encoding="utf-8"))["drawn"] != drawn:
            raise ParameterError(
                f"{folder.parent}: holds machines of another seed, number or axis, or of other sources; choose another "
                "folder"
            )
        if not exists:
            case, logs, peak = _draw_followable(seed, number, effects, axis)
            write_text(part, json.dumps(key_of(case, peak) | {"drawn": drawn}, indent=1) + "\n")
            _write_case(folder / name, case, logs)
        yield name


@functools.cache
def source_digest() -> str:
    """A digest of the sources that draw and integrate machines: those of two editions are not one study."""
    parts = [
        inspect.getsource(module)
        for module in (
            axes,
            control,
            draws,
            equations,
            faults,
            machine,
            motions,
            outsiders,
            truths,
            sys.modules[__name__],
        )
    ]
    parts += [repr(AXES["paper"].drive), *(version(name) for name in ("diffrax", "jax", "jaxlib", "numpy"))]
    return hashlib.sha256("".join(parts).encode()).hexdigest()


def _draw_followable(
    seed: int, number: int, effects: tuple[str, ...], axis: StudyAxis
) -> tuple[WithheldCase, list[Log], float | None]:
    for attempt in range(ATTEMPTS):
        case = draw(np.random.default_rng([seed, 1 + number, attempt]), effects, axis)
        logs, peak = _simulate_logs(case)
        if all(_follows(case, log) for log in logs) and _is_visible(case, logs, peak):
            return case, logs, peak
    raise DivergenceError(f"case {number + 1} ({', '.join(effects)}) does not follow its reference or show its effects")


def _write_case(folder: Path, case: WithheldCase, logs: list[Log]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    remove_temporary(folder)
    for log in logs:
        write_log(folder / f"log-{log.name}.parquet", log)
    write_axis(folder / "drive.toml", _nominal_axis(case))  # the last: with it a case is there


def _nominal_axis(case: WithheldCase) -> Axis:
    drive = case.nominal
    if case.wind_up is not None:
        drive = dataclasses.replace(drive, motor_encoder=Sensor(MOTOR_SHARE * case.resolution, 0.0))
    trace = Trace(rate=case.rate / case.samples_a_row) if case.samples_a_row > 1 else Trace()
    return Axis(drive, _nominal_controller(case), Sampling(case.rate, 10), Limits(), trace=trace)


def _nominal_controller(case: WithheldCase) -> Controller:
    """As it is; of a trace slower than the loop it is unknown."""
    cascaded, kp, kv, ki, feedforward = map(float, case.control)
    if case.samples_a_row > 1:
        return UnknownController()
    if cascaded:
        return Cascade(kp, kv, ki, feedforward, velocity_samples=case.samples)
    return PD(Tracking(PDGains(kp, kv)))


def write_key(path: Path, parts: Path) -> Key:
    """The key, from what was kept of each case."""
    key: Key = {part.stem: json.loads(part.read_text(encoding="utf-8")) for part in sorted(parts.glob("*.json"))}
    write_text(path, json.dumps(key, indent=1) + "\n")
    return key
