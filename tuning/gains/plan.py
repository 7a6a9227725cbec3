"""What a drive is tuned on and what it is verified on: motions, loads, machines and noise, none of them in both."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float

from diffdrive.axis import Axis
from diffdrive.controllers import Controller
from diffdrive.controllers.base import require_rate
from diffdrive.errors import MotionError, ParameterError
from diffdrive.loop import metrics
from diffdrive.loop.run import Run
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.model.quantity import quantities, with_nodes
from diffdrive.model.uncertainty import Uncertainty
from diffdrive.motion import load
from diffdrive.motion.builders import triangular
from diffdrive.motion.load import validated_load
from diffdrive.motion.motion import Limits, Motion, require_within
from diffdrive.motion.text import share
from diffdrive.numerics.arrays import as_arrays
from diffdrive.numerics.pipeline import require_shorter
from diffdrive.support.bounds import require_count, require_number
from diffdrive.support.messages import short_repr
from tuning.gains.scenarios import Scenario
from tuning.gains.uncertain_machine import uncertain_values

OFF_GRID_FACTOR = 1.0137  # at a whole number of quanta a period a quantised loop locks on its grid
HELD_OUT_SPEEDS = (0.7, 2.0)  # times the speed tuned at
SETTLE = 0.4  # s: load estimators have found their load by then
DURATION = 1.2  # s
SPREAD = 0.03  # of parameters of which nothing is known
MAX_SPREAD = 0.5
HELD_OUT_SEED = 1000  # beyond the seed of the machines tuned on


@dataclass(frozen=True)
class TuningPlan:
    """How a tuning is set up; loads in N, speed in m/s, `spread` the relative uncertainty of machine parameters.

    What the `uncertainty` names of these is drawn by that in the place of the spread. The `motion` is a reversal at
    `speed`, unless one is given; what counts of it begins after `settle` (s).
    """

    speed: float = 0.010
    loads: tuple[float, float] = (0.0, 0.0)  # the lowest and the highest
    load_steps: int = 4  # evenly spaced between them
    spread: float = SPREAD
    machines: int = 2  # nominal, and others drawn within the spread
    seed: int = 0
    motion: Motion | None = None
    settle: float = SETTLE
    uncertainty: Uncertainty | None = None

    def __post_init__(self) -> None:
        require_number("speed", self.speed, "m/s", above=0.0)
        if not (np.shape(self.loads) == (2,) and 0.0 <= self.loads[0] <= self.loads[1] < np.inf):
            raise ParameterError(
                f"loads: give the lowest and the highest in N, such as (0.0, 12_600.0), got {short_repr(self.loads)}"
            )
        require_count("load_steps", self.load_steps, 1 if self.loads[0] == self.loads[1] else 2)
        spread_of(self.spread)
        require_count("machines", self.machines)
        require_count("seed", self.seed, at_least=0)
        require_number("settle", self.settle, "s", at_least=0.0)

    @property
    def training_loads(self) -> Float[np.ndarray, " n"]:
        """The constant loads (N) that it is tuned under; one where the lowest is the highest."""
        low, high = self.loads
        return np.linspace(low, high, self.load_steps if high > low else 1)

    @property
    def top_speed(self) -> float:
        """The highest speed (m/s) of the motion."""
        return self.speed if self.motion is None else float(np.max(np.abs(self.motion.velocity)))

    def motion_at(self, factor: float, rate: float) -> Motion:
        """The motion at so many times its speed, over as many times its way, in the same time."""
        if self.motion is None:
            return reversal(factor * OFF_GRID_FACTOR * self.speed, rate)
        motion = self.motion
        start = motion.position[0]
        scaled = start + factor * (motion.position - start)
        return Motion(motion.time, scaled, factor * motion.velocity, factor * motion.acceleration, motion.name)


def spread_of(value: str | float) -> float:
    """The spread of a plan from `3%` or 0.03; raises `ParameterError` for what is none."""
    return share(value, "spread", at_most=MAX_SPREAD, may_be_zero=True)


def reversal(speed: float, rate: float, duration: float = DURATION) -> Motion:
    """There and back at `speed` (m/s) with one reversal in the middle, rounded over 0.1 s."""
    return triangular(
        speed=speed,
        stroke=speed * (duration / 2 - 0.05),
        rounding=0.1,
        duration=duration,
        rate=rate,
        first_reversal=duration / 2,
    )


def perturbed(drive: Drive, spread: float, rng: np.random.Generator) -> Drive:
    """A machine whose plant and friction parameters differ from nominal by the relative deviation `spread`.

    Log-normal, so that no parameter changes sign.
    """
    machine = as_arrays(drive)
    values = {
        name: jax.tree.map(lambda x: x * np.exp(spread * rng.standard_normal()), value)
        for name, _, value in quantities(machine)
        if name.startswith(("plant.", "friction.")) and value is not None
    }
    return with_nodes(machine, values)


def machines(drive: Drive, count: int, spread: float, seed: int, uncertainty: Uncertainty | None = None) -> list[Drive]:
    """The drive itself, then others with each parameter off by the relative deviation `spread`.

    Those that the `uncertainty` names are off by that instead.
    """
    generators = [np.random.default_rng((seed, k)) for k in range(1, count)]
    drawn = [perturbed(drive, spread, rng) for rng in generators]
    if uncertainty is not None:
        uncertain = uncertain_values(drive, uncertainty, generators)
        drawn = [with_nodes(machine, values) for machine, values in zip(drawn, uncertain, strict=True)]
    return [drive, *(jax.tree.map(float, machine) for machine in drawn)]


def held_out_machine(drive: Drive, plan: TuningPlan) -> Drive:
    """A machine within the spread, or the uncertainty, that is not tuned on."""
    return machines(drive, 2, plan.spread, plan.seed + HELD_OUT_SEED, plan.uncertainty)[1]


def training_scenarios(description: Axis, plan: TuningPlan) -> list[Scenario]:
    """Constant loads from none to the highest on every machine, and on the nominal one a load that steps and ramps."""
    motion = plan.motion_at(1.0, description.sampling.rate)
    constant = [(f"{w / 1e3:.3g} kN", w) for w in plan.training_loads]
    found: list[Scenario] = []
    drawn = machines(description.drive, plan.machines, plan.spread, plan.seed, plan.uncertainty)
    for m, machine in enumerate(drawn):
        for name, weight in constant:
            found.append(Scenario(f"{_machine_name(m)}, {name}", machine, motion, weight, len(found) + 1))
    lowest, half, time = plan.loads[0], 0.5 * sum(plan.loads), motion.time
    changing = _that_change({
        "load steps on": load.step(time, at=0.5 * plan.settle, to=half, before=lowest),
        "load ramps on": load.ramp(time, start=0.0, end=motion.duration, to=half, before=lowest),
    })  # fmt: skip
    for name, over_time in changing.items():
        found.append(Scenario(f"nominal, {name}", description.drive, motion, over_time, len(found) + 1))
    _require_possible(description, found)
    return found


def held_out_scenarios(description: Axis, plan: TuningPlan) -> list[Scenario]:
    """Loads in between, loads that change, other speeds, another machine, other noise.

    Under a single load there is none in between: the other machine then has that load.
    """
    rate, drive = description.sampling.rate, description.drive
    motion = plan.motion_at(1.0, rate)
    other = held_out_machine(drive, plan)
    steps = plan.training_loads
    between = (steps[1:] + steps[:-1]) / 2
    on_other = between if len(between) else steps
    half, sixth = 0.5 * sum(plan.loads), round(motion.duration / 6.0, 9)
    changing = _that_change({
        "load ramps off": load.ramp(motion.time, start=sixth, end=2.0 * sixth, before=plan.loads[1], to=half),
        "material removal": load.ramp(motion.time, start=0.5 * sixth, end=6.0 * sixth, before=half, to=0.9 * half),
    })  # fmt: skip
    found = [Scenario(f"nominal, {w / 1e3:.3g} kN", drive, motion, w, 101 + k) for k, w in enumerate(between)]
    found += [Scenario(f"nominal, {name}", drive, motion, w, 201 + k) for k, (name, w) in enumerate(changing.items())]
    found += [Scenario(f"other machine, {w / 1e3:.3g} kN", other, motion, w, 301 + k) for k, w in enumerate(on_other)]
    for k, factor in enumerate(HELD_OUT_SPEEDS):
        other_speed = plan.motion_at(factor, rate)
        if plan.motion is not None and not is_within(other_speed, description.limits):
            continue  # the axis is too short, or too slow, for that
        name = f"{1e3 * np.max(np.abs(other_speed.velocity)):.3g} mm/s, {half / 1e3:.3g} kN"
        found.append(Scenario(name, drive, other_speed, half, 401 + k))
    _require_possible(description, found)
    return found


def _that_change(loads: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Those of these loads over time that change: under a single load, or none, they are what is constant already."""
    return {name: over_time for name, over_time in loads.items() if np.ptp(over_time) > 0.0}


