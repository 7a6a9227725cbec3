"""Machines of an axis whose parameters are known as far as an identification left them."""

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import PyTree

from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import node_at
from diffdrive.model.uncertainty import Uncertainty
from tuning.sweeps.identified import about_nominal
from tuning.sweeps.machines import machines
from tuning.sweeps.samples import correlate, correlation_root
from tuning.sweeps.varied import parse_varied


def uncertain_values(
    drive: Drive, uncertainty: Uncertainty, generators: Sequence[np.random.Generator]
) -> list[dict[str, PyTree]]:
    """What is uncertain of a drive, by path, once for each generator: drawn about its values, as a sweep draws it."""
    distributions = about_nominal(uncertainty)
    varied = [parse_varied(f"{name}={text}", drive) for name, text in distributions.vary.items()]
    shares = np.array([rng.random(len(varied)) for rng in generators]).reshape(-1, len(varied))
    root = correlation_root(distributions.correlation, uncertainty.names)
    drawn = machines(drive, varied, shares if root is None else correlate(shares, root))[0]
    found = {name: node_at(drawn, name) for name in uncertainty.names}
    return [jax.tree.map(lambda values, k=k: float(values[k]), found) for k in range(len(generators))]
