"""The command that serves the local page."""

from pathlib import Path
from typing import Annotated

import typer

from diffdrive.errors import ParameterError
from experiments.cli.options import parse_folder

page = typer.Typer()


@page.command("app")
def app_page(
    folder: Annotated[
        Path | None,
        typer.Option(
            parser=parse_folder,
            metavar="PATH",
            help="Folder for files and results; by default one in the user's data folder.",
        ),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0: that of the last time, or a free one.")] = 0,
    show: Annotated[bool, typer.Option("--show/--no-show", help="Open the page in the browser.")] = True,
) -> None:
    """Serve a page on this machine: drop traces, choose columns, check, identify, diagnose and compare.

    It runs the same commands, with the same reports and files. Only this machine's own user reaches it, at the address
    that is printed. What was dropped, and each run, stands in one folder: runs that were interrupted go on from there.
    Needs `pip install 'diffdrive[app]'`.

    Example: `diffdrive app --folder spindle-axis`
    """
    import importlib.util
    import os
    import sys

    missing = [name for name in ("nicegui", "uvicorn") if importlib.util.find_spec(name) is None]
    if missing:
        raise ParameterError(
            f"app: the page needs a package that is not installed here ({missing[0]}): pip install 'diffdrive[app]'"
        )
    import platformdirs

    from experiments.app.web.server import serve
    from experiments.app.workspace import AppError, Workspace

    try:
        serve(Workspace(folder or Path(platformdirs.user_data_dir("diffdrive", appauthor=False)) / "app"), port, show)
    except AppError as problem:
        raise ParameterError(str(problem)) from None
    except KeyboardInterrupt:  # its ordinary end: the last words of a command that was interrupted do not suit it
        sys.stdout.flush()
        os._exit(0)
