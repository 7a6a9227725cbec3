"""Time stamps to a uniform clock."""
