"""The project's scan beside the same step written by hand, in C and in numba."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from diffdrive.errors import DiffdriveError
from diffdrive.loop.step import Inputs
from diffdrive.model.parameters import Sampling
from diffdrive.motion.load import Ramp
from diffdrive.numerics.arrays import as_arrays
from diffdrive.runtime import cores
from experiments.benchmarks import clock, in_c, loops
from experiments.benchmarks.common import RATE, nominal, ns_per_step
from experiments.benchmarks.parameters import lane_parameters
from experiments.reports.report import Report
from tuning.sweeps.engine import LaneCycle, Precision, lane_costs

TOLERANCE = 1e-10  # m, between the costs of the hand-written step and ours
LANES = (1, 16, 64, 128, 256, 1024, 4096, 16384)
SWEEP_LANES = 8192
OTHER_SWEEP_LANES = (128, 1024, 16384)
SUBSTEPS = (10, 5, 3, 2, 1)  # of one lane: twice the default, the default, half of it as for tuning, and fewer
COARSE_SUBSTEPS = 2  # substeps whose error is below a hundredth of the scale's count (docs/method/numerics.md)


@contextlib.contextmanager
def _baselines(
    report: Report, inputs: Inputs, sampling: Sampling, count: int
) -> Iterator[dict[str, Callable[[], Any]]]:
    """One lane and `count` lanes in C and in numba, as far as they are installed."""
    drive, controller = nominal()
    reference, load = np.stack([np.asarray(signal) for signal in inputs.reference]), np.asarray(inputs.load)
    rows = np.stack([lane_parameters(drive, controller, factor) for factor in np.linspace(0.5, 1.5, count)])
    parameters, steps, threads = lane_parameters(drive, controller), sampling.plant_steps, cores()
    jobs: dict[str, Callable[[], Any]] = {}
    with contextlib.ExitStack() as stack:
        try:
            compiled_c = stack.enter_context(in_c.compiled())
            jobs["C, one lane"] = lambda: compiled_c.roll(parameters, reference, load, sampling.period, steps)
        except DiffdriveError as error:
            report.say(str(error))
        try:
            from experiments.benchmarks import in_numba

            jobs["numba, one lane"] = lambda: in_numba.roll(parameters, reference, load, sampling.period, steps)
            jobs["numba, lanes, one thread"] = lambda: in_numba.sweep(rows, reference, load, sampling.period, steps)
            jobs["numba, lanes, prange"] = lambda: in_numba.sweep(
                rows, reference, load, sampling.period, steps, threads
            )
        except ImportError:
            report.say("no numba: pip install 'diffdrive[bench]' to compare with it")
        yield jobs


def one_lane(report: Report) -> dict[str, float]:
    """A single simulation."""
    steps, rows, measured = 20_000, [], {}
    drive, controller = nominal()
    for substeps in SUBSTEPS:
        sampling, inputs = Sampling(RATE, substeps), loops.paper_inputs(steps)
        with report.working(f"one lane, {substeps} substeps"), _baselines(report, inputs, sampling, 1) as baselines:
            ours = loops.single(drive, controller, inputs, sampling)
            _require_equal_cost(baselines, float(ours.run()), substeps)
            jobs = {"ours": ours.run} | {name: job for name, job in baselines.items() if name.endswith("one lane")}
            timings = clock.time_interleaved(jobs)
        numba = timings.get("numba, one lane")
        for name, timing in timings.items():
            step_ns = ns_per_step(timing, steps)
            rows.append(
                [substeps, name, step_ns, None if numba is None else timing.best / numba.best, 1e9 / RATE / step_ns]
            )
        factor = 1e9 / RATE / ns_per_step(timings["ours"], steps)
        if substeps == COARSE_SUBSTEPS:
            measured[f"real-time factor, {COARSE_SUBSTEPS} substeps"] = factor
        if substeps == Sampling(RATE).plant_steps:
            measured["real-time factor"] = factor
            if numba is not None:
                measured["one lane over numba"] = timings["ours"].best / numba.best
    report.table(
        "single", ("substeps", "what", "ns a step", "over numba", "times real time"), rows,
        "PD+FC+LE, one lane, costs only",
    )  # fmt: skip
    return measured


def _require_equal_cost(baselines: dict[str, Callable[[], Any]], ours: float, substeps: int) -> None:
    """The hand-written steps must compute what ours computes, else a ratio means nothing."""
    for name, job in baselines.items():
        if name.endswith("one lane") and not abs(job()[0][0] - ours) <= TOLERANCE:
            raise DiffdriveError(
                f"{name}: its RMS error differs from ours by more than {TOLERANCE:g} m ({substeps} substeps)"
            )


def lanes_of_one_core(report: Report) -> dict[str, float]:
    """More and more lanes in one block."""
    steps, sampling, rows = 2_000, Sampling(RATE), []
    drive, controller = nominal()
    inputs = loops.paper_inputs(steps)
    with report.working("lanes on one core"), _baselines(report, inputs, sampling, 64) as baselines:
        compiled = {count: loops.lanes(drive, controller, inputs, sampling, count) for count in LANES}
        single = {count: loops.lanes(drive, controller, inputs, sampling, count, "single") for count in LANES}
        jobs = {str(count): loop.run for count, loop in compiled.items()}
        jobs |= {f"single {count}": loop.run for count, loop in single.items()}
        if "numba, lanes, one thread" in baselines:
            jobs["numba"] = baselines["numba, lanes, one thread"]
            _require_equal_costs(np.asarray(jobs["numba"]())[:, 0], np.asarray(compiled[64].run()))
        timings = clock.time_interleaved(jobs)
    base = ns_per_step(timings["numba"], steps, 64) if "numba" in timings else None
    for count, loop in compiled.items():
        step_ns = ns_per_step(timings[str(count)], steps, count)
        ratio, single_ns = (
            None if base is None else base / step_ns,
            ns_per_step(timings[f"single {count}"], steps, count),
        )
        kernel = "yes" if loop.one_kernel and single[count].one_kernel else "NO"
        rows.append(
            [
                count,
                step_ns,
                ratio,
                single_ns,
                step_ns / single_ns,
                loop.compile_seconds,
                loop.memory / count / 2**10,
                kernel,
            ]
        )
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
    inputs = loops.paper_inputs(steps)
    length = (steps - 1) * sampling.period

    def sweep_job(count: int, precision: Precision = "double") -> Callable[[], Any]:
        machines = jax.tree.map(lambda leaf: leaf * jnp.ones(count), as_arrays(drive))
        top = float(np.asarray(inputs.load)[-1]) * np.linspace(0.5, 1.5, count)
        ramp = Ramp(*(jnp.asarray(end) for end in (np.zeros(count), top, np.zeros(count), np.full(count, length))))
        cycle = LaneCycle(inputs.reference, jnp.zeros(steps), jnp.ones(steps), jnp.asarray(1.0))
        return lambda: lane_costs(machines, ramp, None, controller, cycle, sampling, precision)

    with (
        report.working(f"{SWEEP_LANES} lanes on all cores"),
        _baselines(report, inputs, sampling, SWEEP_LANES) as baselines,
    ):
        jobs = {f"ours, {count} lanes": sweep_job(count) for count in (SWEEP_LANES, *OTHER_SWEEP_LANES)}
        single = jobs[f"ours in single precision, {SWEEP_LANES} lanes"] = sweep_job(SWEEP_LANES, "single")
        double_rms, single_rms = (job().rms for job in (jobs[f"ours, {SWEEP_LANES} lanes"], single))
        difference = 1e9 * np.abs(single_rms - double_rms)
        report.values(
            "single precision",
            rms_nm=1e9 * float(np.median(double_rms)),
            off_nm_median=float(np.median(difference)),
            off_nm_99_percent=float(np.quantile(difference, 0.99)),
            off_nm_worst=float(np.max(difference)),
        )
        if "numba, lanes, prange" in baselines:
            prange = jobs[f"numba prange, {SWEEP_LANES} lanes"] = baselines["numba, lanes, prange"]
            _require_equal_costs(np.asarray(prange())[:, 0], jobs[f"ours, {SWEEP_LANES} lanes"]().rms)
        timings = clock.time_interleaved(jobs, rounds=3)
    step_ns = {name: ns_per_step(timing, steps, int(name.split()[-2])) for name, timing in timings.items()}
    ours = step_ns[f"ours, {SWEEP_LANES} lanes"]
    report.table(
        "sweep", ("what", "ns a lane-step", "over ours"), [[name, ns, ns / ours] for name, ns in step_ns.items()],
        "Machines as `diffdrive sweep` runs them, on all cores",
    )  # fmt: skip
    numba = step_ns.get(f"numba prange, {SWEEP_LANES} lanes")
    if numba is None:
        return {}
    return {
        "lanes, numba prange over ours": numba / ours,
        "the same, ours in single precision": numba / step_ns[f"ours in single precision, {SWEEP_LANES} lanes"],
    }


def _require_equal_costs(baselines: np.ndarray, ours: np.ndarray) -> None:
    """The errors must be the same lane by lane, else a ratio means nothing."""
    difference = float(np.max(np.abs(baselines - ours)))
    if not difference <= TOLERANCE:
        raise DiffdriveError(
            f"numba: its RMS errors differ from ours by up to {difference:g} m, more than {TOLERANCE:g} m"
        )
