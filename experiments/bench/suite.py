"""`diffdrive bench`: how fast the tool is on this machine, each figure beside what it is compared with."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from diffdrive.controllers import Controller
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.load import Ramp
from diffdrive.parameters import Drive, Sampling, as_arrays
from diffdrive.presets import paper_drive
from experiments import paper
from experiments.accuracy import REFERENCE, SUBSTEPS, integrator_errors
from experiments.bench import clock, cold, in_c, loops, roof
from experiments.bench.arithmetic import of_step
from experiments.bench.figures import drawn
from experiments.bench.parameters import row
from experiments.report import Report
from experiments.runtime import cores
from experiments.sweeps.engine import Precision, costs_of
from experiments.sweeps.varied import with_effects

RATE = 10_000.0
SAME = 1e-10  # m: the step by hand and ours
LANES = (1, 16, 64, 128, 256, 1024, 4096, 16384)
PARAMETERS = (1, 2, 4, 8)
MANY = 8192
SWEPT = (128, 1024, 16384)
CONTROLLERS = ("PD", "DOBVSC", "PD+FF+DOB", "PD+FC", "PD+FC+LE", "PD+FC+LS")
BARS = {
    "one lane over numba": ("at most", 1.0),
    "real-time factor": ("at least", 600.0),
    "lanes, numba prange over ours": ("at least", 9.0),
    "the same, ours in single precision": ("at least", 17.0),
    "jacfwd over forward": ("at most", 1.7),
    "reverse over forward, 64 lanes": ("at most", 4.5),
    "reverse, MB a lane at 50,000 steps": ("at most", 6.0),
    "tuner's iteration over jacfwd": ("at most", 2.0),
    "controller over its arithmetic": ("at most", 1.5),
    "dearest effect": ("at most", 1.3),
    "whole catalogue": ("at most", 6.0),
    "cold start, s": ("at most", 6.0),
    "warm start, s": ("at most", 3.0),
}


def bench(report: Report, wanted: tuple[str, ...] = ()) -> None:
    """Every part, or those that are wanted. Raises `ParameterError` for one that there is not."""
    parts: dict[str, Callable[[Report], dict[str, float]]] = {
        "single": _single,
        "lanes": _lanes,
        "sweep": _sweep,
        "controllers": _controllers,
        "gradients": _gradients,
        "reverse": _reverse,
        "tuner": _tuner,
        "effects": _effects,
        "growth": _growth,
        "roof": _roof,
        "start": _start,
        "accuracy": _accuracy,
    }
    for name in wanted:
        if name not in parts:
            raise ParameterError(f"--part {name}: no such part; known: {', '.join(parts)}")
    report.values(
        "machine",
        cores=cores(),
        devices=len(jax.devices()),
        kind=jax.devices()[0].device_kind,
        jax=jax.__version__,
    )
    reached: dict[str, float] = {}
    for name, part in parts.items():
        if not wanted or name in wanted:
            reached |= part(report)
    rows = [[name, reached.get(name), *BARS[name], _verdict(name, reached.get(name))] for name in BARS]
    rows = [row for row in rows if row[1] is not None or not wanted]
    report.table("bars", ("figure", "here", "", "bar", "reached"), rows, "Against what it should be")
    report.figure("bench", drawn(report.data["tables"]))


def _verdict(name: str, value: float | None) -> str:
    """Whether a bar is reached."""
    if value is None:
        return "not measured"
    how, bar = BARS[name]
    return "yes" if (value <= bar if how == "at most" else value >= bar) else "NO"


def _model() -> tuple[Drive, Controller]:
    drive = paper_drive()
    return drive, paper.controllers(drive)["PD+FC+LE"]


@contextlib.contextmanager
def _others(report: Report, given: Any, sampling: Sampling, count: int) -> Iterator[dict[str, Callable[[], Any]]]:
    """One lane and `count` lanes in C and in numba, as far as they are installed."""
    drive, controller = _model()
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
            from experiments.bench import in_numba

            jobs["numba, one lane"] = lambda: in_numba.roll(one, reference, load, sampling.period, steps)
            jobs["numba, lanes, one thread"] = lambda: in_numba.sweep(rows, reference, load, sampling.period, steps)
            jobs["numba, lanes, prange"] = lambda: in_numba.sweep(
                rows, reference, load, sampling.period, steps, threads
            )
        except ImportError:
            report.say("no numba: pip install 'diffdrive[bench]' to compare with it")
        yield jobs


def _ns(timing: clock.Timing, steps: int, lanes: int = 1) -> float:
    return 1e9 * timing.best / (steps * lanes)


def _single(report: Report) -> dict[str, float]:
    steps, rows, reached = 20_000, [], {}
    drive, controller = _model()
    for substeps in (8, 4):
        sampling, given = Sampling(RATE, substeps), loops.inputs(steps)
        with report.working(f"one lane, {substeps} substeps"), _others(report, given, sampling, 1) as others:
            ours = loops.single(drive, controller, given, sampling)
            _require_same(others, float(ours.run()), substeps)
            jobs = {"ours": ours.run} | {name: job for name, job in others.items() if name.endswith("one lane")}
            told = clock.by_turns(jobs)
        numba = told.get("numba, one lane")
        for name, timing in told.items():
            each = _ns(timing, steps)
            rows.append([substeps, name, each, None if numba is None else timing.best / numba.best, 1e9 / RATE / each])
        if substeps == Sampling(RATE).plant_steps:
            reached = {"real-time factor": 1e9 / RATE / _ns(told["ours"], steps)}
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
        if name.endswith("one lane") and abs(job()[0][0] - ours) > SAME:
            raise DiffdriveError(
                f"{name}: its RMS error differs from ours by more than {SAME:g} m ({substeps} substeps)"
            )


def _lanes(report: Report) -> dict[str, float]:
    steps, sampling, rows = 2_000, Sampling(RATE), []
    drive, controller = _model()
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
    base = _ns(told["numba"], steps, 64) if "numba" in told else None
    for count, one in compiled.items():
        each = _ns(told[str(count)], steps, count)
        ratio, other = None if base is None else base / each, _ns(told[f"single {count}"], steps, count)
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


def _sweep(report: Report) -> dict[str, float]:
    """As a sweep runs it: blocks, all devices; against numba on all cores, the same machines under the same loads."""
    steps, sampling = 5_000, Sampling(RATE)
    drive, controller = _model()
    given, none = loops.inputs(steps), np.zeros(steps)
    length = (steps - 1) * sampling.period

    def swept(count: int, precision: Precision = "double") -> Callable[[], Any]:
        machines = jax.tree.map(lambda leaf: leaf * jnp.ones(count), as_arrays(drive))
        top = float(given.load[-1]) * np.linspace(0.5, 1.5, count)
        ramp = Ramp(*(jnp.asarray(end) for end in (np.zeros(count), top, np.zeros(count), np.full(count, length))))
        unloaded = given._replace(load=jnp.asarray(none))
        return lambda: costs_of(machines, ramp, None, controller, unloaded, np.ones(steps), sampling, precision)

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
    each = {name: _ns(timing, steps, int(name.split()[-2])) for name, timing in told.items()}
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


def _controllers(report: Report) -> dict[str, float]:
    """Every controller beside PD, and beside what its arithmetic lets expect."""
    steps, sampling = 2_000, Sampling(RATE)
    drive, given = paper_drive(), loops.inputs(2_000)
    with report.working("controllers"):
        compiled = {
            name: loops.lanes(drive, paper.controllers(drive)[name], given, sampling, 64) for name in CONTROLLERS
        }
        told = clock.by_turns({name: one.run for name, one in compiled.items()})
    work = {name: of_step(drive, paper.controllers(drive)[name], sampling) for name in CONTROLLERS}
    rows = []
    for name, one in compiled.items():
        cost, expected = told[name].best / told["PD"].best, work[name] / work["PD"]
        kernel = "yes" if one.one_kernel else "NO"
        rows.append([name, _ns(told[name], steps, 64), cost, work[name], expected, cost / expected, kernel])
    report.table(
        "controllers",
        (
            "controller",
            "ns a lane-step",
            "over PD",
            "operations",
            "of them over PD",
            "cost over arithmetic",
            "one kernel",
        ),
        rows,
        "64 lanes, one core; operations of a step as its expression has them, a division counted as 8",
    )
    return {"controller over its arithmetic": max(row[5] for row in rows)}


def _gradients(report: Report) -> dict[str, float]:
    steps, sampling = 20_000, Sampling(RATE, 4)
    drive, controller = _model()
    with report.working("derivatives"):
        compiled = loops.derivatives(drive, controller, loops.inputs(steps), sampling)
        told = clock.by_turns({name: one.run for name, one in compiled.items()}, rounds=5)
    base = told["forward"].best
    rows = [
        [
            name, _ns(told[name], steps), told[name].best / base, one.memory * 50_000 / steps / 2**20,
            one.compile_seconds, "yes" if one.one_kernel else "NO",
        ]
        for name, one in compiled.items()
    ]  # fmt: skip
    report.table(
        "gradients", ("what", "ns a step", "over forward", "MiB at 50,000 steps", "compile s", "one kernel"), rows,
        "One lane of PD+FC+LE, 4 substeps, eight parameters",
    )  # fmt: skip
    return {"jacfwd over forward": told["jacfwd, 8 parameters"].best / base}


def _reverse(report: Report) -> dict[str, float]:
    """Reverse mode over a block of lanes: time, and what it keeps."""
    steps, sampling, count = 5_000, Sampling(RATE, 4), 64
    drive, controller = _model()
    with report.working("reverse mode over lanes"):
        compiled = loops.reverse(drive, controller, loops.inputs(steps), sampling, count)
        told = clock.by_turns({name: one.run for name, one in compiled.items()}, rounds=5)
    ratio = told[loops.PAIRS].best / told["forward"].best
    kept = {name: one.memory / count * 50_000 / steps / 1e6 for name, one in compiled.items()}
    rows = [
        [name, _ns(told[name], steps, count), told[name].best / told["forward"].best, kept[name],
         "yes" if one.one_kernel else "NO"]
        for name, one in compiled.items()
    ]  # fmt: skip
    report.table(
        "reverse", ("what", "ns a lane-step", "over forward", "MB a lane at 50,000 steps", "one kernel"), rows,
        f"{count} lanes of PD+FC+LE, 4 substeps: the mean error, and its gradient by eight parameters",
    )  # fmt: skip
    return {"reverse over forward, 64 lanes": ratio, "reverse, MB a lane at 50,000 steps": kept[loops.PAIRS]}


def _tuner(report: Report) -> dict[str, float]:
    """An iteration of the search that `diffdrive tune` makes, beside one pass for residuals and Jacobian."""
    steps, sampling = 50_000, Sampling(RATE, 4)
    drive, controller = _model()
    with report.working("the tuner's iteration"):
        given = loops.inputs(steps)
        (one_pass, few, less), (_, many, more) = (loops.tuner(drive, controller, given, sampling, n) for n in (2, 6))
        told = clock.by_turns({"pass": one_pass.run, "few": few, "many": many}, rounds=3)
    each = (told["many"].median - told["few"].median) / (more - less) if more > less else 0.0
    if not each > 0.0:
        report.say("The tuner's iteration is not told: more steps took no more time, or were none. Try again.")
        return {}
    rows = [
        ["residuals and Jacobian", told["pass"].median, 1.0],
        ["iteration", each, each / told["pass"].median],
    ]
    report.table(
        "tuner", ("what", "s", "over the pass"), rows,
        f"Levenberg-Marquardt on {steps} residuals of one lane, eight parameters ({more} steps less {less})",
    )  # fmt: skip
    return {"tuner's iteration over jacfwd": each / told["pass"].median}


def _effects(report: Report) -> dict[str, float]:
    """Each effect of the catalogue in the drive, neutral but there, beside the drive without; then all of them."""
    steps, sampling = 2_000, Sampling(RATE)
    drive, controller = _model()
    given = loops.inputs(steps)
    with report.working("effects"):
        compiled = {"none": loops.lanes(drive, controller, given, sampling, 64)}
        for name in EFFECTS:
            compiled[name] = loops.lanes(with_effects(drive, [name]), controller, given, sampling, 64)
        compiled["all"] = loops.lanes(with_effects(drive, EFFECTS), controller, given, sampling, 64)
        told = clock.by_turns({name: one.run for name, one in compiled.items()}, rounds=5)
    base = told["none"].best
    rows = [
        [name, _ns(told[name], steps, 64), told[name].best / base, "yes" if one.one_kernel else "NO"]
        for name, one in compiled.items()
    ]
    report.table("effects", ("effect", "ns a lane-step", "over none", "one kernel"), rows, "64 lanes, one core")
    return {
        "dearest effect": max(told[name].best for name in EFFECTS) / base,
        "whole catalogue": told["all"].best / base,
    }


def _growth(report: Report) -> dict[str, float]:
    """How the cost grows with the number of steps, and of parameters to differentiate by."""
    sampling, rows = Sampling(RATE), []
    drive, controller = _model()
    with report.working("growth with steps"):
        compiled = {n: loops.single(drive, controller, loops.inputs(n), sampling) for n in (1_000, 10_000, 100_000)}
        told = clock.by_turns({str(n): one.run for n, one in compiled.items()})
    for n, one in compiled.items():
        rows.append([n, _ns(told[str(n)], n), one.compile_seconds, one.memory / 2**20])
    report.table("growth", ("steps", "ns a step", "compile s", "MiB"), rows, "One lane of PD+FC+LE, costs only")
    steps, coarse = 20_000, Sampling(RATE, 4)
    with report.working("growth with parameters"):
        by = loops.by_parameters(drive, controller, loops.inputs(steps), coarse, PARAMETERS)
        told = clock.by_turns({str(n): one.run for n, one in by.items()}, rounds=5)
    report.table(
        "growth_with_parameters", ("parameters", "ns a step", "over forward", "compile s"),
        [[n, _ns(told[str(n)], steps), told[str(n)].best / told["0"].best, by[n].compile_seconds] for n in by],
        "One lane of PD+FC+LE in forward mode, 4 substeps",
    )  # fmt: skip
    return {}


def _roof(report: Report) -> dict[str, float]:
    """How much of what one core can do at most a block of lanes does."""
    steps, sampling = 2_000, Sampling(RATE)
    drive, controller = _model()
    work = of_step(drive, controller, sampling)
    ours = loops.lanes(drive, controller, loops.inputs(steps), sampling, 64)
    with report.working("the roof"), contextlib.ExitStack() as stack:
        try:
            jobs, size = stack.enter_context(roof.kernels())
        except DiffdriveError as problem:
            report.say(str(problem))
            return {}
        told = clock.by_turns(jobs | {"ours": ours.run}, rounds=5)
    rates = {name: times * roof.OPERATIONS / told[name].best / 1e9 for name, times in roof.KERNELS.items()}
    rates["ours"] = work * steps * 64 / told["ours"].best / 1e9
    rows = [[name, rate, rate / rates["added"]] for name, rate in rates.items()]
    report.table(
        "roof", ("what", "1e9 operations a second", "over additions"), rows,
        f"One core; {work} operations of a step of PD+FC+LE, a division counted as 8, in 64 lanes",
    )  # fmt: skip
    report.values("memory", read_GB_per_s=size / told["read"].best / 1e9)
    return {}


def _accuracy(report: Report) -> dict[str, float]:
    """What a substep costs in truth."""
    with report.working("errors of the plant's integrator"):
        errors = integrator_errors()
    report.table(
        "integrator", ("mm/s", *(f"{n} substeps" for n in SUBSTEPS)), errors,
        f"Largest position error over 1 s, nm, against {REFERENCE} substeps a period (10 kHz, PD, one reversal)",
    )  # fmt: skip
    return {}


def _start(report: Report) -> dict[str, float]:
    with report.working("starting in processes of their own"):
        first, others = cold.starts()
    report.values("start", cold_s=first, warm_s=others)
    return {"cold start, s": first, "warm start, s": min(others)}
