"""Derivatives of the project's scan, and the tuner's use of them, beside the scan alone."""

from diffdrive.model.parameters import Sampling
from experiments.benchmarks import clock, loops
from experiments.benchmarks.common import COARSE, RATE, nanoseconds, nominal
from experiments.reports.report import Report


def gradients(report: Report) -> dict[str, float]:
    """Forward and reverse mode over one lane."""
    steps, sampling = 20_000, Sampling(RATE, COARSE)
    drive, controller = nominal()
    with report.working("derivatives"):
        compiled = loops.derivatives(drive, controller, loops.inputs(steps), sampling)
        told = clock.by_turns({name: one.run for name, one in compiled.items()})
    base = told["forward"].best
    rows = [
        [
            name, nanoseconds(told[name], steps), told[name].best / base, one.memory * 50_000 / steps / 2**20,
            one.compile_seconds, "yes" if one.one_kernel else "NO",
        ]
        for name, one in compiled.items()
    ]  # fmt: skip
    report.table(
        "gradients", ("what", "ns a step", "over forward", "MiB at 50,000 steps", "compile s", "one kernel"), rows,
        f"One lane of PD+FC+LE, {COARSE} substeps, eight parameters",
    )  # fmt: skip
    return {"jacfwd over forward": told["jacfwd, 8 parameters"].best / base}


def reverse(report: Report) -> dict[str, float]:
    """Reverse mode over a block of lanes: time, and what it keeps."""
    steps, sampling, count = 5_000, Sampling(RATE, COARSE), 64
    drive, controller = nominal()
    with report.working("reverse mode over lanes"):
        compiled = loops.reverse(drive, controller, loops.inputs(steps), sampling, count)
        told = clock.by_turns({name: one.run for name, one in compiled.items()})
    judged = loops.KEPT[4]  # of many lanes in memory rather than in cache, the fewer kept the faster
    ratio = told[judged].best / told["forward"].best
    kept = {name: one.memory / count * 50_000 / steps / 1e6 for name, one in compiled.items()}
    rows = [
        [name, nanoseconds(told[name], steps, count), told[name].best / told["forward"].best, kept[name],
         one.compile_seconds, "yes" if one.one_kernel else "NO"]
        for name, one in compiled.items()
    ]  # fmt: skip
    report.table(
        "reverse",
        ("what", "ns a lane-step", "over forward", "MB a lane at 50,000 steps", "compile s", "one kernel"),
        rows,
        f"{count} lanes of PD+FC+LE, {COARSE} substeps: the mean error, and its gradient by eight parameters",
    )  # fmt: skip
    return {"reverse over forward, 64 lanes": ratio, "reverse, MB a lane at 50,000 steps": kept[judged]}


def tuner(report: Report) -> dict[str, float]:
    """An iteration of Levenberg-Marquardt as fits make it, beside one pass for residuals and Jacobian."""
    steps, sampling = 50_000, Sampling(RATE, COARSE)
    drive, controller = nominal()
    with report.working("the tuner's iteration"):
        given = loops.inputs(steps)
        (one_pass, few, less), (_, many, more) = (loops.tuner(drive, controller, given, sampling, n) for n in (2, 6))
        told = clock.by_turns({"pass": one_pass.run, "few": few, "many": many}, rounds=7)
    each = (told["many"].best - told["few"].best) / (more - less) if more > less else 0.0
    if not each > 0.0:
        report.say("The tuner's iteration is not told: more steps took no more time, or were none. Try again.")
        return {}
    rows = [
        ["residuals and Jacobian", told["pass"].best, 1.0],
        ["iteration", each, each / told["pass"].best],
    ]
    report.table(
        "tuner", ("what", "s", "over the pass"), rows,
        f"Levenberg-Marquardt on {steps} residuals of one lane, eight parameters ({more} steps less {less})",
    )  # fmt: skip
    return {"tuner's iteration over jacfwd": each / told["pass"].best}
