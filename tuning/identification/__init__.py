"""A drive from its logs."""
