"""Utilities of all packages: files, messages, units, processes, resources of this machine."""
