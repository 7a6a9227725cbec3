"""The commands that print a reference text: template, axes, keys, motions."""

from typing import Annotated

import typer

from experiments.cli.options import Out
from experiments.cli.texts import cached, text

reference = typer.Typer()


@reference.command()
def template(
    out: Out = None,
    controller: Annotated[
        str, typer.Option(help="Its controller: pd+fc+ls, cascade (as most CNCs), pd, or another of the paper's.")
    ] = "pd+fc+ls",
) -> None:
    """Print a complete drive file, the paper's testbed, to start from; with --out, write it as drive.toml.

    Its friction observer estimates the load at every speed. `--controller cascade` is the loop of most CNCs,
    `--controller pd+fc+le` the paper's own.
    """
    from experiments.cli.template import template as text_of

    text(
        lambda: text_of(controller), out, "drive.toml",
        f"a complete drive file, the paper's testbed under the controller {controller}, to edit for an axis of yours",
    )  # fmt: skip


@reference.command()
def axes(
    name: Annotated[
        str | None, typer.Argument(help="An axis whose drive file to print.", metavar="[NAME]", show_default=False)
    ] = None,
    out: Out = None,
) -> None:
    """List the axes of the library (a Markdown table), or print the drive file of one; with --out, write it.

    Every command takes an axis of the library by its name where it takes a drive file. Further ones are the drive files
    in the folders that the environment variable DIFFDRIVE_AXES names.

    Example: `diffdrive simulate gantry`, or to change it `diffdrive axes gantry > mine.toml`
    """
    from diffdrive.library.listing import library_axis, markdown

    if name is None:
        text(markdown, out, "axes.md", "a table of the axes of the library")
    else:
        text(library_axis(name).text, out, f"{name}.toml", f"the drive file of {name}, an axis of the library")


@reference.command()
def keys(out: Out = None) -> None:
    """Print every key that a drive file may hold, with unit, range, default and meaning (a Markdown table)."""
    text(
        lambda: cached(_keys, "keys.md"),
        out,
        "keys.md",
        "every key of a drive file, with its unit, range, default and meaning",
    )


def _keys() -> str:
    from diffdrive.axis_file.reference import markdown

    return markdown()


@reference.command()
def motions(out: Out = None) -> None:
    """Print every motion and every shape of load, with settings, units and defaults (two Markdown tables)."""
    text(
        lambda: cached(_motions, "motions.md"),
        out,
        "motions.md",
        "every motion and shape of load, with settings, units and defaults",
    )


def _motions() -> str:
    from diffdrive.motion.reference import markdown

    return markdown()
