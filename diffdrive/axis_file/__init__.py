"""The file that describes an axis."""
