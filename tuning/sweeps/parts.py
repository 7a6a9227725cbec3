"""A sweep run part by part into a folder: bounded memory, and whatever was done before an interruption stays done."""

import contextlib
from collections.abc import Callable, Generator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from diffdrive.errors import ParameterError
from diffdrive.support.atomic_write import atomic_write
from tuning.sweeps.costs import part_costs
from tuning.sweeps.identity import identity
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.possible import require_possible

IDENTITY_KEY = b"diffdrive.sweep"
MachinesDone = Callable[[int], None]  # machines that were done by now
Notify = Callable[[str], None]  # what keeps an engine from beginning
ComputedParts = Generator[tuple[int, pa.Table], None, None]
Engine = Callable[[SweepPlan, list[int], Notify], ComputedParts]  # the wanted parts, in any order


def part_path(folder: Path, part: int) -> Path:
    """Where a part lies."""
    return folder / f"part-{part:06d}.parquet"


def write_part(table: pa.Table, path: Path, identity: str) -> None:
    """Write a part, whole or not at all, with the question that it answers."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        pq.write_table(table.replace_schema_metadata({IDENTITY_KEY: identity.encode()}), file)


def missing_parts(plan: SweepPlan, folder: Path) -> list[int]:
    """The parts that are not there yet.

    Raises `ParameterError` if what is there is of another sweep: nothing is overwritten.
    """
    question = identity(plan).encode()
    wanted = {part_path(folder, part): part for part in range(plan.parts)}
    for path in sorted(folder.glob("part-*.parquet")):
        stored_identity = _stored_identity(path)
        if stored_identity is None and path in wanted:
            continue  # damaged: it is run again
        if stored_identity != question or path not in wanted:
            raise ParameterError(
                f"{path}: is of another sweep, one that differs in drive, controllers, motions, what varies, number of "
                "machines or seed, in the version of diffdrive, jax, numpy or scipy, in processor, GPU or XLA_FLAGS: "
                "give another folder, or remove this one"
            )
        del wanted[path]
    return sorted(wanted.values())


def _stored_identity(path: Path) -> bytes | None:
    """The question that a part answers; None where nothing can be read."""
    try:
        return (pq.read_schema(path).metadata or {}).get(IDENTITY_KEY, b"")
    except (OSError, pa.ArrowInvalid):
        return None


def in_process(plan: SweepPlan, wanted: list[int], notify: Notify) -> ComputedParts:
    """The parts one after the other, in this process."""
    for part in wanted:
        yield part, part_costs(plan, part)


def _no_notice(_: str) -> None:
    pass


def run_parts(
    plan: SweepPlan, folder: Path, report: MachinesDone, engine: Engine = in_process, notify: Notify = _no_notice
) -> ds.Dataset:
    """All parts of a sweep in `folder`, those that are missing computed by `engine`; as a dataset of all rows."""
    question, remaining = identity(plan), missing_parts(plan, folder)
    require_possible(plan, remaining)
    finished = plan.samples - sum(part_length(plan, part) for part in remaining)
    report(finished)
    with contextlib.closing(engine(plan, remaining, notify)) as computed:  # a full disk leaves no workers behind
        for part, table in computed:
            write_part(table, part_path(folder, part), question)
            finished += part_length(plan, part)
            report(finished)
    return ds.dataset([str(part_path(folder, part)) for part in range(plan.parts)], format="parquet")


def stored_errors(plan: SweepPlan, folder: Path, number: int, controller: str, motion: str) -> list[float] | None:
    """RMS and peak error (m) of one run of the sweep in `folder`, and when it diverged (s; NaN if it did not).

    None where it is not there, or of another edition.
    """
    path = part_path(folder, number // plan.part_size)
    if _stored_identity(path) != identity(plan).encode():
        return None
    wanted = (pc.field("machine") == number) & (pc.field("controller") == controller) & (pc.field("motion") == motion)
    rows = pq.read_table(path, columns=["rms_m", "peak_m", "diverged_at_s"], filters=wanted).to_pylist()
    return [np.nan if value is None else value for value in rows[0].values()] if rows else None


def part_length(plan: SweepPlan, part: int) -> int:
    """How many machines a part has."""
    return min(plan.part_size, plan.samples - part * plan.part_size)
