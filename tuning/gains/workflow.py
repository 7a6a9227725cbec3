"""`tuning.tune`: gains by gradient within requirements, proved on what they were not tuned on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffdrive.axis import Axis
from diffdrive.controllers import Controller, FrictionCompensation
from diffdrive.errors import ParameterError
from diffdrive.loop.margins import NEUTRAL_GROWTH, Margins
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Friction, Sampling, as_arrays
from diffdrive.motion.motion import Motion
from diffdrive.results import Result, Status
from tuning.gains.objective import Objective
from tuning.gains.plan import ScenarioResult, TuningPlan, held_out_scenarios, machines, run_scenario, training_scenarios
from tuning.gains.requirements import MAX_GAIN_MARGIN, Constraints, LoopLimits, check_limits, operating_points
from tuning.gains.scenarios import Ensemble, Scenario, ensemble
from tuning.gains.tune import STARTS, GainSearch, default_space, gain_factors, require_starts
from tuning.gains.tune import tune as search_gains
from tuning.optimisation.space import SearchSpace
from tuning.progress import Progress, reporting

SPEEDS = (0.0, 1e-3, 3e-3, 1.0, 2.0)  # m/s, where margins are looked at; from 1 on, times the speed tuned at
NOISE_TOLERANCE = 1.05  # times the limit of the command noise: more on the exact simulator is said
DEFAULT_NOISE_FACTOR, DEFAULT_LOAD_ERROR_FACTOR = (
    2.0,
    1.1,
)  # times the command noise, and the load error, of the gains as given: where no limit is told
Role = Literal["tuned on", "held out"]


@dataclass(frozen=True)
class Requirements:
    """What the tuned loop must keep, at every speed, direction and load; None: not required.

    Margins are those of the linearised loop, delay and observer included. `command_noise` is the RMS of the command's
    change from sample to sample over the square root of two; by default twice that of the gains as given. `load_error`
    is the RMS error of the load estimate; by default 1.1 times that of the gains as given, scenario by scenario.
    """

    gain_margin: float = 6.0  # dB, up and down
    phase_margin: float = 30.0  # deg
    peak_sensitivity: float | None = None  # largest |1 / (1 + L)|
    command_noise: float | None = None  # N
    load_error: float | None = None  # N
    load_settling: float | None = 2.0  # s, in which an estimator as eq. (20) forgets an error of the load to 1/e

    def limits(self) -> LoopLimits:
        """As factors and radians; raises `ParameterError` for what no loop can keep."""
        if not 0.0 <= self.gain_margin <= MAX_GAIN_MARGIN:
            raise ParameterError(
                f"gain_margin: must be from 0 to {MAX_GAIN_MARGIN:.0f} dB, got {self.gain_margin:g}; 6 to 12 are usual"
            )
        factor = 10.0 ** (self.gain_margin / 20.0)
        required = LoopLimits(
            gain_up=factor, gain_down=factor, phase=float(np.radians(self.phase_margin)),
            sensitivity=self.peak_sensitivity, command_noise=self.command_noise, load_error=self.load_error,
            settling=self.load_settling,
        )  # fmt: skip
        check_limits(required)
        return required


class TuningSetup(NamedTuple):
    """A tuning before its search: what it is tuned on and verified on, what is free, and what is required."""

    training: list[Scenario]
    held_out: list[Scenario]
    lanes: Ensemble
    limits: LoopLimits
    constraints: Constraints
    space: SearchSpace
    speeds: tuple[float, ...]  # m/s, at which margins are looked at
    notes: tuple[str, ...]


def set_up(axis: Axis, plan: TuningPlan, required: LoopLimits, *, friction: bool = False) -> TuningSetup:
    """Scenarios, constraints and search space of a tuning as planned. Raises `ParameterError` and `MotionError`."""
    check_limits(required)
    if friction and not isinstance(axis.controller, FrictionCompensation):
        raise ParameterError("friction: this controller observes no friction that could be tuned along")
    training, held_out_runs = training_scenarios(axis, plan), held_out_scenarios(axis, plan)
    coarse = Sampling(axis.rate, max(2, -(-axis.sampling.plant_steps // 2)))
    lanes = ensemble(training, coarse, settle=plan.settle)
    required, notes = _with_default_limits(axis, required, training, plan.settle)
    speeds = margin_speeds(plan)
    grid = operating_points([axis.drive], speeds, (plan.min_load, plan.max_load))
    space = default_space(axis.controller, friction=friction)
    if left := sorted(
        gain_factors(axis.controller, friction=friction).keys() - {parameter.path for parameter in space.free}
    ):
        notes.append(f"0 in the drive file, and so not tuned, since no factor leads away from it: {', '.join(left)}.")
    return TuningSetup(
        training, held_out_runs, lanes, required, Constraints(required, grid, coarse), space, speeds, tuple(notes)
    )


def _with_default_limits(
    axis: Axis, required: LoopLimits, training: Sequence[Scenario], settle: float
) -> tuple[LoopLimits, list[str]]:
    """Limits that were not given, from what the gains as given do; and what to say of them."""
    notes = []
    before = [run_scenario(axis.controller, scenario, axis.sampling, settle) for scenario in training]
    if required.command_noise is None:
        noise = DEFAULT_NOISE_FACTOR * max(result.command_noise for result in before)
        required = required._replace(command_noise=noise)
        notes.append(
            f"Command noise is limited to {DEFAULT_NOISE_FACTOR:g} times that of the gains as given: {noise:.3g} N."
        )
    if required.load_error is None and before[0].load_error is not None:
        errors = np.array(
            [1e3 * DEFAULT_LOAD_ERROR_FACTOR * result.load_error for result in before if result.load_error is not None]
        )
        required = required._replace(load_error=errors)
        notes.append(
            f"The load error in each scenario is limited to {DEFAULT_LOAD_ERROR_FACTOR:g} times that of the gains as "
            "given."
        )
    return required, notes


def margin_speeds(plan: TuningPlan) -> tuple[float, ...]:
    """The speeds (m/s) at which margins are looked at."""
    return tuple(speed if speed < 1.0 else speed * plan.top_speed for speed in SPEEDS)


@eqx.filter_jit
def _margins(constraints: Constraints, controller: Controller) -> Margins:
    return constraints.margins(controller)


class ControllerMargins(NamedTuple):
    """The margins of one controller, at the operating points that it was tuned at, and at others."""

    training: Margins
    held_out: Margins


def margins_at(axis: Axis, controllers: Sequence[Controller], plan: TuningPlan) -> list[ControllerMargins]:
    """Margins of each controller, also on a machine, at loads and at speeds that were not tuned on."""
    other = machines(axis.drive, 2, plan.spread, plan.seed + 1000)[1]
    low, high = plan.min_load, plan.max_load
    between = [0.3e-3, 0.5 * plan.top_speed, 100e-3 if plan.top_speed < 50e-3 else 2.0 * plan.top_speed]
    tuned_at = operating_points([axis.drive], margin_speeds(plan), (low, high))
    others = operating_points([other, axis.drive], between, (low + 0.25 * (high - low), low + 0.75 * (high - low)))
    count = len(tuned_at.velocity)
    everywhere = jax.tree.map(lambda *ends: jnp.concatenate(ends), tuned_at, others)
    constraints = Constraints(LoopLimits(), everywhere, axis.sampling)
    found = [_margins(constraints, as_arrays(smooth(controller))) for controller in controllers]
    parts = slice(None, count), slice(count, None)
    return [
        ControllerMargins(*(jax.tree.map(lambda values, part=part: values[part], margins) for part in parts))
        for margins in found
    ]


class ScenarioComparison(NamedTuple):
    """One scenario on the exact (quantised, limited) simulator, with the gains as given and as tuned."""

    scenario: Scenario
    role: Role
    before: ScenarioResult
    after: ScenarioResult


def verify(axis: Axis, after: Controller, prepared: TuningSetup, settle: float) -> list[ScenarioComparison]:
    """Every scenario, tuned on and held out, on the exact simulator."""
    roles: tuple[tuple[Role, list[Scenario]], ...] = (("tuned on", prepared.training), ("held out", prepared.held_out))
    return [
        ScenarioComparison(
            scenario,
            role,
            run_scenario(axis.controller, scenario, axis.sampling, settle),
            run_scenario(after, scenario, axis.sampling, settle),
        )
        for role, several in roles
        for scenario in several
    ]


def tuned_axis(axis: Axis, controller: Controller) -> Axis:
    """The axis with tuned gains: its friction is what observers believe, tuned along or not."""
    friction = getattr(getattr(controller, "observer", None), "friction", None)
    drive = axis.drive
    if isinstance(friction, Friction):
        drive = replace(drive, friction=friction)
    return replace(axis, drive=drive, controller=controller)


def noise_warning(prepared: TuningSetup, runs: Sequence[ScenarioComparison]) -> str:
    """What to say where the exact simulator is noisier than the smooth one on which the limit was kept; "" else."""
    limit, noisiest = prepared.limits.command_noise, max(run.after.command_noise for run in runs)
    if limit is None or noisiest <= NOISE_TOLERANCE * limit:
        return ""
    return (
        f"On the exact simulator the command noise is up to {noisiest:.3g} N: the limit of {limit:.3g} N is kept on "
        "the smooth one, in which the steps of the scale are white noise. Ask for a lower --noise."
    )


def is_accepted(tuned: GainSearch, runs: Sequence[ScenarioComparison]) -> bool:
    """Whether every requirement is kept, and every verification run ok."""
    done = not tuned.status.startswith("interrupted")
    return done and tuned.feasible and all(run.after.run.status.ok for run in runs)


class ErrorComparison(NamedTuple):
    """What the tuned gains do in some scenarios on the exact simulator: means over them, and the largest peak."""

    rms_before: float  # m
    rms_after: float
    peak_before: float  # m
    peak_after: float
    command_noise_before: float  # N
    command_noise_after: float

    @classmethod
    def of(cls, runs: Sequence[ScenarioComparison]) -> "ErrorComparison":
        """Of these scenarios."""

        def mean(which: str, of: str) -> float:
            return float(np.mean([getattr(getattr(run, which), of) for run in runs]))

        def largest(which: str) -> float:
            return 1e-6 * max(getattr(run, which).peak for run in runs)

        return cls(
            1e-6 * mean("before", "rms"), 1e-6 * mean("after", "rms"), largest("before"), largest("after"),
            mean("before", "command_noise"), mean("after", "command_noise"),
        )  # fmt: skip


class WorstMargins(NamedTuple):
    """The smallest margins over speeds, directions and loads; infinite where none bounds the loop."""

    gain_margin: float  # dB, the smaller of up and down
    phase_margin: float  # deg
    peak_sensitivity: float
    stable: bool

    @classmethod
    def of(cls, margins: Margins) -> "WorstMargins":
        """Over all operating points."""
        gain = float(np.min([np.min(margins.gain_up), np.min(margins.gain_down)]))
        return cls(
            20.0 * float(np.log10(gain)), float(np.degrees(np.min(margins.phase))),
            float(np.max(margins.sensitivity)), bool(np.max(margins.growth) < NEUTRAL_GROWTH),
        )  # fmt: skip


@dataclass(frozen=True, repr=False, eq=False)
class TuningResult(Result):
    """Tuned gains, and what they are worth.

    `accepted`: every requirement is kept, and every run of the verification is ok; `axis` then has the gains.
    `tuned_on` and `held_out` compare them with the gains as given on the exact simulator, the latter in scenarios
    (loads, speeds, a machine, noise) that were not tuned on; `margins` are the worst that remain. `gains` are (before,
    after) by name. `search` has the search, `runs` every run; `initial_axis` is the axis before, `plan` and `limits`
    how it was tuned.
    """

    axis: Axis
    accepted: bool
    gains: Mapping[str, tuple[float, float]]
    tuned_on: ErrorComparison
    held_out: ErrorComparison
    margins: WorstMargins
    search: GainSearch
    runs: tuple[ScenarioComparison, ...]
    notes: tuple[str, ...]
    initial_axis: Axis
    plan: TuningPlan
    limits: LoopLimits
    status: Status

    schema: ClassVar[str] = "tuning/1"

    def headline(self) -> str:
        verdict = "accepted" if self.accepted else f"NOT ACCEPTED: {self.status.message}"
        before, after = self.held_out.rms_before, self.held_out.rms_after
        return (
            f"{verdict}; held out {1e6 * before:.3g} -> {1e6 * after:.3g} µm RMS, {self.margins.phase_margin:.3g} deg"
        )

    def summary(self) -> str:
        rows = [f"{'':<10}{'RMS µm':>18}{'peak µm':>18}{'command noise N':>20}"]
        for name, comparison in (("tuned on", self.tuned_on), ("held out", self.held_out)):
            rms, peak = (
                f"{1e6 * comparison[0]:.3g} -> {1e6 * comparison[1]:.3g}",
                f"{1e6 * comparison[2]:.3g} -> {1e6 * comparison[3]:.3g}",
            )
            noise = f"{comparison[4]:.3g} -> {comparison[5]:.3g}"
            rows.append(f"{name:<10}{rms:>18}{peak:>18}{noise:>20}")
        margins = self.margins
        rows.append(
            f"margins: {margins.gain_margin:.3g} dB, {margins.phase_margin:.3g} deg, "
            f"peak sensitivity {margins.peak_sensitivity:.3g}"
        )
        rows += [f"{name:<12}{was:>12.5g} -> {now:.5g}" for name, (was, now) in self.gains.items()]
        return "\n".join([self.headline(), *rows, *(f"- {note}" for note in self.notes)])

    def as_dict(self) -> dict[str, object]:
        return {
            "accepted": self.accepted,
            "gains": {name: {"before": was, "after": now} for name, (was, now) in self.gains.items()},
            "tuned_on": self.tuned_on._asdict(),
            "held_out": self.held_out._asdict(),
            "margins": self.margins._asdict(),
            "notes": list(self.notes),
        }


def tune(
    axis: Axis,
    motion: Motion | None = None,
    *,
    loads: tuple[float, float] = (0.0, 12_600.0),
    requirements: Requirements = Requirements(),
    objective: Objective = Objective(),
    friction: bool = False,
    spread: float = 0.03,
    machines: int = 2,
    settle: float | None = None,
    starts: int = STARTS,
    seed: int = 0,
    max_steps: int = 40,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> TuningResult:
    """Tune the gains of an axis's controller, and verify them on what they were not tuned on.

    The gains minimise the `objective` within the `requirements`, over loads, speeds and machines. Method:
    docs/method/tuning.md.

    Args:
        axis: The drive, and the controller with the gains to start from.
        motion: What it is tuned on, at the axis's rate; by default a reversal at 10 mm/s.
        loads: Lowest and highest force on the guides (N).
        requirements: Margins, command noise and load error that the tuned loop must keep.
        objective: What is minimised; by default the RMS tracking error.
        friction: Tune what the observer believes of the friction along.
        spread: Relative difference of the machines' parameters from the axis's.
        machines: How many machines it is tuned on, the axis's own among them.
        settle: From when on errors count (s); by default a third of the motion, at most 0.4 s.
        starts: Starting points of the search.
        seed: Of the machines, the noise, and the starting points.
        max_steps: Steps of each search.
        checkpoint: A file from which an interrupted call continues.
        progress: Called with (stage, done, of how many).
        throw: Raise an error where the result is not accepted.

    Raises:
        ParameterError: What is asked for cannot be tuned, or kept by any loop.
        MotionError: The motion leaves the axis's limits.
        ResultError: The result is not accepted, with `throw`.

    Examples:
        >>> best = tune(axis, lap, requirements=Requirements(phase_margin=35.0))
        >>> best.held_out.rms_after, best.margins.phase_margin
        >>> best.axis.write("tuned.toml")

    """
    low, high = loads
    if not 0.0 <= low < high:
        raise ParameterError(f"loads: give the lowest and the highest in N, such as (0.0, 12_600.0), got {loads!r}")
    plan = TuningPlan(max_load=high, min_load=low, spread=spread, machines=machines, seed=seed, motion=motion)
    if settle is not None or motion is not None:
        third = 0.0 if motion is None else motion.duration / 3.0
        plan = replace(plan, settle=min(plan.settle, third) if settle is None else settle)
    require_starts(starts)
    with reporting(progress) as tell:
        prepared = set_up(axis, plan, requirements.limits(), friction=friction)
        tuned = search_gains(
            axis.controller, prepared.lanes, prepared.constraints, prepared.space, objective=objective, starts=starts,
            seed=seed, max_steps=max_steps, checkpoint=checkpoint,
            progress=lambda step, most, _: tell("tuning by gradient", step, most),
        )  # fmt: skip
        tell("verifying on the exact simulator", 0, 1)
        (margins,) = margins_at(axis, [tuned.controller], plan)
        runs = verify(axis, tuned.controller, prepared, plan.settle)
        tell("verifying on the exact simulator", 1, 1)
    result = tuning_result(axis, plan, prepared, tuned, margins, runs)
    return result.require_ok() if throw else result


def tuning_result(
    axis: Axis,
    plan: TuningPlan,
    prepared: TuningSetup,
    tuned: GainSearch,
    margins: ControllerMargins,
    runs: Sequence[ScenarioComparison],
) -> TuningResult:
    """The result, with what is to be said of it."""
    accepted = is_accepted(tuned, runs)
    notes = [*prepared.notes, *(note for note in [noise_warning(prepared, runs)] if note), *remarks(tuned)]
    bad = [f"{run.scenario.name}: {run.after.run.status.message}" for run in runs if not run.after.run.status.ok]
    names = {gain.path: name for name, gain in axis.controller.tunables.items()}
    gains = {
        names.get(free.path, free.path): (float(was), float(now))
        for free, was, now in zip(prepared.space.free, tuned.before, tuned.after, strict=True)
    }
    code = "ok" if accepted else "interrupted" if tuned.status.startswith("interrupted") else "not_accepted"
    message = tuned.status if accepted or not bad else bad[0]
    return TuningResult(
        axis=replace(tuned_axis(axis, tuned.controller), name="tuned"),
        accepted=accepted,
        gains=gains,
        tuned_on=ErrorComparison.of([run for run in runs if run.role == "tuned on"]),
        held_out=ErrorComparison.of([run for run in runs if run.role == "held out"]),
        margins=WorstMargins.of(margins.training),
        search=tuned,
        runs=tuple(runs),
        notes=(*notes, *bad),
        initial_axis=axis,
        plan=plan,
        limits=prepared.limits,
        status=Status(accepted, message, code=code),
    )


def remarks(tuned: GainSearch) -> list[str]:
    """What stood in the way of better gains."""
    found = [f"At the bound of its range: {', '.join(tuned.at_bound)}."] if tuned.at_bound else []
    found += [
        f"Held back by the {requirement.name}: 1 % more of it would gain {requirement.gain:.2g} % of the objective."
        for requirement in tuned.binding
    ]
    mend = "no gains near these keep it: relax it" if tuned.status.startswith("infeasible") else "search on"
    found += [f"NOT KEPT: {name}, missed by {100 * share:.3g} %; {mend}." for name, share in tuned.violated.items()]
    return found
