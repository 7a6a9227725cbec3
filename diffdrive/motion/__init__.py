"""Motions and loads: as functions, as one line of text, and from files."""
