"""Tune a drive's controller over loads, and prove it on the exact simulator, also where it was not tuned."""

import warnings
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import numpy as np

from diffdrive import metrics
from diffdrive.controllers import Controller
from diffdrive.convergence import printed_estimator, require_convergent, time_constants
from diffdrive.drive_file import DriveDescription, write_drive
from diffdrive.errors import LoadEstimatorError, LoadEstimatorWarning
from diffdrive.load import require_possible
from diffdrive.motion import Motion, require_within, triangular
from diffdrive.parameters import Drive, Sampling
from diffdrive.run import Run
from diffdrive.simulate import simulate
from experiments.report import Report, new_figure
from tuning.gains import Tuned, tune
from tuning.objective import ensemble

OFF_GRID = 1.0137
HELD_OUT_SPEEDS = (0.7, 2.0)  # times the speed tuned at
LABELS = {
    "position": "Q position", "velocity": "Q velocity", "bristle": "Q bristle", "load": "Q load", "measurement": "R",
    "gain": "K_w",
}  # fmt: skip
SETTLE = 0.4  # s: load estimators have found their load by then


@dataclass(frozen=True)
class Case:
    """One verification scenario: its name, motion, load (N) and noise seed."""

    name: str
    motion: Motion
    load: float
    seed: int


def reversal(speed: float, rate: float, duration: float = 1.2) -> Motion:
    """There and back at `speed` (m/s) with one reversal in the middle, rounded over 0.1 s."""
    return triangular(
        speed=speed,
        stroke=speed * duration / 2,
        rounding=0.1,
        duration=duration,
        rate=rate,
        first_reversal=duration / 2,
    )


def cases(rate: float, speed: float, loads: np.ndarray) -> tuple[list[Case], list[Case]]:
    """The scenarios tuned on, and others: loads in between with another seed, a lower and twice the speed.

    All a little off the speed asked for: at a whole number of quanta a period a quantised loop locks on the grid.
    """
    speed = OFF_GRID * speed
    tuned_on = [Case(f"{speed * 1e3:.3g} mm/s, {w / 1e3:.3g} kN", reversal(speed, rate), w, 1) for w in loads]
    between = (loads[1:] + loads[:-1]) / 2
    held_out = [Case(f"{speed * 1e3:.3g} mm/s, {w / 1e3:.3g} kN", reversal(speed, rate), w, 2) for w in between]
    for factor in HELD_OUT_SPEEDS:
        v = factor * speed
        held_out.append(Case(f"{v * 1e3:.3g} mm/s, {loads[-1] / 2e3:.3g} kN", reversal(v, rate), loads[-1] / 2, 3))
    return tuned_on, held_out


def judge(drive: Drive, controller: Controller, case: Case, sampling: Sampling) -> tuple[Run, list[float | None]]:
    """Run one case on the exact simulator: RMS and peak error (um), command noise (N), load error (kN)."""
    with warnings.catch_warnings():  # the load estimator has its own verdict
        warnings.simplefilter("ignore", LoadEstimatorWarning)
        run = simulate(drive, controller, case.motion, case.load, sampling=sampling, seed=case.seed)
    part = run.between(SETTLE, np.inf)
    missed = None
    if run.load_estimate is not None:
        missed = 1e-3 * float(metrics.rms((run.load_estimate - run.load)[part]))
    noise = float(metrics.command_noise(run.command[part]))
    return run, [1e6 * run.rms(SETTLE), 1e6 * run.peak(SETTLE), noise, missed]


