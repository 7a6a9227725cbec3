"""How fast is the loop? Ratios side by side in one run; the absolute figures are this machine's."""

import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffdrive import metrics
from diffdrive.controllers import Controller
from diffdrive.parameters import Drive, Sampling, as_arrays
from diffdrive.presets import paper_drive
from diffdrive.simulate import Inputs, inputs_of, rollout, running_costs
from diffdrive.smooth import smooth
from experiments import paper
from experiments.accuracy import REFERENCE, SUBSTEPS, integrator_errors
from experiments.report import Report
from experiments.tuning_cases import reversal


def seconds(function: Any, *arguments: Any, repeats: int = 5) -> float:
    """Shortest of several runs of a compiled function."""
    jax.block_until_ready(function(*arguments))
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - began)
    return min(times)


def one_kernel(text: str) -> bool:
    """Whether a compiled program runs its loop over time as one native kernel (CPU).

    The mark alone says nothing: the plant's inner loop always carries it. It must stand in the entry computation, and
    no while-loop beside it.
    """
    entry = text[text.index("\nENTRY ") :]
    return "xla_cpu_small_call" in entry and " while(" not in entry


def compiled(function: Any, *arguments: Any) -> tuple[Any, float, bool]:
    """The compiled function, how long that took (s), and whether its loop became one kernel."""
    began = time.perf_counter()
    built = jax.jit(function).lower(*arguments).compile()
    return built, time.perf_counter() - began, one_kernel(built.as_text())


def _loops(
    drive: Drive, controller: Controller, inputs: Inputs, sampling: Sampling
) -> dict[str, tuple[Any, tuple, int]]:
    counts = jnp.ones(len(inputs.load))
    models = as_arrays((drive, controller))
    soft = as_arrays(smooth((drive, controller)))

    def costs(models: Any, load: Any) -> Any:
        return running_costs(*models, inputs._replace(load=load * inputs.load), counts, sampling).rms

    def rms(gains: Any) -> Any:
        changed = eqx.tree_at(lambda c: [c.tracking.gains.kp, c.tracking.gains.kd], soft[1], list(gains))
        return metrics.rms(inputs.reference.position - rollout(soft[0], changed, inputs, sampling).position)

    def lanes(models: Any, loads: Any) -> Any:
        return jax.vmap(costs, in_axes=(None, 0))(models, loads)

    one = jnp.asarray(1.0)
    gains = (soft[1].tracking.gains.kp, soft[1].tracking.gains.kd)
    several = {f"{n} lanes": (lanes, (models, jnp.linspace(0.5, 1.5, n)), n) for n in (16, 64, 256)}
    return {
        "one lane, running costs": (costs, (models, one), 1),
        "one lane, every signal recorded": (lambda m: rollout(*m, inputs, sampling), (models,), 1),
        **several,
        "forward gradient, 2 gains": (jax.jacfwd(rms), (gains,), 1),
        "reverse gradient, 2 gains": (jax.grad(rms), (gains,), 1),
    }


def benchmark(out: Path | None) -> Report:
    """Time the loop of PD, PD+FC+LE and PD+FC+LS in several forms; in ns per lane-step and relative to one lane."""
    title = f"Speed of the closed loop (jax {jax.__version__}, {jax.devices()[0].device_kind}, 1.2 s at 10 kHz)"
    with Report(title, out) as report:
        with report.working("errors of the plant's integrator"):
            errors = integrator_errors()
        report.table(
            "integrator", ("mm/s", *(f"{n} substeps" for n in SUBSTEPS)), errors,
            f"Largest position error over 1 s, nm, against {REFERENCE} substeps a period (10 kHz, PD, one reversal)",
        )  # fmt: skip
        drive = paper_drive()
        motion = reversal(0.010, paper.SAMPLING.rate)
        inputs = inputs_of(motion, np.full(len(motion.time), 5_000.0))
        rows = []
        for name in ("PD", "PD+FC+LE", "PD+FC+LS"):
            controller = paper.controllers(drive)[name]
            base = None
            with report.working(f"timing {name}"):
                for form, (function, arguments, lanes) in _loops(drive, controller, inputs, paper.SAMPLING).items():
                    built, building, hoisted = compiled(function, *arguments)
                    spent = 1e9 * seconds(built, *arguments) / (lanes * len(motion.time))
                    base = base or spent
                    rows.append([name, form, spent, spent / base, building, "yes" if hoisted else "NO"])
        report.table(
            "benchmark", ("controller", "form", "ns per lane-step", "x one lane", "compile s", "one kernel"), rows,
            "Time of one control step (8 plant substeps)",
        )  # fmt: skip
    return report
