"""The parts of a sweep on many processes or machines, by Dask distributed.

Dask, not Ray: it is Python throughout, a worker is one command on any machine, it runs a lost worker's tasks again by
itself, and every batch system has a launcher for it. It is the package's extra `cluster`.
"""

import contextlib
import functools
import itertools
import re
import time
from concurrent.futures import CancelledError
from typing import Any

import pyarrow as pa

from diffdrive.errors import ParameterError
from diffdrive.resources import require_memory
from experiments.runtime import configure, cores, keep_compiled, with_accelerator
from experiments.sweeps.asked import Asked, from_text, to_text
from experiments.sweeps.parts import Computed, Engine, Say
from experiments.sweeps.plan import Plan
from experiments.whole import FULL

ANSWERS_WITHIN = 20.0  # s, the scheduler at an address
SELDOM = 2.0  # s, between two looks at who is there
WORKER = 3e8  # bytes of a process that has done nothing yet, jax and the package in it
AHEAD = 3  # parts for each worker that the scheduler knows of: it holds what it is given


@functools.lru_cache(maxsize=1)
def _plan(text: str, devices: int | None) -> Plan:
    """The plan from its text, once in a process and not once in each of its parts."""
    configure(devices)
    if devices is None:  # a machine of a cluster, not some cores of this one
        with_accelerator()
    keep_compiled()
    return from_text(text).plan()


def _part(text: str, question: str, devices: int | None, part: int) -> pa.Table:
    """One part, on whichever machine this runs."""
    plan = _plan(text, devices)
    if plan.question() != question:
        raise ParameterError(
            "a worker has another edition of diffdrive, jax, numpy or scipy, another processor or other XLA_FLAGS than "
            "the program that asks: the same ones are needed on every machine of the cluster"
        )
    return plan.costs(part)


def _client(address: str) -> Any:
    from distributed import Client

    try:
        return Client(address, timeout=ANSWERS_WITHIN)
    except (OSError, ValueError) as problem:  # ValueError: a scheme that Dask does not know
        raise ParameterError(f"--cluster {address}: no scheduler answers there ({problem})") from None


def _await(client: Any, done: Any, where: str, say: Say) -> None:
    """Until a part is done, saying once if nobody is there to do it."""
    said, asked = False, 0.0
    while not done.has_ready():
        if time.monotonic() - asked > SELDOM:
            asked = time.monotonic()
            if client.nthreads():
                said = False
            elif not said:
                said = True
                say(f"waiting for workers: {where} has none; start some as `dask worker {client.scheduler.address}`")
        time.sleep(0.02)


def on_cluster(asked: Asked, workers: int = 1, address: str | None = None) -> Engine:
    """An engine for `parts.run`: `workers` processes of this machine, or the cluster whose scheduler is at `address`.

    A part whose worker is killed is run again by another. Raises `ParameterError` where the extra is not installed, or
    where nobody answers at the address.
    """
    if address is not None and not re.fullmatch(r"(\w+://)?[^/\s]+:\d+", address):
        raise ParameterError(f"--cluster {address}: write tcp://host:8786")
    if address is None:
        require_memory(ParameterError, f"--workers {workers}: as many processes", WORKER * workers, "give fewer")
    try:
        from distributed import Client, LocalCluster, as_completed
    except ImportError:
        raise ParameterError("several workers need Dask: pip install 'diffdrive[cluster]'") from None

    def engine(plan: Plan, wanted: list[int], say: Say) -> Computed:
        text, question = to_text(asked), plan.question()
        where = f"--cluster {address}" if address else f"--workers {workers}"
        # workers of one machine share its cores; one of a cluster has its machine for itself
        devices = None if address else max(1, cores() // workers)
        room = contextlib.ExitStack()
        client = room.enter_context(_client(address)) if wanted and address else None

        def parts() -> Computed:
            if not wanted:
                return
            here = {"n_workers": workers, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
            with room:
                known = client or room.enter_context(Client(room.enter_context(LocalCluster(**here))))
                left, number = iter(wanted), {}

                def submitted() -> list[Any]:
                    """As many as the workers of this moment are short of: some join late, some go."""
                    short = AHEAD * max(1, len(known.nthreads()), workers) - len(number)
                    futures = []
                    for part in itertools.islice(left, max(0, short)):
                        future = known.submit(_part, text, question, devices, part, pure=False)
                        number[future] = part
                        futures.append(future)
                    return futures

                done = as_completed(submitted())
                while not done.is_empty():
                    _await(known, done, where, say)
                    future = next(done)
                    yield number.pop(future), future.result()
                    future.release()
                    done.update(submitted())

        def reported() -> Computed:
            try:
                yield from parts()
            except (CancelledError, OSError) as problem:
                if isinstance(problem, OSError) and problem.errno in FULL:
                    raise  # of this machine's disk: nobody is lost
                raise ParameterError(
                    f"{where} is lost ({problem}); the parts that were done are kept: the same command goes on there"
                ) from None

        return reported()

    return engine
