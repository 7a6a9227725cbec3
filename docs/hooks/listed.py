"""Entries of the reference for what a catalogue holds: a further effect or controller needs no line there.

A line `<!-- each effect of friction -->` or `<!-- each controller -->` becomes one entry for each of them.
"""

import inspect
import re

LINE = re.compile(r"^<!-- each ([\w ]+) -->$", re.M)
ENTRY = "::: {}\n    options: {{ heading_level: 3, members: false, show_root_full_path: false }}\n"


def listed(page: str) -> str:
    """A page with these entries; raises `KeyError` where there is nothing of that kind."""
    if not LINE.search(page):
        return page
    names = {**_effects(), **_controllers()}
    return LINE.sub(lambda line: "\n".join(map(ENTRY.format, names[line[1]])), page)


def _effects() -> dict[str, list[str]]:
    """Dotted names of the effects on each part of a machine; one that is not exported by that of its module."""
    from diffdrive import effects
    from diffdrive.effects.catalogue import effects_by_part

    return {
        f"effect of {part}": [
            f"{effects.__name__ if one.__name__ in effects.__all__ else one.__module__}.{one.__name__}" for one in here
        ]
        for part, here in effects_by_part().items()
    }


def _controllers() -> dict[str, list[str]]:
    """Dotted names of the controllers that are exported, and of their parts."""
    import equinox as eqx

    from diffdrive import controllers

    exported = {name: getattr(controllers, name) for name in controllers.__all__}
    models = {name: one for name, one in exported.items() if inspect.isclass(one) and issubclass(one, eqx.Module)}
    of_controllers = {name for name, one in models.items() if issubclass(one, controllers.Controller)}
    return {
        "controller": [f"{controllers.__name__}.{name}" for name in models if name in of_controllers - {"Controller"}],
        "part of a controller": [f"{controllers.__name__}.{name}" for name in models if name not in of_controllers],
    }
