"""What varies in a sweep from what a user gives: quantities one by one, all of them together, or an identification."""

from collections.abc import Iterable, Mapping

from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import quantities
from diffdrive.model.uncertainty import MAX_LOG_DEVIATION
from diffdrive.motion.text import share
from tuning.sweeps.identified import Distributions
from tuning.sweeps.varied import known_quantities

DEFAULT_SPREAD = 0.02


def all_that_varies(
    drive: Drive, vary: Mapping[str, str], spread: str | float | None, identified: Distributions | None
) -> Distributions:
    """The distribution of each quantity that varies about a drive, and the correlations between them.

    What is given for itself goes before what was identified, and both before the spread. Where nothing is given, all
    parameters of plant and friction vary by a little.
    """
    distributions, correlation = dict(vary), {}
    if identified is not None:
        own = set(distributions)
        distributions |= {
            name: text for name, text in identified.vary.items() if not any(_overlap(name, other) for other in own)
        }
        left = set(distributions) - own
        correlation = {
            quantity: {other: value for other, value in others.items() if other in left}
            for quantity, others in identified.correlation.items()
            if quantity in left
        }
    if spread is not None or not distributions:
        deviation = DEFAULT_SPREAD if spread is None else share(spread, "spread", at_most=MAX_LOG_DEVIATION)
        distributions |= dict.fromkeys(_not_varied(drive, distributions), f"lognormal:{100.0 * deviation:.12g}%")
    return Distributions(distributions, correlation)


def _overlap(name: str, other: str) -> bool:
    """Whether they are the same quantity, or one is a direction of the other."""
    return name == other or name in _sides(other) or other in _sides(name)


def _sides(name: str) -> list[str]:
    return [f"{name}.positive", f"{name}.negative"]


def _not_varied(drive: Drive, varied: Iterable[str]) -> list[str]:
    """Every plant and friction parameter of the drive that is not varied yet; both directions alike, unless one of them
    is.
    """
    taken, known = set(varied), known_quantities(drive)
    names = [name for name, _, _ in quantities(drive) if name.startswith(("plant.", "friction."))]
    left = [quantity for name in names for quantity in (_sides(name) if taken & {*_sides(name)} else [name])]
    return [name for name in left if name not in taken and known[name].is_scalable]