def is_within(motion: Motion, limits: Limits) -> bool:
    """Whether an axis with these limits can run a motion."""
    try:
        require_within(motion, limits)
    except MotionError:
        return False
    return True


def _machine_name(number: int) -> str:
    return "nominal" if number == 0 else f"machine {number}"


def _require_possible(description: Axis, scenarios: list[Scenario]) -> None:
    require_rate(description.controller, description.rate)
    for scenario in scenarios:
        require_within(scenario.motion, description.limits)
        require_shorter(
            len(scenario.motion.time), (*scenario.drive.actuator.pipelines, *description.controller.pipelines)
        )
        weights = np.broadcast_to(np.asarray(scenario.load, float), scenario.motion.time.shape)
        validated_load(description.drive, weights, scenario.motion.time)


@dataclass(frozen=True)
class ScenarioResult:
    """One scenario on the exact simulator, after it has settled."""

    run: Run
    rms: float  # m
    peak: float  # m
    command_noise: float  # N
    load_error: float | None  # N


def run_scenario(
    controller: Controller, scenario: Scenario, sampling: Sampling, settle: float = SETTLE
) -> ScenarioResult:
    """Run a scenario on the exact (quantised, limited) simulator."""
    run = simulate_loop(
        scenario.drive, controller, scenario.motion, scenario.load, sampling=sampling, seed=scenario.seed
    )
    part = run.between(settle, np.inf)
    missed = None
    if run.load_estimate is not None:
        missed = float(metrics.rms((run.load_estimate - run.load)[part]))
    noise = float(metrics.command_noise(run.command[part]))
    return ScenarioResult(run, run.rms_error(settle), run.peak_error(settle), noise, missed)
