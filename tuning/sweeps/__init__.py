"""Monte Carlo: how often an axis misses its tolerance over the loads, drives and disturbances that it will meet."""
