"""The EMPS axis."""
