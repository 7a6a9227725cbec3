"""What gains are worth: margins, and runs on the exact simulator, where they were tuned and where they were not."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffdrive.axis import Axis
from diffdrive.controllers import Controller
from diffdrive.loop.margins import NEUTRAL_GROWTH, Margins
from diffdrive.loop.smooth import smooth
from diffdrive.numerics.arrays import as_arrays
from tuning.gains.plan import ScenarioResult, TuningPlan, held_out_machine, run_scenario
from tuning.gains.requirements import Constraints, LoopLimits, operating_points
from tuning.gains.scenarios import Scenario
from tuning.gains.setup import TuningSetup, margin_speeds
from tuning.gains.tune import GainSearch

NOISE_TOLERANCE = 1.05  # times the limit of the command noise: more on the exact simulator is said
Role = Literal["tuned on", "held out"]


@eqx.filter_jit
def _margins(constraints: Constraints, controller: Controller) -> Margins:
    return constraints.margins(controller)


class ControllerMargins(NamedTuple):
    """The margins of one controller, at the operating points that it was tuned at, and at others."""

    training: Margins
    held_out: Margins


def margins_at(axis: Axis, controllers: Sequence[Controller], plan: TuningPlan) -> list[ControllerMargins]:
    """Margins of each controller, also on a machine, at loads and at speeds that were not tuned on."""
    other = held_out_machine(axis.drive, plan)
    low, high = plan.loads
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


def noise_warning(prepared: TuningSetup, tuned: GainSearch, runs: Sequence[ScenarioComparison]) -> str:
    """What to say where the exact simulator is noisier than the smooth one on which the limit was kept; "" else."""
    limit, noisiest = prepared.limits.command_noise, max(run.after.command_noise for run in runs)
    if limit is None or noisiest <= NOISE_TOLERANCE * limit or "command noise" in tuned.violated:
        return ""
    return (
        f"On the exact simulator the command noise is up to {noisiest:.3g} N: the limit of {limit:.3g} N is kept on "
        "the smooth one, in which the steps of the scale are white noise. Ask for a lower one."
    )


def is_accepted(tuned: GainSearch, runs: Sequence[ScenarioComparison]) -> bool:
    """Whether every requirement is kept, and every verification run ok."""
    return not tuned.interrupted and tuned.feasible and all(run.after.run.status.ok for run in runs)


class ErrorComparison(NamedTuple):
    """What the tuned gains do in some scenarios on the exact simulator: means over them, and the largest peak."""

    rms_before: float  # m
    rms_after: float
    peak_before: float  # m
    peak_after: float
    command_noise_before: float  # N
    command_noise_after: float

    def as_dict(self) -> dict[str, float]:
        """By names that carry their unit."""
        return {f"{name}_{'N' if 'noise' in name else 'm'}": value for name, value in self._asdict().items()}

    @classmethod
    def of(cls, runs: Sequence[ScenarioComparison]) -> "ErrorComparison":
        """Of these scenarios."""

        def mean(which: str, of: str) -> float:
            return float(np.mean([getattr(getattr(run, which), of) for run in runs]))

        def largest(which: str) -> float:
            return max(getattr(run, which).peak for run in runs)

        return cls(
            mean("before", "rms"), mean("after", "rms"), largest("before"), largest("after"),
            mean("before", "command_noise"), mean("after", "command_noise"),
        )  # fmt: skip


class WorstMargins(NamedTuple):
    """The smallest margins over speeds, directions and loads; infinite where none bounds the loop."""

    gain_margin: float  # dB, the smaller of up and down
    phase_margin: float  # deg
    peak_sensitivity: float
    stable: bool

    def as_dict(self) -> dict[str, object]:
        """By names that carry their unit."""
        return {
            "gain_margin_dB": self.gain_margin, "phase_margin_deg": self.phase_margin,
            "peak_sensitivity": self.peak_sensitivity, "stable": self.stable,
        }  # fmt: skip

    @classmethod
    def of(cls, margins: Margins) -> "WorstMargins":
        """Over all operating points."""
        gain = float(np.min([np.min(margins.gain_up), np.min(margins.gain_down)]))
        return cls(
            20.0 * float(np.log10(gain)), float(np.degrees(np.min(margins.phase))),
            float(np.max(margins.sensitivity)), bool(np.max(margins.growth) < NEUTRAL_GROWTH),
        )  # fmt: skip
