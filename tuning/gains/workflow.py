"""`tuning.tune`: gains by gradient within requirements, proved on what they were not tuned on."""

from collections.abc import Sequence
from pathlib import Path

from diffdrive.axis import Axis, require_axis
from diffdrive.frequency.response import FrequencyResponse
from diffdrive.motion.motion import Motion, require_motion
from diffdrive.support.bounds import require_a
from tuning.gains.measured import measured_margins_of, responses_of
from tuning.gains.objective import Objective
from tuning.gains.plan import SETTLE, SPREAD, TuningPlan, spread_of
from tuning.gains.requirements import Requirements
from tuning.gains.result import TuningResult, tuning_result
from tuning.gains.setup import set_up
from tuning.gains.tune import MAX_STEPS, STARTS, SearchOptions
from tuning.gains.tune import tune as search_gains
from tuning.gains.verification import margins_at, verify
from tuning.progress import Progress, reporting, searching


def tune(
    axis: Axis,
    motion: Motion | None = None,
    *,
    speed: float = 0.010,
    loads: tuple[float, float] = (0.0, 0.0),
    load_steps: int = 4,
    requirements: Requirements = Requirements(),
    objective: Objective = Objective(),
    measured: FrequencyResponse | Sequence[FrequencyResponse] = (),
    friction: bool = False,
    spread: str | float | None = None,
    machines: int = 2,
    settle: float | None = None,
    starts: int = STARTS,
    seed: int = 0,
    max_steps: int = MAX_STEPS,
    resume: str | Path | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> TuningResult:
    """Tune the gains of an axis's controller, and verify them on what they were not tuned on.

    The gains minimise the `objective` within the `requirements`, over loads, speeds and machines. Method:
    docs/method/tuning.md.

    Args:
        axis: The drive, and the controller with the gains to start from.
        motion: What it is tuned on, at the axis's rate; by default a reversal at `speed`.
        speed: Of that reversal (m/s).
        loads: Lowest and highest force on the guides (N), beside the table's own; none by default.
        load_steps: Loads that it is tuned under, evenly spaced between these two; at least 2 where they differ.
        requirements: Margins, command noise and load error that the tuned loop must keep.
        objective: What is minimised; by default the RMS tracking error.
        measured: A measured frequency response of the machine, or several, such as along its stroke: the margins are
            kept in the loops with these in the place of the model's plant, too, within their bands. Of a closed loop it
            was measured with the gains of `axis`.
        friction: Tune what the observer believes of the friction along.
        spread: Relative deviation of the machines' parameters from the axis's, such as `"3%"` or 0.03; at most 0.5. By
            default they are drawn by the `uncertainty` of the axis, and by 3 % where that does not name them.
        machines: How many machines it is tuned on, the axis's own among them.
        settle: From when on errors count (s); by default a third of the motion, at most 0.4 s.
        starts: Starting points of the search.
        seed: Of the machines, the noise, and the starting points.
        max_steps: Steps of each search.
        resume: A folder in which what is finished is kept, from which the same call continues.
        progress: Called with (stage, done, of how many).
        throw: Raise an error where the result is not accepted.

    Raises:
        ParameterError: What is required cannot be tuned, kept by any loop, or judged of this controller.
        MotionError: The motion leaves the axis's limits.
        CheckpointError: What is in the folder `resume` is of another call.
        ResultError: The result is not accepted, with `throw`.

    Examples:
        >>> best = tune(axis, lap, loads=(0.0, 8_000.0), requirements=Requirements(phase_margin=35.0))
        >>> best.held_out.rms_after, best.margins.phase_margin
        >>> best.axis.write("tuned.toml")

    """
    require_axis(axis)
    if motion is not None:
        require_motion(motion)
    require_a(Requirements, "requirements", requirements)
    require_a(Objective, "objective", objective)
    responses = responses_of(measured)
    if settle is None:
        settle = SETTLE if motion is None else min(SETTLE, motion.duration / 3.0)
    plan = TuningPlan(
        speed=speed, loads=loads, load_steps=load_steps, spread=SPREAD if spread is None else spread_of(spread),
        machines=machines, seed=seed, motion=motion, settle=settle,
        uncertainty=axis.uncertainty if spread is None else None,
    )  # fmt: skip
    options = SearchOptions(starts, seed, max_steps)
    with reporting(progress) as advance:
        prepared = set_up(axis, plan, requirements, objective, friction=friction, measured=responses)
        with searching(advance, f"tuning {len(prepared.space.names)} gains by gradient") as step:
            tuned = search_gains(
                axis.controller, prepared.lanes, prepared.constraints, prepared.space, objective=objective,
                options=options, resume=resume, progress=step,
            )  # fmt: skip
        advance("verifying on the exact simulator", 0, 1)
        margins = margins_at(axis, [axis.controller, tuned.controller], plan)
        of_measured = measured_margins_of(axis, tuned.controller, responses, plan.top_speed, plan.loads[0])
        runs = verify(axis, tuned.controller, prepared, plan.settle)
        advance("verifying on the exact simulator", 1, 1)
    result = tuning_result(axis, plan, prepared, objective, options, tuned, margins, runs, of_measured)
    return result.require_ok() if throw else result
