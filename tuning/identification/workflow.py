"""`tuning.identify`: mass, friction and delay of an axis from its logs, each with its interval."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np

from diffdrive.axis import Axis, require_axis
from diffdrive.errors import ParameterError
from diffdrive.model.parameters import Sampling
from diffdrive.results import Result, Status
from tuning.checked_logs import CheckedLogs, checked, require_sound
from tuning.experiment_design.next_motion import Proposal, propose_motions
from tuning.identification.doubts import DeterminedSum, determined_sums, doubts
from tuning.identification.estimates import EstimateStatus, ParameterEstimate, left_open
from tuning.identification.excitation import shortcomings
from tuning.identification.gaps import Gap, gaps
from tuning.identification.identify import Identification, require_search
from tuning.identification.identify import identify as fit_drive
from tuning.identification.informative import most_informative
from tuning.identification.motor_encoder import without_doubtful_encoder
from tuning.identification.parameters import without_side
from tuning.identification.row_force import BetweenRows
from tuning.identification.scale_noise import unstated_noise
from tuning.identification.setup import held_unknowns
from tuning.identification.shown_motion import ExcitationDeficit
from tuning.identification.unknowns import Unknowns
from tuning.optimisation.least_squares import Outcome
from tuning.progress import Progress, reporting, searching
from tuning.store.folder import FolderStore
from tuning.store.store import Store

BELIEVABLE = ("ok", "structure_remains")  # codes of searches that converged


@dataclass(frozen=True, repr=False, eq=False)
class IdentificationResult(Result):
    """The axis as identified from logs, and how sure each of its parameters is.

    `axis` has the identified machine with its `uncertainty`, and a controller that believes in it. `estimates` are the
    parameters one by one; `fit` has the rest: covariance, residuals, adequacy. `held_out` are logs that were only
    looked at afterwards, by `gaps`; what long logs were not fitted of is among them. `shortcomings` is what the logs
    could not determine.

    Not ok: the search did not converge, or something speaks against its answer (code `doubtful`): starts that disagree,
    friction far from what inverse dynamics shows, or held-out logs from which the identified axis is further than the
    believed one. Ok, and not just "converged": the model is incomplete (`structure_remains`), the logs could not
    determine all that was asked (`poor_excitation`), or parameters are known only together (`correlated`).
    """

    axis: Axis
    estimates: tuple[ParameterEstimate, ...]
    fit: Identification
    logs: CheckedLogs
    held_out: CheckedLogs
    notes: tuple[str, ...]
    initial_axis: Axis  # before, as the logs show it
    status: Status
    doubts: tuple[str, ...] = ()  # what speaks against the answer of a search that converged
    shortcomings: tuple[ExcitationDeficit, ...] = ()  # what the logs could not determine, as judged before the fit

    schema: ClassVar[str] = "identification/1"

    def estimate(self, name: str) -> ParameterEstimate:
        """One parameter: by its path in the axis, such as `plant.mass`, or by its name, `mass`.

        A parameter that differs between the directions is named with `.positive` or `.negative`. Raises
        `ParameterError` for an unknown one.
        """
        for wanted in (name, without_side(name)):
            for estimate in self.estimates:
                if wanted in (estimate.path, estimate.name):
                    return estimate
        known = ", ".join(estimate.path for estimate in self.estimates)
        raise ParameterError(f"{name}: is not identified; known: {known}")

    def interval(self, name: str) -> tuple[float, float]:
        """The 95 % interval of one parameter.

        Without end (infinite) where the logs do not determine it, or only in a sum; of no width for one that was held
        fixed.
        """
        estimate = self.estimate(name)
        if estimate.status in (EstimateStatus.UNDETERMINED, EstimateStatus.AT_BOUND, EstimateStatus.IN_A_SUM):
            return (-np.inf, np.inf)
        return (estimate.low, estimate.high)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """The paths of the parameters that the logs do not determine: they stay as they were."""
        return tuple(estimate.path for estimate in self.estimates if estimate.status is EstimateStatus.UNDETERMINED)

    @cached_property
    def gaps(self) -> tuple[Gap, ...]:
        """How far the axis is from each log, held out or not, before and after: some simulations of each log."""
        found, delay = self.fit.drive, self.estimate("delay").value
        return (
            *gaps(self.initial_axis, found, delay, self.logs.logs, "identified from", self.fit.between),
            *gaps(self.initial_axis, found, delay, self.held_out.logs, "held out", self.fit.between),
        )

    @cached_property
    def next_motions(self) -> tuple[Proposal, ...]:
        """For each parameter that the logs leave open, the motion that would determine it: some simulations of each.

        Fewer where the axis's limits leave no motion, or no controller is known that could be simulated.
        """
        if not self.fit.open_unknowns or self.fit.search.outcome is not Outcome.CONVERGED:
            return ()
        axis = self.initial_axis
        return tuple(propose_motions(self.fit, axis.controller, axis.sampling, axis.limits))

    def headline(self) -> str:
        fitted = [estimate for estimate in self.estimates if estimate.status is EstimateStatus.FITTED]
        mass = self.estimate("mass")
        prefix = "" if self.status.ok else "NOT OK: "
        return (
            f"{prefix}{self.status.message}: {len(fitted)} of {len(self.estimates)} parameters from "
            f"{len(self.logs.logs)} log{'s' * (len(self.logs.logs) > 1)}, mass {mass.value:.4g} kg"
        )

    def summary(self) -> str:
        rows = [f"{'parameter':<28}{'unit':<8}{'before':>12}{'identified':>12}  95 % interval"]
        for estimate in self.estimates:
            interval = (
                f"{estimate.low:.4g} to {estimate.high:.4g}"
                if estimate.status is EstimateStatus.FITTED
                else estimate.status
            )
            named = f"{estimate.name:<28}{_unit(estimate.unit):<8}"
            rows.append(f"{named}{estimate.believed:>12.4g}{estimate.value:>12.4g}  {interval}")
        return "\n".join([self.headline(), *rows, *(f"- {note}" for note in self.notes)])

    def as_dict(self) -> dict[str, object]:
        return {
            "estimates": [estimate._asdict() for estimate in self.estimates],
            "adequacy": self.fit.adequacy._asdict(),
            "noise_m": self.fit.noise,
            "white_force_N": self.fit.process_force,
            "logs": [log.name for log in self.logs.logs],
        }


def identify(
    axis: Axis,
    logs: object,
    *,
    fixed: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    loads: Mapping[str, float] | None = None,
    held_out: object | None = None,
    starts: int = 6,
    seed: int = 0,
    force: bool = False,
    resume: str | Path | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> IdentificationResult:
    """Identify mass, friction and delay of an axis from logs of it, starting from what the axis says.

    The logs are looked over first: one that would mislead is refused. Method: docs/method/identification.md.

    Args:
        axis: What is believed of the machine; names the controller and the sampling, too.
        logs: One or several of `Log`, files, data frames or dicts of arrays [n], all at the controller's rate; or
            `CheckedLogs`, which are not looked over again.
        fixed: Parameters that stay as they are, by path (`plant.mass`) or name.
        bounds: Lowest and highest values of parameters, in SI units.
        loads: Force on the guides (N) by the log's file or name, where the log does not say it.
        held_out: Logs that are only looked at afterwards, in `gaps`.
        starts: Starting points of the search.
        seed: Of the starting points.
        force: Identify from logs that would mislead, all the same.
        resume: A folder where what is finished is kept: the same call continues from it.
        progress: Called with (stage, done, of how many).
        throw: Raise an error where the search does not converge.

    Raises:
        LogError: A log cannot be used, or would mislead.
        ParameterError: No parameter or log has this name, `starts` or `seed` is no such number, or the axis has
            effects, of which identification knows none.
        ResultError: The search did not converge, with `throw`.

    Examples:
        >>> fit = identify(axis, ["lap1.csv", "lap2.csv"])
        >>> fit.interval("plant.mass")
        >>> fit.axis.write("identified.toml")

    """
    require_search(starts, seed)  # before the logs are looked over, which takes a while
    require_axis(axis)
    _require_no_effects(axis)
    used, others = checked(axis, logs, held_out, loads=loads)
    if not force:
        for several in (used, others):
            require_sound(several, "force=True identifies all the same, and fits that as mass or friction")
    with reporting(progress) as advance:
        result = identify_checked(
            axis, used, others, fixed=fixed, bounds=bounds or {}, starts=starts, seed=seed,
            store=FolderStore.of(resume), progress=advance,
        )  # fmt: skip
    return result.require_ok() if throw else result


def identify_checked(
    axis: Axis,
    used: CheckedLogs,
    held_out: CheckedLogs,
    *,
    fixed: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    starts: int,
    seed: int,
    store: Store | None,
    progress: Progress,
    start: Unknowns | None = None,
    between: BetweenRows | None = None,
) -> IdentificationResult:
    """`identify` from logs that were looked over, whatever was found in them; finished searches are in the `store`.

    The first search starts from `start`, the answer of an earlier fit of the same axis, if there is one. `between` is
    what the command is known to do between two rows: that of snapshots changes, as the axis says or as they show it.
    """
    _require_no_effects(axis)
    seen = axis.as_logged()
    if between is None and axis.loop_samples > 1:
        between = BetweenRows.SMOOTH
    deficits = shortcomings(used.logs, seen.drive, held_unknowns(fixed))
    logs, notes = without_doubtful_encoder(used.logs, used.findings)
    parts = most_informative(logs, seen.drive)
    fitted, others = replace(used, logs=parts.fitted), replace(held_out, logs=(*held_out.logs, *parts.rest))
    with searching(progress, "fitting friction, mass and delay") as step:
        found = fit_drive(
            fitted.logs, seen.drive, fixed=fixed, bounded=bounds, starts=starts, seed=seed, store=store, progress=step,
            start=start, between=between,
        )  # fmt: skip
    notes += [parts.note] if parts.note else []
    return _result(axis, seen, found, fitted, others, deficits, notes)


def _require_no_effects(axis: Axis) -> None:
    if effects := [effect.name for effect in axis.drive.effects]:
        raise ParameterError(
            f"{axis.name}: [effects] {', '.join(effects)}: identification knows no effects; take them out, or diagnose"
        )


def _result(
    axis: Axis,
    seen: Axis,
    found: Identification,
    used: CheckedLogs,
    held_out: CheckedLogs,
    deficits: Sequence[ExcitationDeficit],
    selection: Sequence[str],
) -> IdentificationResult:
    """The result, with what is to be said of it; `seen` is the axis as its logs show it, `used` what was fitted."""
    against = doubts(found, seen.drive, used.logs, held_out.logs) if found.code in BELIEVABLE else []
    findings = [*used.notable, *held_out.notable]
    notes = [f"{log}: {finding.message}; {finding.remedy}" for log, finding in findings]
    notes += selection
    sums = determined_sums(found)
    notes += [*against, *(one.sentence for one in deficits), *found.notes, *(one.message for one in sums)]
    notes.append(found.adequacy.says)
    unstated = unstated_noise(seen.drive, found.scale_noise)
    notes += [unstated] if unstated else []
    if not axis.logs_show_delay:
        notes.append(f"{axis.unseen_controller}: the delay found is that of the trace, and [actuator] stays as it was")
    known = left_open(found.estimates, found.estimate_covariance)
    identified = replace(axis.with_logged_drive(found.drive), name="identified", uncertainty=known)
    if found.loop_samples > 1 and axis.trace.rate is None and not axis.controller.can_simulate:
        identified = _of_faster_loop(identified, found.loop_samples)
        notes.append(
            f"the rows act as one in {found.loop_samples} of a loop at {identified.rate:g} Hz: [sampling] rate is that "
            "now, and [trace] rate that of the rows"
        )
    return IdentificationResult(
        identified, tuple(found.estimates), found, used, held_out,
        tuple(notes), seen, _status(found, against, deficits, sums), tuple(against), tuple(deficits),
    )  # fmt: skip


def _of_faster_loop(axis: Axis, samples: int) -> Axis:
    """The axis whose control has so many samples to a row of its logs."""
    return replace(axis, sampling=Sampling(samples * axis.rate), trace=replace(axis.trace, rate=axis.rate))


def _status(
    found: Identification,
    against: Sequence[str],
    deficits: Sequence[ExcitationDeficit],
    sums: Sequence[DeterminedSum],
) -> Status:
    """Converged and no more only where nothing speaks against the answer and the logs determine what was asked."""
    if against:
        return Status(False, f"doubtful: {against[0]}", code="doubtful")
    if found.code not in BELIEVABLE:
        return Status(False, found.status, code=found.code)
    said, code = [found.status], found.code
    if sums:
        said.append("known only together: " + ", ".join(f"{one.first} and {one.second}" for one in sums))
        code = "correlated" if code == "ok" else code
    if deficits:
        said.append("not determined: " + ", ".join(one.what for one in deficits))
        code = "poor_excitation" if code in ("ok", "correlated") else code
    return Status(True, "; ".join(said), code=code)


def _unit(unit: str) -> str:
    return "-" if unit == "1" else unit.replace("*", " ")
