"""Everything that fits the parameters of a drive or its controller to something."""
