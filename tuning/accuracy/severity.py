"""`tuning.severity`: what an axis's unmodelled effects cost of its accuracy, and which of them to mend first."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive.axis import Axis, require_axis
from diffdrive.effects.base import Effect
from diffdrive.effects.catalogue import part_of
from diffdrive.errors import ParameterError
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.parameters import Drive
from diffdrive.motion.motion import Motion
from diffdrive.results import Status
from diffdrive.support.bounds import require_number
from tuning.accuracy.circle import Circle, circle_between, last_turn, radial_deviations, roundness
from tuning.accuracy.positioning import DWELL, Visits, deviations, positioning, positioning_motion, targets_within
from tuning.accuracy.result import AS_IT_IS, SOUND, Accuracy, SeverityResult, Without
from tuning.progress import Progress, reporting

STROKE_SHARE = 0.9  # of the stroke, about its middle: the test stays clear of its ends
LONGEST = 16 * DWELL  # s of rest, after which an axis that still moves is taken as it is
AT_REST = 1e-9  # m, or the step of the scale, if that is more: by how much less a longer rest may still move the table
TWO_METRES, ONE_TURN = 2.0, 2.0 * np.pi  # m and rad, beyond which ISO 230-2 has another test


class _Motions(NamedTuple):
    """The motions of both tests."""

    positioning: Motion
    visits: Visits
    circle: Circle | None  # None of a rotary axis


def severity(
    axis: Axis,
    *,
    tolerance: float | None = None,
    stroke: tuple[float, float] | None = None,
    speed: float | None = None,
    acceleration: float | None = None,
    load: float = 0.0,
    seed: int | None = 0,
    progress: Progress | None = None,
) -> SeverityResult:
    """What each unmodelled effect of an axis costs of its accuracy, and which part to look at first.

    The axis goes through the positioning test of ISO 230-2 and, if it is linear, the circular test of ISO 230-4, both
    simulated: as it is, without each of its effects in turn, and without any. What an effect costs is what the axis
    would gain if that one were mended; two that hide one another have less alone than together.
    Method: docs/method/severity.md.

    Args:
        axis: With the effects that were found, as `DiagnosisResult.axis`; its controller is stated.
        tolerance: What accuracy A and circular deviation G may be (m; rad of a rotary axis).
        stroke: Of the tests, lowest and highest position (m); by default the middle 90 % of the axis's stroke.
        speed: Of the tests (m/s); by default the axis's limit.
        acceleration: Of the tests (m/s^2); by default the axis's limit.
        load: Force on the guides (N).
        seed: Of the noise of the encoders (None: no noise).
        progress: Called with (stage, done, of how many).

    Raises:
        ParameterError: The axis has no effect, its controller is not stated, or neither it nor the call limits the
            motion.
        MotionError: The axis cannot do the motion.
        DivergenceError: A loop diverged.
        ResultError: The force limit held back most of the commands.

    Examples:
        >>> found = severity(why.axis, tolerance=5e-6)
        >>> print(found)

    """
    require_axis(axis)
    if not axis.controller.can_simulate:
        raise ParameterError("severity: the axis's controller is not stated: add its [controller] to the drive file")
    if not axis.drive.effects:
        raise ParameterError(
            "severity: the axis has no unmodelled effect, so none costs anything: take the axis of a diagnosis, or add "
            "one with Axis.with_effects"
        )
    if tolerance is not None:
        require_number("tolerance", tolerance, "m", above=0.0)
    effects = axis.drive.effects
    test, notes = _test_of(axis, stroke, speed, acceleration, load)
    machines: list[tuple[str, Sequence[Effect]]] = [
        *((one.name, [one]) for one in effects),
        (SOUND, effects),
    ]
    with reporting(progress) as tell:
        stage, many = "severity", 1 + len(machines)
        sound = _mended(axis.drive, effects)
        other = None if test.circle is None else _turn(axis, sound, test.circle, load, seed)
        circles: dict[str, Float[np.ndarray, "2 t"]] = {}

        def measured(name: str, number: int, machine: Drive) -> Accuracy:
            tell(stage, number, many)
            found = positioning(deviations(_table(axis, machine, test.positioning, load, seed), test.visits))
            if test.circle is None or other is None:
                return Accuracy(*found, None, None)
            turn = _turn(axis, machine, test.circle, load, seed)
            circles[name] = radial_deviations(turn, other)
            return Accuracy(*found, *roundness(turn, other))

        as_it_is = measured(AS_IT_IS, 0, axis.drive)
        rows = [
            Without(name, _parts(mended), measured(name, number, _mended(axis.drive, mended)))
            for number, (name, mended) in enumerate(machines, 1)
        ]
        tell(stage, many, many)
    return SeverityResult(
        as_it_is=as_it_is, without=tuple(rows), tolerance=tolerance, is_rotary=axis.sheet.is_rotary,
        stroke=(float(test.positioning.position.min()), float(test.positioning.position.max())),
        status=Status(True), notes=notes, circles=circles,
    )  # fmt: skip


def _test_of(
    axis: Axis, stroke: tuple[float, float] | None, speed: float | None, acceleration: float | None, load: float
) -> tuple[_Motions, tuple[str, ...]]:
    """The motions, and notes; raises `ParameterError` where nothing says how far and how fast.

    The rest at a target is doubled until the machine without effects, without noise, is found where it was.
    """
    limits = axis.limits
    low, high = limits.stroke if stroke is None else stroke
    given = {
        "stroke": (high - low, "limits.stroke"),
        "speed": (limits.speed if speed is None else speed, "limits.speed"),
        "acceleration": (limits.acceleration if acceleration is None else acceleration, "limits.acceleration"),
    }
    for name, (value, key) in given.items():
        if not np.isfinite(value):
            raise ParameterError(
                f"severity: give {name}, or state {key} in the drive file: it limits the tests' motion"
            )
        require_number(name, value, above=0.0)
    if stroke is None:
        middle, half = 0.5 * (low + high), 0.5 * STROKE_SHARE * (high - low)
        low, high = middle - half, middle + half
    fastest, hardest = given["speed"][0], given["acceleration"][0]
    targets = targets_within(low, high, axis.sheet.is_rotary)
    circle = None if axis.sheet.is_rotary else circle_between(low, high, fastest, hardest, axis.rate)
    notes = []
    if high - low > (ONE_TURN if axis.sheet.is_rotary else TWO_METRES):
        most = "a turn" if axis.sheet.is_rotary else "2 m"
        notes.append(f"ISO 230-2 has another test for strokes beyond {most}: A, E, R and B are not those of acceptance")
    sound, dwell, before = _mended(axis.drive, axis.drive.effects), DWELL, None
    resolution = axis.drive.sensor.resolution
    still = max(AT_REST, 0.0 if resolution is None else float(resolution))
    while True:
        motion, visits = positioning_motion(targets, low, high, fastest, hardest, axis.rate, dwell)
        now = deviations(_table(axis, sound, motion, load, None), visits)
        moved = np.inf if before is None else float(np.max(np.abs(now - before[1])))
        if moved <= still and before is not None:
            return _Motions(*before[0], circle), tuple(notes)  # the shorter rest does
        if dwell >= LONGEST:
            notes.append(
                f"the table does not come to rest: it still moves by {1e6 * moved:.2g} µm from {dwell / 2:g} s of rest "
                f"to {dwell:g} s, which is in A, E, R and B"
            )
            return _Motions(motion, visits, circle), tuple(notes)
        before, dwell = ((motion, visits), now), 2.0 * dwell


def _parts(effects: Sequence[Effect]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(part_of(one) for one in effects))


def _mended(drive: Drive, mended: Sequence[Effect]) -> Drive:
    """The machine with these effects at their defaults, where they do nothing: one program serves all machines."""
    effects = tuple(type(one)() if any(one is other for other in mended) else one for one in drive.effects)
    return dataclasses.replace(drive, effects=effects)


def _table(axis: Axis, machine: Drive, motion: Motion, load: float, seed: int | None) -> Float[np.ndarray, " n"]:
    run = simulate_loop(machine, axis.controller, motion, load, sampling=axis.sampling, limits=axis.limits, seed=seed)
    return run.require_ok().table_position


def _turn(axis: Axis, machine: Drive, circle: Circle, load: float, seed: int | None) -> Float[np.ndarray, " t"]:
    return last_turn(_table(axis, machine, circle.motion, load, seed), circle)
