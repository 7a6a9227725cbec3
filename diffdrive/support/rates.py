"""Whether two rates are one."""

RATE_TOLERANCE = 1e-6  # relative: what units and rounding make of one rate
CLOCK_TOLERANCE = 1e-3  # relative, of a recorded clock: crystals agree far better, wrong settings far worse


def is_same_rate(rate: float, nominal: float, tolerance: float = RATE_TOLERANCE) -> bool:
    """Whether `rate` (Hz) is the `nominal` one (Hz), but for a relative `tolerance`; never where one is no number."""
    return abs(rate / nominal - 1.0) <= tolerance
