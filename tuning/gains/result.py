"""What `tuning.tune` returns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from diffdrive.axis import Axis
from diffdrive.controllers import Controller, FrictionCompensation
from diffdrive.measured_loop import margins_as_dict
from diffdrive.results import Result, Status
from diffdrive.support.spans import format_span
from tuning.gains.measured import MeasuredMargins
from tuning.gains.objective import Objective
from tuning.gains.plan import TuningPlan
from tuning.gains.setup import TuningSetup
from tuning.gains.tune import GainSearch, SearchOptions
from tuning.gains.verification import (
    ControllerMargins,
    ErrorComparison,
    ScenarioComparison,
    WorstMargins,
    is_accepted,
    noise_warning,
)

BELIEVED = (
    "The tuned axis has the friction of the controller's nominal model, not the machine's: simulate it with the axis "
    "that was given as the machine (`machine`, on the command line `--machine`)."
)


@dataclass(frozen=True, repr=False, eq=False)
class TuningResult(Result):
    """Tuned gains, and what they are worth.

    `status.ok`: every requirement is kept, and every run of the verification is ok; `axis` then has the gains.
    `tuned_on` and `held_out` compare them with the gains as given on the exact simulator, the latter in scenarios
    (loads, speeds, a machine, noise) that were not tuned on; `margins` are the worst that remain. `gains` are (before,
    after) by name. `measured_margins` are those of the loops with a measured plant, before and after. `search` has the
    search, `runs` every run, `loop_margins` the margins at every operating point before and after; `initial_axis` is
    the axis before; `plan`, `setup`, `objective`, `options` say how it was tuned.
    """

    axis: Axis
    gains: Mapping[str, tuple[float, float]]
    tuned_on: ErrorComparison
    held_out: ErrorComparison
    search: GainSearch
    runs: tuple[ScenarioComparison, ...]
    loop_margins: tuple[ControllerMargins, ControllerMargins]
    notes: tuple[str, ...]
    initial_axis: Axis
    plan: TuningPlan
    setup: TuningSetup
    objective: Objective
    options: SearchOptions
    status: Status
    measured_margins: tuple[MeasuredMargins, ...] = ()

    schema: ClassVar[str] = "tuning/2"

    @property
    def accepted(self) -> bool:
        """`status.ok`, in the words of tuning."""
        return self.status.ok

    @property
    def margins(self) -> WorstMargins:
        """The smallest margins of the tuned loop over speeds, directions and loads."""
        return WorstMargins.of(self.loop_margins[1].training)

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
        rows += [f"with {name} in the plant's place: {after!r}" for name, _, after in self.measured_margins]
        rows += [f"{name:<12}{was:>12.5g} -> {now:.5g}" for name, (was, now) in self.gains.items()]
        return "\n".join([self.headline(), *rows, *(f"- {note}" for note in self.notes)])

    def as_dict(self) -> dict[str, object]:
        return {
            "accepted": self.accepted,
            "gains": {name: {"before": was, "after": now} for name, (was, now) in self.gains.items()},
            "tuned_on": self.tuned_on.as_dict(),
            "held_out": self.held_out.as_dict(),
            "margins": self.margins.as_dict(),
        } | (
            {"measured_margins": {one.name: margins_as_dict(one.after) for one in self.measured_margins}}
            if self.measured_margins
            else {}
        )


def tuned_axis(axis: Axis, controller: Controller, *, friction: bool) -> Axis:
    """The axis with tuned gains; its `friction` is what the observer believes where that is tuned along."""
    tuned = replace(axis, controller=controller, name="tuned")
    if not friction:
        return tuned
    assert isinstance(controller, FrictionCompensation)
    return replace(tuned, drive=replace(axis.drive, friction=controller.observer.friction))


def tuning_result(
    axis: Axis,
    plan: TuningPlan,
    prepared: TuningSetup,
    objective: Objective,
    options: SearchOptions,
    tuned: GainSearch,
    margins: Sequence[ControllerMargins],
    runs: Sequence[ScenarioComparison],
    measured_margins: tuple[MeasuredMargins, ...] = (),
) -> TuningResult:
    """The result, with what is to be said of it."""
    accepted = is_accepted(tuned, runs)
    notes = [*prepared.notes, *(note for note in [noise_warning(prepared, tuned, runs)] if note), *remarks(tuned)]
    notes += [BELIEVED] if prepared.friction else []
    bad = [f"{run.scenario.name}: {run.after.run.status.message}" for run in runs if not run.after.run.status.ok]
    gains = {
        name: (float(was), float(now)) for name, was, now in zip(tuned.names, tuned.before, tuned.after, strict=True)
    }
    code = "ok" if accepted else "interrupted" if tuned.interrupted else "not_accepted"
    message = tuned.status if accepted or not bad else bad[0]
    return TuningResult(
        axis=tuned_axis(axis, tuned.controller, friction=prepared.friction),
        gains=gains,
        tuned_on=ErrorComparison.of([run for run in runs if run.role == "tuned on"]),
        held_out=ErrorComparison.of([run for run in runs if run.role == "held out"]),
        search=tuned,
        runs=tuple(runs),
        loop_margins=(margins[0], margins[1]),
        notes=(*notes, *bad),
        initial_axis=axis,
        plan=plan,
        setup=prepared,
        objective=objective,
        options=options,
        status=Status(accepted, message, code=code),
        measured_margins=measured_margins,
    )


def remarks(tuned: GainSearch) -> list[str]:
    """What stood in the way of better gains."""
    found = [f"At the bound of its range: {', '.join(tuned.at_bound)}."] if tuned.at_bound else []
    found += [
        f"Held back by the {requirement.name}: relaxing it by 1 % would gain {requirement.gain:.2g} % of the objective."
        for requirement in tuned.binding
    ]
    mend = "no gains near these keep it: relax it" if tuned.best.state.infeasible else "search on"
    found += [
        f"NOT KEPT: {name}, missed by {format_span((100.0 * share, None, None))[0]} %; {mend}."
        for name, share in tuned.violated.items()
    ]
    return found