def tune_drive(
    description: DriveDescription,
    report: Report,
    *,
    speed: float = 0.010,
    max_load: float = 12_600.0,
    loads: int = 4,
    max_steps: int = 20,
) -> tuple[Tuned, bool]:
    """Tune over `loads` loads from 0 to `max_load` (N) at `speed` (m/s); figures, tables and tuned.toml go to `report`.

    The tuning loop has one more sample of delay than the drive file says, as a reserve of phase. Returns what was tuned
    and whether it is accepted: every verification run is ok, and an eq. (20) estimator converges at all of its speeds
    and loads. Only then is tuned.toml written.
    """
    drive, sampling = description.drive, description.sampling
    weights = np.linspace(0.0, max_load, loads)
    tuned_on, held_out = cases(sampling.rate, speed, weights)
    for case in (*tuned_on, *held_out):
        require_within(case.motion, description.limits)
        require_possible(drive, np.full(len(case.motion.time), case.load), case.motion.time)
    delayed = eqx.tree_at(
        lambda d: d.actuator,
        drive,
        replace(drive.actuator, delay_samples=drive.actuator.delay_samples + 1),
        is_leaf=lambda leaf: leaf is drive.actuator,
    )
    motion = tuned_on[0].motion
    coarse = Sampling(sampling.rate, max(2, sampling.plant_steps // 2))
    scenarios = ensemble(delayed, motion, np.outer(weights, np.ones(len(motion.time))), coarse, settle=SETTLE)
    with report.progress("tuning by gradient", max_steps) as advance:
        tuned = tune(description.controller, scenarios, max_steps=max_steps, progress=advance)
    search = tuned.search
    report.values(
        "tuning", status=search.status, steps=search.steps, cost_before=search.cost_before, cost_after=search.cost,
        seconds=round(search.seconds, 1),
    )  # fmt: skip
    report.table(
        "gains", ("gain", "before", "after", "ratio"),
        [
            [LABELS.get(n, n), float(b), float(a), float(a / b)]
            for n, b, a in zip(tuned.names, tuned.before, tuned.after, strict=True)
        ],
        "Gains, SI units",
    )  # fmt: skip
    if tuned.at_bound:
        report.say(f"At the bound of its range: {', '.join(tuned.at_bound)}.")
    runs = _verify(report, drive, description.controller, tuned.controller, tuned_on, held_out, sampling)
    report.figure("tuning", _figure(search.history, runs))
    accepted = all(new.status.ok for _, _, new in runs) and _converges(
        report, tuned.controller, speed, weights, sampling
    )
    report.values("verdict", accepted=accepted)
    if accepted and report.out is not None:
        write_drive(report.out / "tuned.toml", replace(description, controller=tuned.controller))
    return tuned, accepted


def _converges(report: Report, controller: Controller, speed: float, loads: np.ndarray, sampling: Sampling) -> bool:
    """Whether an eq. (20) estimator converges at the speeds and loads of the verification; true if there is none."""
    observer = printed_estimator(controller)
    if observer is None:
        return True
    speeds = [factor * speed for factor in (HELD_OUT_SPEEDS[0], 1.0, HELD_OUT_SPEEDS[1])]
    slowest = [max(time_constants(observer, speeds, sampling.period, w)) for w in (loads[0], loads[-1])]
    report.values("load_estimator", slowest_time_constant_s=float(max(slowest)))
    try:
        require_convergent(observer, speeds, sampling.period, (loads[0], loads[-1]))
    except LoadEstimatorError as error:
        report.say(f"REJECTED, no drive file written: {error}")
        return False
    return True


def _verify(
    report: Report,
    drive: Drive,
    before: Controller,
    after: Controller,
    tuned_on: list[Case],
    held_out: list[Case],
    sampling: Sampling,
) -> list[tuple[Case, Run, Run]]:
    rows: list[list[Any]] = []
    runs = []
    with report.working("verifying on the exact simulator"):
        for role, several in (("tuned on", tuned_on), ("held out", held_out)):
            for case in several:
                old, was = judge(drive, before, case, sampling)
                new, now = judge(drive, after, case, sampling)
                runs.append((case, old, new))
                rows.append([case.name, role, *(value for pair in zip(was, now, strict=True) for value in pair)])
                if not new.status.ok:
                    report.say(f"{case.name}: {new.status.message}")
    report.table(
        "verification",
        (
            "scenario",
            "role",
            "RMS um",
            "RMS tuned",
            "peak um",
            "peak tuned",
            "noise N",
            "noise tuned",
            "load error kN",
            "load error tuned",
        ),
        rows,
        "Before and after on the exact (quantised, limited) simulator",
    )
    for role in ("tuned on", "held out"):
        part = [row for row in rows if row[1] == role]
        for k, what in ((2, "rms_um"), (6, "command_noise_N"), (8, "load_error_kN")):
            if part[0][k] is not None:
                before, after = (float(np.mean([row[j] for row in part])) for j in (k, k + 1))
                report.values(f"mean_{what}_{role.replace(' ', '_')}", before=before, after=after)
    return runs


def _figure(history: list[float], runs: list[tuple[Case, Run, Run]]) -> Any:
    figure, (left, right) = new_figure(1, 2, width=11.0, height=3.4, share_x=False)
    left.plot(history, "o-", ms=3)
    left.set(xlabel="step", ylabel="cost, in units of the scales", title="search", ylim=(0, None))
    case, old, new = runs[-3]
    right.plot(old.time, 1e6 * old.error, lw=0.8, label="before")
    right.plot(new.time, 1e6 * new.error, lw=0.8, label="tuned")
    right.set(xlabel="time, s", ylabel="tracking error, um", title=f"held out: {case.name}", xlim=(SETTLE, None))
    after = new.time > SETTLE
    most = 1.2e6 * max(np.abs(old.error[after]).max(), np.abs(new.error[after]).max())
    right.set_ylim(-most, most)
    right.legend()
    return figure
