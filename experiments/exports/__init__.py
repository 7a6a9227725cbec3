"""A controller as code for its target, from the step that is simulated."""
