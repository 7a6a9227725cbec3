"""The exported C code beside the simulator, bit for bit, and the time that a step of it takes.

    python -m experiments.benchmarks.exported

compiles each kind of controller, with its own gains and with gains at random, and replays 50,000 steps. The simulator
is compiled without fused products and sums, so that both round alike. Last, for comparison, come PD+FC+LE and its plant
in one step, written by hand in C and in numba.
"""

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

FUSION_OFF = "--xla_cpu_max_isa=AVX"  # the last instruction set of x86 without fused products and sums
STEPS = 50_000
# of the largest value of each output: a few units of the last place, times what the disturbance observer's coefficient
# 1 - exp(-w T) loses of its exponential, which is the library's here and XLA's there
TOLERANCE = 1e-12
TIMER = Path(__file__).with_name("exported_time.c")


def main() -> None:
    """Print a table; end with 1 where a kind differs by more than the tolerance."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=3, help="how many sets of gains at random")
    parser.add_argument("--no-time", action="store_true", help="leave the time of a step out")
    given = parser.parse_args()
    if FUSION_OFF not in os.environ.get("XLA_FLAGS", ""):
        flags = f"{os.environ.get('XLA_FLAGS', '')} {FUSION_OFF}".strip()
        sys.exit(
            subprocess.run(
                [sys.executable, "-m", __spec__.name, *sys.argv[1:]], env=os.environ | {"XLA_FLAGS": flags}
            ).returncode
        )
    from diffdrive.runtime import configure

    configure()
    sys.exit(0 if _agree(given.seeds, not given.no_time) else 1)


def _agree(seeds: int, timed: bool) -> bool:
    """Whether every kind agrees."""
    import numpy as np

    from diffdrive import motion
    from diffdrive.paper import example_controllers, paper_axis
    from diffdrive.simulation import simulate
    from experiments.exports.compiled import replayed
    from experiments.exports.replay import replay_of
    from experiments.exports.targets import TARGETS
    from experiments.exports.trace import program_of

    agrees = True
    for kind in example_controllers(paper_axis().drive):
        axis = paper_axis(kind)
        duration = (STEPS - 1) / axis.rate
        lap = motion.sine(amplitude=5e-3, frequency=2.0, duration=duration, rate=axis.rate)
        run = simulate(axis, lap, 5e3)
        for seed in range(seeds + 1):
            random = np.random.default_rng(seed)
            gains = {name: float(gain) * 2.0 ** random.uniform(-1, 1) for name, gain in axis.gains.items()}
            other = axis.with_gains(**gains) if seed else axis
            program = program_of(other.controller, 1.0 / axis.rate, "axis")
            replay = replay_of(program, other, lap, run)
            files = TARGETS["c99"].write(program, kind, replay, dict.fromkeys(replay.outputs, TOLERANCE))
            differences = replayed("axis", files)
            if not differences:
                sys.stdout.write("no C compiler on this machine\n")
                return False
            within = max(differences.values()) <= TOLERANCE
            agrees = agrees and within
            told = ", ".join(f"{name} {value:.1e}" for name, value in differences.items())
            gains_text = f"gains at random, seed {seed}" if seed else "its own gains"
            sys.stdout.write(f"{kind}, {gains_text}: {told}{'' if within else '  BEYOND'}\n")
        if timed:
            for single in (False, True):
                program = program_of(axis.controller, 1.0 / axis.rate, "axis", single=single)
                median, most, largest, rate = _step_time(program, lap, axis, run)
                sys.stdout.write(
                    f"    {'single' if single else 'double'}: median {median:.0f} cycles a step "
                    f"({median / rate:.1f} ns), 99.9 % {most:.0f}, largest {largest:.0f}\n"
                )
    if timed:
        for name, nanoseconds in _by_hand().items():
            sys.stdout.write(f"{name}: {nanoseconds * rate:.0f} cycles a step ({nanoseconds:.1f} ns)\n")
    return agrees


def _step_time(program: object, lap: object, axis: object, run: object) -> tuple[float, ...]:
    """Median, 99.9 % and largest time of a step, cycles; cycles a nanosecond."""
    from diffdrive.support.atomic_write import write_text
    from experiments.exports.compiled import compiler
    from experiments.exports.replay import replay_of
    from experiments.exports.targets import TARGETS

    replay = replay_of(program, axis, lap, run)  # type: ignore[arg-type]
    files = TARGETS["c99"].write(program, "time", replay, dict.fromkeys(replay.outputs, 1.0))  # type: ignore[arg-type]
    with tempfile.TemporaryDirectory() as folder:
        for file, content in files.items():
            write_text(Path(folder) / file, str(content))
        count = len(program.inputs)  # type: ignore[attr-defined]
        options = [f"-DINPUTS={count}", f"-DREAL={'float' if program.single else 'double'}"]  # type: ignore[attr-defined]
        options += ["-std=gnu99", "-O2", "-march=native", "-I.", "-o", "time", str(TIMER), "axis.c", "-lm"]
        subprocess.run([*(compiler() or ["cc"]), *options], cwd=folder, check=True)
        ran = subprocess.run([f"{folder}/time", "axis_run.csv"], cwd=folder, check=True, capture_output=True, text=True)
    return tuple(map(float, ran.stdout.split()))


def _by_hand() -> dict[str, float]:
    """Nanoseconds for a step of PD+FC+LE and its plant in one substep, as far as a compiler and numba are there."""
    import numpy as np

    from diffdrive.errors import DiffdriveError
    from diffdrive.model.parameters import Sampling
    from experiments.benchmarks import clock, in_c, loops
    from experiments.benchmarks.common import RATE, nominal, ns_per_step
    from experiments.benchmarks.parameters import lane_parameters

    sampling, inputs = Sampling(RATE, substeps=1), loops.paper_inputs(STEPS)
    given = (
        lane_parameters(*nominal()), np.stack(list(map(np.asarray, inputs.reference))), np.asarray(inputs.load),
        sampling.period, sampling.plant_steps,
    )  # fmt: skip
    jobs = {}
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(DiffdriveError):
            in_c_roll = stack.enter_context(in_c.compiled()).roll
            jobs["with the plant, by hand in C"] = lambda: in_c_roll(*given)
        with contextlib.suppress(ImportError):
            from experiments.benchmarks import in_numba

            jobs["with the plant, by hand in numba"] = lambda: in_numba.roll(*given)
        timings = clock.time_interleaved(jobs)
    return {f"PD+FC+LE {name}": ns_per_step(timing, STEPS) for name, timing in timings.items()}


if __name__ == "__main__":
    main()
