"""The text beside the code of every target: what was exported, how it is imported, and how the bench is run."""

from collections.abc import Mapping, Sequence

from experiments.exports.program import Program
from experiments.exports.structured_text import ROWS
from experiments.exports.targets import Target
from experiments.exports.templates import rendered
from experiments.reports.report import version_of


def readme_files(
    target: Target,
    program: Program,
    *,
    axis_name: str,
    motion_name: str,
    steps: int,
    files: Sequence[str],
    tolerances: Mapping[str, float],
    differences: Mapping[str, float],
    notes: Sequence[str],
) -> Mapping[str, str]:
    """The readme by its name; `differences` are those that the bench printed here, if it ran."""
    text = rendered(
        target.readme,
        target=target,
        program=program,
        name=program.name,
        next_command=target.next_command(program.name),
        version=version_of("diffdrive"),
        axis_name=axis_name,
        motion_name=motion_name,
        steps=steps,
        most_rows=ROWS,
        files=files,
        compared=list(tolerances),
        tolerances=tolerances,
        differences=differences,
        notes=notes,
    )
    return {f"{program.name}_readme.txt": text}
