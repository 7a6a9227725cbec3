"""Lee et al. 2015, ours beside theirs."""
