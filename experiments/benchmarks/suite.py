"""`diffdrive bench`: how fast the tool is on this machine, each figure beside what it is compared with."""

import contextlib
from collections.abc import Callable

import jax

from diffdrive.effects.catalogue import EFFECTS
from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.model.parameters import Sampling
from diffdrive.model.presets import paper_drive
from diffdrive.runtime import cores
from experiments.benchmarks import clock, loops, roof, start_time
from experiments.benchmarks.accuracy import REFERENCE, SUBSTEPS, errors_of_random_drives, integrator_errors
from experiments.benchmarks.arithmetic import of_step
from experiments.benchmarks.common import COARSE, RATE, nanoseconds, nominal
from experiments.benchmarks.derivatives import gradients, reverse, tuner
from experiments.benchmarks.figures import drawn
from experiments.benchmarks.hand_written import FAST, lanes_of_one_core, one_lane, swept_lanes
from experiments.reports.report import Report
from experiments.studies.paper import scenario as paper
from experiments.studies.recovery.random_drive import SPREAD
from tuning.sweeps.varied import with_effects

PARAMETERS = (1, 2, 4, 8)
CONTROLLERS = ("PD", "DOBVSC", "PD+FF+DOB", "PD+FC", "PD+FC+LE", "PD+FC+LS")
BARS = {
    "one lane over numba": ("at most", 1.0),
    "real-time factor": ("at least", 600.0),
    f"real-time factor, {FAST} substeps": ("at least", 600.0),
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
    figure = drawn(report.data["tables"])
    if figure is not None:
        report.figure("bench", figure)


def _verdict(name: str, value: float | None) -> str:
    """Whether a bar is reached."""
    if value is None:
        return "not measured"
    how, bar = BARS[name]
    return "yes" if (value <= bar if how == "at most" else value >= bar) else "NO"


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
        rows.append([name, nanoseconds(told[name], steps, 64), cost, work[name], expected, cost / expected, kernel])
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


def _effects(report: Report) -> dict[str, float]:
    """Each effect of the catalogue in the drive, neutral but there, beside the drive without; then all of them."""
    steps, sampling = 2_000, Sampling(RATE)
    drive, controller = nominal()
    given = loops.inputs(steps)
    with report.working("effects"):
        compiled = {"none": loops.lanes(drive, controller, given, sampling, 64)}
        for name in EFFECTS:
            compiled[name] = loops.lanes(with_effects(drive, [name]), controller, given, sampling, 64)
        compiled["all"] = loops.lanes(with_effects(drive, EFFECTS), controller, given, sampling, 64)
        told = clock.by_turns({name: one.run for name, one in compiled.items()})
    base = told["none"].best
    rows = [
        [name, nanoseconds(told[name], steps, 64), told[name].best / base, "yes" if one.one_kernel else "NO"]
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
    drive, controller = nominal()
    with report.working("growth with steps"):
        compiled = {n: loops.single(drive, controller, loops.inputs(n), sampling) for n in (1_000, 10_000, 100_000)}
        told = clock.by_turns({str(n): one.run for n, one in compiled.items()})
    for n, one in compiled.items():
        rows.append([n, nanoseconds(told[str(n)], n), one.compile_seconds, one.memory / 2**20])
    report.table("growth", ("steps", "ns a step", "compile s", "MiB"), rows, "One lane of PD+FC+LE, costs only")
    steps, coarse = 20_000, Sampling(RATE, COARSE)
    with report.working("growth with parameters"):
        by = loops.by_parameters(drive, controller, loops.inputs(steps), coarse, PARAMETERS)
        told = clock.by_turns({str(n): one.run for n, one in by.items()})
    report.table(
        "growth_with_parameters", ("parameters", "ns a step", "over forward", "compile s"),
        [[n, nanoseconds(told[str(n)], steps), told[str(n)].best / told["0"].best, by[n].compile_seconds] for n in by],
        f"One lane of PD+FC+LE in forward mode, {COARSE} substeps",
    )  # fmt: skip
    return {}


def _roof(report: Report) -> dict[str, float]:
    """How much of what one core can do at most a block of lanes does."""
    steps, sampling = 2_000, Sampling(RATE)
    drive, controller = nominal()
    work = of_step(drive, controller, sampling)
    ours = loops.lanes(drive, controller, loops.inputs(steps), sampling, 64)
    with report.working("the roof"), contextlib.ExitStack() as stack:
        try:
            jobs, size = stack.enter_context(roof.kernels())
        except DiffdriveError as problem:
            report.say(str(problem))
            return {}
        told = clock.by_turns(jobs | {"ours": ours.run})
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
        errors, others = integrator_errors(), errors_of_random_drives()
    report.table(
        "integrator", ("mm/s", *(f"{n} substeps" for n in SUBSTEPS)), errors,
        f"Largest position error over 1 s, nm, against {REFERENCE} substeps a period (10 kHz, PD, one reversal)",
    )  # fmt: skip
    report.table(
        "integrator_of_others", ("Hz", "mm/s", "median", "95 %", "largest", "drives"), others,
        f"The same, of random drives within {SPREAD:.0%} of that one, with the default substeps",
    )  # fmt: skip
    return {}


def _start(report: Report) -> dict[str, float]:
    with report.working("starting in processes of their own"):
        first, others = start_time.starts()
    report.values("start", cold_s=first, warm_s=others)
    return {"cold start, s": first, "warm start, s": min(others)}
