"""Derivatives of the project's scan, and the tuner's use of them, beside the scan alone."""

from diffdrive.model.parameters import Sampling
from experiments.benchmarks import clock, loops
from experiments.benchmarks.common import RATE, TUNER_SUBSTEPS, nominal, ns_per_step
from experiments.reports.report import Report


def gradients(report: Report) -> dict[str, float]:
    """Forward and reverse mode over one lane."""
    steps, sampling = 20_000, Sampling(RATE, TUNER_SUBSTEPS)
    drive, controller = nominal()
    with report.working("derivatives"):
        compiled = loops.derivatives(drive, controller, loops.paper_inputs(steps), sampling)
        timings = clock.time_interleaved({name: loop.run for name, loop in compiled.items()})
    base = timings["forward"].best
    rows = [
        [
            name, ns_per_step(timings[name], steps), timings[name].best / base, loop.memory * 50_000 / steps / 2**20,
            loop.compile_seconds, "yes" if loop.one_kernel else "NO",
        ]
        for name, loop in compiled.items()
    ]  # fmt: skip
    report.table(
        "gradients", ("what", "ns a step", "over forward", "MiB at 50,000 steps", "compile s", "one kernel"), rows,
        f"One lane of PD+FC+LE, {TUNER_SUBSTEPS} substeps, eight parameters",
    )  # fmt: skip
    return {"jacfwd over forward": timings["jacfwd, 8 parameters"].best / base}


def reverse(report: Report) -> dict[str, float]:
    """Reverse mode over a block of lanes: time, and what it keeps."""
    steps, sampling, count = 5_000, Sampling(RATE, TUNER_SUBSTEPS), 64
    drive, controller = nominal()
    with report.working("reverse mode over lanes"):
        compiled = loops.reverse(drive, controller, loops.paper_inputs(steps), sampling, count)
        timings = clock.time_interleaved({name: loop.run for name, loop in compiled.items()})
    measured = loops.CHECKPOINTS[
        4
    ]  # many lanes are in memory rather than in cache: the fewer carries are kept, the faster
    ratio = timings[measured].best / timings["forward"].best
    memory = {name: loop.memory / count * 50_000 / steps / 1e6 for name, loop in compiled.items()}
    rows = [
        [name, ns_per_step(timings[name], steps, count), timings[name].best / timings["forward"].best, memory[name],
         loop.compile_seconds, "yes" if loop.one_kernel else "NO"]
        for name, loop in compiled.items()
    ]  # fmt: skip
    report.table(
        "reverse",
        ("what", "ns a lane-step", "over forward", "MB a lane at 50,000 steps", "compile s", "one kernel"),
        rows,
        f"{count} lanes of PD+FC+LE, {TUNER_SUBSTEPS} substeps: the mean error, and its gradient by eight parameters",
    )  # fmt: skip
    return {"reverse over forward, 64 lanes": ratio, "reverse, MB a lane at 50,000 steps": memory[measured]}


def tuner(report: Report) -> dict[str, float]:
    """An iteration of Levenberg-Marquardt as fits make it, beside one pass for residuals and Jacobian."""
    steps, sampling = 50_000, Sampling(RATE, TUNER_SUBSTEPS)
    drive, controller = nominal()
    with report.working("the tuner's iteration"):
        inputs = loops.paper_inputs(steps)
        (one_pass, few_steps, few_count), (_, many_steps, many_count) = (
            loops.tuner(drive, controller, inputs, sampling, n) for n in (2, 6)
        )
        timings = clock.time_interleaved({"pass": one_pass.run, "few": few_steps, "many": many_steps}, rounds=7)
    iteration = (
        (timings["many"].best - timings["few"].best) / (many_count - few_count) if many_count > few_count else 0.0
    )
    if not iteration > 0.0:
        report.say(
            "The tuner's iteration cannot be timed: more steps took no more time, or there were none. Try again."
        )
        return {}
    rows = [
        ["residuals and Jacobian", timings["pass"].best, 1.0],
        ["iteration", iteration, iteration / timings["pass"].best],
    ]
    report.table(
        "tuner", ("what", "s", "over the pass"), rows,
        f"Levenberg-Marquardt on {steps} residuals of one lane, eight parameters ({many_count} steps less {few_count})",
    )  # fmt: skip
    return {"tuner's iteration over jacfwd": iteration / timings["pass"].best}
