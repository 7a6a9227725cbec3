"""The Python API and the command line: the paper, tuning, sweeps, real logs."""
