"""Whether two rates are one."""

from diffdrive.errors import ParameterError

RATE_TOLERANCE = 1e-6  # relative: what units and rounding make of one rate
CLOCK_TOLERANCE = 1e-3  # relative, of a recorded clock: crystals agree far better, wrong settings far worse


def is_same_rate(rate: float, nominal: float, tolerance: float = RATE_TOLERANCE) -> bool:
    """Whether `rate` (Hz) is the `nominal` one (Hz), but for a relative `tolerance`; never where one is no number."""
    return abs(rate / nominal - 1.0) <= tolerance


def require_same_rate(name: str, rate: float, nominal_name: str, nominal: float) -> None:
    """Raise `ParameterError` unless two parts of a loop, as messages call them, are sampled at one rate (Hz)."""
    if not is_same_rate(rate, nominal):
        raise ParameterError(
            f"{name}: is sampled at {rate:.10g} Hz, {nominal_name} at {nominal:.10g} Hz: delays are given in samples: "
            "make the rates equal"
        )
