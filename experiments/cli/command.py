"""Commands that compute."""

import typer
from typer.core import TyperCommand

BETWEEN = "\x1f--"  # in the place of the -- between two lists of files: no file begins with that control character


class Computing(TyperCommand):
    """JAX is imported and set up when the command runs: a help text need not wait for it."""

    def invoke(self, ctx: typer.Context) -> object:  # type: ignore[override]  # the context that typer makes
        from diffdrive.runtime import configure

        configure()
        return super().invoke(ctx)


class Comparing(Computing):
    """A command of two lists of files with -- between them: options may stand after it, too."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # as above
        return super().parse_args(ctx, [BETWEEN if one == "--" else one for one in args])
