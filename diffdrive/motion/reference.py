"""Every motion and shape of load with its settings, units and defaults, as their functions declare them."""

import inspect
from collections.abc import Callable, Iterator, Mapping

from diffdrive.motion.text import LISTS, LOAD_UNITS, LOADS, MOTION_UNITS, MOTIONS, PAIRS

COLUMNS = ("name", "settings", "that may be left out", "what")
_BY_DEFAULT = {
    "first_reversal": "stroke / speed + rounding / 2",
    "phases": "Schroeder's",
}  # where the default depends on other settings


def _setting(name: str, unit: str, default: object) -> str:
    list_prefix = "list of " if name in LISTS else "list of pairs of " if name in PAIRS else ""
    kind = list_prefix + ("whole number" if unit == "1" else unit)
    if default is inspect.Parameter.empty:
        return f"{name} ({kind})"
    return f"{name} ({kind}; {_BY_DEFAULT[name] if default is None else f'{default:g}'})"


def reference(builders: Mapping[str, Callable[..., object]], units: dict[str, str]) -> Iterator[tuple[str, ...]]:
    """Rows of `COLUMNS`, one for each name."""
    for name, builder in builders.items():
        settings: dict[bool, list[str]] = {False: [], True: []}
        for key, parameter in inspect.signature(builder).parameters.items():
            if key not in ("time", "rate"):
                optional = parameter.default is not inspect.Parameter.empty
                settings[optional].append(_setting(key, units[key], parameter.default))
        summary = inspect.cleandoc(builder.__doc__ or "").partition("\n\n")[0]
        yield name, ", ".join(settings[False]), ", ".join(settings[True]), " ".join(summary.split())


def markdown() -> str:
    """Both tables in Markdown."""
    tables = []
    for title, builders, units in (("motion", MOTIONS, MOTION_UNITS), ("load", LOADS, LOAD_UNITS)):
        rows = [(title, *COLUMNS[1:]), ("---",) * len(COLUMNS), *reference(builders, units)]
        tables.append("\n".join(f"| {' | '.join(row)} |" for row in rows) + "\n")
    return "\n".join(tables)
