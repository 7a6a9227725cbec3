"""A signal that is known only now and then, as lines that can be seen."""

import numpy as np
from jaxtyping import Float

PIXELS = 1000  # across a chart: 1024 px on a wide screen, 1050 at 150 dpi on paper
SEEN = 2  # pixels: a narrower blank is lost between two lines of one pixel


def as_lines(
    time: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"], span: float
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """The known values over time, on an axis of length `span`, blank in between.

    A line goes on over a blank that nobody could see, and a lone sample, which would be no line, is a pixel long.
    """
    known = np.isfinite(values)
    t, v, pixel = time[known], values[known], span / PIXELS
    breaks = np.flatnonzero(np.diff(t) > SEEN * pixel) + 1
    blank = np.array([np.nan])
    times, lines = list[np.ndarray](), list[np.ndarray]()
    for some, own in zip(np.split(t, breaks), np.split(v, breaks), strict=True):
        if some.size and some[-1] - some[0] < pixel:
            some, own = np.append(some, some[0] + pixel), np.append(own, own[-1])
        times += [some, blank]
        lines += [own, blank]
    return np.concatenate(times), np.concatenate(lines)
