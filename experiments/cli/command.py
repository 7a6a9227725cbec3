"""A command that computes."""

import typer
from typer.core import TyperCommand


class Computing(TyperCommand):
    """JAX is imported and set up when the command runs: a help text need not wait for it."""

    def invoke(self, ctx: typer.Context) -> object:  # type: ignore[override]  # the context that typer makes
        from diffdrive.runtime import configure

        configure()
        return super().invoke(ctx)
