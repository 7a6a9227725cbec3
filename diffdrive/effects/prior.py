"""Parameters of an effect with what an engineer would expect them to be: what the diagnosis needs besides the range."""

from typing import Any, NamedTuple

import equinox as eqx

from diffdrive.model.parameters import quantity


class Prior(NamedTuple):
    """What is expected of a parameter before any log is seen.

    An `amplitude` is normal about zero, with `usual` for its standard deviation, and the effect is gone at zero. Any
    other is positive, and normal in its logarithm about that of `usual`, with `spread` for the standard deviation:
    0.7 is a factor of two. One of the `session` differs from log to log, as phases and times do.
    """

    usual: float
    spread: float = 1.0
    amplitude: bool = False
    session: bool = False


def amplitude(unit: str, meaning: str, *, usual: float, session: bool = False) -> Any:
    """Declare how strong an effect is: a parameter that the effect is linear in, of either sign, and gone at zero.

    Args:
        unit: Of the parameter, in SI.
        meaning: What it is, in a few words.
        usual: What is common of machines: the standard deviation of what is expected.
        session: Whether it differs from log to log.

    """
    return _with(quantity(unit, meaning, default=0.0), Prior(usual, amplitude=True, session=session))


def positive(unit: str, meaning: str, *, usual: float, spread: float = 0.7, session: bool = False) -> Any:
    """Declare a positive parameter of an effect.

    Args:
        unit: Of the parameter, in SI.
        meaning: What it is, in a few words.
        usual: What is common of machines.
        spread: Of its logarithm: within a factor of exp(`spread`) of `usual` in two machines of three.
        session: Whether it differs from log to log.

    """
    return _with(quantity(unit, meaning, above=0.0, default=usual), Prior(usual, spread, session=session))


def _with(field: Any, prior: Prior) -> Any:
    return eqx.field(default=field.default, metadata=dict(field.metadata) | {"prior": prior})
