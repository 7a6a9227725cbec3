"""The parts of a sweep in several processes of this machine.

They talk with the one that started them by pipes that nobody else has: no port is opened, and no secret is needed.
"""

import functools
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool

import pyarrow as pa

from diffdrive.errors import ParameterError
from diffdrive.runtime import allow_accelerator, configure, cores
from diffdrive.support.processes import processes
from diffdrive.support.resources import require_memory
from tuning.sweeps.costs import part_costs
from tuning.sweeps.identity import identity
from tuning.sweeps.parts import ComputedParts, Engine, Notify
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.spec import SweepSpec, from_text, to_text

WORKER_BYTES = 3e8  # bytes of a process that has done nothing yet, jax and the package in it
PARTS_PER_WORKER = 2  # parts for each worker, one that it runs and the next: what is done waits in memory to be written
MAX_LOSSES = 3  # of workers in a row without a part done, as many as Dask allows


@functools.lru_cache(maxsize=1)
def _plan(text: str, devices: int | None) -> SweepPlan:
    """The plan from its text, once in a process and not once in each of its parts."""
    configure(devices)
    if devices is None:  # a machine of a cluster, not some cores of this one
        allow_accelerator()
    return from_text(text).plan()


def run_part(text: str, question: str, devices: int | None, part: int) -> pa.Table:
    """One part, on whichever machine this runs; `devices` is how many of its cores, None for all and a GPU."""
    plan = _plan(text, devices)
    if identity(plan) != question:
        raise ParameterError(
            "a worker has another version of diffdrive, jax, numpy or scipy, another processor, other XLA_FLAGS, or "
            "other effects and controllers of your own than the program that asks: they must be the same everywhere"
        )
    return part_costs(plan, part)


def on_workers(spec: SweepSpec, workers: int) -> Engine:
    """An engine for `parts.run_parts`: so many processes of this machine, which share its cores.

    A part whose worker is killed is run again. Raises `ParameterError` where there is no memory for so many, where
    workers are killed again and again, and where the sweep cannot be sent to them.
    """
    if workers < 1:
        raise ParameterError(f"workers: at least one is needed, got {workers}")
    require_memory(ParameterError, f"workers: {workers} processes", WORKER_BYTES * workers, "give fewer")
    text = to_text(spec)

    def engine(plan: SweepPlan, wanted: list[int], notify: Notify) -> ComputedParts:
        run = functools.partial(run_part, text, identity(plan), max(1, cores() // workers))
        remaining, losses = list(wanted), 0
        while remaining:
            try:
                for part, table in _compute(run, remaining, workers):
                    remaining.remove(part)
                    losses = 0
                    yield part, table
            except BrokenProcessPool:
                losses += 1
                if losses == MAX_LOSSES:
                    raise ParameterError(
                        f"workers: the {workers} processes are killed again and again, for want of memory perhaps: "
                        "give fewer; the parts that were done are kept: the same sweep goes on there"
                    ) from None
                notify("a worker was killed; the parts that were under way are run again")

    return engine


def _compute(run: "functools.partial[pa.Table]", wanted: list[int], workers: int) -> ComputedParts:
    """The parts as they are done, in processes that end with this."""
    with processes(min(workers, len(wanted))) as pool:
        waiting, running = iter(list(wanted)), dict[Future[pa.Table], int]()
        while True:
            for part in waiting:
                running[pool.submit(run, part)] = part
                if len(running) >= PARTS_PER_WORKER * workers:
                    break
            if not running:
                return
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(done), done.result()
