"""What varies in a sweep from what a user gives: quantities one by one, all of them together, or an identification."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.errors import ParameterError
from diffdrive.model.quantity import quantities
from diffdrive.motion.text import number
from tuning.sweeps.identified import Correlation, read_uncertainty
from tuning.sweeps.varied import MAX_LOG_DEVIATION, known_quantities

DEFAULT_SPREAD = "2%"


def varied_texts(
    drive: Path, vary: Sequence[str], spread: str | None, identified: Path | None
) -> tuple[tuple[str, ...], Correlation]:
    """The texts of `varied.parse_varied` for a drive file, and the correlations between them.

    What is given for itself goes before what was identified, and both before the spread. Where nothing is given, all
    parameters of plant and friction vary by a little.
    """
    texts, correlation = list(vary), {}
    if identified is not None:
        known, correlations = read_uncertainty(identified)
        own = _names(texts)
        texts += [text for text in known if not any(_overlap(name, other) for name in _names([text]) for other in own)]
        left = _names(texts) - own
        correlation = {
            quantity: {other: value for other, value in others.items() if other in left}
            for quantity, others in correlations.items()
            if quantity in left
        }
    if spread is not None or not texts:
        texts += _spread(drive, spread or DEFAULT_SPREAD, texts)
    return tuple(texts), correlation


def _names(texts: Sequence[str]) -> set[str]:
    """The quantities of these texts."""
    return {text.partition("=")[0].strip() for text in texts}


def _overlap(name: str, other: str) -> bool:
    """Whether they are the same quantity, or one is a direction of the other."""
    return name == other or name in _sides(other) or other in _sides(name)


def _sides(name: str) -> list[str]:
    return [f"{name}.positive", f"{name}.negative"]


def _spread(drive: Path, spread: str, there: Sequence[str]) -> list[str]:
    """Every plant and friction parameter of the drive file that is not varied yet; both directions alike, unless one of
    them is.
    """
    try:
        share = float(spread.removesuffix("%")) / (100.0 if spread.endswith("%") else 1.0)
    except ValueError:
        share = np.nan
    if not 0.0 < share <= MAX_LOG_DEVIATION:
        raise ParameterError(
            f"--spread {spread}: give a share above 0 and up to {MAX_LOG_DEVIATION:.0%}, as 3% or 0.03"
        )
    percent = f"{100.0 * share:.12g}%"
    taken = _names(there)
    axis = read_axis(drive).drive
    known = known_quantities(axis)
    names = [name for name, _, _ in quantities(axis) if name.startswith(("plant.", "friction."))]
    left = [quantity for name in names for quantity in (_sides(name) if taken & {*_sides(name)} else [name])]
    return [f"{name}=lognormal:{percent}" for name in left if name not in taken and known[name].is_scalable]


def tolerance_of(text: str | None) -> float | None:
    """A tolerance in m, above zero."""
    if text is None:
        return None
    if not text.strip()[-1:].isalpha():
        raise ParameterError(f"--tolerance {text}: give it with its unit, as 2um")
    value = number(text, "m", "--tolerance")
    if not value > 0.0:
        raise ParameterError(f"--tolerance {text}: must be above zero")
    return value
