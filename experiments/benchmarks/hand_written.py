"""The project's scan beside the same step by hand, in C and in numba."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from diffdrive.errors import DiffdriveError
from diffdrive.model.parameters import Sampling, as_arrays
from diffdrive.motion.load import Ramp
from diffdrive.runtime import cores
from experiments.benchmarks import clock, in_c, loops
from experiments.benchmarks.common import RATE, nanoseconds, nominal
from experiments.benchmarks.parameters import row
from experiments.reports.report import Report
from tuning.sweeps.engine import LaneCourse, Precision, costs_of

SAME = 1e-10  # m: the step by hand and ours
LANES = (1, 16, 64, 128, 256, 1024, 4096, 16384)
MANY = 8192
SWEPT = (128, 1024, 16384)
SUBSTEPS = (10, 5, 3, 2, 1)  # of one lane: twice the default, the default, half of it as for tuning, and fewer
FAST = 2  # substeps whose error is below a hundredth of the scale's count (docs/method/numerics.md)


@contextlib.contextmanager
def _others(report: Report, given: Any, sampling: Sampling, count: int) -> Iterator[dict[str, Callable[[], Any]]]:
    """One lane and `count` lanes in C and in numba, as far as they are installed."""
    drive, controller = nominal()
    reference, load = np.stack([np.asarray(one) for one in given.reference]), np.asarray(given.load)
    rows = np.stack([row(drive, controller, factor) for factor in np.linspace(0.5, 1.5, count)])
    one, steps, threads = row(drive, controller), sampling.plant_steps, cores()
    jobs: dict[str, Callable[[], Any]] = {}
    with contextlib.ExitStack() as stack:
        try:
            c = stack.enter_context(in_c.compiled())
            jobs["C, one lane"] = lambda: c.roll(one, reference, load, sampling.period, steps)
        except DiffdriveError as problem:
            report.say(str(problem))
        try:
            from experiments.benchmarks import in_numba

            jobs["numba, one lane"] = lambda: in_numba.roll(one, reference, load, sampling.period, steps)
            jobs["numba, lanes, one thread"] = lambda: in_numba.sweep(rows, reference, load, sampling.period, steps)
            jobs["numba, lanes, prange"] = lambda: in_numba.sweep(
                rows, reference, load, sampling.period, steps, threads
            )
        except ImportError:
            report.say("no numba: pip install 'diffdrive[bench]' to compare with it")
        yield jobs


def one_lane(report: Report) -> dict[str, float]:
    """A single simulation."""
    steps, rows, reached = 20_000, [], {}
    drive, controller = nominal()
    for substeps in SUBSTEPS:
        sampling, given = Sampling(RATE, substeps), loops.inputs(steps)
        with report.working(f"one lane, {substeps} substeps"), _others(report, given, sampling, 1) as others:
            ours = loops.single(drive, controller, given, sampling)
            _require_same(others, float(ours.run()), substeps)
            jobs = {"ours": ours.run} | {name: job for name, job in others.items() if name.endswith("one lane")}
            told = clock.by_turns(jobs)
        numba = told.get("numba, one lane")
        for name, timing in told.items():
            each = nanoseconds(timing, steps)
            rows.append([substeps, name, each, None if numba is None else timing.best / numba.best, 1e9 / RATE / each])
        factor = 1e9 / RATE / nanoseconds(told["ours"], steps)
        if substeps == FAST:
            reached[f"real-time factor, {FAST} substeps"] = factor
        if substeps == Sampling(RATE).plant_steps:
            reached["real-time factor"] = factor
            if numba is not None:
                reached["one lane over numba"] = told["ours"].best / numba.best
    report.table(
        "single", ("substeps", "what", "ns a step", "over numba", "times real time"), rows,
        "PD+FC+LE, one lane, costs only",
    )  # fmt: skip
    return reached


def _require_same(others: dict[str, Callable[[], Any]], ours: float, substeps: int) -> None:
    """The hand-written steps compute what ours computes: else a ratio means nothing."""
    for name, job in others.items():
        if name.endswith("one lane") and not abs(job()[0][0] - ours) <= SAME:
            raise DiffdriveError(
                f"{name}: its RMS error differs from ours by more than {SAME:g} m ({substeps} substeps)"
            )


def lanes_of_one_core(report: Report) -> dict[str, float]:
    """More and more lanes in one block."""
    steps, sampling, rows = 2_000, Sampling(RATE), []
    drive, controller = nominal()
    given = loops.inputs(steps)
    with report.working("lanes on one core"), _others(report, given, sampling, 64) as others:
        compiled = {count: loops.lanes(drive, controller, given, sampling, count) for count in LANES}
        single = {count: loops.lanes(drive, controller, given, sampling, count, "single") for count in LANES}
        jobs = {str(count): one.run for count, one in compiled.items()}
        jobs |= {f"single {count}": one.run for count, one in single.items()}
        if "numba, lanes, one thread" in others:
            jobs["numba"] = others["numba, lanes, one thread"]
            _require_alike(np.asarray(jobs["numba"]())[:, 0], np.asarray(compiled[64].run()))
        told = clock.by_turns(jobs)
    base = nanoseconds(told["numba"], steps, 64) if "numba" in told else None
    for count, one in compiled.items():
        each = nanoseconds(told[str(count)], steps, count)
        ratio, other = None if base is None else base / each, nanoseconds(told[f"single {count}"], steps, count)
        kernel = "yes" if one.one_kernel and single[count].one_kernel else "NO"
        rows.append([count, each, ratio, other, each / other, one.compile_seconds, one.memory / count / 2**10, kernel])
    report.table(
        "lanes",
        (
            "lanes", "ns a lane-step", "numba, one thread, over ours", "in single precision", "double over single",
            "compile s", "KiB a lane", "one kernel",
        ),
        rows,
        f"PD+FC+LE side by side on one core, {sampling.plant_steps} substeps",
    )  # fmt: skip
    return {}


def swept_lanes(report: Report) -> dict[str, float]:
    """As a sweep runs it: blocks, all devices; against numba on all cores, the same machines under the same loads."""
    steps, sampling = 5_000, Sampling(RATE)
    drive, controller = nominal()
    given = loops.inputs(steps)
    length = (steps - 1) * sampling.period

    def swept(count: int, precision: Precision = "double") -> Callable[[], Any]:
        machines = jax.tree.map(lambda leaf: leaf * jnp.ones(count), as_arrays(drive))
        top = float(given.load[-1]) * np.linspace(0.5, 1.5, count)
        ramp = Ramp(*(jnp.asarray(end) for end in (np.zeros(count), top, np.zeros(count), np.full(count, length))))
        course = LaneCourse(given.reference, jnp.zeros(steps), jnp.ones(steps), jnp.asarray(1.0))
        return lambda: costs_of(machines, ramp, None, controller, course, sampling, precision)

    with report.working(f"{MANY} lanes on all cores"), _others(report, given, sampling, MANY) as others:
        jobs = {f"ours, {count} lanes": swept(count) for count in (MANY, *SWEPT)}
        single = jobs[f"ours in single precision, {MANY} lanes"] = swept(MANY, "single")
        double, rough = (job().rms for job in (jobs[f"ours, {MANY} lanes"], single))
        off = 1e9 * np.abs(rough - double)
        report.values("single precision", rms_nm=1e9 * float(np.median(double)), off_nm_median=float(np.median(off)),
                      off_nm_99_percent=float(np.quantile(off, 0.99)), off_nm_worst=float(np.max(off)))  # fmt: skip
        if "numba, lanes, prange" in others:
            prange = jobs[f"numba prange, {MANY} lanes"] = others["numba, lanes, prange"]
            _require_alike(np.asarray(prange())[:, 0], jobs[f"ours, {MANY} lanes"]().rms)
        told = clock.by_turns(jobs, rounds=3)
    each = {name: nanoseconds(timing, steps, int(name.split()[-2])) for name, timing in told.items()}
    ours = each[f"ours, {MANY} lanes"]
    report.table(
        "sweep", ("what", "ns a lane-step", "over ours"), [[name, ns, ns / ours] for name, ns in each.items()],
        "Machines as `diffdrive sweep` runs them, on all cores",
    )  # fmt: skip
    numba = each.get(f"numba prange, {MANY} lanes")
    if numba is None:
        return {}
    return {
        "lanes, numba prange over ours": numba / ours,
        "the same, ours in single precision": numba / each[f"ours in single precision, {MANY} lanes"],
    }


def _require_alike(others: np.ndarray, ours: np.ndarray) -> None:
    """Lane by lane the same errors: else a ratio means nothing."""
    off = float(np.max(np.abs(others - ours)))
    if not off <= SAME:
        raise DiffdriveError(f"numba: its RMS errors differ from ours by up to {off:g} m, more than {SAME:g} m")
