"""`diffdrive bench`: how fast the tool is on this machine, each figure beside what it is compared with."""

import contextlib
from collections.abc import Callable, Mapping, Sequence

import jax

from diffdrive.effects.catalogue import EFFECTS
from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.model.parameters import Sampling
from diffdrive.model.presets import paper_drive
from diffdrive.runtime import cores
from experiments.benchmarks import clock, loops, roof, start_time
from experiments.benchmarks.accuracy import REFERENCE_SUBSTEPS, SUBSTEPS, errors_of_random_drives, integrator_errors
from experiments.benchmarks.arithmetic import step_operations
from experiments.benchmarks.common import RATE, TUNER_SUBSTEPS, nominal, ns_per_step
from experiments.benchmarks.derivatives import gradients, reverse, tuner
from experiments.benchmarks.figures import bench_figure
from experiments.benchmarks.hand_written import COARSE_SUBSTEPS, lanes_of_one_core, one_lane, swept_lanes
from experiments.reports.readable import significant
from experiments.reports.report import Report
from experiments.studies.paper import scenario as paper
from experiments.studies.recovery.random_drive import SPREAD
from tuning.sweeps.varied import with_effects

PARAMETERS = (1, 2, 4, 8)
CONTROLLERS = ("PD", "DOBVSC", "PD+FF+DOB", "PD+FC", "PD+FC+LE", "PD+FC+LS")
BARS = {
    "one lane over numba": ("at most", 1.0),
    "real-time factor": ("at least", 600.0),
    f"real-time factor, {COARSE_SUBSTEPS} substeps": ("at least", 600.0),
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


def bench(report: Report, selected: tuple[str, ...] = ()) -> None:
    """Run every part, or the selected ones. Raises `ParameterError` for an unknown part."""
    parts: dict[str, Callable[[Report], dict[str, float]]] = {
        "single": one_lane,
        "lanes": lanes_of_one_core,
        "sweep": swept_lanes,
        "controllers": _controllers,
        "gradients": gradients,
        "reverse": reverse,
        "tuner": tuner,
        "effects": _effects,
        "growth": _growth,
        "roof": _roof,
        "start": _start,
        "accuracy": _accuracy,
    }
    for name in selected:
        if name not in parts:
            raise ParameterError(f"--part {name}: no such part; known: {', '.join(parts)}")
    report.values(
        "machine",
        cores=cores(),
        devices=len(jax.devices()),
        kind=jax.devices()[0].device_kind,
        jax=jax.__version__,
    )
    measured: dict[str, float] = {}
    for name, part in parts.items():
        if not selected or name in selected:
            measured |= part(report)
    rows = [[name, measured.get(name), *BARS[name], _verdict(name, measured.get(name))] for name in BARS]
    rows = [row for row in rows if row[1] is not None or not selected]
    if rows:
        report.table("bars", ("figure", "here", "", "bar", "reached"), rows, "Against what it should be")
    sentence, good = in_words(measured, selected)
    report.result(sentence, good=good)
    figure = bench_figure(report.data["tables"])
    if figure is not None:
        report.figure(
            "bench", figure, "Time of a step on this machine, and ratios of such times, a panel for each part."
        )


def in_words(measured: Mapping[str, float], selected: Sequence[str]) -> tuple[str, bool | None]:
    """How many of the measured figures reach their bar and which do not; whether all do, None where none has one."""
    judged = [name for name in BARS if name in measured]
    if not judged:
        return f"Measured: {', '.join(selected)}, of which no figure has a bar to reach.", None
    missed = [
        f"{name}: {significant(measured[name])}, should be {' '.join(map(str, BARS[name]))}"
        for name in judged
        if _verdict(name, measured[name]) != "yes"
    ]
    reached = f"{len(judged) - len(missed)} of {len(judged)} figures reach their bar"
    return f"{reached}{'; not ' if missed else ''}{'; '.join(missed)}.", not missed


def _verdict(name: str, value: float | None) -> str:
    """Whether a bar is reached."""
    if value is None:
        return "not measured"
    relation, bar = BARS[name]
    return "yes" if (value <= bar if relation == "at most" else value >= bar) else "NO"


def _controllers(report: Report) -> dict[str, float]:
    """Every controller beside PD, and beside what its arithmetic lets expect."""
    steps, sampling = 2_000, Sampling(RATE)
    drive, inputs = paper_drive(), loops.paper_inputs(2_000)
    with report.working("controllers"):
        compiled = {
            name: loops.lanes(drive, paper.controllers(drive)[name], inputs, sampling, 64) for name in CONTROLLERS
        }
        timings = clock.time_interleaved({name: loop.run for name, loop in compiled.items()})
    work = {name: step_operations(drive, paper.controllers(drive)[name], sampling) for name in CONTROLLERS}
    rows: list[list[object]] = []
    excess: list[float] = []
    for name, loop in compiled.items():
        cost, expected = timings[name].best / timings["PD"].best, work[name] / work["PD"]
        excess.append(cost / expected)
        kernel = "yes" if loop.one_kernel else "NO"
        rows.append([name, ns_per_step(timings[name], steps, 64), cost, work[name], expected, cost / expected, kernel])
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
    return {"controller over its arithmetic": max(excess)}


def _effects(report: Report) -> dict[str, float]:
    """Each effect of the catalogue in the drive, neutral but there, beside the drive without; then all of them."""
    steps, sampling = 2_000, Sampling(RATE)
    drive, controller = nominal()
    inputs = loops.paper_inputs(steps)
    with report.working("effects"):
        compiled = {"none": loops.lanes(drive, controller, inputs, sampling, 64)}
        for name in EFFECTS:
            compiled[name] = loops.lanes(with_effects(drive, [name]), controller, inputs, sampling, 64)
        compiled["all"] = loops.lanes(with_effects(drive, EFFECTS), controller, inputs, sampling, 64)
        timings = clock.time_interleaved({name: loop.run for name, loop in compiled.items()})
    base = timings["none"].best
    rows = [
        [
            name,
            ns_per_step(timings[name], steps, 64),
            timings[name].best / base,
            "yes" if loop.one_kernel else "NO",
        ]
        for name, loop in compiled.items()
    ]
    report.table("effects", ("effect", "ns a lane-step", "over none", "one kernel"), rows, "64 lanes, one core")
    return {
        "dearest effect": max(timings[name].best for name in EFFECTS) / base,
        "whole catalogue": timings["all"].best / base,
    }


def _growth(report: Report) -> dict[str, float]:
    """How the cost grows with the number of steps, and of parameters to differentiate by."""
    sampling, rows = Sampling(RATE), []
    drive, controller = nominal()
    with report.working("growth with steps"):
        compiled = {
            n: loops.single(drive, controller, loops.paper_inputs(n), sampling) for n in (1_000, 10_000, 100_000)
        }
        timings = clock.time_interleaved({str(n): loop.run for n, loop in compiled.items()})
    for n, loop in compiled.items():
        rows.append([n, ns_per_step(timings[str(n)], n), loop.compile_seconds, loop.memory / 2**20])
    report.table("growth", ("steps", "ns a step", "compile s", "MiB"), rows, "One lane of PD+FC+LE, costs only")
    steps, coarse = 20_000, Sampling(RATE, TUNER_SUBSTEPS)
    with report.working("growth with parameters"):
        by_count = loops.by_parameters(drive, controller, loops.paper_inputs(steps), coarse, PARAMETERS)
        timings = clock.time_interleaved({str(n): loop.run for n, loop in by_count.items()})
    report.table(
        "growth_with_parameters", ("parameters", "ns a step", "over forward", "compile s"),
        [
            [n, ns_per_step(timings[str(n)], steps), timings[str(n)].best / timings["0"].best, loop.compile_seconds]
            for n, loop in by_count.items()
        ],
        f"One lane of PD+FC+LE in forward mode, {TUNER_SUBSTEPS} substeps",
    )  # fmt: skip
    return {}


def _roof(report: Report) -> dict[str, float]:
    """How much of what one core can do at most a block of lanes does."""
    steps, sampling = 2_000, Sampling(RATE)
    drive, controller = nominal()
    work = step_operations(drive, controller, sampling)
    block = loops.lanes(drive, controller, loops.paper_inputs(steps), sampling, 64)
    with report.working("the roof"), contextlib.ExitStack() as stack:
        try:
            jobs, size = stack.enter_context(roof.kernels())
        except DiffdriveError as error:
            report.say(str(error))
            return {}
        timings = clock.time_interleaved(jobs | {"ours": block.run})
    rates = {name: times * roof.OPERATIONS / timings[name].best / 1e9 for name, times in roof.KERNELS.items()}
    rates["ours"] = work * steps * 64 / timings["ours"].best / 1e9
    rows = [[name, rate, rate / rates["added"]] for name, rate in rates.items()]
    report.table(
        "roof", ("what", "1e9 operations a second", "over additions"), rows,
        f"One core; {work} operations of a step of PD+FC+LE, a division counted as 8, in 64 lanes",
    )  # fmt: skip
    report.values("memory", read_GB_per_s=size / timings["read"].best / 1e9)
    return {}


def _accuracy(report: Report) -> dict[str, float]:
    """What a substep costs in truth."""
    with report.working("errors of the plant's integrator"):
        errors, random_errors = integrator_errors(), errors_of_random_drives()
    report.table(
        "integrator", ("mm/s", *(f"{n} substeps" for n in SUBSTEPS)), errors,
        f"Largest position error over 1 s, nm, against {REFERENCE_SUBSTEPS} substeps a period "
        "(10 kHz, PD, one reversal)",
    )  # fmt: skip
    report.table(
        "integrator_of_others", ("Hz", "mm/s", "median", "95 %", "largest", "drives"), random_errors,
        f"The same, of random drives within {SPREAD:.0%} of that one, with the default substeps",
    )  # fmt: skip
    return {}


def _start(report: Report) -> dict[str, float]:
    with report.working("starting in processes of their own"):
        cold, warm = start_time.start_times()
    report.values("start", cold_s=cold, warm_s=warm)
    return {"cold start, s": cold, "warm start, s": min(warm)}
