"""What an identification left open, as what a sweep varies: uncertainty.toml."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
import tomli_w

from diffdrive.errors import ParameterError
from diffdrive.support.atomic_write import write_text
from diffdrive.support.text_file import read_toml
from tuning.identification.estimates import EstimateStatus, ParameterEstimate
from tuning.identification.identify import Identification
from tuning.identification.parameters import parameter_at
from tuning.sweeps.varied import MAX_LOG_DEVIATION

FILE = "uncertainty.toml"

Correlation = Mapping[str, Mapping[str, float]]


class Distributions(NamedTuple):
    """Distributions by the name of a quantity, as `varied.parse_varied` takes them, and correlations of pairs."""

    vary: Mapping[str, str]
    correlation: Correlation


def uncertainty(found: Identification) -> Distributions:
    """Each fitted parameter's distribution by its name in a drive, and the correlations between them.

    One that is known only in a sum varies as the sum does: its other part stays as in the drive.
    """
    kept = [
        k
        for k, one in enumerate(found.estimates)
        if one.status in (EstimateStatus.FITTED, EstimateStatus.IN_A_SUM)
        and parameter_at(one.path).in_drive
        and found.estimate_covariance[k, k] > 0.0
    ]
    deviation = np.sqrt(np.diag(found.estimate_covariance))
    vary = {found.estimates[k].path: _distribution(found.estimates[k], float(deviation[k])) for k in kept}
    correlation: dict[str, dict[str, float]] = {}
    for at, k in enumerate(kept):
        others = {
            found.estimates[j].path: float(
                np.clip(found.estimate_covariance[k, j] / (deviation[k] * deviation[j]), -1.0, 1.0)
            )
            for j in kept[at + 1 :]
        }
        if others:  # all of them, and with all digits: of nearly determined pairs no other numbers are possible
            correlation[found.estimates[k].path] = others
    return Distributions(vary, correlation)


def _distribution(one: ParameterEstimate, deviation: float) -> str:
    unit = "" if one.unit == "1" else f" {one.unit}"
    if parameter_at(one.path).is_signed or one.value <= 0.0:
        return f"normal:{one.value:.10g}{unit}..{deviation:.6g}{unit}"
    # beyond that nothing is known of it but that it is positive, and a sweep takes no wider one
    return f"lognormal:{one.value:.10g}{unit}..{100.0 * min(deviation / one.value, MAX_LOG_DEVIATION):.6g}%"


def write_uncertainty(folder: Path, found: Identification) -> None:
    """As a file."""
    write_text(folder / FILE, tomli_w.dumps(uncertainty(found)._asdict()))


def read_uncertainty(path: Path) -> Distributions:
    """What an identification left open: its file uncertainty.toml."""
    tables = read_toml(path, ParameterError, "`diffdrive identify --out FOLDER` writes it")
    if "vary" not in tables:
        raise ParameterError(f"{path}: is no uncertainty.toml of an identification: it has no table [vary]")
    try:
        correlations = cast(Correlation, tables.get("correlation", {}))
        return Distributions(
            {name: str(text) for name, text in cast(Mapping[str, str], tables["vary"]).items()},
            {quantity: {other: float(value) for other, value in of.items()} for quantity, of in correlations.items()},
        )
    except (AttributeError, TypeError, ValueError, OverflowError) as problem:
        raise ParameterError(f"{path}: is no uncertainty.toml of an identification: {problem}") from None
