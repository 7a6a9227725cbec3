"""How well identification recovers what is known."""
