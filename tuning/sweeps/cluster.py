"""The parts of a sweep on many machines, by Dask distributed.

Dask, not Ray: it is Python throughout, a worker is one command on any machine, it runs a lost worker's tasks again by
itself, and every batch system has a launcher for it. It is the package's extra `cluster`.
"""

import itertools
import re
import time
from concurrent.futures import CancelledError
from typing import Any

from diffdrive.errors import ParameterError
from diffdrive.support.atomic_write import NO_SPACE
from tuning.sweeps.identity import identity
from tuning.sweeps.parts import ComputedParts, Engine, Notify
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.spec import SweepSpec, to_text
from tuning.sweeps.workers import run_part

CONNECTION_TIMEOUT = 20.0  # s, the scheduler at an address
POLLING_PERIOD = 2.0  # s, between two looks at who is there
PARTS_PER_WORKER = 3  # parts for each worker that the scheduler knows of: it holds what it is given


def _client(address: str) -> Any:
    from distributed import Client

    try:
        return Client(address, timeout=CONNECTION_TIMEOUT)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as problem:  # ValueError: a scheme that Dask does not know
        raise ParameterError(f"cluster {address}: no scheduler answers there ({problem})") from None


def _wait(client: Any, done: Any, place: str, notify: Notify) -> None:
    """Until a part is done, saying once if nobody is there to do it."""
    notified, checked = False, 0.0
    while not done.has_ready():
        if time.monotonic() - checked > POLLING_PERIOD:
            checked = time.monotonic()
            if client.nthreads():
                notified = False
            elif not notified:
                notified = True
                notify(f"waiting for workers: {place} has none; start some as `dask worker {client.scheduler.address}`")
        time.sleep(0.02)


def _nothing() -> ComputedParts:
    yield from ()


def on_cluster(spec: SweepSpec, address: str) -> Engine:
    """An engine for `parts.run_parts`: the cluster whose scheduler is at `address`.

    A part whose worker is killed is run again by another. Raises `ParameterError` where the extra is not installed,
    where nobody answers at the address, and where the sweep cannot be sent to the workers.
    """
    if not re.fullmatch(r"(\w+://)?[^/\s]+:\d+", address):
        raise ParameterError(f"cluster {address}: write tcp://host:8786")
    try:
        from distributed import as_completed
    except ImportError:
        raise ParameterError("cluster: needs Dask: pip install 'diffdrive[cluster]'") from None

    text = to_text(spec)

    def engine(plan: SweepPlan, wanted: list[int], notify: Notify) -> ComputedParts:
        question = identity(plan)
        place = f"cluster {address}"
        if not wanted:
            return _nothing()
        client = _client(address)

        def parts() -> ComputedParts:
            with client:
                waiting, part_of = iter(wanted), dict[Any, int]()

                def submitted() -> list[Any]:
                    """As many as the workers of this moment are short of: some join late, some go."""
                    missing = PARTS_PER_WORKER * max(1, len(client.nthreads())) - len(part_of)
                    futures = []
                    for part in itertools.islice(waiting, max(0, missing)):
                        future = client.submit(run_part, text, question, None, part, pure=False)
                        part_of[future] = part
                        futures.append(future)
                    return futures

                done: Any = as_completed(submitted())  # type: ignore[no-untyped-call]
                while not done.is_empty():
                    _wait(client, done, place, notify)
                    future = next(done)
                    yield part_of.pop(future), future.result()
                    future.release()
                    done.update(submitted())

        def reported() -> ComputedParts:
            try:
                yield from parts()
            except (CancelledError, OSError) as problem:
                if isinstance(problem, OSError) and problem.errno in NO_SPACE:
                    raise  # of this machine's disk: nobody is lost
                raise ParameterError(
                    f"{place} is lost ({problem}); the parts that were done are kept: the same sweep goes on there"
                ) from None

        return reported()

    return engine
