"""A machine of an axis whose parameters are known as far as an identification left them."""

import numpy as np

from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import node_at, with_nodes
from diffdrive.model.uncertainty import Uncertainty
from tuning.sweeps.identified import about_nominal
from tuning.sweeps.machines import lane, machines
from tuning.sweeps.samples import correlate, correlation_root
from tuning.sweeps.varied import parse_varied


def with_uncertain(machine: Drive, nominal: Drive, uncertainty: Uncertainty, rng: np.random.Generator) -> Drive:
    """The machine with what is uncertain drawn about its nominal values, as a sweep draws it; the rest stays."""
    distributions = about_nominal(uncertainty)
    varied = [parse_varied(f"{name}={text}", nominal) for name, text in distributions.vary.items()]
    shares = rng.random((1, len(varied)))
    root = correlation_root(distributions.correlation, uncertainty.names)
    shares = shares if root is None else correlate(shares, root)
    before = with_nodes(machine, {name: node_at(nominal, name) for name in uncertainty.names})
    return lane(machines(before, varied, shares)[0], 0)
