"""Curves of a trace as small drawings in the page, from what `look` kept: the trace itself is not read again."""

import html
from collections.abc import Sequence

WIDTH, HEIGHT = 800, 100  # units of a drawing, which is stretched to its place

Points = Sequence[Sequence[float]]


def drawings(curves: Sequence[tuple[str, Points]]) -> str:
    """HTML with a strip for each named curve, least and greatest beside its name; a name is text, whatever it holds."""
    return "".join(_strip(name, points) for name, points in curves if points)


def _strip(name: str, points: Points) -> str:
    least, greatest = min(low for low, _ in points), max(high for _, high in points)
    span = greatest - least or 1.0

    def at(k: int, value: float) -> str:
        return f"{WIDTH * k / max(1, len(points) - 1):.1f},{HEIGHT - (value - least) / span * HEIGHT:.1f}"

    # up along the greatest and back along the least: a band where the signal is faster than a pixel, a line elsewhere
    around = [at(k, high) for k, (_, high) in enumerate(points)]
    around += [at(k, points[k][0]) for k in range(len(points) - 1, -1, -1)]
    text = html.escape(f"{name}: {least:.4g} to {greatest:.4g}", quote=True)
    return (
        f'<figure class="dd-strip"><figcaption>{text}</figcaption>'
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" preserveAspectRatio="none" role="img" aria-label="{text}">'
        f'<polygon points="{" ".join(around)}"/></svg></figure>'
    )
