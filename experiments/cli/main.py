"""The `diffdrive` command."""

import sys
import warnings
from collections.abc import Callable
from typing import Annotated

import typer
from rich.console import Console

from diffdrive.support.atomic_write import NO_SPACE
from diffdrive.support.messages import printable
from experiments.cli.app import page
from experiments.cli.drives import drives
from experiments.cli.ending import INTERRUPTED, out_folder, watch_signals
from experiments.cli.logs import logs
from experiments.cli.reference import reference
from experiments.cli.studies import studies
from experiments.cli.sweeps import sweeps

STAYS = "and what was written so far stays"

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _say_version(requested: bool) -> None:
    if requested:
        from experiments.reports.report import version_of

        sys.stdout.write(f"diffdrive {version_of('diffdrive')}\n")
        raise typer.Exit


@app.callback()
def everywhere(
    version: Annotated[
        bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Simulate, tune, identify and diagnose a machine-tool feed drive.

    Start with `diffdrive demo`, or with an axis of the library, `diffdrive simulate gantry`; then `diffdrive template >
    drive.toml`, edit it, `diffdrive simulate drive.toml`. With a log of your machine: `diffdrive start lap.csv`, then
    `identify` and `diagnose`.
    """


def _plain_warning(error: Console) -> Callable[..., None]:
    def show(message: Warning | str, *_: object, **__: object) -> None:
        error.print(f"warning: {printable(str(message))}", style="yellow", soft_wrap=True)

    return show


for group in (drives, logs, page, reference, sweeps, studies):  # in the order of the help text
    app.add_typer(group)


def main() -> None:
    """Run the command line: expected errors in one line, without a traceback, and code 2."""
    error = Console(stderr=True, markup=False, emoji=False, highlight=False)
    warnings.showwarning = _plain_warning(error)
    with watch_signals(out_folder(sys.argv[1:])) as watch:
        try:
            _expected(error)
        except SystemExit as ended:
            # typer makes that code of a Ctrl-C, and a search ends on it with its best; threads may go on computing
            if ended.code == INTERRUPTED or (watch.received_at is not None and not ended.code):
                watch.leave(STAYS)
            raise
        except RuntimeError as problem:
            # of what its Python callbacks raise, jax's compiler (MLIR) keeps the text alone, of a Ctrl-C, too
            if watch.raised and "KeyboardInterrupt" in str(problem):
                watch.leave(STAYS)
            raise


def _expected(error: Console) -> None:
    """The command line; what may be expected to fail in one line."""
    from diffdrive.errors import DiffdriveError

    try:
        app()
    except DiffdriveError as problem:
        error.print(f"error: {problem}", style="red", soft_wrap=True)
        sys.exit(2)
    except OSError as problem:
        if problem.errno not in NO_SPACE:
            raise
        error.print(
            "error: no room is left on the disk: make some, or name another folder; what was written so far stays, and "
            "where a sweep, a search or a study was under way the same command goes on",
            style="red", soft_wrap=True,
        )  # fmt: skip
        sys.exit(2)
