"""The formats of figures."""

from contextvars import ContextVar

# as which every report saves its figures; the options --svg and --pdf set it
figure_formats: ContextVar[tuple[str, ...]] = ContextVar("figure_formats", default=("png",))
