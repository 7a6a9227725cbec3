"""diffdrive: a differentiable simulator of a machine-tool feed drive and its friction compensation."""
