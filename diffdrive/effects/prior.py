"""Parameters of an effect with their prior distribution, which the diagnosis needs."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx

from diffdrive.model.quantity import quantity


class Prior(NamedTuple):
    """The prior distribution of a parameter.

    An `amplitude` is normal about zero with standard deviation `usual`, and the effect vanishes at zero. Any other is
    positive and log-normal about `usual`, with standard deviation `spread` of the logarithm: 0.7 is a factor of two.
    A parameter of the `session` differs from log to log, as phases and times do.
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
    return _with_prior(quantity(unit, meaning, default=0.0), Prior(usual, amplitude=True, session=session))


def positive(unit: str, meaning: str, *, usual: float, spread: float = 0.7, session: bool = False) -> Any:
    """Declare a positive parameter of an effect.

    Args:
        unit: Of the parameter, in SI.
        meaning: What it is, in a few words.
        usual: What is common of machines.
        spread: Of its logarithm: within a factor of exp(`spread`) of `usual` in two machines of three.
        session: Whether it differs from log to log.

    """
    return _with_prior(quantity(unit, meaning, above=0.0, default=usual), Prior(usual, spread, session=session))


def _with_prior(field: dataclasses.Field[Any], prior: Prior) -> Any:
    return eqx.field(default=field.default, metadata=dict(field.metadata) | {"prior": prior})
